"""The physics of one scene: model and state, by the names of robot and objects."""

from __future__ import annotations

from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float

from regrasp_gym.errors import SceneError, StateError
from regrasp_gym.geometry.poses import Pose, canonical, mujoco_quaternion
from regrasp_gym.rendering.setting import GOAL_GROUP, GOAL_RGBA, add_visuals
from regrasp_gym.robots.setup import RobotSetup
from regrasp_gym.scenes.scene import Fixture, Scene
from regrasp_gym.simulation import physics
from regrasp_gym.simulation.scenario import Scenario

_GOAL = "goal"
"""Name of the body that shows the goal."""

_TOUCHING = 1e-5
"""Largest gap of bodies that count as touching, metres."""

_PLANE = mujoco.mjtGeom.mjGEOM_PLANE

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def base_spec(scenario: Scenario, *, buffer_width: int, buffer_height: int) -> mujoco.MjSpec:
    """The robot, light, floor and cameras that all scenes of a scenario share.

    Args:
        scenario: the scenario.
        buffer_width, buffer_height: largest off-screen picture, pixels.
    """
    spec = scenario.robot.build_spec()
    physics.configure(spec)
    add_visuals(spec, scenario.cameras, scenario.floor_height, scenario.setting)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = buffer_width, buffer_height
    return spec


