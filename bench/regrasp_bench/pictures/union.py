"""The union of pick and place scene in the target's frame, with the grasps found in it (the paper's Fig. 1 to 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gymnasium
import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial import HalfspaceIntersection
from scipy.spatial.transform import Rotation

import regrasp_gym
from regrasp_bench.pictures.studio import Picture, Studio, captioned, side_by_side
from regrasp_gym.errors import EnvError
from regrasp_gym.geometry.poses import Pose
from regrasp_gym.rendering.setting import Camera
from regrasp_gym.rendering.surfaces import VISUAL_GROUP, Look, Rgba, faceted
from regrasp_gym.robots.setup import RobotSetup
from regrasp_gym.scenes.scene import Fixture
from regrasp_gym.scenes.scene import Scene as GymScene
from regrasp_planner import Grasp, generate_grasps
from regrasp_planner.pose import rigid, wxyz_xyz

PICK: Rgba = (0.85, 0.1, 0.6, 0.5)
PLACE: Rgba = (0.0, 0.65, 0.75, 0.5)
_SUPPORT_ALPHA = 0.22
_GRIPPERS: tuple[Rgba, ...] = ((0.2, 0.62, 0.25, 1.0), (0.25, 0.45, 0.8, 0.4), (0.9, 0.5, 0.1, 0.4))

DISTINCT = 0.8
"""Shown grasps differ by at least this: radians plus tenths of a metre."""

_AROUND = 0.24
"""Radius about the target of what is shown, metres."""


@dataclass(frozen=True)
class _Part:
    """One scene as it is drawn: a tint, and the motion from the world to the picture."""

    tint: Rgba
    motion: Pose
    center: Float[np.ndarray, " 3"]


def union_picture(
    env_id: str = "regrasp_gym/PandaYCB-v0", seed: int | None = None, grippers: int = 3, size: int = 460
) -> Picture:
    """Pick scene (magenta), place scene (cyan), and both about the target, with grasps free of collision in both.

    Args:
        env_id: id of the environment.
        seed: seed of the scene; by default the first in which one grasp suffices although the target lies on its side
            and has neighbours in both places.
        grippers: largest number of grasps shown; those that differ most.
        size: height and width of each of the three pictures, pixels.

    Raises:
        EnvError: no grasp suffices for pick and place of this scene.
    """
    env = gymnasium.make(env_id)
    try:
        inner = regrasp_gym.PlannerExpert(env).env
        grasps: tuple[Grasp, ...] = ()
        for trial in range(100) if seed is None else (seed,):
            env.reset(seed=trial)
            task = inner.task()
            if seed is None and not _instructive(inner.scene):
                continue
            grasps = _apart(generate_grasps(task.target, (task.pick, task.place), inner.planner_robot.gripper).grasps)
            if grasps:
                break
        if not grasps:
            what = f"seed {seed}" if seed is not None else "any of the seeds 0 to 99"
            raise EnvError(f"no single grasp suffices for pick and place of {what}; try another seed")
        return _draw(inner.scene, inner.scenario.robot, grasps[:grippers], size)
    finally:
        env.close()


def _instructive(scene: GymScene) -> bool:
    """Whether the target has to be turned over and has neighbours in both places."""
    places = (scene.target.pose, scene.goal_pose)
    up = [Rotation.from_quat(pose[:4], scalar_first=True).inv().apply([0, 0, 1]) for pose in places]
    beside = [
        any(np.linalg.norm(thing.pose[4:] - pose[4:]) < 0.8 * _AROUND for thing in scene.others) for pose in places
    ]
    return bool(up[0] @ up[1] < np.cos(np.pi / 4)) and all(beside)


def _draw(scene: GymScene, robot: RobotSetup, grasps: Sequence[Grasp], size: int) -> Picture:
    start, goal = scene.target.pose, scene.goal_pose
    # The target's frame, with the orientation that it has in the pick scene.
    upright = np.concatenate([start[:4], np.zeros(3)])
    pick = _Part(PICK, wxyz_xyz(rigid(upright) * rigid(start).inv()), start[4:])
    place = _Part(PLACE, wxyz_xyz(rigid(upright) * rigid(goal).inv()), goal[4:])
    level = _Part(PLACE, np.concatenate([[1.0, 0, 0, 0], -goal[4:]]), goal[4:])
    views = (
        ("(a) pick scene", (pick,), upright, grasps[:1]),
        ("(b) place scene", (level,), np.concatenate([goal[:4], np.zeros(3)]), grasps[:1]),
        ("(c) their union about the target", (pick, place), upright, grasps),
    )
    panels: list[Picture] = []
    for caption, parts, at, shown in views:
        camera = _clearest(scene, robot, parts, at, shown)
        panels.append(captioned(_studio(scene, robot, parts, at, shown).picture(camera, size, size), caption))
    return side_by_side(panels, 3)


def _studio(
    scene: GymScene, robot: RobotSetup, parts: Sequence[_Part], at: Pose, grasps: Sequence[Grasp], bare: bool = False
) -> Studio:
    studio = Studio(ground=None, size=2 * _AROUND)
    for part in parts:
        for fixture in scene.fixtures:
            cut = _cut(fixture, part.center)
            if cut is not None:
                studio.add(cut, part.motion, (*part.tint[:3], _SUPPORT_ALPHA))
        for thing in scene.others:
            if np.linalg.norm(thing.pose[4:] - part.center) < _AROUND:
                studio.add_object(thing.model, wxyz_xyz(rigid(part.motion) * rigid(thing.pose)), part.tint)
    if not bare:
        studio.add_object(scene.target.model, at)
    for k, grasp in enumerate(grasps):
        for look in gripper_looks(robot, grasp.theta):
            studio.add(look, grasp.gripper_pose(at), _shaded(look, _GRIPPERS[k % len(_GRIPPERS)]))
    return studio


def _clearest(scene: GymScene, robot: RobotSetup, parts: Sequence[_Part], at: Pose, grasps: Sequence[Grasp]) -> Camera:
    """The camera, of several around, that sees most of the target."""
    full, bare = (_studio(scene, robot, parts, at, grasps, without) for without in (False, True))

    def seen(camera: Camera) -> float:
        return float(np.abs(full.picture(camera, 96, 96).astype(int) - bare.picture(camera, 96, 96)).sum())

    around = [
        Camera("c", (1.35 * np.cos(turn), 1.35 * np.sin(turn), 0.8), (0.0, 0.0, 0.03), 21.0)
        for turn in np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ]
    return max(around, key=seen)


def gripper_looks(robot: RobotSetup, theta: float) -> list[Look]:
    """Surfaces of the gripper in its own frame, with the fingers at θ."""
    model = robot.build_spec().compile()
    data = mujoco.MjData(model)
    for name in robot.finger_joints:
        data.qpos[model.joint(name).qposadr[0]] = theta
    mujoco.mj_kinematics(model, data)
    site = model.site(robot.tcp_site).id
    hand = model.site_bodyid[site]
    turn, origin = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    looks: list[Look] = []
    for geom in np.flatnonzero(model.geom_group == VISUAL_GROUP):
        body = model.geom_bodyid[geom]
        if hand not in (body, model.body_parentid[body]):
            continue
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        corners = model.mesh_vert[model.mesh_vertadr[mesh] + model.mesh_face[first : first + count]].reshape(-1, 3)
        normals = model.mesh_normal[model.mesh_normaladr[mesh] + model.mesh_facenormal[first : first + count]]
        frame = turn.T @ data.geom_xmat[geom].reshape(3, 3)
        material = model.geom_matid[geom]
        looks.append(
            Look(
                vertices=corners @ frame.T + turn.T @ (data.geom_xpos[geom] - origin),
                faces=np.arange(3 * count).reshape(-1, 3),
                normals=normals.reshape(-1, 3) @ frame.T,
                rgba=tuple(model.mat_rgba[material].tolist()),
            )
        )
    return looks


def _shaded(look: Look, rgba: Rgba) -> Rgba:
    """The colour, darker where the gripper itself is dark."""
    share = 0.45 + 0.55 * max(look.rgba[:3])
    return (share * rgba[0], share * rgba[1], share * rgba[2], rgba[3])


def _cut(fixture: Fixture, center: Float[np.ndarray, " 3"]) -> Look | None:
    """Part of a box in an upright cylinder about ``center``, in the world; None if it is empty."""
    turn = Rotation.from_quat(fixture.pose[:4], scalar_first=True).as_matrix()
    offset = fixture.pose[4:] - center
    normals = np.concatenate([turn.T, -turn.T])
    planes = np.column_stack([normals, -(normals @ offset) - np.tile(fixture.size / 2, 2)])
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    round_about = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(72), np.full(72, -_AROUND)])
    caps = np.array([[0, 0, 1, -0.7 * _AROUND], [0, 0, -1, -0.55 * _AROUND]])
    halfspaces = np.concatenate([planes, round_about, caps])
    inside = _inner_point(halfspaces)
    if inside is None:
        return None
    return faceted(HalfspaceIntersection(halfspaces, inside).intersections + center)


def _inner_point(halfspaces: Float[np.ndarray, "H 4"]) -> Float[np.ndarray, " 3"] | None:
    """The deepest point inside n·x + b ≤ 0, or None if it is less than a millimetre deep."""
    from scipy.optimize import linprog

    system = np.column_stack([halfspaces[:, :3], np.ones(len(halfspaces))])
    found = linprog([0, 0, 0, -1], A_ub=system, b_ub=-halfspaces[:, 3], bounds=[(None, None)] * 3 + [(0, 1)])
    return found.x[:3] if found.success and found.x[3] > 1e-3 else None


def _apart(grasps: Sequence[Grasp]) -> tuple[Grasp, ...]:
    """The best grasp, then repeatedly the one that differs most from those before."""
    left = list(grasps)
    chosen = left[:1]
    del left[:1]

    def apart(one: Grasp, other: Grasp) -> float:
        turns = [Rotation.from_quat(g.pose[:4], scalar_first=True) for g in (one, other)]
        return float((turns[0].inv() * turns[1]).magnitude() + 10 * np.linalg.norm(one.pose[4:] - other.pose[4:]))

    while left:
        gaps = [min(apart(grasp, other) for other in chosen) for grasp in left]
        if max(gaps) < DISTINCT:
            break
        chosen.append(left.pop(int(np.argmax(gaps))))
    return tuple(chosen)
