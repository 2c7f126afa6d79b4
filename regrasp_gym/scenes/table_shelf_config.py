"""Parameters of the Panda's scenes; see `table_shelf`."""

from __future__ import annotations

from dataclasses import dataclass

from regrasp_gym.checks import check_names, check_ranges
from regrasp_gym.errors import SceneError
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_gym.scenes.graspable import graspable_by_part
from regrasp_gym.scenes.resting import least_width, resting_poses, upright_pose

TARGETS = (
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "010_potted_meat_can",
    "021_bleach_cleanser",
    "061_foam_brick",
    "065-a_cups",
    "077_rubiks_cube",
)
"""Objects that have an upright pose and fit the gripper."""

SHELF_OBJECTS = (
    *TARGETS,
    "013_apple",
    "014_lemon",
    "015_peach",
    "016_pear",
    "017_orange",
    "055_baseball",
    "056_tennis_ball",
)
"""Objects that may stand on the shelf: tall or round ones, nothing flat."""

CLUTTER = tuple(name for name in OBJECTS if name != "025_mug")
"""Objects on the table. The mug is left out: adding it would change the scene of every seed."""


@dataclass(frozen=True)
class TableShelfConfig:
    """Parameters of the scenes. Lengths in metres, angles in radians, ranges inclusive.

    Attributes:
        targets: names of the objects that may be the target.
        clutter: names of the other objects that may lie on the table.
        shelf_objects: names of the objects that may stand on the shelf.
        table_clutter: least and most objects on the table besides the target.
        shelf_clutter: least and most objects on the shelf.
        pick_center, pick_size: centre and full size of the rectangle on the table that all objects start in.
        pick_gap: least gap between two objects on the table, seen from above.
        pick_reach: largest horizontal distance of the target's start from the robot's base.
        landing_weight: a resting pose is drawn by its landing probability to this power: 1 is as objects fall, 0 is
            uniform.
        release_center, release_size: centre and full size of the rectangle on the table kept free.
        table_center, table_size: centre of the table top, and its length, width and thickness.
        shelf_center: centre of the shelf's board on the table plane. The opening faces the robot's base.
        shelf_inside: width and depth of the board between the walls.
        board_height: height of the board's upper face above the table.
        shelf_clearance: free height between the board and the roof.
        shelf_thickness: thickness of all boards and walls.
        goal_gap: least gap between the target at its goal and its neighbours on the shelf, seen from above.
        goal_depth: least and most distance of the goal's footprint from the board's front edge.
        goal_wall_gap: least gap between the target at its goal and the side walls of the shelf.
        goal_yaw: largest turn of the goal, to either side and at most a right angle, from facing a gripper that comes
            straight from the front with its narrow sides. Either narrow side may be on the left.
        max_opening, opening_margin: opening of the gripper, and how much narrower a target must be.
    """

    targets: tuple[str, ...] = TARGETS
    clutter: tuple[str, ...] = CLUTTER
    shelf_objects: tuple[str, ...] = SHELF_OBJECTS
    table_clutter: tuple[int, int] = (3, 5)
    shelf_clutter: tuple[int, int] = (2, 3)
    pick_center: tuple[float, float] = (0.46, -0.31)
    pick_size: tuple[float, float] = (0.32, 0.30)
    pick_gap: float = 0.015
    pick_reach: float = 0.68
    landing_weight: float = 1.0
    release_center: tuple[float, float] = (0.48, 0.01)
    release_size: tuple[float, float] = (0.28, 0.24)
    table_center: tuple[float, float] = (0.32, 0.02)
    table_size: tuple[float, float, float] = (1.2, 1.5, 0.04)
    shelf_center: tuple[float, float] = (0.481, 0.481)
    shelf_inside: tuple[float, float] = (0.54, 0.30)
    board_height: float = 0.16
    shelf_clearance: float = 0.31
    shelf_thickness: float = 0.015
    goal_gap: float = 0.015
    goal_depth: tuple[float, float] = (0.03, 0.09)
    goal_wall_gap: float = 0.1
    goal_yaw: float = 0.5
    max_opening: float = 0.08
    opening_margin: float = 0.004

    def __post_init__(self) -> None:
        check_names(self, "targets", known=OBJECTS)
        check_names(self, "clutter", "shelf_objects", known=OBJECTS, least=0)
        check_ranges(self, "table_clutter", "shelf_clutter", least=0)
        for name in self.targets:
            check_target(OBJECTS[name], self)
        for name in self.shelf_objects:
            if upright_pose(OBJECTS[name]) is None:
                raise SceneError(f"shelf object {name!r} does not stand upright by itself; choose one that does")


def check_target(model: ObjectModel, config: TableShelfConfig) -> None:
    """Raise `SceneError` if the object cannot be a target: too wide for the gripper, or not upright by itself.

    A hollow object may be wider than the gripper opens if a part such as its rim fits.
    """
    width, limit = least_width(model), config.max_opening - config.opening_margin
    if width > limit and not any(graspable_by_part(model, pose, limit) for pose in resting_poses(model)):
        raise SceneError(
            f"target {model.name!r} is {1e3 * width:.0f} mm wide at its thinnest; "
            f"the gripper takes at most {1e3 * limit:.0f} mm"
        )
    upright = upright_pose(model)
    if upright is None:
        raise SceneError(f"target {model.name!r} does not stand upright by itself; choose one that does")
    if upright.level_width > limit and not graspable_by_part(model, upright, limit):
        raise SceneError(
            f"target {model.name!r} is {1e3 * upright.level_width:.0f} mm wide at its thinnest when "
            f"upright; the gripper takes at most {1e3 * limit:.0f} mm"
        )
