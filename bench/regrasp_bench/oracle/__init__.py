"""The exhaustive search that says which scenes one grasp suffices for."""
