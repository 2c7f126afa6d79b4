"""Light, floor, materials and cameras of a scene, and pictures of it.

Every episode has a model of its own. A `SceneRenderer` keeps one OpenGL context for all of them and only uploads the
model anew when it changes.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from regrasp_gym.errors import DisplayError

SHADOW_SIZE = 512
"""Edge of the shadow map in pixels. With MuJoCo's 4096 a software-rendered frame takes many times as long."""

GOAL_GROUP = 5
"""Geoms of this group show the goal. They are in pictures for people, never in observations."""

GOAL_RGBA = (0.25, 0.85, 0.4, 0.35)


@dataclass(frozen=True)
class Camera:
    """A camera fixed in the world.

    Attributes:
        name: by which it is asked for.
        position: metres, world.
        target: the point it looks at, metres, world.
        fovy: vertical field of view, degrees.
    """

    name: str
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    fovy: float = 45.0

    def axes(self) -> Float[np.ndarray, " 6"]:
        """Its x axis (right) and y axis (up) in the world."""
        forward = np.subtract(self.target, self.position)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        return np.concatenate([right, up / np.linalg.norm(up)])


@dataclass(frozen=True)
class Material:
    """What a fixture looks like.

    Attributes:
        texture: makes the (H, W, 3) picture; None for an even surface.
        repeat: repetitions per metre.
        rgba: colour, multiplied with the texture.
        specular, shininess: in [0, 1].
    """

    texture: Callable[[np.random.Generator], UInt8[np.ndarray, "H W 3"]] | None = None
    repeat: float = 1.0
    rgba: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    specular: float = 0.1
    shininess: float = 0.2


def wood(
    rng: np.random.Generator, light: tuple[int, int, int], dark: tuple[int, int, int], size: int = 256
) -> UInt8[np.ndarray, "H W 3"]:
    """Planks along the texture's width, with grain, seamless in both directions."""
    v, u = np.meshgrid(*[np.arange(size) / size] * 2, indexing="ij")
    planks = 4
    plank = np.floor(v * planks).astype(int)
    shade = rng.uniform(-0.12, 0.12, planks)[plank]
    shift = rng.uniform(0, 1, planks)[plank]
    wave = 0.25 * np.sin(2 * np.pi * (u + shift)) + 0.1 * np.sin(2 * np.pi * (3 * u + 2 * shift))
    grain = 0.5 + 0.5 * np.sin(2 * np.pi * (7 * planks * v + wave + 5 * shift))
    fibre = rng.normal(size=(size, size))
    spectrum = np.fft.fft2(fibre) * np.exp(-((np.fft.fftfreq(size) * 60) ** 2))
    fibre = np.real(np.fft.ifft2(spectrum))
    fibre /= np.abs(fibre).max()
    mix = np.clip(0.25 + 0.3 * grain + 0.25 * fibre + shade, 0, 1)[..., None]
    picture = (1 - mix) * np.array(light) + mix * np.array(dark)
    seam = ((v * planks) % 1 < 0.02)[..., None]
    return np.where(seam, picture * 0.82, picture).astype(np.uint8)


def speckled(
    rng: np.random.Generator, colour: tuple[int, int, int], strength: float = 6.0, size: int = 128
) -> UInt8[np.ndarray, "H W 3"]:
    """An even colour with a little noise."""
    noise = rng.normal(0, strength, (size, size, 1))
    return np.clip(np.array(colour) + noise, 0, 255).astype(np.uint8)


