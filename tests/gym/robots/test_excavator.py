"""The excavator's model: what is in it, how it moves and holds still."""

from __future__ import annotations

import jaxlie
import mujoco
import numpy as np
import pytest
from excavator_alone import (
    BODIES,
    CLOSED,
    FAR,
    JAWS,
    OPEN,
    compiled,
    loaded,
    pose,
    ramp,
    random_configurations,
)
from robot_alone import STEP, body_geoms, farthest_outside, fingers_follow, mesh_points, outside, step
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_gym.objects.stones import stone
from regrasp_gym.robots.excavator import EXCAVATOR
from regrasp_planner.robot.kinematics import body_poses, forward_kinematics, robot_bodies


def test_everything_that_is_promised_is_there() -> None:
    model, data = compiled()
    for body in (*BODIES, *JAWS):
        assert model.body_gravcomp[model.body(body).id] == 1.0
        assert (model.geom_bodyid[model.geom_group == 2] == model.body(body).id).any(), f"{body} is to be seen"
    assert [model.joint(name).id for name in (*EXCAVATOR.arm_joints, *EXCAVATOR.finger_joints)] == list(range(8))
    assert [model.actuator(n).id for n in (*EXCAVATOR.arm_actuators, EXCAVATOR.gripper_actuator)] == list(range(7))
    assert model.camera("cab").bodyid == model.body("house").id
    assert not model.jnt_pos.any(), "every joint sits at the origin of its body"
    # 21.6 t with a bucket of 0.9 t, whose place a tool of 1.2 t takes.
    assert model.body_mass.sum() == pytest.approx(21600 - 900 + 1200)
    tool = [*BODIES[4:], *JAWS]
    assert sum(model.body(name).mass[0] for name in tool) == pytest.approx(1200)
    tcp = data.site(EXCAVATOR.tcp_site)
    assert tcp.xpos == pytest.approx([6.3, 0.0, 2.2], abs=1e-3)
    assert tcp.xmat.reshape(3, 3) == pytest.approx(np.diag([-1.0, 1.0, -1.0]), abs=1e-4)
    assert data.ncon == 0


def test_limits_are_those_of_the_class() -> None:
    model, _ = compiled()
    half = np.pi / 4
    expected = [(-np.pi, np.pi), (-1.137, 1.0), (0.594, 2.687), (-0.54, 1.83), (-half, half), (-np.pi, np.pi)]
    assert model.jnt_range[:6] == pytest.approx(np.array(expected))
    assert model.actuator_ctrlrange[:6] == pytest.approx(np.array(expected))
    assert model.actuator_forcerange[:6, 1] == pytest.approx([74e3, 370e3, 190e3, 73e3, 40e3, 9e3])
    assert model.actuator_forcerange[:, 0] == pytest.approx(-model.actuator_forcerange[:, 1])
    assert np.clip(EXCAVATOR.home, *model.jnt_range[:6].T) == pytest.approx(EXCAVATOR.home)
    for limit in (EXCAVATOR.max_velocity, EXCAVATOR.max_acceleration):
        assert limit.shape == (6,)
        assert (limit > 0).all()


def test_kinematics_are_those_of_the_drawing() -> None:
    """Against the closed form with the boom's pivot at (0.23, 1.96), boom 5.7 m, arm 2.9 m and the tool's offsets."""
    model, data = compiled()
    for q, theta in random_configurations(model, 50):
        pose(data, q, theta)
        mujoco.mj_kinematics(model, data)
        swing, boom, arm, pitch, tilt, rotate = q
        below, curl = boom + arm, boom + arm + pitch
        radius = 0.23 + 5.7 * np.cos(boom) + 2.9 * np.cos(below)
        height = 1.96 - 5.7 * np.sin(boom) - 2.9 * np.sin(below)
        upper = Rotation.from_euler("ZY", [swing, curl + np.pi / 2]).as_matrix()
        lower = upper @ Rotation.from_euler("XZ", [tilt, rotate]).as_matrix()
        wrist = [radius * np.cos(swing), radius * np.sin(swing), height]
        tcp = data.site(EXCAVATOR.tcp_site)
        assert tcp.xpos == pytest.approx(wrist + upper @ [0, 0, 0.32] + lower @ [0, 0, 1.61], abs=1e-6)
        assert tcp.xmat.reshape(3, 3) == pytest.approx(lower, abs=1e-6)


