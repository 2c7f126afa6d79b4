"""LeRobot datasets of regrasp_gym's environments: collected, checked, described and run again."""