def ground(
    rng: np.random.Generator,
    colour: tuple[int, int, int],
    clods: float,
    pebbles: int,
    size: int = 256,
) -> UInt8[np.ndarray, "H W 3"]:
    """Soil or gravel, seamless: patches, clods and pebbles, each pebble lit from one side.

    Args:
        rng: draws all of it.
        colour: of the soil.
        clods: contrast of patches and clods, in units of 255.
        pebbles: how many of them.
        size: edge length, pixels.
    """
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(size) * size] * 2))
    frequency[0, 0] = np.inf
    noise = np.real(np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) / frequency**1.1))
    grain = rng.normal(0, 0.35, (size, size))
    shade = clods * (noise / noise.std() + grain)
    v, u = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    for _ in range(pebbles):
        middle, radius = rng.uniform(0, size, 2), size * rng.uniform(0.004, 0.012)
        tone, squeeze, angle = rng.normal(3, 10), rng.uniform(0.6, 1.0), rng.uniform(0, np.pi)
        reach = int(radius / squeeze) + 2
        # A pebble that sticks out on one side goes on at the other.
        rows = (np.arange(int(middle[0]) - reach, int(middle[0]) + reach + 1)) % size
        columns = (np.arange(int(middle[1]) - reach, int(middle[1]) + reach + 1)) % size
        window = np.ix_(rows, columns)
        y = (v[window] - middle[0] + size / 2) % size - size / 2
        x = (u[window] - middle[1] + size / 2) % size - size / 2
        along, across = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        inside = along**2 * squeeze + across**2 / squeeze < radius**2
        shade[window] = np.where(inside, tone - 9 * (x + y) / radius, shade[window])
    return np.clip(np.array(colour) + shade[..., None], 0, 255).astype(np.uint8)


MATERIALS: dict[str, Material] = {
    "table": Material(lambda rng: wood(rng, (214, 178, 132), (166, 122, 78)), 2.0),
    "shelf": Material(lambda rng: wood(rng, (242, 236, 226), (214, 203, 186)), 3.0),
    "floor": Material(lambda rng: speckled(rng, (150, 156, 164)), 1.0),
    "acrylic": Material(rgba=(0.8, 0.9, 0.95, 0.22), specular=0.6, shininess=0.8),
    "earth": Material(lambda rng: ground(rng, (128, 113, 94), 9.0, 260), 0.5, specular=0.0, shininess=0.0),
    "gravel": Material(lambda rng: ground(rng, (150, 146, 138), 6.0, 1500), 0.4, specular=0.0, shininess=0.0),
    "plain": Material(lambda rng: ground(rng, (150, 148, 128), 4.0, 0), 0.06, specular=0.0, shininess=0.0),
}
"""What fixtures may be made of."""


@dataclass(frozen=True)
class Setting:
    """Where a scene is: how large it is, and what it is lit and surrounded by.

    Attributes:
        extent: size of the scene in units of the Panda's table, which light, shadows, floor and clipping go by; metres.
        center: middle of what is seen, metres, world.
        lamp: position of the lamp at ``extent`` 1, multiplied with it.
        light: direction in which the lamp shines.
        diffuse: colour of the lamp.
        shadow_size: edge of the shadow map, pixels.
        sky: colours of the sky at the zenith and at the nadir.
        floor: material of the floor.
        materials: those that are at hand for fixtures, keys of `MATERIALS`.
    """

    extent: float = 1.0
    center: tuple[float, float, float] = (0.4, 0.0, 0.2)
    lamp: tuple[float, float, float] = (0.1, -0.7, 1.9)
    light: tuple[float, float, float] = (0.18, 0.42, -1.0)
    diffuse: tuple[float, float, float] = (0.55, 0.54, 0.5)
    shadow_size: int = SHADOW_SIZE
    sky: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0.9, 0.93, 0.96), (0.7, 0.74, 0.78))
    floor: str = "floor"
    materials: tuple[str, ...] = ("table", "shelf", "floor", "acrylic")


TABLE_TOP = Setting()
"""A table in a room."""

SITE = Setting(
    extent=10.0,
    center=(4.0, 0.0, 0.5),
    light=(0.45, 0.5, -1.0),
    lamp=(-0.375, -0.75, 1.5),
    diffuse=(0.64, 0.62, 0.57),
    shadow_size=1024,
    sky=((0.55, 0.7, 0.88), (0.86, 0.9, 0.93)),
    floor="plain",
    materials=("earth", "gravel", "plain"),
)
"""A building site of some 20 m in the open."""


