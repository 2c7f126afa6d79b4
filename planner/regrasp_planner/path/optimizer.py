"""Trajectory optimisation of one path: smoothness under clearance constraints, augmented Lagrangian and trust region.

The path is a clamped, uniform cubic B-spline q(s) = Σ_i B_i(s) P_i on [0, 1] whose first and last control points are
the start and the goal. It is C² (what the time parametrisation needs), a sample depends on four control points only,
and it stays within the joint limits whenever its control points do (convex hull property).

    minimise   ½ ∫ |q'|² ds + ½ w ∫ |q''|² ds
    such that  d_r(q(s_i)) ≥ m_ir    at samples s_i, several per knot interval, for every pair r of bodies
               lower ≤ P_i ≤ upper

The objective is a constant quadratic form; the constraints' gradients are normal · contact-point Jacobian. So the
augmented Lagrangian has an inexpensive, positive definite Gauss–Newton Hessian, and each step is one Cholesky
factorisation, damped (Levenberg) until it fits the trust region, with joints at their limits held (projected Newton).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from regrasp_planner.path.polyline import chord_lengths, points_at

_BENDING = 6e-3
"""w: weight of ∫|q''|² against ∫|q'|². Bends spread over about √w ≈ 8 % of the path; with less, a path may race through
a thin wall between two samples."""
_PATIENCE = 12
"""Iterations without a tenth less violation after which a path is given up: it is caught between bodies."""
_FEASIBLE = 5e-4
"""Constraint violation (metres) that counts as solved. Ask for a margin this much larger than needed."""


@dataclass(frozen=True)
class Rows:
    """Active constraints at a batch of samples: row r is pair ``pair[r]`` at sample ``sample[r]``.

    Attributes:
        sample, pair: (R,) indices.
        clearance: (R,) distance minus the required margin, metres.
        gradient: (R, n) derivative of the distance by the joints at that sample, m/rad.
    """

    sample: Int[np.ndarray, " R"]
    pair: Int[np.ndarray, " R"]
    clearance: Float[np.ndarray, " R"]
    gradient: Float[np.ndarray, "R n"]


RowFunction = Callable[[Float[np.ndarray, "N n"], float], Rows]
"""(samples (N, n), reach) → every pair whose clearance at a sample is below ``reach`` metres."""


@dataclass(frozen=True)
class OptimizedPath:
    """Outcome of `optimize_path`.

    Attributes:
        control_points: (C, n) radians, of the best iterate (least violation first, then least cost).
        violation: () largest shortfall of clearance over the samples, metres; 0 if none.
        cost: smoothness objective.
        iterations: trust-region steps tried.
    """

    control_points: Float[np.ndarray, "C n"]
    violation: float
    cost: float
    iterations: int

    @property
    def feasible(self) -> bool:
        """Whether all samples keep their clearance, to half a millimetre."""
        return self.violation <= _FEASIBLE

    @property
    def path(self) -> BSpline:
        """The spline on [0, 1]."""
        return bspline(self.control_points)


def knots(count: int) -> Float[np.ndarray, " C+4"]:
    """Clamped uniform knot vector of a cubic spline on [0, 1] with ``count`` control points."""
    return np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, count - 2), np.ones(3)])


def bspline(control_points: Float[np.ndarray, "C n"]) -> BSpline:
    """The clamped, uniform cubic B-spline with these control points."""
    return BSpline(knots(len(control_points)), control_points, 3)


def fit_control_points(polyline: Float[np.ndarray, "K n"], count: int) -> Float[np.ndarray, "C n"]:
    """Control points (count, n) of the spline closest to a polyline traversed at even speed; ends are exact."""
    s = np.linspace(0.0, 1.0, 4 * count)
    points = points_at(polyline, s * chord_lengths(polyline)[-1])
    basis = BSpline.design_matrix(s, knots(count), 3).toarray()
    ends = points[[0, -1]]
    rest = points - basis[:, [0, -1]] @ ends
    # Greville abscissae keep the fit well posed where the polyline says little; a little of it is enough.
    knot = knots(count)
    greville = (knot[1 : count + 1] + knot[2 : count + 2] + knot[3 : count + 3]) / 3
    prior = np.stack([np.interp(greville, s, points[:, j]) for j in range(points.shape[1])], axis=1)
    inner = basis[:, 1:-1]
    normal = inner.T @ inner + 1e-3 * np.eye(count - 2)
    solution = np.linalg.solve(normal, inner.T @ rest + 1e-3 * prior[1:-1])
    return np.concatenate([ends[:1], solution, ends[1:]])


def smoothness_form(count: int) -> Float[np.ndarray, "C C"]:
    """Matrix W of the objective: ½ tr(Pᵀ W P) = ½ ∫|q'|² + ½ w ∫|q''|², exact (Gauss–Legendre on each interval)."""
    knot = knots(count)
    breaks = np.unique(knot)
    node, weight = np.polynomial.legendre.leggauss(3)  # exact to degree 5; |q'|² has degree 4
    half = np.diff(breaks) / 2
    s = (breaks[:-1, None] + half[:, None] * (node + 1)).ravel()
    weights = (half[:, None] * weight).ravel()
    basis = BSpline(knot, np.eye(count), 3)
    first, second = basis(s, 1), basis(s, 2)
    return first.T @ (weights[:, None] * first) + _BENDING * second.T @ (weights[:, None] * second)


