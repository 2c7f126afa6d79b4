import coal
import jax
import numpy as np
import pytest
from jaxlie import SE3
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_planner.collision.model import body_frames, collision_model
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.ik.line import ArmKinematics, follow_line
from regrasp_planner.path.clearance import PathClearance
from regrasp_planner.path.path_plan import PathOptions, PathStatus, cartesian_path, plan_path
from regrasp_planner.path.rrt import rrt_connect
from regrasp_planner.path.trajectory import Trajectory, interpolating_path, time_parametrize
from regrasp_planner.robot.kinematics import forward_kinematics
from regrasp_planner.task import Body, Obstacle

THETA = 0.03
STANDS_ON = {("link1", "table"): None}
"""The base capsule reaches below the table top."""


class Oracle:
    """Exact distances of a collision model's pairs by coal: hulls, with their sweeps taken off."""

    def __init__(self, model):
        self.model = model
        self.pairs = model.pairs[np.asarray(model.arrays.valid)]
        bodies = model.arrays.bodies
        self.radius = np.asarray(bodies.radius)
        self.shapes = [self._shape(bodies[i].hull_vertices()) for i in range(bodies.batch_size)]
        self.frames = jax.jit(jax.vmap(lambda q: body_frames(model.arrays, q, THETA)))

    @staticmethod
    def _shape(vertices):
        hull = ConvexHull(vertices)
        points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for vertex in vertices:
            points.append(vertex)
        for a, b, c in hull.simplices:
            triangles.append(coal.Triangle(int(a), int(b), int(c)))
        return coal.Convex(points, triangles)

    def least(self, configurations):
        """Smallest distance over pairs, for each configuration."""
        poses = np.asarray(self.frames(configurations))
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        out = []
        for here in poses:
            places = [coal.Transform3s(coal.Quaternion(*p[:4]).toRotationMatrix(), p[4:]) for p in here]
            best = np.inf
            for a, b in self.pairs:
                result.clear()
                coal.distance(self.shapes[a], places[a], self.shapes[b], places[b], request, result)
                best = min(best, result.min_distance - self.radius[a] - self.radius[b])
            out.append(best)
        return np.array(out)


@pytest.fixture(scope="module")
def robot(panda):
    return panda


def pose(xyz, yaw=0.0):
    return np.concatenate([Rotation.from_euler("z", yaw).as_quat(scalar_first=True), np.asarray(xyz, float)])


def box_obstacle(name, size, xyz, yaw=0.0):
    return Obstacle(Body(name, (ConvexBody.box(size),), np.zeros(3)), pose(xyz, yaw))


def shelf_scene(seed, clutter=10):
    """A table, a shelf of two compartments to the left of the robot, boxes and 24-sided cans on the table."""
    rng = np.random.default_rng(seed)
    scene = [box_obstacle("table", (1.6, 2.0, 0.04), (0.4, 0, -0.02))]
    scene += [box_obstacle(f"board{i}", (0.5, 0.3, 0.02), (0.35, 0.55, z)) for i, z in enumerate((0.01, 0.35, 0.7))]
    scene += [box_obstacle(f"side{i}", (0.02, 0.3, 0.7), (x, 0.55, 0.36)) for i, x in enumerate((0.1, 0.6))]
    scene += [box_obstacle("back", (0.5, 0.02, 0.7), (0.35, 0.71, 0.36))]
    turn = 2 * np.pi * np.arange(24) / 24
    for i in range(clutter):
        at = rng.uniform([0.3, -0.55], [0.75, 0.3])
        size = rng.uniform([0.04, 0.04, 0.05], [0.10, 0.10, 0.22])
        if i % 2:
            scene.append(box_obstacle(f"box{i}", size, (*at, size[2] / 2), rng.uniform(0, 3)))
        else:
            ring = 0.5 * size[0] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            prism = np.concatenate([np.column_stack([ring, np.full(24, z)]) for z in (0, size[2])])
            scene.append(Obstacle(Body(f"can{i}", (ConvexBody.from_vertices(prism),), np.zeros(3)), pose((*at, 0))))
    return scene


