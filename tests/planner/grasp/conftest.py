"""Targets, scenes and the gripper's bodies for all tests of grasps."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from regrasp_planner.geometry.distance import certified_distance
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.pose import rigid, wxyz_xyz
from regrasp_planner.task import Body, Scene

SIZE = np.array([0.048, 0.093, 0.176])


def box(size=SIZE):
    return Body("box", (ConvexBody.box(size),), np.zeros(3), 0.5)


def can(radius=0.033, height=0.1, sides=24):
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    points = np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-height / 2, height / 2)])
    return Body("can", (ConvexBody.from_vertices(points),), np.zeros(3), 0.3)


def stone(seed=1, count=20):
    points = np.random.default_rng(seed).normal(size=(count, 3)) * [0.015, 0.018, 0.03]
    body = ConvexBody.from_vertices(points)
    return Body("stone", (body,), np.asarray(body.center), 0.2)


def handled():
    """Too large to grasp except by its handle."""
    block = ConvexBody.box((0.12, 0.12, 0.12))
    handle = ConvexBody.from_vertices(block.hull_vertices() * [0.15, 0.6, 0.5] + [0.0, 0.0, 0.09])
    return Body("handled", (block, handle), np.array([0.0, 0.0, 0.01]), 0.5)


def cage(build):
    """A scene in which walls surround the target on all sides."""
    walls = tuple(
        build.box_obstacle(f"wall{k}", np.where(np.arange(3) == k // 2, 0.02, 0.5), 0.1 * (-1) ** k * np.eye(3)[k // 2])
        for k in range(6)
    )
    return Scene("cage", build.pose(), walls)


def palm(gripper, pose):
    """Bodies of the palm with their poses, straight from the robot's description."""
    return [(gripper.palm[k], pose) for k in range(gripper.palm.batch_size)]


def fingers(gripper, pose, theta):
    """Bodies of the fingers with their poses, straight from the robot's description."""
    moved = np.asarray(gripper.finger_motion(theta))
    return [(gripper.fingers[k], wxyz_xyz(rigid(pose) * rigid(moved[k]))) for k in range(gripper.fingers.batch_size)]


def certified_gap(first, first_pose, second, second_pose):
    """Rigorous lower bound of the distance of two bodies' hulls."""
    a, b = ConvexBody.stack([first]), ConvexBody.stack([second])
    return float(certified_distance(a, jnp.asarray(first_pose)[None], b, jnp.asarray(second_pose)[None])[0])


@pytest.fixture(scope="session")
def gap():
    return certified_gap


@pytest.fixture(scope="session")
def bodies():
    """The functions that make targets."""
    return SimpleNamespace(size=SIZE, box=box, can=can, stone=stone, handled=handled)


@pytest.fixture
def target(request):
    """The target of a given name."""
    return {"box": box, "can": can, "stone": stone}[request.param]()


@pytest.fixture(scope="session")
def free(build):
    """A scene without obstacles."""
    return Scene("free", build.pose(), ())


@pytest.fixture(scope="session")
def caged(build):
    return cage(build)


@pytest.fixture(scope="session")
def hand():
    """The functions that place the gripper's bodies."""
    return SimpleNamespace(palm=palm, fingers=fingers)


@pytest.fixture(scope="session")
def scenes(build):
    """A box lying on a narrow side on a table, and standing on a shelf board."""
    table = build.box_obstacle("table", (1.2, 1.6, 0.05), (0.4, 0, -0.025))
    board = build.box_obstacle("board", (0.3, 0.5, 0.02), (0.6, 0.4, 0.19))
    roof = build.box_obstacle("roof", (0.3, 0.5, 0.02), (0.6, 0.4, 0.57))
    post = build.box_obstacle("post", (0.06, 0.06, 0.1), (0.5, -0.42, 0.05), (0.3, 0.2, 0.1))
    world = (table, board, roof, post)
    lying = build.pose((0.5, -0.3, SIZE[1] / 2), (np.pi / 2, 0, 0))
    standing = build.pose((0.58, 0.4, 0.2 + SIZE[2] / 2), (0, 0, np.pi / 2))
    return Scene("pick", lying, world), Scene("place", standing, world)
