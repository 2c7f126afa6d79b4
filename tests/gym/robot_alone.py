"""A robot alone in a simulation: measurements that the tests of all robot models share."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest

from regrasp_gym.robots.setup import RobotSetup
from regrasp_gym.simulation import physics

STEP = physics.TIMESTEP


def at_rest(
    setup: RobotSetup, spec: mujoco.MjSpec | None = None, home: np.ndarray | None = None
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot at rest with an open gripper, commanded to stay there."""
    spec = setup.build_spec() if spec is None else spec
    home = setup.home if home is None else home
    physics.configure(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    n = len(home)
    data.qpos[:n] = data.ctrl[:n] = home
    data.qpos[n : n + 2] = data.ctrl[n] = setup.theta_range[1]
    mujoco.mj_forward(model, data)
    return model, data


def step(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    for _ in range(round(seconds / STEP)):
        mujoco.mj_step(model, data)


def fingers_follow(
    setup: RobotSetup, targets: Sequence[float], seconds: float, apart: float, error: float
) -> np.floating:
    """Top speed of fingers that must follow θ within ``error`` and stay within ``apart`` of each other."""
    model, data = at_rest(setup)
    n = len(setup.arm_joints)
    fastest = np.float64(0.0)
    for target in targets:
        data.ctrl[n] = target
        for _ in range(round(seconds / STEP)):
            mujoco.mj_step(model, data)
            fastest = max(fastest, np.abs(data.qvel[n : n + 2]).max())
            assert data.qpos[n] == pytest.approx(data.qpos[n + 1], abs=apart)
        assert data.qpos[n : n + 2] == pytest.approx([target] * 2, abs=error)
    return fastest


def pose_in_gripper(data: mujoco.MjData, setup: RobotSetup, body: str) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation of a body in the gripper frame."""
    site, held = data.site(setup.tcp_site), data.body(body)
    frame = site.xmat.reshape(3, 3)
    return frame.T @ (held.xpos - site.xpos), frame.T @ held.xmat.reshape(3, 3)


def pad_forces(model: mujoco.MjModel, data: mujoco.MjData, pad: str, steps: int) -> list[float]:
    """Sum of the normal forces on a pad after each of the next steps, newtons."""
    geom, force, sums = model.geom(pad).id, np.zeros(6), []
    for _ in range(steps):
        mujoco.mj_step(model, data)
        sums.append(0.0)
        for k, contact in enumerate(data.contact):
            if geom in contact.geom:
                mujoco.mj_contactForce(model, data, k, force)
                sums[-1] += force[0]
    return sums


def mesh_points(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Vertices (N, 3) of a mesh geom in the world."""
    mesh = model.geom_dataid[geom]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    return data.geom_xpos[geom] + model.mesh_vert[start : start + count] @ data.geom_xmat[geom].reshape(3, 3).T


def farthest_outside(model: mujoco.MjModel, data: mujoco.MjData, geom: int, points: int) -> float:
    """Greatest distance of about ``points`` vertices of a visible geom from all collision geoms."""
    shapes = np.flatnonzero(model.geom_group == 3)
    vertices = mesh_points(model, data, geom)
    return max(
        min(outside(model, data, shape, point) for shape in shapes)
        for point in vertices[:: max(1, len(vertices) // points)]
    )


def outside(model: mujoco.MjModel, data: mujoco.MjData, geom: int, point: np.ndarray) -> float:
    """Distance of a point outside a capsule, a sphere, or the bounding box of another geom."""
    local = (point - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
    size, kind = model.geom_size[geom], model.geom_type[geom]
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE):
        half = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        local = local - [0, 0, np.clip(local[2], -half, half)]
        return max(0.0, float(np.linalg.norm(local)) - size[0])
    center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    return float(np.linalg.norm(np.maximum(np.abs(local - center) - half, 0)))


def body_geoms(model: mujoco.MjModel, palm: str, fingers: tuple[str, ...]) -> list[int]:
    """Collision geoms in the order of `robot_bodies`: links, palm, fingers."""
    names = [model.body(model.geom_bodyid[g]).name for g in range(model.ngeom)]
    touched = [g for g in range(model.ngeom) if model.geom_group[g] == 3]
    order = dict.fromkeys(fingers, 2) | {palm: 1}
    return sorted(touched, key=lambda g: (order.get(names[g], 0), g))
