"""The grapple holds stones of a ton by friction alone, through a swing and for as long as one likes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from excavator_alone import CLOSED, OPEN, compiled, pose, ramp
from jaxtyping import Float
from robot_alone import STEP, pad_forces, pose_in_gripper, step
from scipy.spatial.transform import Rotation

from regrasp_gym.objects.stones import StoneConfig, stone
from regrasp_gym.robots.excavator import EXCAVATOR


def grasped(shape: Float[np.ndarray, "N 3"], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation and offset from the grasp centre of a stone that both pads touch within 25° of square, and the angles.

    Found by trying: turn the stone at random, close the jaws in steps of what is left between pads and stone.
    """
    rng = np.random.default_rng(seed)
    spec = EXCAVATOR.build_spec()
    mesh = spec.add_mesh(name="stone", uservert=shape.ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    body = spec.worldbody.add_body(name="stone", mocap=True)
    body.add_geom(name="stone", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="stone")
    model, data = compiled(spec)
    stone_geom, pads = model.geom("stone").id, [model.geom(name).id for name in EXCAVATOR.pads]
    others = [g for g in range(model.ngeom) if model.geom_group[g] == 3 and g not in pads]
    center = data.site(EXCAVATOR.tcp_site).xpos.copy()

    def touch(geom: int) -> tuple[float, np.ndarray]:
        ends = np.zeros(6)
        return mujoco.mj_geomDistance(model, data, geom, stone_geom, 2.0, ends), ends[3:]

    for _ in range(500):
        turn, offset, theta = Rotation.random(random_state=rng), np.append(rng.normal(size=2) * 0.05, 0.0), OPEN
        offset = offset[[0, 2, 1]]
        for _ in range(25):
            pose(data, EXCAVATOR.home, max(theta, CLOSED))
            data.mocap_pos[0], data.mocap_quat[0] = center + offset, turn.as_quat(scalar_first=True)
            mujoco.mj_kinematics(model, data)
            left, right = touch(pads[0])[0], touch(pads[1])[0]
            offset[1] += (left - right) / 2
            theta -= (left + right) / 2
        if abs(left) + abs(right) > 1e-4 or not CLOSED < theta < OPEN or abs(offset[1]) > 0.15:
            continue
        if min(mujoco.mj_geomDistance(model, data, g, stone_geom, 1.0, None) for g in others) < 0.03:
            continue
        points = [touch(pad)[1] for pad in pads]
        across = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
        angles = []
        for pad, point, sign in zip(pads, points, (1, -1), strict=True):
            axis, away = data.geom_xmat[pad].reshape(3, 3)[:, 2], point - data.geom_xpos[pad]
            away = away - np.clip(away @ axis, -0.12, 0.12) * axis
            angles.append(np.degrees(np.arccos(np.clip(sign * away @ across / np.linalg.norm(away), -1, 1))))
        if max(angles) < 25:
            return turn.as_matrix(), offset, np.array(angles)
    raise AssertionError("no grasp found")


def moved(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> tuple[float, float]:
    """Metres and degrees between two poses."""
    turn = np.arccos(np.clip((np.trace(a[1].T @ b[1]) - 1) / 2, -1, 1))
    return float(np.linalg.norm(a[0] - b[0])), float(np.degrees(turn))


@pytest.mark.parametrize("seed", range(8))
def test_friction_alone_holds_a_heavy_stone_through_a_swing(seed: int) -> None:
    thing = stone(seed, StoneConfig(mass=(850.0, 1000.0)))
    turn, offset, _ = grasped(thing.pieces[0], seed)
    spec = EXCAVATOR.build_spec()
    center = compiled()[1].site(EXCAVATOR.tcp_site).xpos
    where = np.concatenate([Rotation.from_matrix(turn).as_quat(scalar_first=True), center + offset])
    body = thing.add_to(spec, name="stone", pose=where)
    body.gravcomp = 1.0
    model, data = compiled(spec)
    # It floats until the jaws have it.
    dofs = slice(model.joint("stone_joint").dofadr[0], None)
    model.dof_damping[dofs] = 3000.0
    data.ctrl[6] = CLOSED
    step(model, data, 2.5)
    model.body_gravcomp[model.body("stone").id] = 0.0
    model.dof_damping[dofs] = 0.0

    step(model, data, 0.5)
    presses = pad_forces(model, data, "left_bite", steps=100)
    assert 34e3 < np.mean(presses) < 48e3, "the pad presses with about 40 kN"
    assert np.std(presses) < 100.0, "and without chatter"

    grip = pose_in_gripper(data, EXCAVATOR, "stone")
    assert np.linalg.norm(grip[0] - offset * [-1, 1, -1]) < 0.02, "where it was gripped"
    position, end = ramp(2.2, EXCAVATOR.max_velocity[0], EXCAVATOR.max_acceleration[0])
    lift = np.array([0.0, -0.12, 0.0, 0.12, 0.0, 0.0])
    for k in range(round((end + 1.0) / STEP)):
        share = min(1.0, k * STEP / 2.5)
        data.ctrl[:6] = EXCAVATOR.home + lift * share**2 * (3 - 2 * share)
        data.ctrl[0] += position(k * STEP)
        mujoco.mj_step(model, data)
    slip, twist = moved(grip, pose_in_gripper(data, EXCAVATOR, "stone"))
    assert slip < 0.02
    assert twist < 1.0
    assert data.qpos[0] == pytest.approx(2.2, abs=1e-3)

    after = pose_in_gripper(data, EXCAVATOR, "stone")
    step(model, data, 20.0)
    slip, twist = moved(after, pose_in_gripper(data, EXCAVATOR, "stone"))
    assert slip < 0.003, "a held stone does not creep"
    assert twist < 0.5