def optimize_path(
    control_points: Float[np.ndarray, "C n"],
    rows: RowFunction,
    samples: Float[np.ndarray, " N"],
    pair_count: int,
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    max_iterations: int = 40,
) -> OptimizedPath:
    """Smoothest path from the first to the last control point that keeps its clearances.

    Args:
        control_points: (C, n) initial guess, C ≥ 5; the ends stay.
        rows: the clearance constraints at given configurations.
        samples: (N,) path parameters in (0, 1) at which they are asked for.
        pair_count: number of pairs that ``Rows.pair`` can name.
        lower, upper: (n,) joint limits.
        max_iterations: evaluations of ``rows`` allowed.
    """
    problem = _Problem(control_points, rows, samples, lower, upper)
    multiplier = np.zeros((len(samples), pair_count))
    # One centimetre of violation costs as much as the straight motion itself.
    penalty = 1e4 * max(problem.scale, 1e-2)
    stiffest = 1e4 * penalty
    radius = 0.5
    x = np.clip(control_points[1:-1], lower, upper)
    state = problem.evaluate(x, multiplier, penalty)
    best = state
    iterations = 1
    settled = False
    last_violation, last_cost = np.inf, np.inf
    progress = [(1, np.inf)]
    while iterations < max_iterations and not settled:
        for _ in range(4):
            step, predicted = problem.step(state, multiplier, penalty, radius)
            if predicted <= 1e-3 * problem.scale:
                break
            trial = problem.evaluate(state.x + step, multiplier, penalty)
            iterations += 1
            gain = (state.merit - trial.merit) / predicted
            length = np.abs(step).max()
            radius = 0.5 * length if gain < 0.25 else (max(radius, 2 * length) if gain > 0.75 else radius)
            if gain > 0.05:
                state = trial
                if (max(state.violation, _FEASIBLE), state.cost) < (max(best.violation, _FEASIBLE), best.cost):
                    best = state
            if iterations >= max_iterations or radius < 1e-4:
                break
        # Feasible is not enough: the first feasible iterate may bend more than it has to.
        settled = best.violation <= _FEASIBLE and best.cost > 0.97 * last_cost
        last_cost = best.cost if best.violation <= _FEASIBLE else np.inf
        r = state.rows
        multiplier[r.sample, r.pair] = np.maximum(0.0, multiplier[r.sample, r.pair] - penalty * r.clearance)
        if state.violation > 0.4 * last_violation:
            penalty = min(4.0 * penalty, stiffest)
        if radius < 1e-3:
            radius = 0.05
        last_violation = state.violation
        progress.append((iterations, best.violation))
        before = [violation for at, violation in progress if at <= iterations - _PATIENCE]
        if before and best.violation > max(_FEASIBLE, 0.9 * before[-1]):
            break
        state = problem.remerit(state, multiplier, penalty)
    points = np.concatenate([control_points[:1], best.x, control_points[-1:]])
    return OptimizedPath(points, float(best.violation), float(best.cost), iterations)


@dataclass(frozen=True)
class _State:
    x: Float[np.ndarray, "F n"]
    rows: Rows
    cost: float
    merit: float
    violation: float


