"""Surroundings of a scene: light, sky, floor and cameras."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from regrasp_gym.rendering.materials import MATERIALS

SHADOW_SIZE = 512
"""Edge of the shadow map, pixels. With MuJoCo's 4096 a software-rendered frame takes many times as long."""

GOAL_GROUP = 5
"""Group of geoms that show the goal. They are in pictures for people, never in observations."""

GOAL_RGBA = (0.25, 0.85, 0.4, 0.35)


@dataclass(frozen=True)
class Camera:
    """A camera fixed in the world.

    Attributes:
        name: name of the camera.
        position: position, metres, world.
        target: point in the middle of the picture, metres, world.
        fovy: vertical field of view, degrees.
    """

    name: str
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    fovy: float = 45.0

    def axes(self) -> Float[np.ndarray, " 6"]:
        """(6,) x axis (right) and y axis (up), world."""
        forward = np.subtract(self.target, self.position)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        return np.concatenate([right, up / np.linalg.norm(up)])


@dataclass(frozen=True)
class Setting:
    """Size, light and surroundings of a scene.

    Attributes:
        extent: size of the scene, metres; 1 for the Panda's table. Scales light, shadows, floor and clipping.
        center: centre of the scene, metres, world.
        lamp: position of the lamp in units of ``extent``.
        light: direction of the lamp's light.
        diffuse: colour of the lamp.
        shadow_size: edge of the shadow map, pixels.
        sky: colours of the sky at the zenith and at the nadir.
        floor: material of the floor.
        materials: materials available to fixtures, keys of `MATERIALS`.
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
"""An outdoor building site of about 20 m."""


def add_visuals(
    spec: mujoco.MjSpec, cameras: Iterable[Camera], floor_height: float, setting: Setting = TABLE_TOP
) -> None:
    """Add light, sky, floor, materials and cameras to a specification, in place.

    Args:
        spec: the specification.
        cameras: cameras fixed in the world.
        floor_height: height of the floor, metres. Surfaces at exactly this height flicker.
        setting: size, light and surroundings.
    """
    size = setting.extent
    visual = spec.visual
    visual.headlight.ambient = [0.38, 0.38, 0.4]
    visual.headlight.diffuse = [0.3, 0.3, 0.3]
    visual.headlight.specular = [0.05, 0.05, 0.05]
    visual.quality.shadowsize = setting.shadow_size
    visual.quality.offsamples = 0
    # Clipping planes are in units of the extent. It is set here so that they do not change with the objects.
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
    # Finite and in one piece: MuJoCo draws an infinite floor as thousands of quads, which doubles the cost of a frame.
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
