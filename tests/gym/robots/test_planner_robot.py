"""The planner's robot against the MuJoCo model that it was read from."""

from __future__ import annotations

import itertools
from dataclasses import replace

import jax
import jaxlie
import mujoco
import numpy as np
import pytest
from robot_alone import body_geoms

from regrasp_gym.robots.collision_geoms import geom_body
from regrasp_gym.robots.model_reader import RobotModelError
from regrasp_gym.robots.panda import PANDA
from regrasp_gym.robots.setup import RobotSetup
from regrasp_planner import separation
from regrasp_planner.robot.kinematics import body_poses, forward_kinematics, robot_bodies
from regrasp_planner.robot.model import Robot

JAWS = """
<mujoco>
  <compiler angle="radian"/>
  <default><geom group="3"/></default>
  <worldbody>
    <geom name="ground" type="plane" size="9 9 1" group="0"/>
    <body name="house" pos="0.3 -0.2 0.5" quat="0.9 0.1 0.2 0.3">
      <geom type="box" size="0.4 0.3 0.2"/>
      <body name="boom" pos="0.1 0 0.2" quat="0.7071068 0.7071068 0 0">
        <joint name="swing" axis="0 0 1" range="-2 2"/>
        <geom type="capsule" size="0.05" fromto="0 0 0 0.8 0 0"/>
        <body name="bracket" pos="0.8 0 0" quat="0.9238795 0 0.3826834 0">
          <geom type="sphere" size="0.07"/>
          <body name="stick" pos="0.1 0.02 0.03">
            <joint name="crowd" axis="0.6 0.8 0" range="-1 2"/>
            <geom type="capsule" size="0.04" fromto="0 0 0 0.1 0 -0.6"/>
            <body name="tool" pos="0.1 0 -0.7">
              <geom type="cylinder" size="0.1 0.05"/>
              <site name="grip" pos="0 0 -0.3" quat="0 1 0 0"/>
              <body name="jaw1" pos="0 0.1 -0.05">
                <joint name="hinge1" axis="1 0 0" range="0 0.8"/>
                <geom name="plate1" type="box" size="0.08 0.02 0.12" pos="0 -0.08 -0.13"/>
              </body>
              <body name="jaw2" pos="0 -0.1 -0.05">
                <joint name="hinge2" axis="-1 0 0" range="-0.1 0.9"/>
                <geom name="plate2" type="box" size="0.08 0.02 0.12" pos="0 0.08 -0.13"/>
              </body></body></body></body></body></body>
  </worldbody>
</mujoco>
"""


REVERSED_JAWS = JAWS.replace('axis="1 0 0" range="0 0.8"', 'axis="-1 0 0" range="-0.8 0"').replace(
    'axis="-1 0 0" range="-0.1 0.9"', 'axis="1 0 0" range="-0.9 0.1"'
)


def jaw_robot(xml: str = JAWS, **changes) -> Robot:
    setup = RobotSetup(
        name="digger",
        build_spec=lambda: mujoco.MjSpec.from_string(xml),
        base="house",
        arm_joints=("swing", "crowd"),
        arm_actuators=(),
        finger_joints=("hinge1", "hinge2"),
        pads=("plate1", "plate2"),
        gripper_actuator="",
        tcp_site="grip",
        home=np.zeros(2),
        max_velocity=np.ones(2),
        max_acceleration=np.ones(2),
        theta_range=(0.0, 0.8),
    )
    return replace(setup, **changes).planner_robot()


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return PANDA.build_spec().compile()


@pytest.fixture(scope="module")
def robot(model: mujoco.MjModel) -> Robot:
    return PANDA.planner_robot(model)


def panda_geoms(model: mujoco.MjModel) -> list[int]:
    return body_geoms(model, "hand", ("left_finger", "right_finger"))


def posed(model: mujoco.MjModel, q: np.ndarray, theta: float) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:7], data.qpos[7:9] = q, theta
    mujoco.mj_forward(model, data)
    return data


def random_configurations(robot: Robot, count: int, seed: int = 0) -> list[tuple[np.ndarray, float]]:
    rng = np.random.default_rng(seed)
    low, high = np.asarray(robot.arm.lower), np.asarray(robot.arm.upper)
    return [(rng.uniform(low, high), rng.uniform(0, 0.04)) for _ in range(count)]


