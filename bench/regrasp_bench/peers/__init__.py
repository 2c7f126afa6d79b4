"""Other libraries in the place of the planner's modules: coal, mink and OMPL."""
