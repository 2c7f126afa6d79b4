"""Scenes in MuJoCo: physics, the state of one scene, and what scenarios are made of."""
