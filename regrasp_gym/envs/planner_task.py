"""The planner's view of a world: a `regrasp_planner.Task` of the current state."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from regrasp_gym.scenes.scene import Fixture
from regrasp_gym.simulation.world import World

if TYPE_CHECKING:
    from regrasp_planner.task import Body, Task


def make_task(world: World) -> Task:
    """The task of moving the target from its current pose to the goal, while everything else stays in place.

    All fixtures and all other objects are obstacles, in both scenes.
    """
    # Loads JAX, which stepping does not need.
    from regrasp_planner.task import Obstacle, ReleaseArea, Scene, Task

    scene = world.scene
    fixtures = tuple(Obstacle(_fixture_body(fixture), fixture.pose) for fixture in scene.fixtures)
    others = zip(scene.others, world.other_poses, strict=True)
    obstacles = fixtures + tuple(Obstacle(thing.model.body(), pose) for thing, pose in others)
    return Task(
        target=scene.target.model.body(),
        pick=Scene("pick", world.target_pose, obstacles),
        place=Scene("place", scene.goal_pose, obstacles),
        release=ReleaseArea(scene.release.center, scene.release.half_extents),
        # Joint limits are soft in the simulation: an arm that rests against one may slightly exceed it.
        start=np.clip(world.joint_positions, *world.joint_limits),
        supports=frozenset(fixture.name for fixture in scene.fixtures if fixture.support),
    )


@lru_cache(maxsize=64)
def _fixture_body(fixture: Fixture) -> Body:
    from regrasp_planner.geometry.support import ConvexBody
    from regrasp_planner.task import Body

    return Body(fixture.name, (ConvexBody.box(fixture.size),), np.zeros(3))
