"""Other people's libraries in the planner's place: coal, mink, OMPL."""