def test_the_jaws_open_from_0_1_to_1_2_metres_and_mirror_each_other() -> None:
    model, data = compiled()
    pads = [model.geom(name).id for name in EXCAVATOR.pads]
    for theta in np.linspace(CLOSED, OPEN, 9):
        pose(data, np.zeros(6), theta)
        mujoco.mj_kinematics(model, data)
        site = data.site(EXCAVATOR.tcp_site)
        local = (data.geom_xpos[pads] - site.xpos) @ site.xmat.reshape(3, 3)
        assert local[0] == pytest.approx(local[1] * [1, -1, 1], abs=1e-9)
        gap = mujoco.mj_geomDistance(model, data, *pads, 10.0, None)
        assert gap == pytest.approx(0.84 + 1.8 * np.sin(theta), abs=1e-6)
        if theta == CLOSED:
            assert gap == pytest.approx(0.10, abs=1e-3)
    assert gap == pytest.approx(1.20, abs=1e-3)
    # The grasp centre lies between the pads where they are 0.7 m apart.
    pose(data, np.zeros(6), float(np.arcsin((0.7 - 0.84) / 1.8)))
    mujoco.mj_kinematics(model, data)
    assert data.geom_xpos[pads].mean(axis=0) == pytest.approx(data.site(EXCAVATOR.tcp_site).xpos, abs=5e-3)


def test_a_block_of_one_metre_touches_the_pads_alone() -> None:
    """1.0 m wide and 0.8 m high, held at half its height, with 3 cm to spare everywhere else."""
    spec = EXCAVATOR.build_spec()
    spec.body("gripper").add_geom(
        name="block", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.4, 0.5, 0.4], pos=[0, 0, 0.323 + 0.896], group=5
    )
    model, data = compiled(spec)
    pose(data, EXCAVATOR.home, float(np.arcsin((1.0 - 0.84) / 1.8)))
    mujoco.mj_kinematics(model, data)
    block = model.geom("block").id
    for geom in np.flatnonzero(model.geom_group == 3):
        distance = mujoco.mj_geomDistance(model, data, block, geom, 10.0, None)
        if model.geom(geom).name in EXCAVATOR.pads:
            assert distance == pytest.approx(0.0, abs=1e-3)
        else:
            assert distance > 0.03, model.geom(geom).name


def test_seen_and_touched_geoms_are_apart() -> None:
    model, _ = compiled()
    seen, touched, bites = (model.geom_group == group for group in (2, 3, 4))
    assert (seen | touched | bites).all()
    assert not model.geom_contype[seen].any()
    assert not model.geom_conaffinity[seen].any()
    assert touched.sum() <= 16, "the planner checks every one"
    pads = np.isin(np.arange(model.ngeom), [model.geom(name).id for name in EXCAVATOR.pads])
    # What touches a stone, whose bits are 1: everything but the pads, and the polyhedra in their place.
    meets = (model.geom_contype | model.geom_conaffinity) & 1 == 1
    assert (meets == (touched & ~pads | bites)).all()
    assert sorted(model.geom_bodyid[bites]) == sorted(model.geom_bodyid[pads])


def test_what_bites_fills_the_pads() -> None:
    """The polyhedra stay inside the capsules that the planner sees, and are nowhere 2 mm thinner along the bar."""
    model, data = compiled()
    for pad in EXCAVATOR.pads:
        capsule, bite = model.geom(pad).id, model.geom(pad.replace("pad", "bite")).id
        corners = mesh_points(model, data, bite)
        assert max(outside(model, data, capsule, point) for point in corners) < 1e-6
        local = (corners - data.geom_xpos[capsule]) @ data.geom_xmat[capsule].reshape(3, 3)
        ring = ConvexHull(local[np.abs(local[:, 2] - 0.12) < 1e-6][:, :2])
        assert -ring.equations[:, 2].max() > 0.098