def dress(spec: mujoco.MjSpec, cameras: Iterable[Camera], floor_height: float, setting: Setting = TABLE_TOP) -> None:
    """Add light, sky, floor, materials and cameras to a specification, in place.

    Args:
        spec: the specification.
        cameras: fixed in the world.
        floor_height: metres. Nothing may lie at exactly this height, or it flickers.
        setting: surroundings, and the scale of the whole.
    """
    size = setting.extent
    visual = spec.visual
    visual.headlight.ambient = [0.38, 0.38, 0.4]
    visual.headlight.diffuse = [0.3, 0.3, 0.3]
    visual.headlight.specular = [0.05, 0.05, 0.05]
    visual.quality.shadowsize = setting.shadow_size
    visual.quality.offsamples = 0
    # Clipping planes in units of the extent, which is set so that they do not change with the objects.
    spec.stat.extent = size
    spec.stat.center = setting.center
    visual.map.znear = 0.02
    visual.map.zfar = 12.0
    visual.map.shadowclip = 1.2
    spec.worldbody.add_light(
        name="lamp",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[size * x for x in setting.lamp],
        dir=setting.light,
        diffuse=setting.diffuse,
        specular=[0.2, 0.2, 0.2],
        castshadow=True,
    )
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=setting.sky[0],
        rgb2=setting.sky[1],
        width=64,
        height=64 * 6,
    )
    for name in setting.materials:
        material = MATERIALS[name]
        made = spec.add_material(
            name=name,
            rgba=material.rgba,
            specular=material.specular,
            shininess=material.shininess,
            texrepeat=[material.repeat] * 2,
            texuniform=True,
        )
        if material.texture is not None:
            picture = material.texture(np.random.default_rng(len(name)))
            texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, nchannel=3)
            texture.height, texture.width = picture.shape[:2]
            texture.data = picture.tobytes()
            made.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    # Finite and in one piece: MuJoCo draws an infinite floor in thousands of quads, which doubles a frame's cost.
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[8 * size, 8 * size, 20],
        pos=[0, 0, floor_height],
        material=setting.floor,
        group=2,
    )
    for camera in cameras:
        spec.worldbody.add_camera(name=camera.name, pos=camera.position, xyaxes=camera.axes(), fovy=camera.fovy)


_LEFT_OPEN: list[tuple[Any, mujoco.MjrContext | None]] = []
"""What renderers that were dropped without `SceneRenderer.close` have left; the next picture frees it."""


def _free(gl: Any, context: mujoco.MjrContext | None) -> None:
    gl.make_current()
    if context is not None:
        context.free()
    gl.free()


class SceneRenderer:
    """Pictures of one model after another, with one OpenGL context.

    Args:
        width, height: largest picture that will be asked for, pixels.
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
            model, data: what to draw, with body poses up to date.
            camera: its name.
            width, height: of the picture, pixels.
            show_goal: whether geoms of group `GOAL_GROUP` are seen.

        Raises:
            DisplayError: no OpenGL here.
            KeyError: there is no such camera; the message lists those there are.
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
        # Left to itself MuJoCo frees the memory in whichever context is current, which may be another one's; and the
        # collector runs at any time, even while another one draws.
        if self._gl is not None and not is_finalizing():
            _LEFT_OPEN.append((self._gl, self._context))

    def close(self) -> None:
        """Free everything. Rendering again opens it again."""
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


class Window:
    """An interactive window that shows the simulation in real time, MuJoCo's passive viewer.

    Args:
        period: least time between two states shown, seconds.

    Raises:
        DisplayError: there is no display.
    """

    def __init__(self, period: float) -> None:
        if not has_display():
            raise DisplayError(
                "render_mode='human' needs a display, and neither DISPLAY nor WAYLAND_DISPLAY is set; "
                "use render_mode='rgb_array'"
            )
        self._period = period
        self._shown = 0.0
        self._handle: Any = None
        self._threads: set[threading.Thread] = set()
        self._model: mujoco.MjModel | None = None

    def show(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Draw the current state; a new model gets a new window."""
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
            # The viewer closes in threads of its own; the interpreter crashes if it ends before they do.
            for thread in self._threads:
                thread.join(timeout=5.0)
            self._handle = self._model = None


def has_display() -> bool:
    """Whether windows can be opened here."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def halved(picture: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H2 W2 3"]:
    """A picture of half the width and height, each pixel the mean of four: smooth edges for pictures to look at."""
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