def free_configurations(robot, model, rng, count, low=(0.2, -0.6, 0.03), high=(0.75, 0.6, 0.6)):
    """Random free configurations with the gripper in a box."""
    clearance = PathClearance(model, THETA)
    hand = jax.jit(jax.vmap(lambda q: forward_kinematics(robot.arm, q)[-1][4:]))
    found = np.zeros((0, 7))
    while len(found) < count:
        q = rng.uniform(robot.arm.lower, robot.arm.upper, (2000, 7))
        at = np.asarray(hand(q))
        q = q[((at > low) & (at < high)).all(axis=1)]
        found = np.concatenate([found, q[clearance.free(q)]])
    return found[:count]


def held_box():
    return [ConvexBody.box((0.05, 0.05, 0.14))]


def dense(trajectory, step=0.004):
    return trajectory.at(np.arange(0, trajectory.duration, step))


@pytest.mark.parametrize("held", [False, True])
def test_paths_in_random_shelf_scenes_are_free_and_no_fewer_than_rrt_connect_finds(robot, held):
    rng = np.random.default_rng(11)
    solved = by_search = 0
    for scene in range(4):
        pieces = held_box() if held else []
        model = collision_model(robot, shelf_scene(scene), held=pieces, overrides=STANDS_ON)
        for start, goal in free_configurations(robot, model, rng, 6).reshape(3, 2, 7):
            clearance = PathClearance(model, THETA)
            limits = robot.arm.lower, robot.arm.upper
            polyline = rrt_connect(start, goal, clearance.free, *limits, np.random.default_rng(0), max_rounds=40)
            by_search += polyline is not None
            result = plan_path(model, start, goal, THETA, PathOptions(search_rounds=40))
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
            assert Oracle(model).least(trajectory.at(every)).min() > -1e-6
    assert solved >= by_search
    assert solved >= 10


def test_a_detour_is_free_at_a_millimetre(robot):
    """Across a thick wall; the exact check is dense enough that no corner slips through between samples."""
    wall = box_obstacle("wall", (0.5, 0.06, 0.5), (0.6, 0, 0.25))
    model = collision_model(robot, [wall])
    home = np.array([0, 0.3, 0, -2.0, 0, 2.2, 0.8])
    start, goal = home + np.eye(7)[0] * 0.7, home - np.eye(7)[0] * 0.7
    result = plan_path(model, start, goal, THETA)
    assert result.success
    assert result.stats["method"] == "optimised"
    least = Oracle(model).least(dense(result.trajectory)).min()
    assert least > 0
    assert result.stats["clearance"] <= least + 1e-3
    again = plan_path(model, start, goal, THETA)
    np.testing.assert_array_equal(again.trajectory.positions, result.trajectory.positions)


def test_with_nothing_in_the_way_the_path_is_straight(robot):
    model = collision_model(robot)
    start, goal = np.asarray(robot.home), np.asarray(robot.home) + 0.3
    result = plan_path(model, start, goal, THETA)
    assert result.stats["method"] == "straight"
    direction = (goal - start) / np.linalg.norm(goal - start)
    offset = dense(result.trajectory) - start
    assert np.abs(offset - np.outer(offset @ direction, direction)).max() < 1e-6


def test_the_search_alone_finds_paths_too(robot):
    wall = box_obstacle("wall", (0.5, 0.06, 0.5), (0.6, 0, 0.25))
    model = collision_model(robot, [wall])
    home = np.array([0, 0.3, 0, -2.0, 0, 2.2, 0.8])
    start, goal = home + np.eye(7)[0] * 0.7, home - np.eye(7)[0] * 0.7
    result = plan_path(model, start, goal, THETA, PathOptions(max_guesses=0))
    assert result.success
    assert str(result.stats["method"]).startswith("searched")
    assert Oracle(model).least(dense(result.trajectory, 0.02)).min() > 0


