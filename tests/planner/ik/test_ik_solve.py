"""IkSolve: kinematics, freedom from collisions, alternatives, and reasons for failure."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import collision_model
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.ik.candidates import TargetSearch, batches, descend, draw_starts, screen
from regrasp_planner.ik.descent import descend_to_pose, solve_positive
from regrasp_planner.ik.ik_solve import IkFailure, solve_ik
from regrasp_planner.ik.null_space import leave_collisions
from regrasp_planner.robot.kinematics import forward_kinematics, gripper_jacobian, pose_error

ON_TABLE = {("link1", "table"): None}
OPENING = 0.03
gripper_poses = jax.jit(jax.vmap(lambda arm, q: forward_kinematics(arm, q)[-1], in_axes=(None, 0)))
seeds = st.integers(0, 2**31 - 1)


def random_configurations(arm, count, seed):
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, arm.dof))


def errors(arm, q, targets):
    """Position (m) and rotation (rad) distance of the gripper from the targets."""
    apart = jaxlie.SE3(jnp.asarray(targets)).inverse() @ jaxlie.SE3(gripper_poses(arm, jnp.asarray(q)))
    turn = 2 * np.arctan2(np.linalg.norm(apart.wxyz_xyz[:, 1:4], axis=1), np.abs(apart.wxyz_xyz[:, 0]))
    return np.linalg.norm(apart.translation(), axis=1), turn


@pytest.fixture(scope="module")
def cluttered(panda, build):
    """A scene with walls, and configurations that are free in it but less than 2 cm from something."""
    walls = (
        build.box_obstacle("left wall", (0.6, 0.02, 0.8), (0.4, 0.45, 0.4)),
        build.box_obstacle("right wall", (0.6, 0.02, 0.8), (0.4, -0.45, 0.4)),
        build.box_obstacle("ceiling", (0.8, 1.0, 0.02), (0.4, 0, 0.95)),
    )
    model = collision_model(panda, (*build.shelf_scene(0, clutter=8), *walls), overrides=ON_TABLE)
    q = random_configurations(panda.arm, 3072, seed=3)
    q = q[np.asarray(gripper_poses(panda.arm, jnp.asarray(q)))[:, 4] > 0.25]
    clearance = configuration_clearance(model, q, OPENING, cap=0.03).value
    tight = q[(clearance >= 0) & (clearance < 0.02)]
    assert len(tight) >= 16
    return model, tight


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_descent_inverts_forward_kinematics(panda, seed):
    truth = random_configurations(panda.arm, 8, seed)
    targets = gripper_poses(panda.arm, jnp.asarray(truth))
    starts = random_configurations(panda.arm, 8 * 32, seed + 1).reshape(8, 32, 7)
    found = descend_to_pose(panda.arm, np.asarray(targets), starts, 3, 60)
    best = np.argmin(found.position_error.reshape(8, 32) + found.rotation_error.reshape(8, 32), axis=1)
    q = np.asarray(found.q).reshape(8, 32, 7)[np.arange(8), best]
    position, rotation = errors(panda.arm, q, targets)
    assert position.max() < 1e-5
    assert rotation.max() < 1e-5
    assert np.all(q >= panda.arm.lower)
    assert np.all(q <= panda.arm.upper)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_small_solver_agrees_with_numpy(seed):
    rng = np.random.default_rng(seed)
    root, right = rng.normal(size=(6, 6)), rng.normal(size=6)
    matrix = root @ root.T + 1e-3 * np.eye(6)
    np.testing.assert_allclose(
        jax.jit(solve_positive)(jnp.asarray(matrix), jnp.asarray(right)), np.linalg.solve(matrix, right), rtol=1e-6
    )


def test_jacobian_matches_finite_differences(panda):
    q = jnp.asarray(random_configurations(panda.arm, 1, 0)[0])
    frames = jax.jit(forward_kinematics)(panda.arm, q)
    jacobian = gripper_jacobian(panda.arm, frames)
    for i in range(7):
        h = 1e-6
        moved = forward_kinematics(panda.arm, q.at[i].add(h))[-1]
        np.testing.assert_allclose(pose_error(frames[-1], moved) / h, jacobian[:, i], atol=1e-5)


def test_tight_poses_are_solved_without_collision(cluttered):
    """Every pose that has a solution (it was made from one) is solved, to 0.1 mm and 1 mrad, and truly free."""
    model, tight = cluttered
    arm = model.arrays.robot.arm
    targets = np.asarray(gripper_poses(arm, jnp.asarray(tight)))
    results = solve_ik(model, targets, OPENING)
    solved = [i for i, result in enumerate(results) if result.success]
    assert len(solved) >= 0.99 * len(targets) - 1
    q = np.stack([results[i].q for i in solved])
    position, rotation = errors(arm, q, targets[solved])
    assert position.max() < 1e-4
    assert rotation.max() < 1e-3
    assert np.all((q >= arm.lower) & (q <= arm.upper))
    assert configuration_clearance(model, q, OPENING, cap=0.0, exact=True).value.min() >= 0.0


def test_alternatives_are_distinct_free_and_ranked_by_the_reference(cluttered):
    model, tight = cluttered
    arm = model.arrays.robot.arm
    targets = np.asarray(gripper_poses(arm, jnp.asarray(tight[:8])))
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


def test_null_space_descent_leaves_collisions(cluttered):
    """From colliding configurations only, the augmented Lagrangian finds free ones for most of the poses."""
    model, tight = cluttered
    arm = model.arrays.robot.arm
    targets = np.asarray(gripper_poses(arm, jnp.asarray(tight[:32])))
    home = np.asarray(model.arrays.robot.home)
    searches = [TargetSearch(model, target, OPENING, home, closest=tight[0]) for target in targets]
    for batch in batches(searches):
        starts = draw_starts(arm, batch, np.zeros((0, 7)), np.random.default_rng(0))
        screen(batch, descend(arm, batch, starts, 30), 4)
    trapped = [search for search in searches if search.colliding]
    for search in trapped:
        search.solutions.clear()
    assert len(trapped) >= 4
    for batch in batches(trapped):
        leave_collisions(batch, 4)
    escaped = [search for search in trapped if search.solutions]
    assert len(escaped) >= 0.5 * len(trapped)
    q = np.stack([search.solutions[0].q for search in escaped])
    position, rotation = errors(arm, q, np.stack([search.target for search in escaped]))
    assert position.max() < 1e-4
    assert rotation.max() < 1e-3
    assert configuration_clearance(model, q, OPENING, cap=0.0, exact=True).value.min() >= 0.0


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


def test_same_seed_same_answer(cluttered):
    model, tight = cluttered
    targets = np.asarray(gripper_poses(model.arrays.robot.arm, jnp.asarray(tight[:3])))
    one, two = (solve_ik(model, targets, OPENING, seed=5) for _ in range(2))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.nearest, b.nearest)
