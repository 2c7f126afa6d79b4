"""Robots: MuJoCo models and how the planner sees them."""
