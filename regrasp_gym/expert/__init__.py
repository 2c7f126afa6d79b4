"""The planner as an expert, and its plans in print and picture."""
