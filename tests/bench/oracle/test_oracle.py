from __future__ import annotations

import gymnasium
import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import regrasp_gym  # noqa: F401
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_planner import ConvexBody
from regrasp_planner.robot.kinematics import forward_kinematics
from regrasp_planner.task import Body, Obstacle, Scene, Task

coal = pytest.importorskip("coal")

from regrasp_bench.oracle.reach import Reach, ReachOptions  # noqa: E402

from regrasp_bench.oracle.antipodal import AntipodalOptions, Hand, sample_grasps  # noqa: E402
from regrasp_bench.oracle.oracle import Oracle, OracleOptions, Use  # noqa: E402
from regrasp_bench.peers.coal_shapes import Posed, Shape, clear  # noqa: E402
from regrasp_bench.tables.difficulty import compare, summarise  # noqa: E402

COARSE = AntipodalOptions(rays=300, cloud=3000, angles=12, across=0.03, depths=3)


@pytest.fixture(scope="module")
def world():
    env = gymnasium.make("regrasp_gym/PandaYCB-v0").unwrapped
    env.reset(seed=0)
    return env


@pytest.fixture(scope="module")
def robot(world):
    return world.planner_robot


@pytest.fixture(scope="module")
def reach(robot):
    return Reach(robot, ReachOptions(bank=8000))


@pytest.fixture(scope="module")
def oracle(robot):
    return Oracle(robot, OracleOptions(grasps=COARSE, reach=ReachOptions(bank=8000)))


# Exact collision checks ---------------------------------------------------------------------------------------------


def test_clear_says_what_the_distance_says():
    rng = np.random.default_rng(0)
    bodies = [ConvexBody.from_vertices(rng.normal(size=(12, 3)) * 0.05) for _ in range(4)]
    shapes = [Shape.of(body) for body in bodies]
    count, margin = 300, 0.01
    turns = Rotation.random(2 * (count + 1), random_state=1).as_matrix().reshape(-1, 2, 3, 3)
    shifts = rng.uniform(-0.2, 0.2, (count + 1, 2, 3))
    moving = Posed(shapes[:2], turns[:count], shifts[:count])
    still = Posed(shapes[2:], turns[count], shifts[count])
    expected = np.ones(count, bool)
    for i in range(count):
        for a in range(2):
            for b in range(2):
                distance = coal.distance(
                    shapes[a].geometry,
                    coal.Transform3s(turns[i, a], shifts[i, a]),
                    shapes[2 + b].geometry,
                    coal.Transform3s(turns[count, b], shifts[count, b]),
                    coal.DistanceRequest(),
                    coal.DistanceResult(),
                )
                expected[i] &= distance > margin
    assert 20 < expected.sum() < count - 20
    np.testing.assert_array_equal(clear(moving, still, margin), expected)


def test_the_sweep_counts():
    ball = Shape.of(ConvexBody.sphere(0.05))
    at = np.array([[[0.0, 0, 0.12]], [[0.0, 0, 0.09]]])
    turns = np.tile(np.eye(3), (2, 1, 1, 1))
    still = Posed([ball], np.eye(3)[None], np.zeros((1, 3)))
    np.testing.assert_array_equal(clear(Posed([ball], turns, at), still, 0.0), [True, False])
    np.testing.assert_array_equal(clear(Posed([ball], turns, at), still, 0.03), [False, False])


# Grasps -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "sink"), [("003_cracker_box", 1e-4), ("005_tomato_soup_can", 2e-3), ("006_mustard_bottle", 2e-3)]
)
def test_pads_touch_from_both_sides_and_clear_the_target_when_open(robot, name, sink):
    target, gripper = OBJECTS[name].body(), robot.gripper
    grasps = sample_grasps(target, gripper, COARSE)
    assert len(grasps.thetas) > 20
    hand = Hand(gripper)
    pads = [hand.palms + int(i) for i in np.asarray(gripper.contact)]
    pieces = [Shape.of(piece) for piece in target.pieces]
    still = Posed(pieces, np.tile(np.eye(3), (len(pieces), 1, 1)), np.zeros((len(pieces), 3)))

    def pads_at(thetas, pad):
        posed = hand.at(grasps.rotations, grasps.positions, thetas)
        return Posed([hand.shapes[pad]], posed.rotations[:, [pad]], posed.positions[:, [pad]])

    for pad in pads:
        assert clear(pads_at(grasps.openings, pad), still, COARSE.finger_margin - 1e-6).all()
        # Where sides slant, the point that touches first lies between those of the cloud.
        assert clear(pads_at(grasps.thetas + sink, pad), still, 0.0).mean() > (0.95 if sink > 1e-3 else 0.999)
        assert not clear(pads_at(grasps.thetas - 1e-4, pad), still, 0.0).any()


def test_a_box_is_taken_by_its_narrow_sides_only(robot):
    grasps = sample_grasps(OBJECTS["003_cracker_box"].body(), robot.gripper, COARSE)
    closing = grasps.rotations @ np.asarray(robot.gripper.width_axis)
    np.testing.assert_allclose(np.abs(closing), np.tile([1.0, 0, 0], (len(closing), 1)), atol=1e-9)
    np.testing.assert_allclose(2 * grasps.thetas, 0.0718, atol=1e-6)


def test_what_is_too_wide_has_no_grasp(robot):
    wide = Body("crate", (ConvexBody.box((0.1, 0.12, 0.14)),), np.zeros(3))
    assert len(sample_grasps(wide, robot.gripper, COARSE).thetas) == 0


# Inverse kinematics -------------------------------------------------------------------------------------------------


