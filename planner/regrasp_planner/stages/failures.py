"""Failures of planning, each with the constraint to change."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from regrasp_planner.grasp.grasp import NoGraspReason
from regrasp_planner.grasp.grasp_gen import GraspSearch
from regrasp_planner.path.path_plan import PathResult
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.grasp_ik import GraspIk
from regrasp_planner.stages.plan import Failure, Reason, SegmentKind, StageKind
from regrasp_planner.task import Body, Task, check_task

_PROGRESS = (
    Reason.TOO_WIDE,
    Reason.NO_STABLE_POSE,
    Reason.ENCLOSED,
    Reason.NO_COMMON_GRASP,
    Reason.UNREACHABLE,
    Reason.NO_PATH,
)
"""Reasons in the order of the pipeline."""


def most_advanced_failure(one: Failure | None, other: Failure) -> Failure:
    """The failure later in the pipeline, which says most about what to change; ``one`` if both are alike."""
    return other if one is None else max((one, other), key=lambda failure: _PROGRESS.index(failure.reason))


def bad_input(task: Task, robot: Robot) -> Failure | None:
    """The first mistake in the task, if any."""
    try:
        check_task(task, robot)
    except ValueError as error:
        return Failure(Reason.BAD_INPUT, "", "", str(error))
    return None


def unreachable(target: Body, kind: StageKind, failed: Iterable[GraspIk] = ()) -> Failure:
    """No configuration at the grasps; the constraint is the most frequent one of ``failed``."""
    message = f"no collision-free configuration of the arm reaches the grasps of {target.name!r} where they are needed"
    # Without the figures, which differ from grasp to grasp.
    constraints = Counter(ik.constraint.split(",")[0] for ik in failed if ik.constraint).most_common(1)
    return Failure(Reason.UNREACHABLE, kind, constraints[0][0] if constraints else "inverse kinematics", message)


def no_grasp(search: GraspSearch, kind: StageKind, where: str, robot: Robot) -> Failure:
    """Why a grasp search ended without a grasp.

    Args:
        search: the search.
        kind: the stage it was for.
        where: the scenes it was for, in words.
        robot: the robot, for the opening of its gripper.
    """
    name, reason = search.target.name, search.reason
    if reason is NoGraspReason.TOO_WIDE:
        opening = 1e3 * float(robot.gripper.max_opening) * robot.unit
        message = f"{name!r} is wider in every direction than the gripper opens ({opening:.0f} mm)"
        return Failure(Reason.TOO_WIDE, kind, "finger limits", message)
    if reason is NoGraspReason.OUT_OF_REACH:
        return unreachable(search.target, kind)
    if reason is NoGraspReason.ENCLOSED and len(search.scenes) == 1:
        message = f"no grasp of {name!r} keeps clear of the obstacles around it in the {where} scene"
        return Failure(Reason.ENCLOSED, kind, "world collision", message)
    message = f"no grasp of {name!r} keeps clear of the obstacles of {where} together"
    constraint = "world collision" if reason is NoGraspReason.ENCLOSED else reason.value
    return Failure(Reason.NO_COMMON_GRASP, kind, constraint, message)


def no_stable_pose(target: Body) -> Failure:
    """No placement in the release area."""
    message = f"{target.name!r} has no stable pose that fits the release area and from which it can be taken on"
    return Failure(Reason.NO_STABLE_POSE, StageKind.PICK_TO_RELEASE, "stable pose", message)


def no_path(kind: StageKind, segment: SegmentKind, result: PathResult) -> Failure:
    """A segment without a path: the bodies in the way, if any."""
    bodies = " – ".join(result.bodies) if result.bodies else result.status.value
    return Failure(Reason.NO_PATH, kind, f"{segment}: {bodies}", result.message)