class _Problem:
    """Objective, constraints and their derivatives over the free control points (F = C − 2)."""

    def __init__(
        self,
        control_points: Float[np.ndarray, "C n"],
        rows: RowFunction,
        samples: Float[np.ndarray, " N"],
        lower: Float[np.ndarray, " n"],
        upper: Float[np.ndarray, " n"],
    ):
        count, self.dof = control_points.shape
        form = smoothness_form(count)
        self.basis = BSpline.design_matrix(samples, knots(count), 3).toarray()
        ends = control_points[[0, -1]]
        self.fixed = self.basis[:, [0, -1]] @ ends
        self.free_basis = self.basis[:, 1:-1]
        self.form = form[1:-1, 1:-1]
        self.linear = form[1:-1][:, [0, -1]] @ ends
        self.constant = 0.5 * np.sum(ends * (form[[0, -1]][:, [0, -1]] @ ends))
        self.scale = 0.5 * float(np.sum((ends[1] - ends[0]) ** 2))
        self.row_function = rows
        self.lower, self.upper = lower, upper
        self.hessian = np.kron(self.form, np.eye(self.dof))

    def evaluate(self, x: Float[np.ndarray, "F n"], multiplier: Float[np.ndarray, "N P"], penalty: float) -> _State:
        """Constraints, objective and augmented Lagrangian at x."""
        reach = float(multiplier.max()) / penalty + 0.01
        rows = self.row_function(self.fixed + self.free_basis @ x, reach)
        cost = self.constant + float(np.sum(x * self.linear)) + 0.5 * float(np.sum(x * (self.form @ x)))
        violation = float(np.maximum(-rows.clearance, 0.0).max(initial=0.0))
        return self.remerit(_State(x, rows, cost, 0.0, violation), multiplier, penalty)

    def remerit(self, state: _State, multiplier: Float[np.ndarray, "N P"], penalty: float) -> _State:
        """The same point under other multipliers."""
        push = self._push(state.rows, multiplier, penalty)
        # Constant −λ²/2μ left out: it is the same at every point that is compared.
        merit = state.cost + 0.5 / penalty * float(push @ push)
        return _State(state.x, state.rows, state.cost, merit, state.violation)

    @staticmethod
    def _push(rows: Rows, multiplier: Float[np.ndarray, "N P"], penalty: float) -> Float[np.ndarray, " R"]:
        return np.maximum(0.0, multiplier[rows.sample, rows.pair] - penalty * rows.clearance)

    def step(
        self, state: _State, multiplier: Float[np.ndarray, "N P"], penalty: float, radius: float
    ) -> tuple[Float[np.ndarray, "F n"], float]:
        """Gauss–Newton step within the radius (largest joint, radians) and the limits, and the decrease it predicts."""
        shape = state.x.shape
        push = self._push(state.rows, multiplier, penalty)
        active = push > 0
        sample, gradient = state.rows.sample[active], state.rows.gradient[active]
        jacobian = (self.free_basis[sample][:, :, None] * gradient[:, None, :]).reshape(len(sample), state.x.size)
        slope = (self.linear + self.form @ state.x).ravel() - jacobian.T @ push[active]
        hessian = self.hessian + penalty * (jacobian.T @ jacobian)
        low = (np.broadcast_to(self.lower, shape) - state.x).ravel()
        high = (np.broadcast_to(self.upper, shape) - state.x).ravel()
        held = ((low > -1e-9) & (slope > 0)) | ((high < 1e-9) & (slope < 0))
        move = np.flatnonzero(~held)
        step = np.zeros(slope.size)
        block = hessian[np.ix_(move, move)]
        diagonal = np.arange(len(move))
        damping = 1e-10 * float(np.trace(block)) / max(len(move), 1)
        for _ in range(30):
            damped = block.copy()
            damped[diagonal, diagonal] += damping
            step[move] = cho_solve(cho_factor(damped, check_finite=False), -slope[move], check_finite=False)
            longest = np.abs(step).max()
            if longest <= 1.2 * radius:
                break
            damping = max(4 * damping, 1e-2 * float(np.median(np.diag(block))))
        step = np.clip(np.clip(step, -radius, radius), low, high)
        predicted = -float(slope @ step) - 0.5 * float(step @ (hessian @ step))
        return step.reshape(shape), predicted
