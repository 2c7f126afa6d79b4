"""Silences messages of LeRobot and its libraries that a user cannot act on."""

from __future__ import annotations

import logging
import os


def quiet_environment() -> None:
    """Set environment variables that the libraries read on import.

    Values that the user has set are kept. Look-ups on the Hugging Face Hub are off.
    """
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    os.environ.setdefault("TQDM_DISABLE", "1")
    os.environ.setdefault("SVT_LOG", "1")
    # A worker that is stopped in an episode leaves a semaphore of tqdm's. Python's resource tracker removes it, with a
    # long warning.
    filters = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [filters, "ignore:resource_tracker"]))


def quiet_lerobot() -> None:
    """Silence the informative messages of LeRobot and of the video libraries."""
    from av import logging as av_logging

    logging.getLogger("lerobot").setLevel(logging.ERROR)
    av_logging.set_libav_level(av_logging.ERROR)