def test_a_pad_pushes_square_to_its_surface() -> None:
    """Contacts between pad and stone, edges and corners included, point across the capsule that the planner sees."""
    angles = []
    for seed in range(3):
        thing, rng = stone(seed), np.random.default_rng(seed)
        spec = EXCAVATOR.build_spec()
        thing.add_to(spec, name="stone")
        model, data = compiled(spec)
        address = model.joint("stone_joint").qposadr[0]
        bite, pad = model.geom("left_bite").id, model.geom("left_pad").id
        middle, axis = data.geom_xpos[pad].copy(), data.geom_xmat[pad].reshape(3, 3)[:, 2].copy()
        for _ in range(60):
            turn = Rotation.random(random_state=rng).as_quat(scalar_first=True)
            place = middle + np.array([rng.normal() * 0.1, -0.45, rng.normal() * 0.15])
            ends = np.zeros(6)
            for _ in range(15):
                data.qpos[address : address + 7] = np.concatenate([place, turn])
                mujoco.mj_kinematics(model, data)
                place[1] += 0.95 * mujoco.mj_geomDistance(model, data, bite, model.geom("stone_c0").id, 5.0, ends)
            away = ends[3:] - middle
            away -= np.clip(away @ axis, -0.12, 0.12) * axis
            away /= np.linalg.norm(away)
            data.qpos[address : address + 3] = place - 1e-4 * away
            mujoco.mj_forward(model, data)
            normals = [c.frame[:3] * (1 if c.geom[0] == bite else -1) for c in data.contact if bite in c.geom]
            angles += [np.degrees(np.arccos(np.clip(normal @ away, -1, 1))) for normal in normals]
    assert len(angles) > 150
    assert np.mean(np.array(angles) > 20) < 0.01
    assert np.max(angles) < 45


def test_what_is_seen_stays_near_what_touches() -> None:
    """A tool seen to pass through a stone would be wrong; rails and cylinders above the boom meet nothing."""
    model, data = compiled()
    for geom in np.flatnonzero(model.geom_group == 2):
        body = model.body(model.geom_bodyid[geom]).name
        assert farthest_outside(model, data, geom, points=60) < (0.09 if body in (*BODIES[4:], *JAWS) else 0.45), (
            model.geom(geom).name
        )


def test_the_operator_sees_where_the_tool_works() -> None:
    model, data = compiled()
    camera = model.camera("cab").id
    frame = data.cam_xmat[camera].reshape(3, 3)
    half = np.tan(np.deg2rad(model.cam_fovy[camera]) / 2)
    for point in ([4.6, 0.0, 0.3], [6.3, 0.0, 0.0], [6.3, 1.2, 0.5], [8.0, 0.0, 0.5], [6.3, 0.0, 3.0]):
        x, y, z = (np.array(point) - data.cam_xpos[camera]) @ frame
        assert z < 0
        assert max(abs(x), abs(y)) / -z < half


def test_it_holds_still_without_load() -> None:
    model, data = compiled()
    step(model, data, 1.0)
    assert np.abs(data.qpos[:6] - EXCAVATOR.home).max() < 1e-9


def test_it_sags_little_under_a_tonne_at_eight_metres() -> None:
    model, data = compiled(loaded(), FAR)
    before = data.site(EXCAVATOR.tcp_site).xpos.copy()
    assert np.hypot(*before[:2]) > 8.0
    step(model, data, 3.0)
    sag = before - data.site(EXCAVATOR.tcp_site).xpos
    assert 1e-4 < sag[2] < 0.015
    assert np.abs(data.qvel).max() < 1e-6, "and does not swing"


