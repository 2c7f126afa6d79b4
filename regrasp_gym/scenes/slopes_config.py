"""What can be tuned about the excavator's scenes; see `slopes`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from regrasp_gym.checks import check_probabilities, check_ranges
from regrasp_gym.errors import SceneError
from regrasp_gym.objects.stones import FRICTION, StoneConfig

MAX_OTHERS = 10
"""Most stones besides the target: what observations have room for."""


@dataclass(frozen=True)
class SlopesConfig:
    """Everything about the scenes that can be tuned. Lengths in metres, angles in radians, ranges inclusive.

    Attributes:
        target: what the stone to be moved is like.
        stones: what the others are like.
        base: what the stone is like that the target is to be put on.
        pick_stones: least and most stones on the pick slope besides the target.
        place_stones: least and most stones on the place slope, the one under the goal among them. Together with
            ``pick_stones`` at most `MAX_OTHERS`.
        pick_azimuth, place_azimuth: of the middle of the slopes, about z from the machine's x axis.
        slope_distance: of the middle of a slope from the swing axis.
        inclination: of a slope.
        downhill: direction in which a slope falls, seen from above, counted from the way to the machine: 0 falls
            towards the machine, ±π away from it.
        lift: height above the ground of the lowest point of the disc that stones lie on.
        slope_size: edge length of the slope's top face.
        slope_thickness: of its box, most of it under the ground.
        slope_radius: of the disc about the middle of a slope that all stones on it keep inside, seen along its normal.
        target_spread, goal_spread: largest distance of the target's start, or of a goal on the slope itself, from the
            middle of the slope (of the foot of its centre of mass).
        pick_gap: range of gaps on the pick slope. One is drawn for each stone; it is pushed towards the target from a
            random side until this near to it or to a stone on the way, seen along the slope's normal.
        goal_gap: likewise on the place slope, towards the goal. Small gaps leave the gripper little room.
        landing_weight: a stone's facet to lie on is drawn with the facet's solid angle, seen from the centre of mass,
            to this power: 1 is near to how stones fall, 0 is all alike.
        goal_landing_weight: likewise for the target at its goal where this is not on the facet it starts on.
        same_side: probability that the target is to lie on the facet that it lies on at the start. Seldom more come
            out, where no other facet will do.
        goal_yaw: range of the turn, to a random side, between start and goal as the machine sees it, that is about
            the slope's normal and in frames whose x axes point away from the machine. With another facet down the
            stone is first rolled onto it by the least turn.
        on_top: probability that the goal is on another stone. Seldom fewer come out, where no stone fits.
        top_inclination: steepest facet of a stone that a goal may be on.
        top_height: greatest height above the ground of the middle of that facet.
        rest_margin: least distance from the edge of the supporting facet of where gravity through a stone's centre of
            mass meets the plane that it lies on.
        top_margin: likewise for a goal on a stone, from the edge of what both facets share, and for that stone under
            its load.
        max_opening: of the gripper; as the target lies, at the start and at the goal, it is no wider than this minus
            ``opening_margin`` between some two planes along the slope's normal.
        opening_margin: see ``max_opening``.
        release_center, release_size: flat patch of ground that is kept free, middle and full size.
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
                f"pick_stones {self.pick_stones} and place_stones {self.place_stones} may be more than {MAX_OTHERS} "
                "together; lower one of them"
            )
        if self.on_top > 0 and self.place_stones[0] < 1:
            raise SceneError(
                f"place_stones is {self.place_stones} with on_top {self.on_top}; a goal on a stone needs one"
            )
        for name in ("inclination", "top_inclination"):
            steepest = float(np.max(getattr(self, name)))
            if np.tan(steepest) > 0.8 * FRICTION:
                raise SceneError(f"{name} is up to {steepest:.2f} rad; stones slide from {np.arctan(FRICTION):.2f} rad")