def same_pose(pose: np.ndarray, position: np.ndarray, matrix: np.ndarray, tolerance: float) -> bool:
    turn = np.asarray(jaxlie.SO3(pose[:4]).as_matrix())
    return bool(np.abs(pose[4:] - position).max() < tolerance and np.abs(turn - matrix.reshape(3, 3)).max() < tolerance)


def test_forward_kinematics_is_mujocos(model: mujoco.MjModel, robot: Robot) -> None:
    kinematics = jax.jit(forward_kinematics)
    for q, _ in random_configurations(robot, 100):
        data = posed(model, q, 0.0)
        frames = np.asarray(kinematics(robot.arm, q))
        for k in range(8):
            assert same_pose(frames[k], data.body(f"link{k}").xpos, data.body(f"link{k}").xmat, 1e-9)
        assert same_pose(frames[8], data.site("tcp").xpos, data.site("tcp").xmat, 1e-9)


def test_bodies_are_where_the_geoms_are(model: mujoco.MjModel, robot: Robot) -> None:
    """Every body contains its geom's support in random directions, and exceeds it by at most 1 mm."""
    bodies = robot_bodies(robot)
    geoms = panda_geoms(model)
    assert bodies.batch_size == len(geoms)
    rng = np.random.default_rng(1)
    for q, theta in random_configurations(robot, 5):
        data = posed(model, q, theta)
        poses = np.asarray(body_poses(robot, q, theta))
        for k, geom in enumerate(geoms):
            turn = np.asarray(jaxlie.SO3(poses[k, :4]).as_matrix())
            vertices = np.asarray(bodies.vertices[k]) @ turn.T + poses[k, 4:]
            for direction in rng.normal(size=(10, 3)):
                direction /= np.linalg.norm(direction)
                ours = (vertices @ direction).max() + float(bodies.radius[k])
                theirs = geom_support(model, data, geom, direction)
                assert theirs - 1e-9 <= ours <= theirs + 1e-3


def geom_support(model: mujoco.MjModel, data: mujoco.MjData, geom: int, direction: np.ndarray) -> float:
    """Support function of a capsule, box or mesh geom, written without the code under test."""
    local = data.geom_xmat[geom].reshape(3, 3).T @ direction
    size = model.geom_size[geom]
    base = data.geom_xpos[geom] @ direction
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return base + size[0] + size[1] * abs(local[2])
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        return base + np.abs(local) @ size
    mesh = model.geom_dataid[geom]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    return base + (model.mesh_vert[start : start + count] @ local).max()


def test_body_distances_are_mujocos(model: mujoco.MjModel, robot: Robot) -> None:
    """Distances of the self-collision pairs: never larger than MuJoCo's, and within 2 mm of them."""
    bodies, geoms = robot_bodies(robot), panda_geoms(model)
    pairs = np.asarray(robot.self_pairs)
    measure = jax.jit(lambda a, b: separation(bodies[pairs[:, 0]], a, bodies[pairs[:, 1]], b).distance)
    for q, theta in random_configurations(robot, 8, seed=2):
        data = posed(model, q, theta)
        poses = np.asarray(body_poses(robot, q, theta))
        ours = np.asarray(measure(poses[pairs[:, 0]], poses[pairs[:, 1]]))
        theirs = np.array([mujoco.mj_geomDistance(model, data, geoms[i], geoms[j], 10.0, None) for i, j in pairs])
        apart = theirs > 1e-3
        assert apart.sum() > 20
        assert (ours[apart] <= theirs[apart] + 1e-6).all()
        assert (ours[apart] >= theirs[apart] - 2e-3).all()
        # MuJoCo's own depth of overlapping pairs is not exact; only the sign is compared.
        assert (ours[theirs < -1e-3] < 0).all()


def test_self_pairs_hold_every_contact_that_can_happen(model: mujoco.MjModel, robot: Robot) -> None:
    geoms = panda_geoms(model)
    known = {frozenset((geoms[i], geoms[j])) for i, j in np.asarray(robot.self_pairs)}
    met = set()
    for q, theta in random_configurations(robot, 1500, seed=3):
        data = posed(model, q, theta)
        met |= {frozenset(contact.geom.tolist()) for contact in data.contact}
    assert len(met) > 20
    assert met <= known


