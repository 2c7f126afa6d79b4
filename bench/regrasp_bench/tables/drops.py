"""Objects let go above a table in MuJoCo, with the physics of the environments, to see how they come to rest."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from regrasp_gym.objects.model import ObjectModel, solid
from regrasp_gym.scenes.scene import Fixture
from regrasp_gym.simulation import physics
from regrasp_gym.simulation.world import add_fixture

STONE_DENSITY = 2600.0
"""Of granite and limestone, kg/m³."""

SLOWEST = 0.004
"""At rest no point of the object is faster than this, m/s, …"""

QUIET_TIME = 0.15
"""… for so long, seconds."""

LONGEST = 8.0
"""Simulated seconds after which an object that still moves counts as not settled."""

SAME_POSE = np.deg2rad(5)
"""Two resting poses are the same if what points down differs by less than this, radians."""

OPENING_TIME = 0.25
"""A gripper takes so long to open, seconds, …"""

RETREAT_TIME = 0.5
"""… and as long as this to go back, beginning that long after it began to open."""

_STEPS = 5


@dataclass(frozen=True, eq=False)
class Landing:
    """How an object came to rest.

    Attributes:
        down: (3,) unit direction in the object's frame that points down in the end.
        seconds: simulated time until it rested.
        rested: whether it did within `LONGEST`.
    """

    down: Float[np.ndarray, " 3"]
    seconds: float
    rested: bool

    def away_from(self, direction: Float[np.ndarray, " 3"]) -> float:
        """Angle between ``direction`` and what points down, radians."""
        return float(2 * np.arctan2(np.linalg.norm(self.down - direction), np.linalg.norm(self.down + direction)))

    def settled_into(self, direction: Float[np.ndarray, " 3"]) -> bool:
        """Whether it rests in the pose in which ``direction`` points down."""
        return self.rested and self.away_from(direction) < SAME_POSE


@dataclass(frozen=True, eq=False)
class Hand:
    """A gripper about an object that opens and goes back, all in the object's frame when it is let go.

    Attributes:
        bodies: convex pieces of the closed gripper, (N, 3) metres each.
        travel: how far each is moved by opening, (3,) metres each.
        back: (3,) displacement of the retreat, metres.
    """

    bodies: tuple[Float[np.ndarray, "N 3"], ...]
    travel: tuple[Float[np.ndarray, " 3"], ...]
    back: Float[np.ndarray, " 3"]


class DropTable:
    """A table and one object above it; its contacts are those of the environments.

    Args:
        thing: the object; its frame has its origin at the centre of mass.
        hand: a gripper that lets go of the object.
    """

    def __init__(self, thing: ObjectModel, hand: Hand | None = None) -> None:
        spec = mujoco.MjSpec()
        physics.configure(spec)
        side = 100 * float(thing.size.max())
        slab = np.array([side, side, 0.04])
        add_fixture(spec, Fixture("table", slab, np.array([1.0, 0, 0, 0, 0, 0, -0.02]), "", support=True))
        thing.add_to(spec, "thing")
        for mesh in spec.meshes:
            # Pieces of the environments' objects have few vertices anyway; a hull given here is not to be simplified.
            mesh.maxhullvert = -1
        self._hand = hand
        for k, body in enumerate(hand.bodies if hand else ()):
            _add_hand_body(spec, f"hand_{k}", body)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._points = np.concatenate(thing.pieces)
        self._reach = float(np.linalg.norm(self._points, axis=1).max())

    def drop(self, rotation: Float[np.ndarray, "3 3"], height: float) -> Landing:
        """Let the object go at rest, its lowest point ``height`` metres above the table, until it rests.

        A gripper opens as the object is let go and then retreats.

        Args:
            rotation: (3, 3) object to world.
            height: metres.
        """
        model, data = self._model, self._data
        mujoco.mj_resetData(model, data)
        data.qpos[2] = height - (self._points @ rotation[2]).min()
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
        data.qpos[3:7] = quaternion
        data.mocap_quat[:] = quaternion
        start = data.qpos[:3].copy()
        quiet, needed = 0, round(QUIET_TIME / model.opt.timestep / _STEPS)
        while data.time < LONGEST and quiet < needed:
            alone = self._hand is None or self._move(self._hand, start, rotation)
            mujoco.mj_step(model, data, _STEPS if alone else 1)
            speed = np.linalg.norm(data.qvel[:3]) + self._reach * np.linalg.norm(data.qvel[3:6])
            quiet = quiet + 1 if alone and speed < SLOWEST else 0
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        return Landing(-turn[6:], float(data.time), quiet >= needed)

    def _move(self, hand: Hand, start: Float[np.ndarray, " 3"], rotation: Float[np.ndarray, "3 3"]) -> bool:
        """Put the hand where it is at this time, and tell whether it has gone."""
        opened = min(self._data.time / OPENING_TIME, 1.0)
        gone = np.clip(self._data.time / RETREAT_TIME - 1.0, 0.0, 1.0)
        shift = opened * np.array(hand.travel) + gone * hand.back
        self._data.mocap_pos[:] = start + shift @ rotation.T
        return bool(gone == 1.0)


def _add_hand_body(spec: mujoco.MjSpec, name: str, points: Float[np.ndarray, "N 3"]) -> None:
    """A body that is moved from outside, with the contacts of the Panda's pads."""
    mesh = spec.add_mesh(name=name, maxhullvert=-1)
    mesh.uservert = points.ravel()
    body = spec.worldbody.add_body(name=name, mocap=True)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        condim=4,
        priority=2,
        friction=[1.2, 0.008, 0.0002],
        solref=[0.004, 1.0],
        solimp=[0.99, 0.999, 0.001, 0.5, 2],
    )


def stone(seed: int) -> ObjectModel:
    """A random convex stone for the Panda: 12 to 60 vertices, 30 to 70 mm thick, up to three times as long and wide."""
    rng = np.random.default_rng([seed, 0x570E])
    points = random_hull(rng, int(rng.integers(12, 61)), roughness=0.1) * [1.0, *rng.uniform(1.0, 3.0, 2)]
    return stone_of(points * (rng.uniform(0.030, 0.070) / np.ptp(points[:, 0])), f"stone_{seed}")


def stone_of(points: Float[np.ndarray, "N 3"], name: str) -> ObjectModel:
    """The hull of the points (metres) as a solid of stone."""
    # Imported here because it loads JAX, which the physics alone does not need.
    from regrasp_planner.geometry.hull import mass_properties, qhull

    corners = qhull(points).vertices
    mass = STONE_DENSITY * mass_properties(points).volume
    return solid(name, name.replace("_", " "), mass, [points[corners]], rgba=(0.5, 0.48, 0.45, 1.0))


def random_hull(rng: np.random.Generator, count: int, roughness: float = 0.0) -> Float[np.ndarray, "N 3"]:
    """``count`` random points on the unit sphere, each pulled inwards by up to ``roughness``."""
    points = rng.normal(size=(count, 3))
    return points * (1 - roughness * rng.uniform(size=(count, 1))) / np.linalg.norm(points, axis=1, keepdims=True)
