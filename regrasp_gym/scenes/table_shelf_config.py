"""What can be tuned about the Panda's scenes; see `table_shelf`."""

from __future__ import annotations

from dataclasses import dataclass

from regrasp_gym.checks import check_names, check_ranges
from regrasp_gym.errors import SceneError
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_gym.scenes.graspable import over_a_part
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
"""Objects that "upright" means something for and that the gripper can take."""


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
"""Objects that may stand on the shelf: tall or round ones, nothing that lies."""


CLUTTER = tuple(name for name in OBJECTS if name != "025_mug")
"""Objects that may lie about. With the mug every seed would give another scene: it is for configs that name it."""


@dataclass(frozen=True)
class TableShelfConfig:
    """Everything about the scenes that can be tuned. Lengths in metres, angles in radians, ranges inclusive.

    Attributes:
        targets: names of the objects that may have to be moved.
        clutter: names of the objects that may lie around it on the table.
        shelf_objects: names of the objects that may stand on the shelf.
        table_clutter: least and most objects on the table besides the target.
        shelf_clutter: least and most objects on the shelf.
        pick_center, pick_size: rectangle on the table in which all objects start, middle and full size.
        pick_gap: least gap between two objects on the table, seen from above.
        pick_reach: largest horizontal distance of the target's start from the robot's base.
        landing_weight: a resting pose is drawn with its landing probability to this power: 1 as objects fall,
            0 all alike.
        release_center, release_size: rectangle on the table that is kept free, middle and full size.
        table_center, table_size: middle of the table top, and its length, width and thickness.
        shelf_center: middle of the shelf's board on the table plane. The opening faces the robot's base.
        shelf_inside: width and depth of the board between the walls.
        board_height: of the upper face of the board above the table.
        shelf_clearance: free height between the board and the roof.
        shelf_thickness: of all boards and walls.
        goal_gap: least gap between the target at its goal and its neighbours on the shelf, seen from above.
        goal_depth: least and most distance of the goal's footprint from the board's front edge.
        goal_wall_gap: least gap between the target at its goal and the side walls of the shelf.
        goal_yaw: at its goal the target is turned by up to ± this, at most a right angle, from where the gripper would
            take it straight from the front by its narrow sides, with either of these to the left.
        max_opening: of the gripper; targets must have less least width than this minus ``opening_margin``.
        opening_margin: see ``max_opening``.
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
    """Raise `SceneError` if the object cannot be a target: too wide for the gripper, or it does not stand upright.

    A hollow object may be wider than the gripper opens, if the gripper can take it by a part such as its rim.
    """
    width, limit = least_width(model), config.max_opening - config.opening_margin
    if width > limit and not any(over_a_part(model, pose, limit) for pose in resting_poses(model)):
        raise SceneError(
            f"target {model.name!r} is {1e3 * width:.0f} mm wide where it is thinnest; "
            f"the gripper takes at most {1e3 * limit:.0f} mm"
        )
    upright = upright_pose(model)
    if upright is None:
        raise SceneError(f"target {model.name!r} does not stand upright by itself; choose one that does")
    if upright.level_width > limit and not over_a_part(model, upright, limit):
        raise SceneError(
            f"target {model.name!r} is {1e3 * upright.level_width:.0f} mm wide where it is thinnest as it stands "
            f"upright; the gripper takes at most {1e3 * limit:.0f} mm"
        )
