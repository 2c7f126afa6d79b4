import numpy as np
import pytest
from jaxlie import SE3
from scipy.spatial.transform import Rotation

from regrasp_planner.collision.model import body_frames, collision_model
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.ik.line import ArmKinematics
from regrasp_planner.path.clearance import path_clearance
from regrasp_planner.path.options import PathOptions
from regrasp_planner.path.path_plan import PathStatus, cartesian_path, plan_path
from regrasp_planner.path.query import LineQuery, PathQuery
from regrasp_planner.path.rrt import rrt_connect
from regrasp_planner.path.space import ConfigurationSpace
from regrasp_planner.robot.kinematics import forward_kinematics

THETA = 0.03
STANDS_ON = {("link1", "table"): None}
"""The base capsule reaches below the table top."""


def held_box():
    return [ConvexBody.box((0.05, 0.05, 0.14))]


def dense(trajectory, step=0.004):
    return trajectory.at(np.arange(0, trajectory.duration, step))


@pytest.mark.parametrize("held", [False, True])
def test_paths_in_random_shelf_scenes_are_free_and_no_fewer_than_rrt_connect_finds(robot, held, paths):
    rng = np.random.default_rng(11)
    solved = by_search = 0
    for scene in range(4):
        pieces = held_box() if held else []
        model = collision_model(robot, paths.crowded_shelf(scene), held=pieces, overrides=STANDS_ON)
        for start, goal in paths.free_configurations(robot, model, rng, 6).reshape(3, 2, 7):
            clearance = path_clearance(ConfigurationSpace(model, THETA))
            limits = robot.arm.lower, robot.arm.upper
            polyline = rrt_connect(start, goal, clearance.free, *limits, np.random.default_rng(0), max_rounds=40)
            by_search += polyline is not None
            result = plan_path(PathQuery(ConfigurationSpace(model, THETA), start, goal, PathOptions(search_rounds=40)))
            solved += result.success
            if not result.success:
                assert result.status is PathStatus.NO_PATH
                continue
            trajectory = result.trajectory
            np.testing.assert_allclose(trajectory.start, start, atol=1e-9)
            np.testing.assert_allclose(trajectory.goal, goal, atol=1e-9)
            velocity, acceleration = trajectory.peak_ratios(robot.arm.max_velocity, robot.arm.max_acceleration)
            assert max(velocity, acceleration) <= 0.5 + 1e-6
            every = np.linspace(0, trajectory.duration, 60)
            assert paths.ExactDistances(model).least(trajectory.at(every)).min() > -1e-6
    assert solved >= by_search
    assert solved >= 10


def test_a_detour_is_free_at_a_millimetre(robot, build, paths):
    """Across a thick wall; the exact check is dense enough that no corner slips through between samples."""
    wall = build.box_obstacle("wall", (0.5, 0.06, 0.5), (0.6, 0, 0.25))
    model = collision_model(robot, [wall])
    home = np.array([0, 0.3, 0, -2.0, 0, 2.2, 0.8])
    start, goal = home + np.eye(7)[0] * 0.7, home - np.eye(7)[0] * 0.7
    result = plan_path(PathQuery(ConfigurationSpace(model, THETA), start, goal))
    assert result.success
    assert result.stats["method"] == "optimised"
    least = paths.ExactDistances(model).least(dense(result.trajectory)).min()
    assert least > 0
    assert result.stats["clearance"] <= least + 1e-3
    again = plan_path(PathQuery(ConfigurationSpace(model, THETA), start, goal))
    np.testing.assert_array_equal(again.trajectory.positions, result.trajectory.positions)


def test_with_nothing_in_the_way_the_path_is_straight(robot):
    model = collision_model(robot)
    start, goal = np.asarray(robot.home), np.asarray(robot.home) + 0.3
    result = plan_path(PathQuery(ConfigurationSpace(model, THETA), start, goal))
    assert result.stats["method"] == "straight"
    direction = (goal - start) / np.linalg.norm(goal - start)
    offset = dense(result.trajectory) - start
    assert np.abs(offset - np.outer(offset @ direction, direction)).max() < 1e-6


def test_the_search_alone_finds_paths_too(robot, build, paths):
    wall = build.box_obstacle("wall", (0.5, 0.06, 0.5), (0.6, 0, 0.25))
    model = collision_model(robot, [wall])
    home = np.array([0, 0.3, 0, -2.0, 0, 2.2, 0.8])
    start, goal = home + np.eye(7)[0] * 0.7, home - np.eye(7)[0] * 0.7
    result = plan_path(PathQuery(ConfigurationSpace(model, THETA), start, goal, PathOptions(max_guesses=0)))
    assert result.success
    assert str(result.stats["method"]).startswith("searched")
    assert paths.ExactDistances(model).least(dense(result.trajectory, 0.02)).min() > 0


