"""Parameters of the excavator's scenes; see `slopes`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from regrasp_gym.checks import check_probabilities, check_ranges
from regrasp_gym.errors import SceneError
from regrasp_gym.objects.stones import FRICTION, StoneConfig

MAX_OTHERS = 10
"""Most stones besides the target that observations have room for."""


@dataclass(frozen=True)
class SlopesConfig:
    """Parameters of the scenes. Lengths in metres, angles in radians, ranges inclusive.

    Attributes:
        target: the target stone.
        stones: the other stones.
        base: the stone under the goal.
        pick_stones: least and most stones on the pick slope besides the target.
        place_stones: least and most stones on the place slope, including the one under the goal. Together with
            ``pick_stones`` at most `MAX_OTHERS`.
        pick_azimuth, place_azimuth: azimuth of the slope's middle, from the machine's x axis about z.
        slope_distance: distance of a slope's middle from the swing axis.
        inclination: inclination of a slope.
        downhill: downhill direction of a slope seen from above: 0 is towards the machine, ±π away from it.
        lift: height above the ground of the lowest point of the disc that stones lie on.
        slope_size: edge length of the slope's top face.
        slope_thickness: thickness of the slope's box, most of it under the ground.
        slope_radius: radius of the disc, about the middle of a slope and along its normal, that holds all its stones.
        target_spread, goal_spread: largest distance from the middle of the slope to the foot of the centre of mass, of
            the target's start and of a goal on the slope itself.
        pick_gap: gaps on the pick slope. One is drawn for each stone. The stone is pushed from a random side towards
            the target until it is this near to it or to another stone, seen along the slope's normal.
        goal_gap: likewise on the place slope, towards the goal. Small gaps leave the gripper little room.
        landing_weight: the facet under a stone is drawn by its solid angle from the centre of mass to this power:
            1 is close to how stones fall, 0 is uniform.
        goal_landing_weight: likewise for the target at its goal, if on another facet than at its start.
        same_side: probability that the target lies on the same facet at the start and at the goal. Rarely more scenes
            do, where no other facet fits.
        goal_yaw: turn, to a random side, between start and goal as the machine sees it: about the slope's normal, in
            frames whose x axes point away from the machine. For another facet the stone is first rolled onto it by the
            smallest rotation.
        on_top: probability that the goal is on another stone. Rarely fewer are, where no stone fits.
        top_inclination: steepest facet of a stone that may carry a goal.
        top_height: greatest height above the ground of the middle of that facet.
        rest_margin: least distance from the edge of the supporting facet to the point below the centre of mass.
        top_margin: likewise for a goal on a stone, from the edge of the shared surface, and for the loaded stone.
        max_opening, opening_margin: opening of the gripper, and how much narrower the target must be along the slope,
            between some two planes along its normal, at the start and at a goal on the slope.
        release_center, release_size: centre and full size of the flat patch of ground kept free.
        ground_size: edge length of the ground.
    """

    target: StoneConfig = field(default_factory=StoneConfig)
    stones: StoneConfig = field(default_factory=StoneConfig)
    base: StoneConfig = field(default_factory=lambda: StoneConfig(kinds=("slab", "block"), mass=(450.0, 950.0)))
    pick_stones: tuple[int, int] = (2, 5)
    place_stones: tuple[int, int] = (2, 5)
    pick_azimuth: tuple[float, float] = (-1.26, -1.01)
    place_azimuth: tuple[float, float] = (1.01, 1.26)
    slope_distance: tuple[float, float] = (6.15, 6.45)
    inclination: tuple[float, float] = (0.09, 0.31)
    downhill: tuple[float, float] = (-1.6, 1.6)
    lift: tuple[float, float] = (0.03, 0.15)
    slope_size: float = 4.0
    slope_thickness: float = 2.0
    slope_radius: float = 1.8
    target_spread: float = 0.5
    goal_spread: float = 0.5
    pick_gap: tuple[float, float] = (0.4, 1.1)
    goal_gap: tuple[float, float] = (0.4, 1.1)
    landing_weight: float = 1.0
    goal_landing_weight: float = 1.0
    same_side: float = 0.12
    goal_yaw: tuple[float, float] = (0.0, np.pi)
    on_top: float = 0.32
    top_inclination: float = 0.26
    top_height: float = 1.6
    rest_margin: float = 0.06
    top_margin: float = 0.06
    max_opening: float = 1.2
    opening_margin: float = 0.25
    release_center: tuple[float, float] = (6.3, 0.0)
    release_size: tuple[float, float] = (3.2, 3.2)
    ground_size: float = 40.0

    def __post_init__(self) -> None:
        check_ranges(self, "pick_azimuth", "place_azimuth", "slope_distance", "downhill", "lift", "goal_yaw")
        check_ranges(self, "pick_stones", "place_stones", "pick_gap", "goal_gap", "inclination", least=0)
        check_probabilities(self, "same_side", "on_top")
        if self.pick_stones[1] + self.place_stones[1] > MAX_OTHERS:
            raise SceneError(
                f"pick_stones {self.pick_stones} and place_stones {self.place_stones} allow more than {MAX_OTHERS} "
                "together; lower one of them"
            )
        if self.on_top > 0 and self.place_stones[0] < 1:
            raise SceneError(
                f"place_stones is {self.place_stones} with on_top {self.on_top}; a goal on a stone needs at least 1"
            )
        for name in ("inclination", "top_inclination"):
            steepest = float(np.max(getattr(self, name)))
            if np.tan(steepest) > 0.8 * FRICTION:
                raise SceneError(
                    f"{name} is up to {steepest:.2f} rad; give at most {np.arctan(0.8 * FRICTION):.2f}, or stones slide"
                )
