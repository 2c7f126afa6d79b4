"""IkSolve: free of collisions, with alternatives, and with reasons for failure."""

from dataclasses import replace

import numpy as np
import pytest

from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import collision_model
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.ik.ik_solve import IkFailure, solve_ik

ON_TABLE = {("link1", "table"): None}
OPENING = 0.03


def test_tight_poses_are_solved_without_collision(cluttered, gripper_poses, pose_errors):
    """Every pose that has a solution (it was made from one) is solved, to 0.1 mm and 1 mrad, and truly free."""
    model, tight = cluttered
    arm = model.arrays.robot.arm
    targets = gripper_poses(arm, tight)
    results = solve_ik(model, targets, OPENING)
    solved = [i for i, result in enumerate(results) if result.success]
    assert len(solved) >= 0.99 * len(targets) - 1
    q = np.stack([results[i].q for i in solved])
    position, rotation = pose_errors(arm, q, targets[solved])
    assert position.max() < 1e-4
    assert rotation.max() < 1e-3
    assert np.all((q >= arm.lower) & (q <= arm.upper))
    assert configuration_clearance(model, q, OPENING, cap=0.0, exact=True).value.min() >= 0.0


def test_alternatives_are_distinct_free_and_ranked_by_the_reference(cluttered, gripper_poses):
    model, tight = cluttered
    arm = model.arrays.robot.arm
    targets = gripper_poses(arm, tight[:8])
    results = solve_ik(model, targets, OPENING, reference=tight[:8], max_solutions=4)
    several = [result for result in results if len(result.solutions) > 1]
    assert len(several) >= 4
    for result, near in zip(results, tight[:8], strict=True):
        q = np.stack([solution.q for solution in result.solutions])
        for i in range(len(q)):
            assert np.all(np.abs(q[:i] - q[i]).max(axis=1, initial=0.0) > 0.05)
        assert configuration_clearance(model, q, OPENING, cap=0.0).value.min() >= 0.0
        # The reference itself solves the pose, so the best solution is not far from it.
        assert np.linalg.norm(q[0] - near) < 1.5


def test_held_body_keeps_clear(panda, build):
    """With a long body in the hand the wrist has to be higher over the same table."""
    table = (build.box_obstacle("table", (1.2, 1.6, 0.04), (0.4, 0, -0.03)),)
    rod = ConvexBody.box((0.02, 0.02, 0.3))
    target = build.pose((0.45, 0.1, 0.08), (np.pi, 0, 0))
    empty = collision_model(panda, table, overrides=ON_TABLE)
    holding = collision_model(panda, table, held=[rod], overrides=ON_TABLE)
    touching = collision_model(panda, table, held=[rod], overrides={**ON_TABLE, ("held", "table"): None})
    hits = solve_ik(holding, target, OPENING)[0]
    assert solve_ik(empty, target, OPENING)[0].success
    assert solve_ik(touching, target, OPENING)[0].success
    assert hits.failure == IkFailure.HELD_OBJECT
    assert "held – table" in hits.message
    one_of_each = solve_ik([empty, holding], np.stack([target, target]), OPENING)
    assert [result.success for result in one_of_each] == [True, False]


def test_failures_name_their_constraint(panda, build):
    table = (build.box_obstacle("table", (1.2, 1.6, 0.04), (0.4, 0, -0.03)),)
    model = collision_model(panda, table, overrides=ON_TABLE)
    bare = collision_model(panda)
    down = (np.pi, 0, 0)
    far, inside = solve_ik(
        [bare, model], np.stack([build.pose((1.5, 0, 0.4), down), build.pose((0.4, 0, -0.05), down)]), OPENING
    )
    assert far.failure == IkFailure.UNREACHABLE
    assert "[1.5, 0.0, 0.4]" in far.message
    assert inside.failure == IkFailure.WORLD_COLLISION
    assert "table" in inside.message
    with pytest.raises(ValueError, match="unreachable"):
        _ = far.q


def test_joint_limits_are_told_from_reach(panda, build):
    """The same pose, with the base joint free and with the arm held to one side."""
    lower, upper = panda.arm.lower.copy(), panda.arm.upper.copy()
    lower[[0, 2]], upper[[0, 2]] = [1.0, -0.1], [1.2, 0.1]
    home = panda.home + np.array([1.1, 0, 0, 0, 0, 0, 0])
    held_aside = replace(panda, arm=replace(panda.arm, lower=lower, upper=upper), home=home)
    target = build.pose((0.2, -0.6, 0.4), (np.pi, 0, 0))
    assert solve_ik(collision_model(panda), target, OPENING)[0].success
    limited = solve_ik(collision_model(held_aside), target, OPENING)[0]
    assert limited.failure == IkFailure.JOINT_LIMITS
    assert "joint limits: 'joint" in limited.message


def test_bad_input_is_refused(panda):
    bare = collision_model(panda)
    with pytest.raises(ValueError, match="shape"):
        solve_ik(bare, np.zeros((2, 6)), OPENING)
    with pytest.raises(ValueError, match="finite"):
        solve_ik(bare, np.full((1, 7), np.nan), OPENING)
    with pytest.raises(ValueError, match="2 collision models for 1 targets"):
        solve_ik([bare, bare], np.ones((1, 7)), OPENING)
    assert solve_ik(bare, np.zeros((0, 7)), OPENING) == []


def test_same_seed_same_answer(cluttered, gripper_poses):
    model, tight = cluttered
    targets = gripper_poses(model.arrays.robot.arm, tight[:3])
    one, two = (solve_ik(model, targets, OPENING, seed=5) for _ in range(2))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.nearest, b.nearest)
