"""The planner's view of a world: a `regrasp_planner.Task` of the present state."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from regrasp_gym.scenes.scene import Fixture
from regrasp_gym.simulation.world import World

if TYPE_CHECKING:
    from regrasp_planner.task import Body, Task


def make_task(world: World) -> Task:
    """Move the target from where it is now to the goal, everything else staying where it is now.

    The obstacles are all fixtures and all other objects, in both scenes.
    """
    # Imported here because it loads JAX, which stepping an environment does not need.
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
        # Joint limits are soft in the simulation: an arm that rests against one may be a little beyond it.
        start=np.clip(world.joint_positions, *world.joint_limits),
        supports=frozenset(fixture.name for fixture in scene.fixtures if fixture.support),
    )


@lru_cache(maxsize=64)
def _fixture_body(fixture: Fixture) -> Body:
    from regrasp_planner.geometry.support import ConvexBody
    from regrasp_planner.task import Body

    return Body(fixture.name, (ConvexBody.box(fixture.size),), np.zeros(3))
