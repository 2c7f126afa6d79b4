"""The exhaustive search that tells in which scenes one grasp suffices."""
