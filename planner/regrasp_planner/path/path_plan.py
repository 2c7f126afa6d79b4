"""PathPlan: collision-free, smooth, timed motions of the arm, in joint space and along straight lines of the gripper.

`plan_path` tries, in this order, and returns the first that passes the exact check of the *timed* motion:

1. the straight line in joint space, which is the optimum when nothing is in the way;
2. trajectory optimisation (`path_optimizer`) from several initial guesses, the least obstructed first: straight, over
   configurations with the gripper retracted or lifted at either end, over the robot's home, over random configurations;
3. RRT-Connect (`path_search`), shortcut, as the initial guess of the same optimisation; should the optimised curve not
   pass, the shortcut polyline itself, which rests at each corner. A short search comes after half of the guesses.

Clearance (`path_clearance`): each pair of bodies keeps its margin of the collision model. A pair that is closer than
its margin at an end of the path has its margin relieved there; see `PathClearance`. Every returned trajectory was
certified against the exact hulls over its whole duration, between samples too.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline

from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.ik.line import ArmKinematics, follow_line
from regrasp_planner.path.clearance import Collision, PathClearance
from regrasp_planner.path.optimizer import Rows, bspline, fit_control_points, optimize_path
from regrasp_planner.path.rrt import rrt_connect, shortcut
from regrasp_planner.path.trajectory import Trajectory, interpolating_path, time_parametrize
from regrasp_planner.robot.model import Arm

_SLACK = 1e-3
"""Clearance beyond the margin that the optimiser asks for: its tolerance, and what happens between its samples."""
_REFINEMENTS = 2
"""How often a path that collides between its samples is optimised again with more of them."""
_NEARLY = 3e-3
"""An optimised path that misses its clearance by less than this (metres) may still be free: the exact check decides."""


class PathStatus(Enum):
    """Why a path was or was not found."""

    SUCCESS = "success"
    OUT_OF_LIMITS = "start or goal outside the joint limits"
    START_IN_COLLISION = "start in collision"
    GOAL_IN_COLLISION = "goal in collision"
    NO_PATH = "no collision-free path found"
    LINE_OUT_OF_REACH = "straight line leaves the joint limits or the reach"
    LINE_IN_COLLISION = "straight line in collision"


@dataclass(frozen=True)
class PathOptions:
    """Options of `plan_path` and `cartesian_path`.

    Attributes:
        control_points: of the spline, ends included.
        samples_per_interval: clearance samples in each knot interval of the spline.
        max_guesses: initial guesses to optimise before the search.
        max_iterations: constraint evaluations per guess.
        search_rounds: rounds of RRT-Connect; 0 turns it off.
        velocity_scale, acceleration_scale: fractions of the arm's limits to use.
        contact_tolerance: overlap (metres) in which the start may be found, and at the goal the held body: an object
            that stands on a surface is in contact with it, and the robot is where it is.
    """

    control_points: int = 24
    samples_per_interval: int = 3
    max_guesses: int = 4
    max_iterations: int = 30
    search_rounds: int = 200
    velocity_scale: float = 0.5
    acceleration_scale: float = 0.5
    contact_tolerance: float = 1e-3


@dataclass(frozen=True)
class PathResult:
    """A path, or why there is none.

    Attributes:
        status: SUCCESS or the reason.
        message: the reason in words, naming joints and bodies.
        trajectory: the timed motion; None unless successful.
        bodies: names of the two bodies in the way, None if none is to blame.
        configuration: (n,) where that happened, radians.
        stats: "method" (how it was found), "clearance" (smallest certified distance met, metres), "iterations",
            "seconds".
    """

    status: PathStatus
    message: str = ""
    trajectory: Trajectory | None = None
    bodies: tuple[str, str] | None = None
    configuration: Float[np.ndarray, " n"] | None = None
    stats: dict[str, float | str] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        """Whether there is a trajectory."""
        return self.status is PathStatus.SUCCESS


def plan_path(
    model: CollisionModel,
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    theta: float,
    options: PathOptions | None = None,
    seed: int = 0,
) -> PathResult:
    """A collision-free, smooth motion from start to goal, from rest to rest within the limits.

    Args:
        model: the robot, the obstacles, perhaps a held body; the pairs to check and their margins.
        start, goal: (n,) configurations, radians.
        theta: finger coordinate during the motion.
        options: see `PathOptions`.
        seed: of the random guesses and the search.

    Raises:
        ValueError: for configurations of the wrong shape or not finite. Everything else is a status.
    """
    began = time.perf_counter()
    query = _Query(model, theta, options or PathOptions(), seed)
    result = query.plan(_configuration(model, start), _configuration(model, goal))
    result.stats["seconds"] = time.perf_counter() - began
    return result


def cartesian_path(
    model: CollisionModel,
    start: Float[np.ndarray, " n"],
    displacement: Float[np.ndarray, " 3"],
    theta: float,
    options: PathOptions | None = None,
) -> PathResult:
    """Move the gripper along a straight line with fixed orientation: approach, lift, lower, retreat.

    Args:
        model: as in `plan_path`; pairs meant to touch (pads and target) are left out of it.
        start: (n,) configuration, radians.
        displacement: (3,) of the gripper in world axes, metres.
        theta: finger coordinate during the motion.
        options: see `PathOptions`.

    Raises:
        ValueError: for arrays of the wrong shape or not finite.
    """
    began = time.perf_counter()
    displacement = np.asarray(displacement, float)
    if displacement.shape != (3,) or not np.isfinite(displacement).all():
        raise ValueError(f"displacement must be 3 finite metres, got {displacement}")
    query = _Query(model, theta, options or PathOptions(), 0)
    result = query.line(_configuration(model, start), displacement)
    result.stats["seconds"] = time.perf_counter() - began
    return result


def _configuration(model: CollisionModel, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    q = np.asarray(q, float)
    if q.shape != (model.arrays.robot.arm.dof,) or not np.isfinite(q).all():
        raise ValueError(f"a configuration must be {model.arrays.robot.arm.dof} finite angles in radians, got {q}")
    return q


class _Query:
    """One path query: the clearance functions, limits and options that its steps share."""

    def __init__(self, model: CollisionModel, theta: float, options: PathOptions, seed: int):
        self.model, self.options = model, options
        self.arm: Arm = model.arrays.robot.arm
        self.lower, self.upper = np.asarray(self.arm.lower, float), np.asarray(self.arm.upper, float)
        self.velocity = np.asarray(self.arm.max_velocity, float)
        self.acceleration = np.asarray(self.arm.max_acceleration, float)
        self.home = np.asarray(model.arrays.robot.home, float)
        self.kinematics = ArmKinematics(self.arm)
        self.clearance = PathClearance(model, theta, extra_margin=_SLACK)
        self.rng = np.random.default_rng(seed)
        self.stats: dict[str, float | str] = {"iterations": 0}
        self.blocked: Collision | None = None
        held = np.array([name == "held" for name in model.body_names])[model.pairs].any(axis=1)
        self.contact_at_goal = np.where(held, self.options.contact_tolerance, 0.0)

    # --- results ------------------------------------------------------------------------------------------------------

    def failure(self, status: PathStatus, collision: Collision | None = None, detail: str = "") -> PathResult:
        if collision is None:
            return PathResult(status, detail or status.value, stats=self.stats)
        a, b = (self.model.body_names[i] for i in self.model.pairs[collision.pair])
        apart = 1e3 * collision.distance * self.model.arrays.robot.unit
        message = f"{status.value}: {a!r} and {b!r} are {apart:.1f} mm apart" + detail
        return PathResult(status, message, None, (a, b), collision.configuration, self.stats)

    def finish(self, path: BSpline, method: str) -> PathResult | None:
        """Time the path and check the timed motion exactly; None if it collides."""
        options = self.options
        scales = options.velocity_scale, options.acceleration_scale
        return self.accept(time_parametrize(path, self.velocity, self.acceleration, *scales), method)

    def accept(self, trajectory: Trajectory, method: str) -> PathResult | None:
        collision, nearest = self.clearance.certify(trajectory)
        if collision is not None:
            self.blocked = collision
            return None
        self.stats |= {"method": method, "clearance": nearest}
        return PathResult(PathStatus.SUCCESS, trajectory=trajectory, stats=self.stats)

    def ends(self, *named: tuple[Float[np.ndarray, " n"], PathStatus]) -> PathResult | None:
        """The failure of the first end that is outside the limits or in collision."""
        for q, status in named:
            outside = np.flatnonzero((q < self.lower - 1e-6) | (q > self.upper + 1e-6))
            if len(outside):
                j = int(outside[0])
                span = f"[{self.lower[j]:.4f}, {self.upper[j]:.4f}]"
                joint = f"joint {self.arm.joint_names[j]!r} is at {q[j]:.4f} rad, limits {span}"
                return self.failure(PathStatus.OUT_OF_LIMITS, detail=f"{PathStatus.OUT_OF_LIMITS.value}: {joint}")
            at_start = status is PathStatus.START_IN_COLLISION
            allowed = self.options.contact_tolerance if at_start else self.contact_at_goal
            collision = self.clearance.touching(q[None], allowed)
            if collision is not None:
                return self.failure(status, collision)
        return None

    # --- joint space --------------------------------------------------------------------------------------------------

    def plan(self, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"]) -> PathResult:
        bad = self.ends((start, PathStatus.START_IN_COLLISION), (goal, PathStatus.GOAL_IN_COLLISION))
        if bad is not None:
            return bad
        start, goal = np.clip(start, self.lower, self.upper), np.clip(goal, self.lower, self.upper)
        self.clearance.set_ends(start, goal)
        line = np.stack([start, goal])
        if self.clearance.free(_interpolate(line, 24)).all():
            result = self.finish(bspline(fit_control_points(line, 8)), "straight")
            if result is not None:
                return result
        guesses = self.ranked([line, *self.guesses(start, goal)])[: self.options.max_guesses]
        half, rounds = len(guesses) // 2, self.options.search_rounds
        for some, share in ((guesses[:half], rounds // 4), (guesses[half:], rounds)):
            for guess in some:
                result = self.optimized(guess, "optimised")
                if result is not None:
                    return result
            result = self.searched(start, goal, share)
            if result is not None:
                return result
        return self.failure(PathStatus.NO_PATH, self.blocked)

    def optimized(
        self, guess: Float[np.ndarray, "K n"], method: str, control_points: int | None = None
    ) -> PathResult | None:
        """Optimise a polyline into a path that passes the exact check, or None."""
        count = control_points or self.options.control_points
        points = np.clip(fit_control_points(guess, count), self.lower, self.upper)
        samples = np.linspace(0.0, 1.0, self.options.samples_per_interval * (count - 3) + 1)[1:-1]
        for _ in range(_REFINEMENTS + 1):
            outcome = optimize_path(
                points,
                self.rows,
                samples,
                self.clearance.pair_count,
                self.lower,
                self.upper,
                self.options.max_iterations,
            )
            self.stats["iterations"] = int(self.stats["iterations"]) + outcome.iterations
            if outcome.violation > _NEARLY:
                self.blocked = self.clearance.touching(outcome.path(samples)) or self.blocked
                return None
            result = self.finish(outcome.path, method)
            if result is not None or self.blocked is None:
                return result
            # Something slipped through between samples: once more from here, with more of them about that place.
            dense = np.linspace(0.0, 1.0, 2001)
            hit = dense[np.linalg.norm(outcome.path(dense) - self.blocked.configuration, axis=1).argmin()]
            more = hit + np.arange(-6, 7) / (4.0 * len(samples))
            samples = np.union1d(samples, np.clip(more, 1e-3, 1 - 1e-3))
            points = outcome.control_points
        return None

    def rows(self, q: Float[np.ndarray, "N n"], reach: float) -> Rows:
        required = self.clearance.required(q)
        found = self.clearance.measure(q, required + reach)
        slack = found.distance - required[found.sample, found.pair]
        keep = slack < reach
        return Rows(found.sample[keep], found.pair[keep], slack[keep], found.gradient[keep])

    def searched(self, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"], rounds: int) -> PathResult | None:
        """RRT-Connect, shortcut and optimised."""
        if rounds == 0:
            return None
        free = self.clearance.free
        ways_out = [np.array([q, *self.escapes(q, kind, every=6)]) for q in (start, goal) for kind in ("up", "back")]
        polyline = rrt_connect(
            start, goal, free, self.lower, self.upper, self.rng, max_rounds=rounds, branches=ways_out
        )
        if polyline is None:
            return None
        polyline = shortcut(polyline, free, self.rng)
        result = self.optimized(polyline, "searched") or self.optimized(
            polyline, "searched", 2 * self.options.control_points
        )
        if result is not None:
            return result
        pieces = [
            time_parametrize(
                bspline(fit_control_points(piece, 8)),
                self.velocity,
                self.acceleration,
                self.options.velocity_scale,
                self.options.acceleration_scale,
            )
            for piece in np.stack([polyline[:-1], polyline[1:]], axis=1)
        ]
        return self.accept(_joined(pieces), "searched, with stops")

    # --- initial guesses ----------------------------------------------------------------------------------------------

    def guesses(self, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"]) -> list[Float[np.ndarray, "K n"]]:
        """Polylines from start to goal that might go round what is in the way."""
        ways = [[start, *self.escapes(start, kind)] for kind in ("none", "up", "back")]
        returns = [[*self.escapes(goal, kind)[::-1], goal] for kind in ("none", "up", "back")]
        out = [np.array(a + b) for a in ways for b in returns if len(a) + len(b) > 2]
        middle = 0.5 * (start + goal)
        vias = [self.home, 0.5 * (self.home + middle), *self.rng.uniform(self.lower, self.upper, (2, len(start)))]
        vias += [np.clip(middle + self.rng.normal(scale=0.5, size=len(start)), self.lower, self.upper)]
        out += [np.array([start, via, goal]) for via in vias]
        # Out of both ends first, then over home.
        out += [np.array([*ways[2], self.home, *returns[2]])]
        return out

    def escapes(self, q: Float[np.ndarray, " n"], kind: str, every: int | None = None) -> list[Float[np.ndarray, " n"]]:
        """Configurations on lifting the gripper, or drawing it back along its approach axis, by 15 cm.

        The last one alone, or each ``every``-th on the way (5 mm apart); none if the line cannot be followed.
        """
        if kind == "none":
            return []
        pose, _ = self.kinematics.gripper(q)
        axis = np.asarray(self.model.arrays.robot.gripper.approach_axis, float)
        direction = np.array([0.0, 0.0, 1.0]) if kind == "up" else -pose[:3, :3] @ axis
        line = follow_line(self.kinematics, q, 0.15 * direction, coarse=every is None)
        if line.fraction < 0.2:
            return []
        return [line.configurations[-1]] if every is None else list(line.configurations[every::every])

    def ranked(self, polylines: list[Float[np.ndarray, "K n"]]) -> list[Float[np.ndarray, "K n"]]:
        """Least obstructed first: total shortfall of clearance along the way, then length."""
        count = 20
        q = np.concatenate([_interpolate(polyline, count) for polyline in polylines])
        required = self.clearance.required(q)
        found = self.clearance.measure(q, required)
        shortfall = np.maximum(required[found.sample, found.pair] - found.distance, 0.0)
        total = np.bincount(found.sample // count, shortfall, minlength=len(polylines))
        lengths = np.array([np.linalg.norm(np.diff(polyline, axis=0), axis=1).sum() for polyline in polylines])
        # A radian of detour weighs as much as a centimetre of shortfall at every sample.
        order = np.argsort(total + 0.01 * lengths, kind="stable")
        return [polylines[i] for i in order]

    # --- straight lines -----------------------------------------------------------------------------------------------

    def line(self, start: Float[np.ndarray, " n"], displacement: Float[np.ndarray, " 3"]) -> PathResult:
        bad = self.ends((start, PathStatus.START_IN_COLLISION))
        if bad is not None:
            return bad
        start = np.clip(start, self.lower, self.upper)
        line = follow_line(self.kinematics, start, displacement)
        if line.fraction < 1.0:
            done = line.fraction * float(np.linalg.norm(displacement)) * self.model.arrays.robot.unit
            cause = (
                f"joint {self.arm.joint_names[line.limited]!r} reaches its limit"
                if line.limited is not None
                else "the arm does not reach further"
            )
            detail = f"{PathStatus.LINE_OUT_OF_REACH.value}: {cause} after {done * 1e3:.0f} mm"
            result = self.failure(PathStatus.LINE_OUT_OF_REACH, detail=detail)
            return PathResult(result.status, detail, configuration=line.configurations[-1], stats=self.stats)
        goal = line.configurations[-1]
        bad = self.ends((goal, PathStatus.LINE_IN_COLLISION))
        if bad is not None:
            return bad
        self.clearance.set_ends(start, goal)
        path = interpolating_path(line.configurations) if len(line.configurations) > 1 else None
        if path is None:
            path = bspline(np.repeat(start[None], 5, axis=0))
        result = self.finish(path, "line")
        return result or self.failure(PathStatus.LINE_IN_COLLISION, self.blocked)


def _interpolate(polyline: Float[np.ndarray, "K n"], count: int) -> Float[np.ndarray, "N n"]:
    """``count`` configurations evenly spread over the inside of a polyline."""
    chord = np.linalg.norm(np.diff(polyline, axis=0), axis=1)
    s = np.concatenate([[0.0], np.cumsum(chord)])
    at = np.linspace(0.0, s[-1], count + 2)[1:-1]
    return np.stack([np.interp(at, s, polyline[:, j]) for j in range(polyline.shape[1])], axis=1)


def _joined(pieces: list[Trajectory]) -> Trajectory:
    """Trajectories one after another; each starts where the last one ended, at rest."""
    times, positions, velocities = [pieces[0].times], [pieces[0].positions], [pieces[0].velocities]
    for piece in pieces[1:]:
        times.append(times[-1][-1] + piece.times[1:])
        positions.append(piece.positions[1:])
        velocities.append(piece.velocities[1:])
    return Trajectory(np.concatenate(times), np.concatenate(positions), np.concatenate(velocities))
