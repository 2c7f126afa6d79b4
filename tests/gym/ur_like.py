"""A third-party robot: an arm of a UR5e's dimensions with a parallel gripper, on the table.

Each section stands for one of the files in `docs/adding-a-robot.md`.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.envs.registration import WrapperSpec

from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.envs.panda_ycb import PANDA_YCB
from regrasp_gym.robots.setup import RobotSetup
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig

ENV_ID = "third_party/URYCB-v0"

# robots/ur.xml ------------------------------------------------------------------------------------------------------

XML = """
<mujoco model="ur">
  <!-- Frames and masses: Universal Robots, "DH Parameters for calculations of kinematics and dynamics", UR5e:
  d1 = 0.1625, a2 = -0.425, a3 = -0.3922, d4 = 0.1333, d5 = 0.0997, d6 = 0.0996 m. A body's frame is that of its joint,
  z the joint's axis. Ranges, speeds and torques: UR5e data sheet (the elbow cannot pass the upper arm: half
  a turn each way); the other ranges are cut to the same, since a longer range only repeats poses.
  Shapes, armatures, gains and the gripper: estimates. -->
  <compiler angle="radian" autolimits="true"/>
  <default>
    <default class="ur">
      <joint axis="0 0 1" range="-3.14159265 3.14159265" armature="0.5"/>
      <geom type="capsule" group="3" friction="0.6 0.005 0.0001" rgba="0.6 0.65 0.7 1"/>
      <position kp="12000" kv="480" forcerange="-150 150" inheritrange="1"/>
      <default class="wrist">
        <joint armature="0.1"/>
        <position kp="1500" kv="45" forcerange="-28 28" inheritrange="1"/>
      </default>
      <default class="finger">
        <joint type="slide" axis="0 1 0" range="0 0.0425" damping="350" armature="2"/>
        <geom type="box" size="0.011 0.006 0.03" pos="0 0.006 0.115" mass="0.05" friction="1.2 0.008 0.0002" condim="4"
          priority="2" solref="0.004 1" solimp="0.99 0.999 0.001" rgba="0.2 0.2 0.2 1"/>
      </default>
    </default>
  </default>
  <worldbody>
    <!-- Half a turn: the negative lengths point the arm backwards. -->
    <body name="base" childclass="ur" quat="0 0 0 1" gravcomp="1">
      <geom name="base_c" size="0.07" fromto="0 0 0.07 0 0 0.08" mass="4"/>
      <body name="shoulder" pos="0 0 0.1625" gravcomp="1">
        <joint name="shoulder_pan"/>
        <geom name="shoulder_c" size="0.06" fromto="0 -0.01 0 0 0.01 0" mass="3.761"/>
        <body name="upper_arm" quat="1 1 0 0" gravcomp="1">
          <joint name="shoulder_lift"/>
          <geom name="upper_arm_c" size="0.06" fromto="0 0 0.138 -0.425 0 0.138" mass="8.058"/>
          <body name="forearm" pos="-0.425 0 0" gravcomp="1">
            <joint name="elbow"/>
            <geom name="forearm_c" size="0.05" fromto="0 0 0.007 -0.3922 0 0.007" mass="2.846"/>
            <body name="wrist_1_link" pos="-0.3922 0 0" gravcomp="1">
              <joint name="wrist_1" class="wrist"/>
              <geom name="wrist_1_c" size="0.045" fromto="0 0 0.09 0 0 0.14" mass="1.37"/>
              <body name="wrist_2_link" pos="0 0 0.1333" quat="1 1 0 0" gravcomp="1">
                <joint name="wrist_2" class="wrist"/>
                <geom name="wrist_2_c" size="0.045" fromto="0 0 0.06 0 0 0.1" mass="1.3"/>
                <body name="wrist_3_link" pos="0 0 0.0997" quat="1 -1 0 0" gravcomp="1">
                  <joint name="wrist_3" class="wrist"/>
                  <geom name="wrist_3_c" size="0.035" fromto="0 0 0.05 0 0 0.064" mass="0.365"/>
                  <body name="palm" pos="0 0 0.0996" gravcomp="1">
                    <geom name="palm_c" type="box" size="0.025 0.07 0.04" pos="0 0 0.04" mass="0.8"/>
                    <site name="tcp" pos="0 0 0.125" group="4"/>
                    <body name="left_finger" gravcomp="1">
                      <joint name="left_slide" class="finger"/>
                      <geom name="left_pad" class="finger"/>
                    </body>
                    <body name="right_finger" quat="0 0 0 1" gravcomp="1">
                      <joint name="right_slide" class="finger"/>
                      <geom name="right_pad" class="finger"/>
                    </body></body></body></body></body></body></body></body></body>
  </worldbody>
  <contact>
    <!-- The base is fixed to the world, so MuJoCo does not filter it from its child. -->
    <exclude body1="base" body2="shoulder"/>
    <exclude body1="left_finger" body2="right_finger"/>
  </contact>
  <tendon>
    <fixed name="fingers"><joint joint="left_slide" coef="0.5"/><joint joint="right_slide" coef="0.5"/></fixed>
  </tendon>
  <equality>
    <joint joint1="left_slide" joint2="right_slide" solref="0.004 1" solimp="0.99 0.999 0.001"/>
  </equality>
  <actuator>
    <position name="shoulder_pan" class="ur" joint="shoulder_pan"/>
    <position name="shoulder_lift" class="ur" joint="shoulder_lift"/>
    <position name="elbow" class="ur" joint="elbow"/>
    <position name="wrist_1" class="wrist" joint="wrist_1"/>
    <position name="wrist_2" class="wrist" joint="wrist_2"/>
    <position name="wrist_3" class="wrist" joint="wrist_3"/>
    <position name="gripper" tendon="fingers" kp="14000" forcerange="-140 140" ctrlrange="0 0.0425"/>
  </actuator>
