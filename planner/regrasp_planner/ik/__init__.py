"""Inverse kinematics: IkSolve, graded reachability, and straight lines of the gripper."""
