"""Plans: the stages that a target is moved in, and the search for them."""
