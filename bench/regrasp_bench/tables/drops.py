"""Drops above a table in MuJoCo, with the physics of the environments, to see how objects come to rest."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.scenes.scene import Fixture
from regrasp_gym.simulation import physics
from regrasp_gym.simulation.world import add_fixture

SLOWEST, QUIET_TIME = 0.004, 0.15
"""An object is at rest if no point of it is faster than this (m/s) for so long (s)."""

LONGEST = 8.0
"""Simulated seconds after which an object that still moves counts as not settled."""

SAME_POSE = np.deg2rad(5)
"""Two resting poses are the same if the directions that point down differ by less than this, radians."""

OPENING_TIME, RETREAT_TIME = 0.25, 0.5
"""Duration of a gripper's opening, and of the retreat that starts that long after the opening starts; seconds."""

_STEPS = 5


@dataclass(frozen=True, eq=False)
class Landing:
    """How an object came to rest.

    Attributes:
        down: (3,) unit direction in the object's frame that points down in the end.
        seconds: simulated time until it rested.
        rested: whether it rested within `LONGEST`.
    """

    down: Float[np.ndarray, " 3"]
    seconds: float
    rested: bool

    def angle_to(self, direction: Float[np.ndarray, " 3"]) -> float:
        """Angle between ``direction`` and the direction that points down, radians."""
        return angle_between(self.down, direction)

    def settled_into(self, direction: Float[np.ndarray, " 3"]) -> bool:
        """Whether it rests in the pose in which ``direction`` points down."""
        return self.rested and self.angle_to(direction) < SAME_POSE


@dataclass(frozen=True, eq=False)
class RetreatingGripper:
    """A gripper that opens and retreats, in the frame of the object at its release.

    Attributes:
        bodies: convex pieces of the closed gripper, (N, 3) metres each.
        travel: displacement of each piece by opening, (3,) metres each.
        back: (3,) displacement of the retreat, metres.
    """

    bodies: tuple[Float[np.ndarray, "N 3"], ...]
    travel: tuple[Float[np.ndarray, " 3"], ...]
    back: Float[np.ndarray, " 3"]


class DropTable:
    """A table and one object above it; its contacts are those of the environments.

    Args:
        thing: the object; its frame has its origin at the centre of mass.
        gripper: the gripper that releases the object.
    """

    def __init__(self, thing: ObjectModel, gripper: RetreatingGripper | None = None) -> None:
        spec = mujoco.MjSpec()
        physics.configure(spec)
        side = 100 * float(thing.size.max())
        slab = np.array([side, side, 0.04])
        add_fixture(spec, Fixture("table", slab, np.array([1.0, 0, 0, 0, 0, 0, -0.02]), "", support=True))
        thing.add_to(spec, "thing")
        for mesh in spec.meshes:
            # Unlike the environments' objects, a hull may have many vertices. MuJoCo must keep them all.
            mesh.maxhullvert = -1
        self._gripper = gripper
        for k, body in enumerate(gripper.bodies if gripper else ()):
            _add_gripper_body(spec, f"gripper_{k}", body)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._points = np.concatenate(thing.pieces)
        self._radius = float(np.linalg.norm(self._points, axis=1).max())

    def drop(self, rotation: Float[np.ndarray, "3 3"], height: float) -> Landing:
        """Release the object at rest and simulate until it rests again. A gripper opens at the release, then retreats.

        Args:
            rotation: (3, 3) object to world.
            height: of the object's lowest point above the table, metres.
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
            alone = self._gripper is None or self._move(self._gripper, start, rotation)
            mujoco.mj_step(model, data, _STEPS if alone else 1)
            speed = np.linalg.norm(data.qvel[:3]) + self._radius * np.linalg.norm(data.qvel[3:6])
            quiet = quiet + 1 if alone and speed < SLOWEST else 0
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        return Landing(-turn[6:], float(data.time), quiet >= needed)

    def _move(
        self, gripper: RetreatingGripper, start: Float[np.ndarray, " 3"], rotation: Float[np.ndarray, "3 3"]
    ) -> bool:
        """Move the gripper to its place at this time; whether its retreat is over."""
        opened = min(self._data.time / OPENING_TIME, 1.0)
        gone = np.clip(self._data.time / RETREAT_TIME - 1.0, 0.0, 1.0)
        shift = opened * np.array(gripper.travel) + gone * gripper.back
        self._data.mocap_pos[:] = start + shift @ rotation.T
        return bool(gone == 1.0)


def _add_gripper_body(spec: mujoco.MjSpec, name: str, points: Float[np.ndarray, "N 3"]) -> None:
    """Add a body that is moved kinematically, with the contact parameters of the Panda's pads."""
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


def angle_between(a: Float[np.ndarray, " 3"], b: Float[np.ndarray, " 3"]) -> float:
    """Angle between two unit vectors, radians."""
    return float(2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))
