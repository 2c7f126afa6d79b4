"""Pictures and films of plans: where the robot and the target are at the turning points, and the execution."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.expert.expert import PlannerExpert
from regrasp_gym.geometry.poses import Pose
from regrasp_gym.rendering.film import write_film
from regrasp_planner import Grasp, Plan, SegmentKind, Stage, Trajectory
from regrasp_planner.pose import rigid, wxyz_xyz

Picture = UInt8[np.ndarray, "H W 3"]


def plan_strip(env: RegraspEnv, plan: Plan, *, height: int = 300, width: int = 340) -> Picture:
    """The turning points of a plan side by side, one row per stage; the environment is left as it was.

    Args:
        env: with ``render_mode="rgb_array"`` and ``render_size`` at least (height, width), in the state the plan was
            made from.
        plan: a successful plan.
        height, width: of one picture, pixels.
    """
    state = env.get_state()
    try:
        rows = [
            np.concatenate([_panel(env, moment, height, width) for moment in _turning_points(stage, number)], 1)
            for number, stage in enumerate(plan.stages, 1)
        ]
    finally:
        env.set_state(state)
    return np.concatenate(rows, 0)


def save_plan_picture(env: RegraspEnv, plan: Plan, path: Path) -> None:
    """Write `plan_strip` to an image file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    imageio.imwrite(path, plan_strip(env, plan))


def save_execution(env: RegraspEnv, expert: PlannerExpert, path: Path, *, camera: str = "overview") -> bool:
    """Let the expert act out its plan in the simulation, film it, and say whether it succeeded.

    Args:
        env: with ``render_mode="rgb_array"``.
        expert: after its ``reset()``.
        path: an .mp4 file (H.264), written at the environment's frame rate.
        camera: camera of the film.
    """

    def pictures() -> Iterator[Picture]:
        yield env.picture(camera, *env.render_size)
        while (action := expert.act()) is not None:
            env.step(action)
            yield env.picture(camera, *env.render_size)

    write_film(path, pictures(), round(1 / env.scenario.control_period))
    return env.is_success


def release_tilt(stage: Stage) -> float:
    """Angle between the target as it is let go and as it settles, seen against the vertical, radians.

    Zero for a static release.
    """
    up = [
        Rotation.from_quat(pose[:4], scalar_first=True).inv().apply([0.0, 0.0, 1.0])
        for pose in (stage.release_pose, stage.settled_pose)
    ]
    return float(np.arctan2(np.linalg.norm(np.cross(up[0], up[1])), up[0] @ up[1]))


@dataclass(frozen=True)
class _Moment:
    """The robot at a turning point, and the target: standing at a pose, or in the hand."""

    caption: str
    joints: Float[np.ndarray, " n"]
    theta: float
    target: Pose | Grasp


def _turning_points(stage: Stage, number: int) -> Iterator[_Moment]:
    moving: Trajectory | None = None
    for segment in stage.segments:
        moving = segment.trajectory or moving
        assert moving is not None, "a stage begins with a motion"
        theta = stage.grasp.theta if segment.holding else segment.theta
        match segment.kind:
            case SegmentKind.CLOSE:
                yield _Moment(f"{number}. grasp", moving.goal, theta, stage.start_pose)
            case SegmentKind.TRANSFER:
                yield _Moment(f"{number}. carry", moving.at(0.5 * moving.duration), theta, stage.grasp)
            case SegmentKind.OPEN:
                tilt = np.rad2deg(release_tilt(stage))
                words = f"let go, {tilt:.0f}° tilted" if tilt >= 1 else "let go"
                yield _Moment(f"{number}. {words}", moving.goal, theta, stage.release_pose)
            case SegmentKind.RETREAT:
                yield _Moment(f"{number}. retreat", moving.goal, theta, stage.settled_pose)
            case _:
                continue


def _panel(env: RegraspEnv, moment: _Moment, height: int, width: int) -> Picture:
    world = env.world
    world.set_robot(moment.joints, moment.theta)
    target = moment.target
    if isinstance(target, Grasp):
        target = wxyz_xyz(rigid(world.gripper_pose) * rigid(target.pose).inv())
    world.set_object_pose(env.scene.target.name, target)
    picture = Image.fromarray(env.picture(env.render_camera, height, width))
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(size=max(12, height // 16))
    left, top, right, bottom = draw.textbbox((10, 8), moment.caption, font=font)
    draw.rectangle((left - 6, top - 4, right + 6, bottom + 4), fill=(255, 255, 255))
    draw.text((10, 8), moment.caption, fill=(20, 20, 20), font=font)
    return np.asarray(picture)
