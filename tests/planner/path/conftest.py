"""Scenes, free configurations and exact distances for the tests of paths."""

from functools import partial
from types import SimpleNamespace

import coal
import jax
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from regrasp_planner.collision.model import body_frames
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.path.clearance import path_clearance
from regrasp_planner.path.space import ConfigurationSpace
from regrasp_planner.robot.kinematics import forward_kinematics
from regrasp_planner.task import Body, Obstacle

THETA = 0.03


class ExactDistances:
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


def crowded_shelf(build, seed, clutter=10):
    """A table, a shelf of two compartments to the left of the robot, boxes and 24-sided cans on the table."""
    rng = np.random.default_rng(seed)
    scene = [build.box_obstacle("table", (1.6, 2.0, 0.04), (0.4, 0, -0.02))]
    scene += [
        build.box_obstacle(f"board{i}", (0.5, 0.3, 0.02), (0.35, 0.55, z)) for i, z in enumerate((0.01, 0.35, 0.7))
    ]
    scene += [build.box_obstacle(f"side{i}", (0.02, 0.3, 0.7), (x, 0.55, 0.36)) for i, x in enumerate((0.1, 0.6))]
    scene += [build.box_obstacle("back", (0.5, 0.02, 0.7), (0.35, 0.71, 0.36))]
    turn = 2 * np.pi * np.arange(24) / 24
    for i in range(clutter):
        at = rng.uniform([0.3, -0.55], [0.75, 0.3])
        size = rng.uniform([0.04, 0.04, 0.05], [0.10, 0.10, 0.22])
        if i % 2:
            scene.append(build.box_obstacle(f"box{i}", size, (*at, size[2] / 2), (0, 0, rng.uniform(0, 3))))
        else:
            ring = 0.5 * size[0] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            prism = np.concatenate([np.column_stack([ring, np.full(24, z)]) for z in (0, size[2])])
            scene.append(
                Obstacle(Body(f"can{i}", (ConvexBody.from_vertices(prism),), np.zeros(3)), build.pose((*at, 0)))
            )
    return scene


def free_configurations(robot, model, rng, count, low=(0.2, -0.6, 0.03), high=(0.75, 0.6, 0.6)):
    """Random free configurations with the gripper in a box."""
    clearance = path_clearance(ConfigurationSpace(model, THETA))
    hand = jax.jit(jax.vmap(lambda q: forward_kinematics(robot.arm, q)[-1][4:]))
    found = np.zeros((0, 7))
    while len(found) < count:
        q = rng.uniform(robot.arm.lower, robot.arm.upper, (2000, 7))
        at = np.asarray(hand(q))
        q = q[((at > low) & (at < high)).all(axis=1)]
        found = np.concatenate([found, q[clearance.free(q)]])
    return found[:count]


@pytest.fixture(scope="session")
def robot(panda):
    return panda


@pytest.fixture(scope="session")
def paths(build):
    """What the tests of paths share: a crowded scene, free configurations, and exact distances by coal."""
    return SimpleNamespace(
        crowded_shelf=partial(crowded_shelf, build),
        free_configurations=free_configurations,
        ExactDistances=ExactDistances,
    )