class World:
    """A scene in MuJoCo, with the robot at home and every object at its start.

    Args:
        base: from `base_spec`; copied, not changed.
        robot: names of the robot's parts.
        scene: the scene.

    Raises:
        SceneError: two bodies of the scene have the same name, or the model does not compile.
    """

    def __init__(self, base: mujoco.MjSpec, robot: RobotSetup, scene: Scene) -> None:
        self.scene = scene
        self.robot = robot
        self.model = _compile(base, scene)
        self.data = mujoco.MjData(self.model)
        self._locate()
        self.data.qpos[self._arm_qpos] = robot.home
        self.data.qpos[self._finger_qpos] = robot.theta_range[1]
        self.set_command(np.append(robot.home, robot.theta_range[1]))
        self.refresh()

    # State ------------------------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Float[np.ndarray, " n"]:
        """(n,) joint positions of the arm, radians."""
        return self.data.qpos[self._arm_qpos]

    @property
    def joint_limits(self) -> Float[np.ndarray, "2 n"]:
        """(2, n) least and greatest joint positions of the arm, radians."""
        return np.array([self.model.joint(name).range for name in self.robot.arm_joints]).T

    @property
    def joint_velocities(self) -> Float[np.ndarray, " n"]:
        """(n,) joint velocities of the arm, rad/s."""
        return self.data.qvel[self._arm_dof]

    @property
    def theta(self) -> float:
        """Finger coordinate θ: mean of the finger joints, metres or radians."""
        return float(self.data.qpos[self._finger_qpos].mean())

    @property
    def theta_rate(self) -> float:
        """Rate dθ/dt: mean of the finger joints, m/s or rad/s."""
        return float(self.data.qvel[self._finger_dof].mean())

    @property
    def gripper_pose(self) -> Pose:
        """(7,) pose of the gripper frame, world."""
        quaternion = mujoco_quaternion(self.data.site_xmat[self._site])
        return canonical(np.concatenate([quaternion, self.data.site_xpos[self._site]]))

    @property
    def target_pose(self) -> Pose:
        """(7,) pose of the target, world."""
        return self._pose_of(self._target_qpos)

    @property
    def target_velocity(self) -> Float[np.ndarray, " 6"]:
        """(6,) linear (m/s) and angular (rad/s) velocity of the target, world."""
        velocity = self.data.qvel[self._target_dof : self._target_dof + 6].copy()
        # A free joint's angular velocity is in the body's own frame.
        velocity[3:] = self.data.xmat[self._target_body].reshape(3, 3) @ velocity[3:]
        return velocity

    @property
    def other_poses(self) -> Float[np.ndarray, "m 7"]:
        """(m, 7) poses of the other objects in the scene's order, world."""
        return np.array([self._pose_of(address) for address in self._other_qpos]).reshape(-1, 7)

    def target_contacts(self) -> tuple[bool, bool]:
        """Whether the target touches the robot, and whether it touches anything else."""
        pairs = self.data.contact.geom[self.data.contact.dist <= 0]
        bodies = self.model.geom_bodyid[pairs]
        mine = bodies == self._target_body
        others = np.where(mine[:, 0], bodies[:, 1], bodies[:, 0])[mine.any(axis=1)]
        robot = self._is_robot[others]
        if len(robot):
            return bool(robot.any()), bool((~robot).any())
        # An object placed exactly on a surface makes contact only after it sinks in slightly.
        return False, self._target_is_put_down()

    def _target_is_put_down(self) -> bool:
        fromto = np.empty(6)
        return any(
            mujoco.mj_geomDistance(self.model, self.data, mine, other, 2 * _TOUCHING, fromto) <= _TOUCHING
            for mine in self._target_geoms
            for other in self._other_geoms
        )

    def set_robot(self, joints: Float[np.ndarray, " n"], theta: float) -> None:
        """Move the robot and its set points, at rest. For pictures only: no episode does this."""
        self.data.qpos[self._arm_qpos] = joints
        self.data.qpos[self._finger_qpos] = theta
        self.data.qvel[self._arm_dof] = 0.0
        self.data.qvel[self._finger_dof] = 0.0
        self.set_command(np.append(joints, theta))
        self.refresh()

    def set_object_pose(self, name: str, pose: Pose, velocity: Float[np.ndarray, " 6"] | None = None) -> None:
        """Move an object, at rest unless a velocity (m/s, rad/s, world) is given.

        For tests and for tools that inspect states: no episode does this.
        """
        joint = self.model.joint(f"{name}_joint")
        pose = np.asarray(pose, float)
        self.data.qpos[joint.qposadr[0] : joint.qposadr[0] + 7] = np.concatenate([pose[4:], pose[:4]])
        self.data.qvel[joint.dofadr[0] : joint.dofadr[0] + 6] = 0.0
        self.refresh()
        if velocity is not None:
            start = joint.dofadr[0]
            turn = self.data.xmat[self.model.body(name).id].reshape(3, 3)
            self.data.qvel[start : start + 3] = velocity[:3]
            self.data.qvel[start + 3 : start + 6] = turn.T @ velocity[3:]

    # Time -------------------------------------------------------------------------------------------------------

    def run(self, start: Float[np.ndarray, " n+1"], end: Float[np.ndarray, " n+1"], steps: int) -> None:
        """Simulate ``steps`` physics steps while the set points move linearly from ``start`` to ``end``."""
        for k in range(1, steps + 1):
            self.set_command(start + (end - start) * (k / steps))
            mujoco.mj_step(self.model, self.data)
        self.refresh()

    def set_command(self, command: Float[np.ndarray, " n+1"]) -> None:
        """Set the actuators' set points: joint positions, then θ."""
        self.data.ctrl[self._command_ctrl] = command

    def refresh(self) -> None:
        """Update body poses and contacts, which a physics step leaves one step behind."""
        mujoco.mj_fwdPosition(self.model, self.data)

    def get_state(self) -> Float[np.ndarray, " s"]:
        """The full state of the physics, mjSTATE_INTEGRATION."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state

    def set_state(self, state: Float[np.ndarray, " s"]) -> None:
        """Restore a state from `get_state` of the same scene.

        Raises:
            StateError: the state has another size, so it is another scene's.
        """
        size = mujoco.mj_stateSize(self.model, _STATE)
        if np.shape(state) != (size,):
            raise StateError(
                f"physics state has shape {np.shape(state)}, this scene's has ({size},); restore it in its own scene"
            )
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        self.refresh()

    # Layout -----------------------------------------------------------------------------------------------------

    def _locate(self) -> None:
        model, robot, scene = self.model, self.robot, self.scene
        self._arm_qpos = np.array([model.joint(name).qposadr[0] for name in robot.arm_joints])
        self._arm_dof = np.array([model.joint(name).dofadr[0] for name in robot.arm_joints])
        self._finger_qpos = np.array([model.joint(name).qposadr[0] for name in robot.finger_joints])
        self._finger_dof = np.array([model.joint(name).dofadr[0] for name in robot.finger_joints])
        actuators = (*robot.arm_actuators, robot.gripper_actuator)
        self._command_ctrl = np.array([model.actuator(name).id for name in actuators])
        self._site = model.site(robot.tcp_site).id
        self._target_body = model.body(scene.target.name).id
        joint = model.joint(f"{scene.target.name}_joint")
        self._target_qpos, self._target_dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._other_qpos = [int(model.joint(f"{thing.name}_joint").qposadr[0]) for thing in scene.others]
        root = model.body_rootid[model.site_bodyid[self._site]]
        self._is_robot = np.asarray(model.body_rootid == root)
        solid = (model.geom_contype != 0) & ~self._is_robot[model.geom_bodyid]
        is_target = model.geom_bodyid == self._target_body
        self._target_geoms = np.flatnonzero(solid & is_target).tolist()
        self._other_geoms = np.flatnonzero(solid & ~is_target & (model.geom_type != _PLANE)).tolist()

    @cached_property
    def object_sizes(self) -> Float[np.ndarray, "m+1 3"]:
        """(m + 1, 3) full extents of the target and the others along their own axes, metres."""
        return np.array([thing.model.size for thing in (self.scene.target, *self.scene.others)])

    def _pose_of(self, address: int) -> Pose:
        # From qpos: xpos rounds differently after a state is restored.
        position, quaternion = self.data.qpos[address : address + 3], self.data.qpos[address + 3 : address + 7]
        return canonical(np.concatenate([quaternion, position]))


def _compile(base: mujoco.MjSpec, scene: Scene) -> mujoco.MjModel:
    things = (scene.target, *scene.others)
    names = [_GOAL, *(thing.name for thing in (*things, *scene.fixtures))]
    for name in names:
        if names.count(name) > 1 or base.body(name) is not None:
            raise SceneError(f"the scene has two bodies named {name!r}; give each a unique name")
    spec = base.copy()
    for fixture in scene.fixtures:
        add_fixture(spec, fixture)
    for thing in things:
        thing.model.add_to(spec, thing.name, thing.pose)
    _add_goal(spec, scene)
    try:
        return spec.compile()
    except ValueError as error:
        raise SceneError(
            f"the scene of seed {scene.seed} does not compile ({error}); check its objects' meshes and masses"
        ) from error


def add_fixture(spec: mujoco.MjSpec, fixture: Fixture) -> None:
    """Add a fixture to ``spec`` as a body and a geom, both of its name."""
    body = spec.worldbody.add_body(name=fixture.name, pos=fixture.pose[4:], quat=fixture.pose[:4])
    body.add_geom(
        name=fixture.name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=fixture.size / 2,
        material=fixture.material,
        friction=[0.8, 0.005, 0.0001],
        group=1,
    )


def _add_goal(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Add a translucent copy of the target at the goal, for pictures only."""
    ghost = scene.target.model.add_to(spec, _GOAL, scene.goal_pose, free=False)
    for geom in list(ghost.geoms):
        if geom.contype == geom.conaffinity == 0:
            geom.group = GOAL_GROUP
            geom.rgba = GOAL_RGBA
        else:
            spec.delete(geom)
