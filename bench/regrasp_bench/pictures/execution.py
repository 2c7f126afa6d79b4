"""The execution of one regrasp, frame by frame, from an episode in the simulation."""

from __future__ import annotations

from dataclasses import dataclass

import gymnasium
import mujoco
import numpy as np
from jaxtyping import Float

import regrasp_gym
from regrasp_bench.pictures.studio import SHADOW_SIZE, Picture, captioned, resized, side_by_side
from regrasp_gym.envs.base import EnvState, RegraspEnv
from regrasp_gym.errors import EnvError
from regrasp_gym.expert.expert import PlannerExpert
from regrasp_gym.expert.plan_picture import release_tilt
from regrasp_gym.rendering.renderer import SceneRenderer
from regrasp_gym.rendering.setting import Camera
from regrasp_planner import SegmentKind

TILTED = np.deg2rad(10)
"""A release is worth a picture if it differs by more than this from the settled pose, radians."""

_NEAR = 0.45
"""Distance of the close-up's camera from the target, metres."""


@dataclass(frozen=True)
class _Step:
    """A moment of an episode: its state, stage and segment."""

    state: EnvState
    stage: int
    kind: SegmentKind | None


def execution_picture(
    env_id: str = "regrasp_gym/PandaYCB-v0",
    seed: int | None = None,
    camera: str = "overview",
    height: int = 300,
    width: int = 360,
) -> Picture:
    """Eight moments of an episode with a regrasp, from the first grasp to the placement, all simulated.

    Args:
        env_id: id of the environment.
        seed: seed of the scene; by default the first in which the target is released tilted and everything succeeds.
        camera: camera of the environment's model.
        height, width: size of one moment, pixels.

    Raises:
        EnvError: there is no successful episode with a regrasp.
    """
    env = gymnasium.make(env_id)
    try:
        expert = regrasp_gym.PlannerExpert(env)
        for trial in range(200) if seed is None else (seed,):
            env.reset(seed=trial)
            if not expert.reset() or len(expert.plan.stages) < 2:
                continue
            if seed is None and release_tilt(expert.plan.stages[0]) < TILTED:
                continue
            steps = _run(expert)
            stages = 1 + max(step.stage for step in steps)
            if expert.env.is_success and stages == 2:
                return _strip(expert, steps, camera, height, width)
        raise EnvError(f"no successful episode with one regrasp in {env_id}, seed {seed}; try another seed")
    finally:
        env.close()


def _run(expert: PlannerExpert) -> list[_Step]:
    steps = [_Step(expert.env.get_state(), 0, None)]
    while (action := expert.act()) is not None:
        stage, segment = expert.stage_index, expert.segment
        expert.env.step(action)
        steps.append(_Step(expert.env.get_state(), stage, segment.kind if segment else None))
    return steps


def _strip(expert: PlannerExpert, steps: list[_Step], camera: str, height: int, width: int) -> Picture:
    angle = np.degrees(release_tilt(expert.plan.stages[0]))
    released = f"let go, tilted by {angle:.0f}°" if angle > np.degrees(TILTED) else "let go"
    moments = [
        ("at first", steps[0]),
        ("taken", _last(steps, 0, SegmentKind.CLOSE)),
        ("carried", _middle(steps, 0, SegmentKind.TRANSFER)),
        (released, _last(steps, 0, SegmentKind.LOWER)),
        ("settled", [step for step in steps if step.stage == 0][-1]),
        ("taken again", _last(steps, 1, SegmentKind.CLOSE)),
        ("carried on", _middle(steps, 1, SegmentKind.TRANSFER)),
        ("placed", steps[-1]),
    ]
    panels = [
        captioned(picture, f"{number}. {words}", 16)
        for number, ((words, _), picture) in enumerate(
            zip(moments, _pictures(expert.env, [step for _, step in moments], camera, height, width), strict=True), 1
        )
    ]
    return side_by_side(panels, 4)


def _pictures(env: RegraspEnv, steps: list[_Step], camera: str, height: int, width: int) -> list[Picture]:
    """Pictures with finer shadows than the environment's, and a close-up of the target in a corner."""
    model = env.world.model
    model.vis.quality.shadowsize, model.vis.quality.offsamples = SHADOW_SIZE, 8
    renderer = SceneRenderer(2 * width, 2 * height)
    near = height * 2 // 5
    made: list[Picture] = []
    for step in steps:
        env.set_state(step.state)
        large = renderer.render(model, env.world.data, camera, 2 * width, 2 * height, show_goal=True)
        picture = resized(large, height, width).copy()
        picture[-near - 4 :, -near - 4 :] = 255
        picture[-near:, -near:] = _close_up(env, renderer, camera, step, near)
        made.append(picture)
    renderer.close()
    return made


def _close_up(env: RegraspEnv, renderer: SceneRenderer, camera: str, step: _Step, size: int) -> Picture:
    """The target from the side, of several, from which most of it is seen."""
    world, index = env.world, env.world.model.camera(camera).id
    model = world.model
    kept = model.cam_pos[index].copy(), model.cam_quat[index].copy(), float(model.cam_fovy[index])
    middle = world.target_pose[4:].copy()
    radius = 0.5 * float(np.linalg.norm(env.scene.target.model.size))
    views = [_from(middle, turn, 0.6) for turn in np.deg2rad([-100, -75, -50, -25, 0, 25, -125, -150])]

    def look(view: Camera, pixels: int) -> Picture:
        axes = view.axes()
        frame = np.column_stack([axes[:3], axes[3:], np.cross(axes[:3], axes[3:])])
        model.cam_pos[index] = view.position
        mujoco.mju_mat2Quat(model.cam_quat[index], frame.ravel())
        model.cam_fovy[index] = np.rad2deg(2 * np.arctan(1.5 * (radius + 0.03) / _NEAR))
        mujoco.mj_camlight(model, world.data)
        return renderer.render(model, world.data, camera, pixels, pixels, show_goal=False)

    with_target = [look(view, 64).astype(int) for view in views]
    world.set_object_pose(env.scene.target.name, np.array([1.0, 0, 0, 0, 0, 0, -5.0]))
    seen = [np.abs(look(view, 64) - shown).sum() for view, shown in zip(views, with_target, strict=True)]
    env.set_state(step.state)
    picture = resized(look(views[int(np.argmax(seen))], 2 * size), size, size)
    model.cam_pos[index], model.cam_quat[index], model.cam_fovy[index] = kept
    return picture


def _from(middle: Float[np.ndarray, " 3"], turn: float, rise: float) -> Camera:
    away = _NEAR * np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    x, y, z = (middle + away).tolist()
    return Camera("near", (x, y, z), tuple(middle.tolist()))


def _of(steps: list[_Step], stage: int, kind: SegmentKind) -> list[_Step]:
    return [step for step in steps if step.stage == stage and step.kind is kind]


def _last(steps: list[_Step], stage: int, kind: SegmentKind) -> _Step:
    return _of(steps, stage, kind)[-1]


def _middle(steps: list[_Step], stage: int, kind: SegmentKind) -> _Step:
    found = _of(steps, stage, kind)
    return found[len(found) // 2]