def test_ends_in_collision_name_the_bodies(robot):
    home = np.asarray(robot.home)
    at = np.asarray(forward_kinematics(robot.arm, home))[-1][4:]
    model = collision_model(robot, [box_obstacle("crate", (0.1, 0.1, 0.1), at)])
    away = home + np.eye(7)[0]
    for ends, status in (((home, away), "START_IN_COLLISION"), ((away, home), "GOAL_IN_COLLISION")):
        result = plan_path(model, *ends, THETA)
        assert result.status is PathStatus[status]
        assert "crate" in result.bodies
        assert "crate" in result.message
        np.testing.assert_array_equal(result.configuration, home)


def test_limits_are_reported_by_joint(robot):
    goal = np.asarray(robot.home).copy()
    goal[3] = 0.2
    result = plan_path(collision_model(robot), np.asarray(robot.home), goal, THETA)
    assert result.status is PathStatus.OUT_OF_LIMITS
    assert "joint4" in result.message


def test_a_closed_cage_gives_no_path_and_says_what_is_in_the_way(robot):
    start = np.array([1.2, 0.3, 0, -2.0, 0, 2.2, 0.8])
    goal = start - np.eye(7)[0] * 2.4
    # Longer and higher than the arm reaches, before and behind it.
    wall = box_obstacle("wall", (3.0, 0.05, 3.0), (1.65, 0, 0.5))
    model = collision_model(robot, [wall, box_obstacle("rear", (3.0, 0.05, 3.0), (-1.65, 0, 0.5))])
    result = plan_path(model, start, goal, THETA, PathOptions(search_rounds=5, max_guesses=2))
    assert result.status is PathStatus.NO_PATH
    assert {"wall", "rear"} & set(result.bodies)


def test_wrong_shapes_are_refused(robot):
    model = collision_model(robot)
    with pytest.raises(ValueError, match="7 finite angles"):
        plan_path(model, np.zeros(6), np.zeros(7), THETA)
    with pytest.raises(ValueError, match="7 finite angles"):
        plan_path(model, np.full(7, np.nan), np.zeros(7), THETA)
    with pytest.raises(ValueError, match="3 finite metres"):
        cartesian_path(model, np.asarray(robot.home), np.zeros(2), THETA)


# --- ends in contact --------------------------------------------------------------------------------------------------


def standing_object(robot, gap):
    """A held box that stands on a table, ``gap`` metres above it, and the configuration."""
    q = np.array([0, 0.35, 0, -2.1, 0, 2.45, 0.785])
    hand = np.asarray(forward_kinematics(robot.arm, q))[-1]
    box = ConvexBody.box((0.04, 0.04, 0.1))
    upright = pose(hand[4:])
    in_hand = np.asarray((SE3(hand).inverse() @ SE3(upright)).wxyz_xyz)
    table = box_obstacle("table", (0.5, 0.5, 0.04), (hand[4], hand[5], hand[6] - 0.05 - gap - 0.02))
    return q, collision_model(robot, [table], held=[box], held_pose=in_hand)


@pytest.mark.parametrize("gap", [0.0, 1e-3, -3e-4])
def test_an_object_standing_on_the_table_is_lifted_and_put_down_again(robot, gap):
    start, model = standing_object(robot, gap)
    up = cartesian_path(model, start, np.array([0, 0, 0.08]), 0.02)
    assert up.success, up.message
    # In joint space too, from contact to contact.
    goal = start.copy()
    goal[0] += 0.1
    across = plan_path(model, start, goal, 0.02)
    assert across.success, across.message
    least = Oracle(model).least(dense(across.trajectory)).min()
    assert least > min(gap, 0.0) - 3e-4
    middle = across.trajectory.at(across.trajectory.duration / 2)
    assert Oracle(model).least(middle[None])[0] > 1e-3


