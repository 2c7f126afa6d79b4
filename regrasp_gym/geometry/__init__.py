"""Poses, convex polygons and the facets of convex polyhedra."""
