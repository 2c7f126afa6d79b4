"""LeRobot and the libraries below it print a great deal; here only what a user can act on gets through."""

from __future__ import annotations

import logging
import os


def quiet_environment() -> None:
    """Set the environment variables that have to be there before the libraries are imported.

    What the user has set stays as it is. Nothing here looks anything up on the Hugging Face Hub.
    """
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    os.environ.setdefault("TQDM_DISABLE", "1")
    os.environ.setdefault("SVT_LOG", "1")


def quiet_lerobot() -> None:
    """Silence the informative messages of LeRobot and of the video libraries."""
    from av import logging as av_logging

    logging.getLogger("lerobot").setLevel(logging.ERROR)
    av_logging.set_libav_level(av_logging.ERROR)
