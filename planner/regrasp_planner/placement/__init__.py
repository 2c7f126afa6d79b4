"""Placements: stable poses, their basins, and where and how the target is let go."""