</mujoco>
"""

# robots/ur.py -------------------------------------------------------------------------------------------------------

D1, A2, A3, D4, D5, D6 = 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996
DH = ((D1, 0, np.pi / 2), (0, A2, 0), (0, A3, 0), (D4, 0, np.pi / 2), (D5, 0, -np.pi / 2), (D6, 0, 0))
"""d, a, α of each joint, metres and radians; the test compares the kinematics with them."""


def build_spec() -> mujoco.MjSpec:
    """A new specification of the robot alone; its collision shapes are also its visible ones."""
    spec = mujoco.MjSpec.from_string(XML)
    for geom in list(spec.geoms):
        look = {"type": geom.type, "size": geom.size, "pos": geom.pos, "quat": geom.quat, "rgba": geom.rgba}
        if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
            look["fromto"] = geom.fromto
        geom.parent.add_geom(group=2, contype=0, conaffinity=0, mass=0, **look)
    return spec


_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")

UR = RobotSetup(
    name="ur",
    build_spec=build_spec,
    base="base",
    arm_joints=_JOINTS,
    arm_actuators=_JOINTS,
    finger_joints=("left_slide", "right_slide"),
    pads=("left_pad", "right_pad"),
    gripper_actuator="gripper",
    tcp_site="tcp",
    home=np.array([-0.34, -1.83, 1.65, -1.39, -np.pi / 2, 1.231]),
    max_velocity=np.full(6, np.pi),
    max_acceleration=np.full(6, 5.0),
    theta_range=(0.0, 0.0425),
)

# envs/ur_ycb.py -----------------------------------------------------------------------------------------------------

UR_YCB = dataclasses.replace(PANDA_YCB, robot=UR, pixels=("front",))
"""The Panda's scenes, rate and tolerance."""


class URYCBEnv(RegraspEnv):
    """Take an object from among others on a table and stand it upright among others on a shelf, with a UR arm."""

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, scene_config: TableShelfConfig | None = None, **arguments: Any) -> None:
        scene_config = scene_config or TableShelfConfig(max_opening=2 * UR.theta_range[1])
        super().__init__(UR_YCB, scene_config=scene_config, **arguments)


# __init__.py --------------------------------------------------------------------------------------------------------

gym.register(
    ENV_ID,
    entry_point=URYCBEnv,
    max_episode_steps=1000,
    additional_wrappers=(WrapperSpec("GoalReward", "regrasp_gym.envs.wrappers:GoalReward", {}),),
)