def test_forward_kinematics_agree_with_the_planner(robot, reach):
    q = np.random.default_rng(2).uniform(reach.lower, reach.upper, (20, 7))
    turns, shifts = reach.forward(q)
    frames = np.asarray(jax.vmap(lambda angles: forward_kinematics(robot.arm, angles))(q))
    np.testing.assert_allclose(shifts, frames[..., 4:], atol=1e-9)
    quaternions = Rotation.from_quat(frames[..., :4].reshape(-1, 4), scalar_first=True)
    np.testing.assert_allclose(turns.reshape(-1, 3, 3), quaternions.as_matrix(), atol=1e-9)


def test_poses_of_known_configurations_are_reached(reach):
    low, high = reach.lower, reach.upper
    middle, span = (low + high) / 2, (high - low) / 2
    q = np.random.default_rng(3).uniform(middle - 0.8 * span, middle + 0.8 * span, (60, 7))
    turns, shifts = reach.forward(q)
    found, owner = reach.solve(turns[:, -1], shifts[:, -1])
    assert len(np.unique(owner)) >= 58
    assert ((found >= low) & (found <= high)).all()
    again_turns, again_shifts = reach.forward(found)
    np.testing.assert_allclose(again_shifts[:, -1], shifts[owner, -1], atol=1.1e-4)
    np.testing.assert_allclose(again_turns[:, -1], turns[owner, -1], atol=1e-3)


def test_what_is_out_of_reach_is_not_reached(reach):
    found, _ = reach.solve(np.eye(3)[None], np.array([[1.6, 0.0, 0.3]]))
    assert len(found) == 0


# Verdicts -----------------------------------------------------------------------------------------------------------


def table_task(world, goal_x=0.5, goal_y=0.25, walls=()):
    """A cube on an empty table, to be moved elsewhere on it."""
    task = world.task()
    table = next(obstacle for obstacle in task.pick.obstacles if obstacle.body.name == "table")
    cube = Body("cube", (ConvexBody.box((0.05, 0.05, 0.05)),), np.zeros(3))
    start, goal = (np.array([1.0, 0, 0, 0, x, y, 0.025]) for x, y in ((0.5, -0.25), (goal_x, goal_y)))
    obstacles = (table, *walls)
    return Task(
        cube, Scene("pick", start, obstacles), Scene("place", goal, obstacles), task.release, task.start, task.supports
    )


def wall(name, size, position):
    return Obstacle(Body(name, (ConvexBody.box(size),), np.zeros(3)), np.array([1.0, 0, 0, 0, *position]))


def test_one_grasp_suffices_on_an_empty_table(world, oracle):
    verdict = oracle.judge(table_task(world))
    assert verdict[:3] == (Use.MOVED, Use.MOVED, Use.MOVED)
    assert verdict.common_grasps > 0


def test_nothing_is_placed_beyond_reach(world, oracle):
    verdict = oracle.judge(table_task(world, goal_x=1.5))
    assert verdict[:3] == (Use.MOVED, Use.NONE, Use.NONE)


def test_nothing_is_taken_out_of_a_well(world, oracle):
    beside = [wall(f"x{s}", (0.01, 0.2, 0.3), (0.5 + s * 0.045, -0.25, 0.15)) for s in (-1, 1)]
    beside += [wall(f"y{s}", (0.1, 0.01, 0.3), (0.5, -0.25 + s * 0.045, 0.15)) for s in (-1, 1)]
    verdict = oracle.judge(table_task(world, walls=beside))
    assert verdict.pick_grasps == 0
    assert verdict[:3] == (Use.NONE, Use.MOVED, Use.NONE)


def test_walls_that_leave_different_sides_open_need_two_grasps(world, oracle):
    # Low roofs leave level grasps only, by the x faces at one end and by the y faces at the other.
    roofs = [wall(f"roof{y}", (0.3, 0.3, 0.02), (0.5, y, 0.09)) for y in (-0.25, 0.25)]
    ends = [wall(f"x{s}", (0.02, 0.12, 0.08), (0.5 + s * 0.06, -0.25, 0.04)) for s in (-1, 1)]
    sides = [wall(f"y{s}", (0.12, 0.02, 0.08), (0.5, 0.25 + s * 0.06, 0.04)) for s in (-1, 1)]
    verdict = oracle.judge(table_task(world, walls=(*roofs, *ends, *sides)))
    assert verdict.common_grasps == 0
    assert verdict.both is Use.NONE


def test_the_same_task_gets_the_same_verdict(world, robot, oracle):
    world.reset(seed=3)
    again = Oracle(robot, oracle.options)
    assert oracle.judge(world.task()) == again.judge(world.task())


# The command's summary ----------------------------------------------------------------------------------------------


def record(trial, target, pick, goal, both):
    found = {"pick": pick, "goal": goal, "both": both, "common_grasps": 7 * both}
    return {"trial": trial, "target": target, **found}


def test_shares_and_comparison_count_what_they_say():
    judged = [record(0, "box", 2, 2, 2), record(1, "box", 2, 2, 1), record(2, "can", 2, 0, 0)]
    judged.append({"trial": 3, "crashed": "ValueError: no", "traceback": ""})
    report = summarise(judged)
    assert [report["shares"][name]["count"] for name in ("pick", "goal", "both")] == [3, 2, 1]
    assert report["shares_without_straight_lines"]["both"]["count"] == 2
    assert report["one_grasp_seeds"] == [0]
    assert report["targets"]["box"] == {"trials": 2, "pick": 2, "goal": 2, "both": 1}
    assert report["no_common_grasp"] == 1
    assert report["crashed"] == {"ValueError: no": [3]}
    planned = [{"trial": 0, "planned": False}, {"trial": 1, "planned": True}, {"trial": 3, "planned": True}]
    compared = compare(judged, planned)
    assert compared["missed_by_direct"] == [0]
    assert compared["missed_by_oracle"] == [1]
    assert compared["of_one_grasp_seeds"] == 0
