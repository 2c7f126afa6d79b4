"""A white studio to picture surfaces in: light, ground, camera, captions, and pictures side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from regrasp_gym.geometry.poses import Pose
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.rendering.renderer import SceneRenderer
from regrasp_gym.rendering.setting import Camera
from regrasp_gym.rendering.surfaces import Look, Rgba, add_look, revolve
from regrasp_planner.pose import IDENTITY

Picture = UInt8[np.ndarray, "H W 3"]


_PERCENT = "0 45 70 90 45 5 0 62 45 80 25 45 93 75 15 45 30 65 55 35 20 45 75 20 30 75 90 90 60 75 30 35 40 75 10 10"
COLOURS: tuple[Rgba, ...] = tuple(
    (red / 100, green / 100, blue / 100, 1.0) for red, green, blue in np.reshape(_PERCENT.split(), (-1, 3)).astype(int)
)
"""A dozen colours, as distinguishable as possible for colour-blind people."""

SHADOW_SIZE = 4096
"""Edge of the shadow map, pixels. Large, because these pictures may take long."""

_SHARPER = 2
"""Pictures are rendered this many times larger and then reduced."""


class Studio:
    """Surfaces at poses, on a white ground or in a white void.

    Args:
        ground: height of the ground, metres; None for no ground.
        size: size of the pictured objects, metres; it sets the light's position and softness.
    """

    def __init__(self, ground: float | None = 0.0, size: float = 0.5) -> None:
        self.spec = mujoco.MjSpec()
        self._count = 0
        self._void = ground is None
        headlight, depth = self.spec.visual.headlight, self.spec.visual.map
        headlight.ambient, headlight.diffuse, headlight.specular = ([grey] * 3 for grey in (0.45, 0.25, 0.05))
        depth.znear, depth.zfar, depth.shadowclip = 0.01, 60.0, 2.0
        self.spec.visual.quality.shadowsize, self.spec.visual.quality.offsamples = SHADOW_SIZE, 8
        self.spec.stat.extent, self.spec.stat.center = size, [0.0, 0.0, 0.0]
        self.spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            rgb1=[1, 1, 1],
            rgb2=[1, 1, 1],
            width=8,
            height=48,
        )
        self.spec.worldbody.add_light(
            name="lamp",
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=np.array([-0.3, -0.5, 1.5]) * size * 4,
            dir=[0.25, 0.3, -1.0],
            diffuse=[0.5, 0.5, 0.5],
            specular=[0.15, 0.15, 0.15],
            castshadow=ground is not None,
        )
        if ground is not None:
            self.spec.add_material(name="ground", rgba=[1.0, 1.0, 1.0, 1.0], specular=0.0, shininess=0.0)
            self.spec.worldbody.add_geom(
                name="ground",
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                size=[20 * size, 20 * size, 1],
                pos=[0, 0, ground],
                material="ground",
                group=2,
            )

    def add(self, look: Look, pose: Pose = IDENTITY, rgba: Rgba | None = None) -> None:
        """Put a surface at a pose, in its own colour or in ``rgba``."""
        if rgba is not None:
            look = replace(look, texture=None, texcoords=None).painted(rgba)
        name = f"look{self._count}"
        self._count += 1
        body = self.spec.worldbody.add_body(name=name, pos=pose[4:], quat=pose[:4])
        add_look(self.spec, body, name, look)

    def add_object(self, model: ObjectModel, pose: Pose = IDENTITY, rgba: Rgba | None = None) -> None:
        """Put an object at a pose, in its own colours or all in ``rgba``, which may be translucent."""
        for look in model.looks:
            self.add(look, pose, rgba)

    def picture(self, camera: Camera, height: int, width: int) -> Picture:
        """What the camera sees."""
        for old in list(self.spec.worldbody.cameras):
            self.spec.delete(old)
        if self._void:
            # From behind the camera's left shoulder.
            axes = camera.axes()
            toward = np.subtract(camera.target, camera.position)
            lamp = self.spec.worldbody.lights[0]
            lamp.dir = toward / np.linalg.norm(toward) + 0.45 * axes[:3] - 0.6 * axes[3:]
        self.spec.worldbody.add_camera(name=camera.name, pos=camera.position, xyaxes=camera.axes(), fovy=camera.fovy)
        model = self.spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        renderer = SceneRenderer(_SHARPER * width, _SHARPER * height)
        try:
            return resized(
                renderer.render(model, data, camera.name, _SHARPER * width, _SHARPER * height), height, width
            )
        finally:
            renderer.close()


def resized(picture: Picture, height: int, width: int) -> Picture:
    """The picture in another size, with smooth edges."""
    return np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS))


def to_pixels(camera: Camera, points: Float[np.ndarray, "N 3"], height: int, width: int) -> Float[np.ndarray, "N 2"]:
    """Pixels (column, row) at which the camera sees points of the world."""
    right, up = camera.axes()[:3], camera.axes()[3:]
    rays = np.asarray(points, float) - np.asarray(camera.position)
    depth = rays @ np.cross(up, right)
    scale = 0.5 * height / np.tan(0.5 * np.deg2rad(camera.fovy))
    return np.column_stack([0.5 * width + scale * (rays @ right) / depth, 0.5 * height - scale * (rays @ up) / depth])


def arrow(length: float, radius: float) -> Look:
    """An arrow from the origin along z; the head is three radii wide and six long."""
    head = min(6 * radius, 0.6 * length)
    profile = [(0.0, 0.0), (radius, 0.0), (radius, length - head), (3 * radius, length - head), (0.0, length)]
    return revolve(profile, 24, smooth=False)


def cone(half_angle: float, length: float) -> Look:
    """The cone of directions within ``half_angle`` radians of z, from the origin, with a spherical cap."""
    rim = np.linspace(half_angle, 0.0, 12)
    profile = [(0.0, 0.0), *((length * np.sin(a), length * np.cos(a)) for a in rim)]
    return revolve(profile, 48, smooth=False)


def pose_along(direction: Float[np.ndarray, " 3"], origin: Float[np.ndarray, " 3"]) -> Pose:
    """A pose at ``origin`` whose z axis is the unit ``direction``."""
    x, y, z = direction
    if z < -1 + 1e-9:
        return np.array([0.0, 1, 0, 0, *origin])
    quaternion = np.array([1 + z, -y, x, 0.0])
    return np.concatenate([quaternion / np.linalg.norm(quaternion), origin])


def captioned(picture: Picture, caption: str, size: int = 18) -> Picture:
    """The picture with a caption below."""
    height, width = picture.shape[:2]
    image = Image.new("RGB", (width, height + 2 * size), (255, 255, 255))
    image.paste(Image.fromarray(picture))
    write_text(image, (width / 2, height + 0.9 * size), caption, size, "mm")
    return np.asarray(image)


def write_text(image: Image.Image, at: tuple[float, float], words: str, size: int, anchor: str = "la") -> None:
    """Write dark text on a picture, with a white outline so that it can be read on any background."""
    ImageDraw.Draw(image).text(
        at,
        words,
        fill=(25, 25, 30),
        font=ImageFont.load_default(size=size),
        anchor=anchor,
        align="center",
        stroke_width=2,
        stroke_fill=(255, 255, 255),
    )


def cropped(picture: Picture, margin: int = 16) -> Picture:
    """The picture without the white around it, except for a margin in pixels."""
    rows, columns = (np.flatnonzero((picture < 240).any(axis=(axis, 2))) for axis in (1, 0))
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    return picture[top : rows[-1] + margin + 1, left : columns[-1] + margin + 1]


def side_by_side(pictures: Sequence[Picture], columns: int, gap: int = 6) -> Picture:
    """Pictures of equal size in rows, on white."""
    height, width = pictures[0].shape[:2]
    rows = -(-len(pictures) // columns)
    sheet = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, np.uint8)
    for k, picture in enumerate(pictures):
        top, left = (k // columns) * (height + gap), (k % columns) * (width + gap)
        sheet[top : top + height, left : left + width] = picture
    return sheet


def save(picture: Picture, path: Path) -> None:
    """Write an image file small enough for a repository: JPEG for photographs, PNG with 256 colours for drawings."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(picture)
    if path.suffix == ".png":
        image = image.quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    image.save(path, optimize=True, quality=88)
