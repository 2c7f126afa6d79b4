"""Convex bodies by their support functions: distances, contact normals, exact facets."""

from regrasp_planner.geometry.distance import (
    Separation,
    certified_distance,
    contact_direction,
    separation,
    signed_distance,
)
from regrasp_planner.geometry.hull import Facets, MassProperties, facets, mass_properties, minimal_width, qhull
from regrasp_planner.geometry.support import (
    ConvexBody,
    exact_support_value,
    support_hessian,
    support_point,
    support_value,
)

__all__ = [
    "ConvexBody",
    "Facets",
    "MassProperties",
    "Separation",
    "certified_distance",
    "contact_direction",
    "exact_support_value",
    "facets",
    "mass_properties",
    "minimal_width",
    "qhull",
    "separation",
    "signed_distance",
    "support_hessian",
    "support_point",
    "support_value",
]
