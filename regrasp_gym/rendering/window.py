"""An interactive window on the simulation."""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import Any

import mujoco

from regrasp_gym.errors import DisplayError


class Window:
    """An interactive window on the simulation in real time, MuJoCo's passive viewer.

    Args:
        period: least time between two states shown, seconds.

    Raises:
        DisplayError: no display.
    """

    def __init__(self, period: float) -> None:
        if not has_display():
            raise DisplayError(
                "render_mode='human' needs a display, but neither DISPLAY nor WAYLAND_DISPLAY is set; "
                "use render_mode='rgb_array'"
            )
        self._period = period
        self._shown = 0.0
        self._handle: Any = None
        self._threads: set[threading.Thread] = set()
        self._model: mujoco.MjModel | None = None

    def show(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Show the current state; a new model opens a new window."""
        if model is not self._model or not self._handle.is_running():
            self.close()
            import mujoco.viewer  # Loads GLFW, which only windows need.

            before = set(threading.enumerate())
            self._handle = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
            self._threads = set(threading.enumerate()) - before
            self._model = model
        self._handle.sync()
        time.sleep(max(0.0, self._shown + self._period - time.monotonic()))
        self._shown = time.monotonic()

    def close(self) -> None:
        """Close the window."""
        if self._handle is not None:
            self._handle.close()
            # The viewer closes in its own threads; the interpreter crashes if it exits before they do.
            for thread in self._threads:
                thread.join(timeout=5.0)
            self._handle = self._model = None


def has_display() -> bool:
    """Whether this machine can open windows."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
