"""Off-screen pictures of scenes.

Every episode has its own model. A `SceneRenderer` keeps one OpenGL context for all of them and uploads a model only
when it changes.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from jaxtyping import UInt8

from regrasp_gym.errors import DisplayError
from regrasp_gym.rendering.setting import GOAL_GROUP

_LEFT_OPEN: list[tuple[Any, mujoco.MjrContext | None]] = []
"""Contexts of renderers dropped without `SceneRenderer.close`; the next picture frees them."""


def _free(gl: Any, context: mujoco.MjrContext | None) -> None:
    gl.make_current()
    if context is not None:
        context.free()
    gl.free()


class SceneRenderer:
    """Pictures of one model after another, with one OpenGL context.

    Args:
        width, height: size of the largest picture, pixels.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._gl: Any = None
        self._model: mujoco.MjModel | None = None
        self._context: mujoco.MjrContext | None = None
        self._scene: mujoco.MjvScene | None = None
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0

    def render(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        camera: str,
        width: int,
        height: int,
        *,
        show_goal: bool = False,
    ) -> UInt8[np.ndarray, "H W 3"]:
        """A picture from a named camera, rows from top to bottom.

        Args:
            model, data: the simulation, with body poses up to date.
            camera: name of the camera.
            width, height: size of the picture, pixels.
            show_goal: whether to show geoms of group `GOAL_GROUP`.

        Raises:
            DisplayError: OpenGL is not available.
            KeyError: unknown camera; the message lists the known ones.
        """
        while _LEFT_OPEN:
            _free(*_LEFT_OPEN.pop())
        if self._gl is None:
            self._gl = _open_gl(self.width, self.height)
        self._gl.make_current()
        if model is not self._model:
            self._upload(model)
        assert self._scene is not None, "uploading a model makes its scene"
        view = mujoco.MjvCamera()
        view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        view.fixedcamid = model.camera(camera).id
        self._option.geomgroup[:] = [group < 3 or (show_goal and group == GOAL_GROUP) for group in range(6)]
        mujoco.mjv_updateScene(model, data, self._option, None, view, mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        rect = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(rect, self._scene, self._context)
        picture = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, rect, self._context)
        return np.ascontiguousarray(picture[::-1])

    def __del__(self, is_finalizing: Callable[[], bool] = sys.is_finalizing) -> None:
        # MuJoCo would free the memory in the current context, which may be another renderer's. The garbage collector
        # runs at any time, even while another renderer draws.
        if self._gl is not None and not is_finalizing():
            _LEFT_OPEN.append((self._gl, self._context))

    def close(self) -> None:
        """Free the context; the next picture opens a new one."""
        if self._gl is not None:
            _free(self._gl, self._context)
            self._gl = self._context = self._scene = self._model = None

    def _upload(self, model: mujoco.MjModel) -> None:
        if self._context is not None:
            self._context.free()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_resizeOffscreen(self.width, self.height, self._context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 200)
        self._model = model


def halved(picture: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H2 W2 3"]:
    """The picture at half its width and height, each pixel the mean of four, which smooths edges."""
    h, w = picture.shape[:2]
    return picture.reshape(h // 2, 2, w // 2, 2, 3).mean(axis=(1, 3)).astype(np.uint8)


def _open_gl(width: int, height: int) -> Any:
    backend = os.environ.get("MUJOCO_GL", "default")
    try:
        # MuJoCo chose its backend when it was imported, perhaps before this package could.
        if backend == "egl":
            from mujoco.egl import GLContext
        elif backend == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco import GLContext
        return GLContext(width, height)
    except Exception as error:
        raise DisplayError(
            f"no OpenGL for off-screen pictures (MUJOCO_GL={backend}: {error}); install Mesa's software EGL "
            "(Debian and Ubuntu: libegl1 libgl1-mesa-dri) and set MUJOCO_GL=egl, or use obs_type='state' and no "
            "render_mode"
        ) from error
