"""Collision model: which pairs with which margins, and shapes that do not depend on the scene."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from regrasp_planner.collision.model import collision_model
from regrasp_planner.geometry.support import ConvexBody

HELD = ConvexBody.box((0.05, 0.06, 0.15))


def test_pairs_margins_and_overrides(panda, build):
    obstacles = (
        build.box_obstacle("table", (1, 1, 0.04), (0.4, 0, -0.03)),
        build.box_obstacle("cup", (0.05, 0.05, 0.1), (0.5, 0, 0.05)),
    )
    bare = collision_model(panda, obstacles)
    loose = collision_model(
        panda,
        obstacles,
        held=[HELD],
        overrides={("gripper", "cup"): None, ("held", "table"): -0.003, ("arm", "world"): 0.02},
    )

    def margins(model):
        valid = np.flatnonzero(model.arrays.valid)
        return {(model.describe(p), model.kind(p)): float(model.arrays.margin[p]) for p in valid}

    assert margins(bare)["palm – cup", "world collision"] == pytest.approx(0.005)
    assert ("palm – cup", "world collision") not in margins(loose)
    assert margins(loose)["held – table", "held object"] == pytest.approx(-0.003)
    assert margins(loose)["held – cup", "held object"] == pytest.approx(0.005)
    assert margins(loose)["link5 – cup", "world collision"] == pytest.approx(0.02)
    assert not any("link0 – table" in name for name, _ in margins(bare))  # the base never moves
    with pytest.raises(ValueError, match="names 'mug'"):
        collision_model(panda, obstacles, overrides={("gripper", "mug"): None})


def test_another_scene_does_not_compile_again(panda, build):
    count = []
    for seed in range(3):
        model = collision_model(panda, build.shelf_scene(seed, clutter=seed + 3), overrides={("link1", "table"): None})
        shapes = jax.tree.map(jnp.shape, model.arrays)
        count.append(str(shapes))
    assert len(set(count)) == 1


def test_a_body_is_moved_by_its_name(model, build):
    elsewhere = build.pose((0.1, 0.2, 0.3))
    moved = np.asarray(model.moved("shelf board", elsewhere).arrays.local_poses)
    before, row = np.asarray(model.arrays.local_poses), model.body_names.index("shelf board")
    np.testing.assert_array_equal(moved[row], elsewhere)
    np.testing.assert_array_equal(np.delete(moved, row, 0), np.delete(before, row, 0))
    with pytest.raises(ValueError, match="no body called 'mug'"):
        model.moved("mug", elsewhere)
