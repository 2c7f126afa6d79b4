"""Grasps: GraspGen, its problem and its starts, and the sampling baseline."""
