"""Constrained minimisation on products of SE(3) and Rⁿ: manifolds, BFGS, trust region, augmented Lagrangian."""
