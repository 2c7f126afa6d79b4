"""Releases within cones and outside of them."""

from __future__ import annotations

import numpy as np
import pytest

from regrasp_bench.tables.drops import DropTable
from regrasp_bench.tables.hulls import random_hull, stone
from regrasp_bench.tables.release_trials import random_in_cone
from regrasp_gym.objects import OBJECTS
from regrasp_planner import stable_poses as stab_pose
from regrasp_planner.placement.basins import DROP, release_cones
from regrasp_planner.placement.stab_pose import rotation_to


def tilted(axis, angle, towards):
    return np.cos(angle) * np.asarray(axis, float) + np.sin(angle) * np.asarray(towards, float)


def test_directions_in_a_cone_are_spread_over_its_solid_angle():
    rng = np.random.default_rng(0)
    axis = np.array([0.6, 0, -0.8])
    x = np.array([random_in_cone(axis, 0.7, rng) for _ in range(4000)])
    np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1)
    cosine = x @ axis
    assert cosine.min() > np.cos(0.7)
    # By Archimedes' theorem the cosine is uniform.
    assert cosine.mean() == pytest.approx(0.5 * (1 + np.cos(0.7)), abs=0.005)
    assert np.abs((x - cosine[:, None] * axis).mean(axis=0)).max() < 0.02


def test_releases_within_the_cones_settle_as_predicted_and_those_well_outside_do_not():
    rng = np.random.default_rng(1)
    inside, outside = [], []
    for seed in range(30):
        thing = stone(900 + seed) if seed % 2 else OBJECTS[sorted(OBJECTS)[seed % len(OBJECTS)]]
        body = thing.body()
        cones = release_cones(stab_pose(body.hull_vertices(), body.center_of_mass))[:8]
        usable = [cone for cone in cones if cone.half_angle > 0.02]
        if not usable:
            continue
        drop_table = DropTable(thing)
        for _ in range(4):
            cone = usable[int(rng.integers(len(usable)))]
            x = random_in_cone(cone.axis, cone.half_angle, rng)
            inside.append(drop_table.drop(rotation_to(x), DROP).settled_into(cone.axis))
            side = np.cross(cone.axis, random_hull(rng, 1)[0])
            y = tilted(cone.axis, 2.5 * cone.half_angle, side / np.linalg.norm(side))
            outside.append(drop_table.drop(rotation_to(y), DROP).settled_into(cone.axis))
    assert len(inside) > 80
    assert np.mean(inside) >= 0.97
    assert np.mean(outside) < 0.5
