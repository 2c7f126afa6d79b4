"""Riemannian optimisation on products of S², SE(3) and Rⁿ: trust region, BFGS, augmented Lagrangian."""

from regrasp_planner.optim.augmented_lagrangian import ConstrainedResult, Problem, augmented_lagrangian
from regrasp_planner.optim.bfgs import bfgs_update
from regrasp_planner.optim.manifold import SE3, Euclidean, Manifold, Point, Product, Sphere
from regrasp_planner.optim.trust_region import Result, Status, truncated_cg, trust_region

__all__ = [
    "SE3",
    "ConstrainedResult",
    "Euclidean",
    "Manifold",
    "Point",
    "Problem",
    "Product",
    "Result",
    "Sphere",
    "Status",
    "augmented_lagrangian",
    "bfgs_update",
    "truncated_cg",
    "trust_region",
]
