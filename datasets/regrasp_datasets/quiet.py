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
    # A worker that is ended in the middle of an episode leaves a semaphore of tqdm's behind; Python's resource tracker
    # removes it and says so at length.
    filters = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [filters, "ignore:resource_tracker"]))


def quiet_lerobot() -> None:
    """Silence the informative messages of LeRobot and of the video libraries."""
    from av import logging as av_logging

    logging.getLogger("lerobot").setLevel(logging.ERROR)
    av_logging.set_libav_level(av_logging.ERROR)