def test_no_self_collision_where_there_is_none(model: mujoco.MjModel, robot: Robot) -> None:
    """Fat capsules must not report a collision at home, nor in most of the joint space."""
    assert posed(model, PANDA.home, 0.04).ncon == 0
    free = [posed(model, q, theta).ncon == 0 for q, theta in random_configurations(robot, 400, seed=4)]
    assert np.mean(free) > 0.85


def test_the_gripper_is_described(model: mujoco.MjModel, robot: Robot) -> None:
    gripper = robot.gripper
    assert float(gripper.max_opening) == pytest.approx(0.08, abs=1e-6)
    assert (float(gripper.lower), float(gripper.upper)) == (0.0, pytest.approx(0.04))
    geoms = panda_geoms(model)
    first = robot.links.batch_size + gripper.palm.batch_size
    pads = [model.geom(geoms[first + int(k)]).name for k in gripper.contact]
    assert pads == ["left_pad_c", "right_pad_c"]
    assert np.asarray(gripper.finger_of)[np.asarray(gripper.contact)].tolist() == [0, 1]
    # The pads' faces meet at the grasp centre when closed.
    for contact, side in zip(gripper.contact, (1, -1), strict=True):
        y = np.asarray(gripper.fingers[int(contact)].hull_vertices())[:, 1] * side
        assert y.min() == pytest.approx(0.0, abs=1e-9)


def test_swinging_jaws_and_fixed_parts_between_joints() -> None:
    model = mujoco.MjModel.from_xml_string(JAWS)
    robot = jaw_robot()
    assert (float(robot.gripper.lower), float(robot.gripper.upper)) == (0.0, pytest.approx(0.8))
    assert np.asarray(robot.link_of).tolist() == [0, 1, 1, 2]
    bodies, geoms = robot_bodies(robot), body_geoms(model, "tool", ("jaw1", "jaw2"))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(5)
    for _ in range(10):
        q, theta = rng.uniform([-2, -1], [2, 2]), rng.uniform(0, 0.8)
        data.qpos[:] = [*q, theta, theta]
        mujoco.mj_kinematics(model, data)
        poses = np.asarray(body_poses(robot, q, theta))
        frames = np.asarray(forward_kinematics(robot.arm, q))
        assert same_pose(frames[-1], data.site("grip").xpos, data.site("grip").xmat, 1e-9)
        for k, geom in enumerate(geoms):
            center = jaxlie.SE3(poses[k]).apply(bodies.center[k])
            assert np.asarray(center) == pytest.approx(data.geom_xpos[geom], abs=1e-9)


def test_a_cylinder_contains_itself() -> None:
    model = mujoco.MjModel.from_xml_string(JAWS)
    tool = next(g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_CYLINDER)
    vertices = geom_body(model, tool).hull_vertices()
    for angle, z in itertools.product(np.linspace(0, 6.28, 50), (-0.05, 0.05)):
        point = np.array([0.1 * np.cos(angle), 0.1 * np.sin(angle), z])
        direction = np.array([np.cos(angle), np.sin(angle), 0])
        assert (vertices @ direction).max() >= point @ direction - 1e-12
        assert np.abs(vertices[:, 2]).max() == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": "hoose"}, "no body 'hoose'"),
        ({"arm_joints": ("swing", "crawl")}, "no joint 'crawl'"),
        ({"arm_joints": ("crowd", "swing")}, "does not follow"),
        ({"arm_joints": ("swing", "hinge1"), "finger_joints": ("crowd", "hinge2")}, "not carried by the last link"),
        ({"pads": ("plate1", "plate1")}, "one per finger"),
        ({"xml": REVERSED_JAWS}, "does not open"),
        ({"max_velocity": np.ones(3)}, r"max_velocity of 'digger' has shape \(3,\)"),
        ({"tcp_site": "grab"}, "no site 'grab'"),
    ],
)
def test_wrong_descriptions_are_refused_by_name(changes: dict, message: str) -> None:
    with pytest.raises(RobotModelError, match=message):
        jaw_robot(**changes)


def test_a_plane_is_no_body() -> None:
    model = mujoco.MjModel.from_xml_string(JAWS)
    with pytest.raises(RobotModelError, match="'ground' is a plane"):
        geom_body(model, model.geom("ground").id)