@pytest.mark.parametrize("joint", range(6))
def test_a_loaded_joint_follows_at_full_speed_and_stops_dead(joint: int) -> None:
    """The time constant of 0.04 s is all that it lags, and 0.3 s after the end the tool is where it shall be."""
    model, data = compiled(loaded(), FAR)
    step(model, data, 0.5)
    rest = data.qpos[:6] - FAR
    speed, sign = EXCAVATOR.max_velocity[joint], -1 if joint == 3 else 1
    position, end = ramp([1.6, 0.4, 0.5, 0.5, 0.4, 1.5][joint], speed, EXCAVATOR.max_acceleration[joint])
    for k in range(round((end + 1.3) / STEP)):
        data.ctrl[joint] = FAR[joint] + sign * position((k + 1) * STEP)
        mujoco.mj_step(model, data)
        error = data.qpos[:6] - data.ctrl[:6]
        lag = -sign * error[joint] / speed
        assert -0.01 < lag < 0.055
        assert np.abs(np.delete(error - rest, joint)).max() < 2e-3, "the other joints stand"
        if k * STEP > end + 0.3:
            # 8 m of reach make 8 mm of this at the tool.
            assert np.abs(error).max() < 1e-3


def test_the_jaws_follow_one_command_as_one() -> None:
    fastest = fingers_follow(EXCAVATOR, (-0.2, 0.1, CLOSED, OPEN), seconds=2.8, apart=1e-4, error=1e-3)
    assert 0.2 < fastest < 0.36


def test_the_planner_sees_the_same_machine() -> None:
    model, data = compiled()
    robot = EXCAVATOR.planner_robot(model)
    geoms = body_geoms(model, "gripper", JAWS)
    assert robot_bodies(robot).batch_size == len(geoms) == 16
    assert robot.gripper.fingers.batch_size == 4
    assert float(robot.gripper.max_opening) == pytest.approx(1.2, abs=1e-3)
    assert (float(robot.gripper.lower), float(robot.gripper.upper)) == pytest.approx(EXCAVATOR.theta_range)
    for q, theta in random_configurations(model, 20):
        pose(data, q, theta)
        mujoco.mj_kinematics(model, data)
        frames = np.asarray(forward_kinematics(robot.arm, q))
        tcp = data.site(EXCAVATOR.tcp_site)
        assert frames[-1][4:] == pytest.approx(tcp.xpos, abs=1e-9)
        assert np.asarray(jaxlie.SO3(frames[-1][:4]).as_matrix()) == pytest.approx(tcp.xmat.reshape(3, 3), abs=1e-9)
        for body, centered, geom in zip(
            np.asarray(body_poses(robot, q, np.asarray(theta))),
            np.asarray(robot_bodies(robot).center),
            geoms,
            strict=True,
        ):
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
                continue
            center = body[4:] + np.asarray(jaxlie.SO3(body[:4]).as_matrix()) @ centered
            assert center == pytest.approx(data.geom_xpos[geom], abs=1e-6)


def test_few_pairs_can_collide_and_none_does_in_usual_work() -> None:
    model, data = compiled()
    assert 20 < len(EXCAVATOR.planner_robot(model).self_pairs) < 80
    rng = np.random.default_rng(0)
    for _ in range(300):
        radius, height = rng.uniform(4.3, 8.3), rng.uniform(0.0, 1.8)
        x, z = radius - 0.23, height + 1.93 - 1.96
        distance = np.hypot(x, z)
        boom = np.arctan2(z, x) + np.arccos((5.7**2 + distance**2 - 2.9**2) / (2 * 5.7 * distance))
        arm = np.pi - np.arccos((5.7**2 + 2.9**2 - distance**2) / (2 * 5.7 * 2.9))
        if not model.jnt_range[2, 0] < arm < model.jnt_range[2, 1]:
            continue
        down = np.pi / 2 + boom - arm
        swing, tilt, rotate = rng.uniform(-1.4, 1.4), rng.uniform(-0.7, 0.7), rng.uniform(-np.pi, np.pi)
        pose(data, np.array([swing, -boom, arm, down, tilt, rotate]), rng.uniform(CLOSED, OPEN))
        mujoco.mj_forward(model, data)
        assert data.site(EXCAVATOR.tcp_site).xpos[2] == pytest.approx(height + 1.61 * (1 - np.cos(tilt)), abs=1e-6)
        assert data.ncon == 0