def test_where_a_path_ends_only_what_is_held_may_touch(robot):
    """The robot is where it is, and an object stands on something; but nobody has to go into a wall, however little."""
    q, held = standing_object(robot, -1e-3)
    away = q + 0.3 * np.eye(7)[0]
    options = PathOptions(contact_tolerance=3e-3)
    assert plan_path(held, away, q, 0.02, options).success
    bare = collision_model(robot)
    lowest = min(_lowest_points_of_fingers(bare, q, 0.02))
    hand = np.asarray(forward_kinematics(robot.arm, q))[-1]
    model = collision_model(robot, [box_obstacle("block", (0.2, 0.2, 0.04), (hand[4], hand[5], lowest - 0.019))])
    assert plan_path(model, q, away, 0.02, options).success
    result = plan_path(model, away, q, 0.02, options)
    assert result.status is PathStatus.GOAL_IN_COLLISION
    assert "block" in result.bodies
    down = cartesian_path(model, q, np.array([0, 0, 0.05]), 0.02, options).trajectory
    assert down is not None
    back = cartesian_path(model, down.goal, np.array([0, 0, -0.05]), 0.02, options)
    assert back.status is PathStatus.LINE_IN_COLLISION


def _lowest_points_of_fingers(model, q, theta):
    """Heights of the lowest points of the fingers' bodies, metres."""
    poses = np.asarray(body_frames(model.arrays, q, theta))
    for i, name in enumerate(model.body_names):
        if name.startswith("finger"):
            body = model.arrays.bodies[i]
            turn = Rotation.from_quat(poses[i, :4], scalar_first=True)
            yield (turn.apply(body.hull_vertices()) + poses[i, 4:])[:, 2].min() - float(body.radius)


def test_an_object_deep_in_the_table_is_a_collision(robot):
    start, model = standing_object(robot, -0.01)
    result = cartesian_path(model, start, np.array([0, 0, 0.08]), 0.02)
    assert result.status is PathStatus.START_IN_COLLISION
    assert set(result.bodies) == {"held", "table"}


def test_pressing_a_held_object_into_the_table_is_a_collision(robot):
    start, model = standing_object(robot, 0.03)
    result = cartesian_path(model, start, np.array([0, 0, -0.05]), 0.02)
    assert result.status is PathStatus.LINE_IN_COLLISION
    assert set(result.bodies) == {"held", "table"}


# --- straight lines ---------------------------------------------------------------------------------------------------


def test_kinematics_on_the_host_are_those_of_the_robot(robot):
    kinematics = ArmKinematics(robot.arm)
    rng = np.random.default_rng(0)
    for q in rng.uniform(robot.arm.lower, robot.arm.upper, (20, 7)):
        place, jacobian = kinematics.gripper(q)
        expected = np.asarray(forward_kinematics(robot.arm, q))[-1]
        np.testing.assert_allclose(place[:3, 3], expected[4:], atol=1e-12)
        h = 1e-6
        for j in range(7):
            ahead, behind = kinematics.gripper(q + h * np.eye(7)[j])[0], kinematics.gripper(q - h * np.eye(7)[j])[0]
            np.testing.assert_allclose((ahead - behind)[:3, 3] / (2 * h), jacobian[:3, j], atol=1e-8)
            spin = (ahead - behind)[:3, :3] @ place[:3, :3].T / (2 * h)
            np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], jacobian[3:, j], atol=1e-8)


