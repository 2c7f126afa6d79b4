"""The robot as the planner sees it: arm, gripper, their bodies and their motion."""