def test_ends_in_collision_name_the_bodies(robot, build):
    home = np.asarray(robot.home)
    at = np.asarray(forward_kinematics(robot.arm, home))[-1][4:]
    model = collision_model(robot, [build.box_obstacle("crate", (0.1, 0.1, 0.1), at)])
    away = home + np.eye(7)[0]
    for ends, status in (((home, away), "START_IN_COLLISION"), ((away, home), "GOAL_IN_COLLISION")):
        result = plan_path(PathQuery(ConfigurationSpace(model, THETA), *ends))
        assert result.status is PathStatus[status]
        assert "crate" in result.bodies
        assert "crate" in result.message
        np.testing.assert_array_equal(result.configuration, home)


def test_limits_are_reported_by_joint(robot):
    goal = np.asarray(robot.home).copy()
    goal[3] = 0.2
    result = plan_path(PathQuery(ConfigurationSpace(collision_model(robot), THETA), np.asarray(robot.home), goal))
    assert result.status is PathStatus.OUT_OF_LIMITS
    assert "joint4" in result.message


def test_a_closed_cage_gives_no_path_and_says_what_is_in_the_way(robot, build):
    start = np.array([1.2, 0.3, 0, -2.0, 0, 2.2, 0.8])
    goal = start - np.eye(7)[0] * 2.4
    # Longer and higher than the arm reaches, before and behind it.
    wall = build.box_obstacle("wall", (3.0, 0.05, 3.0), (1.65, 0, 0.5))
    model = collision_model(robot, [wall, build.box_obstacle("rear", (3.0, 0.05, 3.0), (-1.65, 0, 0.5))])
    result = plan_path(
        PathQuery(ConfigurationSpace(model, THETA), start, goal, PathOptions(search_rounds=5, max_guesses=2))
    )
    assert result.status is PathStatus.NO_PATH
    assert {"wall", "rear"} & set(result.bodies)


def test_wrong_shapes_are_refused(robot):
    model = collision_model(robot)
    with pytest.raises(ValueError, match="7 finite angles"):
        plan_path(PathQuery(ConfigurationSpace(model, THETA), np.zeros(6), np.zeros(7)))
    with pytest.raises(ValueError, match="7 finite angles"):
        plan_path(PathQuery(ConfigurationSpace(model, THETA), np.full(7, np.nan), np.zeros(7)))
    with pytest.raises(ValueError, match="3 finite metres"):
        cartesian_path(LineQuery(ConfigurationSpace(model, THETA), np.asarray(robot.home), np.zeros(2)))


# --- ends in contact --------------------------------------------------------------------------------------------------


def standing_object(robot, build, gap):
    """A held box that stands on a table, ``gap`` metres above it, and the configuration."""
    q = np.array([0, 0.35, 0, -2.1, 0, 2.45, 0.785])
    hand = np.asarray(forward_kinematics(robot.arm, q))[-1]
    box = ConvexBody.box((0.04, 0.04, 0.1))
    upright = build.pose(hand[4:])
    in_hand = np.asarray((SE3(hand).inverse() @ SE3(upright)).wxyz_xyz)
    table = build.box_obstacle("table", (0.5, 0.5, 0.04), (hand[4], hand[5], hand[6] - 0.05 - gap - 0.02))
    return q, collision_model(robot, [table], held=[box], held_pose=in_hand)


@pytest.mark.parametrize("gap", [0.0, 1e-3, -3e-4])
def test_an_object_standing_on_the_table_is_lifted_and_put_down_again(robot, gap, build, paths):
    start, model = standing_object(robot, build, gap)
    up = cartesian_path(LineQuery(ConfigurationSpace(model, 0.02), start, np.array([0, 0, 0.08])))
    assert up.success, up.message
    # In joint space too, from contact to contact.
    goal = start.copy()
    goal[0] += 0.1
    across = plan_path(PathQuery(ConfigurationSpace(model, 0.02), start, goal))
    assert across.success, across.message
    least = paths.ExactDistances(model).least(dense(across.trajectory)).min()
    assert least > min(gap, 0.0) - 3e-4
    middle = across.trajectory.at(across.trajectory.duration / 2)
    assert paths.ExactDistances(model).least(middle[None])[0] > 1e-3


