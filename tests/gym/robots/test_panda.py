"""The Panda's model: what is in it, how it tracks, how it grips."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from robot_alone import STEP, at_rest, farthest_outside, fingers_follow, pad_forces, pose_in_gripper

from regrasp_gym.objects import OBJECTS
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.robots.panda import PANDA


def test_everything_that_the_contract_names_is_there() -> None:
    model, _ = at_rest(PANDA)
    for body in [f"link{i}" for i in range(8)] + ["hand", "left_finger", "right_finger"]:
        assert model.body_gravcomp[model.body(body).id] == 1.0
    assert [model.joint(name).id for name in (*PANDA.arm_joints, *PANDA.finger_joints)] == list(range(9))
    assert [model.actuator(name).id for name in (*PANDA.arm_actuators, PANDA.gripper_actuator)] == list(range(8))
    assert model.site(PANDA.tcp_site).pos == pytest.approx([0, 0, 0.1034])
    assert model.camera("wrist").bodyid == model.body("hand").id
    # Gaz et al. 2019 for the links, franka_description for the hand.
    total = 0.6298 + 4.9707 + 0.6469 + 3.2286 + 3.5879 + 1.2259 + 1.6666 + 0.7355 + 0.73 + 2 * 0.015
    assert model.body_mass.sum() == pytest.approx(total, abs=1e-3)


def test_limits_are_those_of_the_data_sheet() -> None:
    model, _ = at_rest(PANDA)
    bound = np.array([2.8973, 1.7628, 2.8973, np.nan, 2.8973, np.nan, 2.8973])
    expected = np.column_stack([-bound, bound])
    expected[3], expected[5] = (-3.0718, -0.0698), (-0.0175, 3.7525)
    assert model.jnt_range[:7] == pytest.approx(expected)
    assert model.actuator_ctrlrange[:7] == pytest.approx(expected)
    assert model.actuator_forcerange[:7, 1] == pytest.approx([87] * 4 + [12] * 3)


def test_seen_and_touched_geoms_are_apart() -> None:
    model, _ = at_rest(PANDA)
    seen, touched = model.geom_group == 2, model.geom_group == 3
    assert (seen | touched).all()
    assert not model.geom_contype[seen].any()
    assert not model.geom_conaffinity[seen].any()
    assert model.geom_contype[touched].all()


def test_what_is_seen_stays_near_what_touches() -> None:
    """An observer must not see parts pass through things that the physics leaves alone, or the other way round."""
    model, data = at_rest(PANDA)
    visible = np.flatnonzero(model.geom_group == 2)
    assert max(farthest_outside(model, data, geom, points=40) for geom in visible) < 0.025


def test_the_arm_holds_still_without_gravity_load() -> None:
    model, data = at_rest(PANDA)
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos[:7] - PANDA.home).max() < 1e-9
    assert data.ncon == 0


def test_the_arm_tracks_a_trajectory_given_at_20_hz() -> None:
    """Set points that go linearly from one control step to the next are followed with less than 30 ms lag."""
    model, data = at_rest(PANDA)
    amplitude, rate = 0.35 * PANDA.max_velocity, 2 * np.pi * 0.3
    amplitude = amplitude / rate

    def reference(time: float) -> np.ndarray:
        return PANDA.home + amplitude * np.sin(rate * time)

    errors, velocities = [], []
    for control in range(60):
        start, end = reference(0.05 * control), reference(0.05 * (control + 1))
        for k in range(25):
            data.ctrl[:7] = start + (end - start) * (k + 1) / 25
            mujoco.mj_step(model, data)
            if control > 10:
                errors.append(data.qpos[:7] - data.ctrl[:7])
                velocities.append(amplitude * rate * np.cos(rate * data.time))
    errors, velocities = np.array(errors), np.array(velocities)
    lag = -(errors * velocities).sum(axis=0) / (velocities**2).sum(axis=0)
    assert (lag > 0).all()
    assert (lag < 0.03).all()
    assert np.abs(errors + lag * velocities).max() < 0.005


@pytest.mark.parametrize("joint", range(7))
def test_a_step_is_followed_without_overshoot(joint: int) -> None:
    model, data = at_rest(PANDA)
    data.ctrl[joint] += 0.02
    course = []
    for _ in range(250):
        mujoco.mj_step(model, data)
        course.append(data.qpos[joint] - PANDA.home[joint])
    assert max(course) < 0.02 * 1.06
    assert course[-1] == pytest.approx(0.02, abs=2e-4)
    assert course[60] > 0.015


def test_the_fingers_follow_one_command_as_one() -> None:
    fastest = fingers_follow(PANDA, (0.01, 0.03, 0.0, 0.04), seconds=0.8, apart=1e-5, error=2e-4)
    assert 0.1 < fastest < 0.21


def test_the_wrist_camera_sees_the_grasp_centre() -> None:
    model, data = at_rest(PANDA)
    camera = model.camera("wrist").id
    frame = data.cam_xmat[camera].reshape(3, 3)
    half = np.tan(np.deg2rad(model.cam_fovy[camera]) / 2)
    for depth in (-0.01, 0.0, 0.05, 0.1):
        tcp = data.site(PANDA.tcp_site)
        point = (tcp.xpos + depth * tcp.xmat.reshape(3, 3)[:, 2] - data.cam_xpos[camera]) @ frame
        assert point[2] < 0
        assert np.abs(point[:2] / -point[2]).max() < half


def grasp_spec(thing: ObjectModel) -> mujoco.MjSpec:
    """The robot at home and an upright object between its fingers, narrow side across, on a stand."""
    _, data = at_rest(PANDA)
    tcp = data.site(PANDA.tcp_site).xpos
    points = np.concatenate(thing.pieces)
    yaws = np.linspace(0, np.pi, 181)
    widths = [np.ptp(points[:, 0] * np.sin(yaw) + points[:, 1] * np.cos(yaw)) for yaw in yaws]
    yaw = yaws[int(np.argmin(widths))]
    across = points[:, 0] * np.sin(yaw) + points[:, 1] * np.cos(yaw)
    # The pads reach 9.5 mm beyond the grasp centre, the palm is 37 mm above it.
    grip = np.clip(0.0, points[:, 2].max() - 0.033, None)
    position = tcp - [0.0, (across.max() + across.min()) / 2, max(grip, points[:, 2].min() + 0.012)]
    spec = PANDA.build_spec()
    floor = position[2] + points[:, 2].min()
    spec.worldbody.add_geom(
        name="stand",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.15, 0.15, 0.01],
        pos=[position[0], position[1], floor - 0.01],
    )
    thing.add_to(spec, name="thing", pose=np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2), *position]))
    return spec


HELD = [
    "004_sugar_box",
    "005_tomato_soup_can",
    "010_potted_meat_can",
    "011_banana",
    "040_large_marker",
    "043_phillips_screwdriver",
    "055_baseball",
    "058_golf_ball",
    "061_foam_brick",
]


@pytest.mark.parametrize("name", HELD)
def test_friction_alone_holds_a_shaken_object(name: str) -> None:
    model, data = at_rest(PANDA, grasp_spec(OBJECTS[name]))

    def run(seconds: float, motion=None) -> list[tuple[np.ndarray, np.ndarray]]:
        poses = []
        for k in range(round(seconds / STEP)):
            if motion is not None:
                data.ctrl[:7] = motion(k * STEP)
            mujoco.mj_step(model, data)
            poses.append(pose_in_gripper(data, PANDA, "thing"))
        return poses

    run(0.2)
    data.ctrl[7] = 0.0
    run(0.7)
    presses = pad_forces(model, data, "left_pad_c", steps=50)
    assert np.mean(presses) > 45, "both pads press with what the hand can"
    assert np.std(presses) < 1.0, "and without chatter"

    position, rotation = pose_in_gripper(data, PANDA, "thing")
    # Up by the shoulder and elbow, then all joints at once, near the limits of their accelerations.
    lifted = PANDA.home + np.array([0, -0.15, 0, 0.1, 0, 0.25, 0])
    amplitude, rate = np.array([0.3, 0.1, 0, 0.25, 0, 0.3, 0.35]), np.array([6, 5, 1, 6, 1, 7, 7.0])
    poses = run(1.0, lambda t: PANDA.home + (lifted - PANDA.home) * t)
    poses += run(2.5, lambda t: lifted + amplitude * np.sin(rate * t) * min(1, t, max(0, 2.2 - t)))
    assert data.body("thing").xpos[2] > data.geom("stand").xpos[2] + 0.05
    slip = max(np.linalg.norm(p - position) for p, _ in poses)
    turn = max(np.arccos(np.clip((np.trace(rotation.T @ r) - 1) / 2, -1, 1)) for _, r in poses)
    assert slip < 0.005
    assert np.degrees(turn) < 5.0

    before, _ = pose_in_gripper(data, PANDA, "thing")
    run(3.0)
    assert np.linalg.norm(pose_in_gripper(data, PANDA, "thing")[0] - before) < 2e-4, "a held object does not creep"
