"""Inverse kinematics: IkSolve, and straight lines of the gripper."""
