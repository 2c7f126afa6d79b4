"""Benchmarks of the planner and the environments, each beside its peers, and lists of certified scenes."""