@pytest.mark.parametrize("direction", [(0, 0, 0.12), (0.1, 0.05, -0.05), (0, -0.15, 0)])
def test_the_gripper_keeps_to_the_line_and_its_orientation(robot, direction):
    direction = np.array(direction)
    start = np.asarray(robot.home)
    result = cartesian_path(collision_model(robot), start, direction, THETA)
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
    result = cartesian_path(collision_model(robot), np.asarray(robot.home), np.array([0.9, 0, 0]), THETA)
    assert result.status is PathStatus.LINE_OUT_OF_REACH
    assert "mm" in result.message
    reached = ArmKinematics(robot.arm).gripper(result.configuration)[0]
    began = ArmKinematics(robot.arm).gripper(np.asarray(robot.home))[0]
    assert 0.05 < reached[0, 3] - began[0, 3] < 0.9


def test_a_line_goes_on_with_the_other_joints_when_one_is_at_its_limit(robot):
    kinematics = ArmKinematics(robot.arm)
    # Not the symmetric home, where the joints that could help are singular.
    start = np.asarray(robot.home) + np.array([0.3, 0.2, 0.5, 0.1, -0.4, 0.2, 0])
    kinematics.upper = kinematics.upper.copy()
    kinematics.upper[1] = start[1] + 0.02
    line = follow_line(kinematics, start, np.array([0.08, 0, 0]))
    assert line.fraction == 1.0
    assert line.configurations[:, 1].max() <= kinematics.upper[1] + 1e-12
    ends = [kinematics.gripper(q)[0] for q in line.configurations[[0, -1]]]
    np.testing.assert_allclose(ends[1] - ends[0], np.pad([[0.08], [0], [0]], ((0, 1), (3, 0))), atol=1e-4)


def test_a_line_into_an_obstacle_names_it(robot):
    home = np.asarray(robot.home)
    at = np.asarray(forward_kinematics(robot.arm, home))[-1][4:]
    model = collision_model(robot, [box_obstacle("crate", (0.1, 0.1, 0.1), at - [0, 0, 0.15])])
    result = cartesian_path(model, home, np.array([0, 0, -0.12]), THETA)
    assert result.status is PathStatus.LINE_IN_COLLISION
    assert "crate" in result.bodies


# --- the certificate --------------------------------------------------------------------------------------------------


def test_the_certificate_sees_a_thin_plate_between_two_samples(robot):
    """Two samples far apart, both free, with a plate of one millimetre that the hand sweeps through."""
    home = np.asarray(robot.home)
    at = np.asarray(forward_kinematics(robot.arm, home))[-1][4:]
    model = collision_model(robot, [box_obstacle("plate", (0.3, 0.001, 0.3), at)])
    ends = np.stack([home - np.eye(7)[0] * 0.6, home + np.eye(7)[0] * 0.6])
    trajectory = Trajectory(np.array([0.0, 1.0]), ends, np.zeros((2, 7)))
    clearance = PathClearance(model, THETA)
    assert clearance.free(ends).all()
    collision, _ = clearance.certify(trajectory)
    assert collision is not None
    assert "plate" in model.describe(collision.pair)
    assert Oracle(model).least(collision.configuration[None])[0] < 1e-3


def test_what_the_certificate_passes_is_free(robot):
    """Random motions through a scene: where coal finds an overlap at fine steps, there is no certificate."""
    rng = np.random.default_rng(2)
    model = collision_model(robot, shelf_scene(1), overrides=STANDS_ON)
    oracle, clearance = Oracle(model), PathClearance(model, THETA)
    verdicts = []
    for start in free_configurations(robot, model, rng, 16):
        goal = np.clip(start + rng.normal(scale=0.6, size=7), robot.arm.lower, robot.arm.upper)
        path = interpolating_path(np.stack([start, goal]))
        trajectory = time_parametrize(path, robot.arm.max_velocity, robot.arm.max_acceleration)
        collision, nearest = clearance.certify(trajectory)
        least = oracle.least(trajectory.at(np.linspace(0, trajectory.duration, 80))).min()
        verdicts.append(collision is None)
        if collision is None:
            assert least > 0
            assert least <= nearest + 0.05
        else:
            assert oracle.least(collision.configuration[None])[0] < 2e-3
    assert 2 <= sum(verdicts) <= 14