def test_where_a_path_ends_only_what_is_held_may_touch(robot, build):
    """The robot is where it is, and an object stands on something; but nobody has to go into a wall, however little."""
    q, held = standing_object(robot, build, -1e-3)
    away = q + 0.3 * np.eye(7)[0]
    options = PathOptions(contact_tolerance=3e-3)
    assert plan_path(PathQuery(ConfigurationSpace(held, 0.02), away, q, options)).success
    bare = collision_model(robot)
    lowest = min(_lowest_points_of_fingers(bare, q, 0.02))
    hand = np.asarray(forward_kinematics(robot.arm, q))[-1]
    model = collision_model(robot, [build.box_obstacle("block", (0.2, 0.2, 0.04), (hand[4], hand[5], lowest - 0.019))])
    assert plan_path(PathQuery(ConfigurationSpace(model, 0.02), q, away, options)).success
    result = plan_path(PathQuery(ConfigurationSpace(model, 0.02), away, q, options))
    assert result.status is PathStatus.GOAL_IN_COLLISION
    assert "block" in result.bodies
    down = cartesian_path(LineQuery(ConfigurationSpace(model, 0.02), q, np.array([0, 0, 0.05]), options)).trajectory
    assert down is not None
    back = cartesian_path(LineQuery(ConfigurationSpace(model, 0.02), down.goal, np.array([0, 0, -0.05]), options))
    assert back.status is PathStatus.LINE_IN_COLLISION


def _lowest_points_of_fingers(model, q, theta):
    """Heights of the lowest points of the fingers' bodies, metres."""
    poses = np.asarray(body_frames(model.arrays, q, theta))
    for i, name in enumerate(model.body_names):
        if name.startswith("finger"):
            body = model.arrays.bodies[i]
            turn = Rotation.from_quat(poses[i, :4], scalar_first=True)
            yield (turn.apply(body.hull_vertices()) + poses[i, 4:])[:, 2].min() - float(body.radius)


def test_an_object_deep_in_the_table_is_a_collision(robot, build):
    start, model = standing_object(robot, build, -0.01)
    result = cartesian_path(LineQuery(ConfigurationSpace(model, 0.02), start, np.array([0, 0, 0.08])))
    assert result.status is PathStatus.START_IN_COLLISION
    assert set(result.bodies) == {"held", "table"}


def test_pressing_a_held_object_into_the_table_is_a_collision(robot, build):
    start, model = standing_object(robot, build, 0.03)
    result = cartesian_path(LineQuery(ConfigurationSpace(model, 0.02), start, np.array([0, 0, -0.05])))
    assert result.status is PathStatus.LINE_IN_COLLISION
    assert set(result.bodies) == {"held", "table"}


# --- straight lines ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("direction", [(0, 0, 0.12), (0.1, 0.05, -0.05), (0, -0.15, 0)])
def test_the_gripper_keeps_to_the_line_and_its_orientation(robot, direction):
    direction = np.array(direction)
    start = np.asarray(robot.home)
    result = cartesian_path(LineQuery(ConfigurationSpace(collision_model(robot), THETA), start, direction))
    assert result.success
    kinematics = ArmKinematics(robot.arm)
    first = kinematics.gripper(start)[0]
    np.testing.assert_allclose(
        kinematics.gripper(result.trajectory.goal)[0][:3, 3], first[:3, 3] + direction, atol=1e-4
    )
    unit = direction / np.linalg.norm(direction)
    for q in result.trajectory.at(np.linspace(0, result.trajectory.duration, 200)):
        place = kinematics.gripper(q)[0]
        moved = place[:3, 3] - first[:3, 3]
        assert np.linalg.norm(moved - unit * (unit @ moved)) < 5e-4
        assert np.arccos(np.clip((np.trace(place[:3, :3] @ first[:3, :3].T) - 1) / 2, -1, 1)) < 2e-3


def test_a_line_out_of_reach_says_how_far_it_got(robot):
    result = cartesian_path(
        LineQuery(ConfigurationSpace(collision_model(robot), THETA), np.asarray(robot.home), np.array([0.9, 0, 0]))
    )
    assert result.status is PathStatus.LINE_OUT_OF_REACH
    assert "mm" in result.message
    reached = ArmKinematics(robot.arm).gripper(result.configuration)[0]
    began = ArmKinematics(robot.arm).gripper(np.asarray(robot.home))[0]
    assert 0.05 < reached[0, 3] - began[0, 3] < 0.9


def test_a_line_into_an_obstacle_names_it(robot, build):
    home = np.asarray(robot.home)
    at = np.asarray(forward_kinematics(robot.arm, home))[-1][4:]
    model = collision_model(robot, [build.box_obstacle("crate", (0.1, 0.1, 0.1), at - [0, 0, 0.15])])
    result = cartesian_path(LineQuery(ConfigurationSpace(model, THETA), home, np.array([0, 0, -0.12])))
    assert result.status is PathStatus.LINE_IN_COLLISION
    assert "crate" in result.bodies
