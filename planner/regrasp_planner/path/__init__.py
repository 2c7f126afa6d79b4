"""Paths: PathPlan, certified clear between its waypoints, and timed."""
