"""GraspGen: force-closure grasps that are free of collision in several scenes at once (the paper's Alg. 1, eq. 1–4).

The obstacles of all scenes are brought into the frame of the target, their union; a grasp found there holds in every
one of them. Starts come from critical directions of the target's width function w(x) = h(x) + h(−x), whose support
points are antipodal; they are looked at in the order of `grasp_order`, a few at a time, and most often the first ones
are feasible as they are. Where none is, the augmented Lagrangian with the Riemannian trust region refines the most
promising ones. The ground that the target stands on before or after is a plane (`release`), which needs no evaluation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from itertools import islice
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from regrasp_planner.geometry.boxes import bounding_boxes
from regrasp_planner.grasp.broad_phase import overlaps
from regrasp_planner.grasp.grasp import Grasp, GraspGenOptions, GraspResult, StartKind
from regrasp_planner.grasp.problem import (
    NO_PLANE,
    GraspProblem,
    Terms,
    evaluate,
    grasp_problem,
    graspable_parts,
    refine,
)
from regrasp_planner.grasp.starts import Starts, closing_axes, grasp_starts, uniform_starts
from regrasp_planner.placement.tilted_release import (
    BLOCKED,
    ReleaseCone,
    plane_clearance,
    relaxed_release,
    settling_clearance,
)
from regrasp_planner.robot.gripper import gripper_corners, reduce_gripper
from regrasp_planner.robot.model import Gripper
from regrasp_planner.task import Body, Scene

BATCH = 4
"""Grasps evaluated, or refined, in one call of the compiled program."""
OUTER_ROUNDS = 2
"""Rounds of Algorithm 3: grasps are refined, then the ground is tilted anew."""
REACH_CHUNK = 32
"""Starts whose reachability is asked for at once."""
LOOKED_AT = 8
"""Times that is done in search of starts that the arm takes freely, before others are evaluated."""
PATIENCE = 3
"""How many times as many starts are evaluated where there are grasps, but the arm can not make use of them."""
VIOLATION = 0.01
"""Largest violation of a constraint that counts as none, in gripper openings."""

Reachable = Callable[[Float[np.ndarray, "K 7"]], Int[np.ndarray, " K"]]
"""How well the arm can take K gripper poses in the target's frame: 0 not at all, greater is better."""


class Found(NamedTuple):
    """A grasp, and the direction in the target's frame that points down when it is let go; None where not asked."""

    grasp: Grasp
    release: Float[np.ndarray, " 3"] | None


class GraspSearch:
    """GraspGen and GraspGen⁺ for one target among the obstacles of one or more scenes.

    Evaluations are kept: searching again with another ground under the target costs only what is new.

    Args:
        target: the body to take, convex pieces in its own frame.
        scenes: scenes the same grasp must be feasible in, such as pick and place; none for a target in free space.
        gripper: the two-finger gripper.
        options: see `GraspGenOptions`.
        reachable: asked before a start is evaluated.
        seed: of the uniform starts.

    Attributes:
        evaluations: grasps evaluated so far, each member of a batch counted.
        ordered: start grasps put in order by bounding boxes so far, without an evaluation.
    """

    def __init__(
        self,
        target: Body,
        scenes: Sequence[Scene],
        gripper: Gripper,
        options: GraspGenOptions | None = None,
        reachable: Reachable | None = None,
        seed: int = 0,
    ) -> None:
        self.target, self.scenes, self.gripper = target, tuple(scenes), gripper
        self.options, self.seed = options or GraspGenOptions(), seed
        self.evaluations, self.ordered = 0, 0
        self._length = float(gripper.max_opening)
        self._margin = self.options.margin * self._length
        self._travel = reduce_gripper(gripper).travel
        self._stroke = self._length * self._travel
        self._reachable = reachable
        self._reached: dict[Reachable, dict[int, int]] = {}
        self._known: dict[int, Terms] = {}
        self._improved: list[tuple[Float[np.ndarray, " 7"], Terms]] = []
        self._contact_found = False
        self._hopeless = np.zeros(0, bool)
        self._hull = target.hull_vertices()

    @property
    def any_feasible(self) -> bool:
        """Whether any grasp evaluated so far is feasible, the ground under the target aside."""
        known = ((self._starts.poses[i], terms) for i, terms in self._known.items())
        return bool(self._improved) or any(self._grasp(*each) is not None for each in known)

    @property
    def reason(self) -> str:
        """Why there is no grasp, once a search has ended without one."""
        if len(self._starts.poses) == 0:
            return "too wide"
        if self._reached and not any(any(answers.values()) for answers in self._reached.values()):
            return "out of reach"
        return "poor quality" if self._contact_found else "enclosed"

    def grasps(
        self,
        start: ReleaseCone | None = None,
        end: ReleaseCone | None = None,
        also: Sequence[Reachable] = (),
    ) -> Iterator[list[Found]]:
        """Feasible grasps, a few at a time, the most open ones first; the caller stops when it has what it needs.

        Args:
            start: the ground under the target when it is taken, as the cone of a stable pose; its axis counts alone.
            end: the ground when it is let go. Where its half-angle is positive the plane may tilt within the cone
                (GraspGen⁺, Algorithm 3); otherwise the release is static.
            also: asked, too, before a start is made use of: where else the arm has to take the grasp. Answers are kept
                by the function, so that the same one should be given again.
        """
        if len(self._starts.poses) == 0:
            return
        asked = (*([] if self._reachable is None else [self._reachable]), *also)
        release: Sequence[Float[np.ndarray, " 3"] | None] = [None] * len(self._starts.poses)
        clear = np.ones(len(self._starts.poses), bool)
        if start is not None or end is not None:
            release, clear, _ = self._grounds(self._bodies, start, end)
        tried: list[int] = []
        if self.options.starts is StartKind.CRITICAL:
            refused: list[Grasp] = []
            for batch in self._screened(clear, refused, asked):
                tried += batch
                grasps = [self._grasp(self._starts.poses[i], self._known[i]) for i in batch]
                found = [Found(grasp, release[i]) for i, grasp in zip(batch, grasps, strict=True) if grasp is not None]
                if found := self._settling(found, end):
                    yield found
                    refused += [each.grasp for each in found]
        if self._improved:
            poses = np.array([pose for pose, _ in self._improved])
            thetas = np.array([terms.closing[0] for _, terms in self._improved]) * self._stroke
            found = self._cleared(poses, thetas, [terms for _, terms in self._improved], start, end)
            if found:
                yield found
        yield from self._refined(self._promising(tried, clear, asked), start, end)

    def _screened(
        self, clear: Bool[np.ndarray, " K"], refused: Sequence[Grasp], asked: Sequence[Reachable]
    ) -> Iterator[list[int]]:
        """Batches of evaluated starts: those known from other searches, then new ones as far as the budgets allow."""
        evaluated = np.array([i for i in self._order if clear[i] and int(i) in self._known], int)
        known = iter(evaluated[self._grades(evaluated, asked) > 0].tolist())
        while batch := list(islice(known, BATCH)):
            yield batch
        unknown = (i for i in self._in_order(clear, refused, asked) if i not in self._known)
        spent = 0
        while spent < self.options.screened * (PATIENCE if refused else 1) and self.evaluations < self.options.budget:
            batch = list(islice(unknown, BATCH))
            if not batch:
                return
            self._evaluate(batch)
            spent += len(batch)
            yield batch

    def _cleared(
        self,
        poses: Float[np.ndarray, "K 7"],
        thetas: Float[np.ndarray, " K"],
        terms: Sequence[Terms],
        start: ReleaseCone | None,
        end: ReleaseCone | None,
    ) -> list[Found]:
        """Those of K solved grasps that are feasible and clear the ground."""
        release, clear, _ = self._grounds(self._around(poses, thetas), start, end)
        grasps = [self._grasp(pose, each) for pose, each in zip(poses, terms, strict=True)]
        found = [Found(grasp, release[k]) for k, grasp in enumerate(grasps) if grasp is not None and clear[k]]
        return self._settling(found, end)

    # --- starts -------------------------------------------------------------------------------------------------------

    @cached_property
    def _starts(self) -> Starts:
        options, parts = self.options, graspable_parts(self.target)
        widest = self._length * (1 - 0.25 * options.margin)
        shares = [options.max_axes] if len(parts) == 1 else [max(2, options.max_axes // len(parts))] * len(parts)
        axes = [closing_axes(part, widest, share, options.lean)[0] for part, share in zip(parts, shares, strict=True)]
        number = sum(map(len, axes))
        if number == 0:
            return Starts.none()
        if options.starts is StartKind.UNIFORM:
            return uniform_starts(self._hull, self.gripper, options.refined, self.seed)
        angles = 2 * options.angles if number <= 4 else options.angles
        pieces = [piece.hull_vertices() for piece in self.target.pieces]
        every = [
            grasp_starts(pieces, k, parts[k], axes[k], self.gripper, angles, 1.2 * self._margin)
            for k in range(len(parts))
            if len(axes[k])
        ]
        return Starts.concatenate(every)

    @cached_property
    def _order(self) -> Int[np.ndarray, " K"]:
        """Starts by overlap of bounding boxes and lack of depth; then openness, and nearness to the centre of mass."""
        starts = self._starts
        if self.options.starts is StartKind.UNIFORM:
            return np.arange(len(starts.poses))
        opened = np.minimum(starts.thetas + self._margin * self._travel, float(self.gripper.upper))
        problem = self._problem
        boxes, where = bounding_boxes(problem.obstacles), np.asarray(problem.obstacle_poses)
        overlap, gap = overlaps(starts.poses, opened, self.gripper, boxes, where, self._margin)
        self.ordered += len(starts.poses)
        wanted = self.options.depth * reduce_gripper(self.gripper).tip_length
        lever = np.linalg.norm(starts.poses[:, 4:] - self.target.center_of_mass, axis=1)
        self._hopeless = gap < -self.options.deep * self._length
        cost = overlap + np.maximum(0.0, wanted - starts.depths) - 0.1 * np.clip(gap, 0.0, 6 * self._margin)
        return np.argsort(cost + 0.03 * lever, kind="stable")

    def _in_order(
        self, clear: Bool[np.ndarray, " K"], refused: Sequence[Grasp], asked: Sequence[Reachable]
    ) -> Iterator[int]:
        """Starts that clear the ground and that the arm reaches, the best graded ones first.

        Of those alike in that, such come first as differ from others before, and as do not hold the target the way the
        grasps do that were ``refused``.
        """
        order = self._order[(clear & ~self._hopeless)[self._order]]
        chunks = [order[begin : begin + REACH_CHUNK] for begin in range(0, len(order), REACH_CHUNK)]
        passes = [(2, chunks[:LOOKED_AT]), (1, chunks)] if asked else [(1, chunks)]
        for grade, some in passes:
            for chunk in some:
                grades = self._grades(chunk, asked)
                first, rest = _spread(self._starts.poses[chunk], 0.15 * self._length)
                waiting = [k for k in (*first, *rest) if grades[k] == grade]
                while waiting:
                    at = next((k for k in waiting if not self._alike(int(chunk[k]), refused)), waiting[0])
                    waiting.remove(at)
                    yield int(chunk[at])

    def _alike(self, i: int, refused: Sequence[Grasp]) -> bool:
        """Whether the start is turned by less than 30° against one of the grasps."""
        turn = self._starts.poses[i, :4]
        return any(abs(float(turn @ grasp.pose[:4])) > np.cos(np.radians(15)) for grasp in refused)

    def _grades(self, chunk: Int[np.ndarray, " C"], asked: Sequence[Reachable]) -> Int[np.ndarray, " C"]:
        """The least of the answers for each start; those it is hopeless for already are not asked about any more."""
        grades = np.full(len(chunk), 2 if asked else 1)
        for reachable in asked:
            answers = self._reached.setdefault(reachable, {})
            new = np.array([i for i, grade in zip(chunk, grades, strict=True) if grade and int(i) not in answers], int)
            if len(new):
                told = reachable(self._starts.poses[new])
                answers |= {int(i): int(answer) for i, answer in zip(new, told, strict=True)}
            grades = np.minimum(grades, [answers.get(int(i), 0) for i in chunk])
        return grades

    # --- evaluations --------------------------------------------------------------------------------------------------

    @cached_property
    def _problem(self) -> GraspProblem:
        return grasp_problem(self.target, self.scenes, self.gripper, self.options)

    @cached_property
    def _bodies(self) -> Float[np.ndarray, "K G 3"]:
        return self._around(self._starts.poses, self._starts.thetas)

    def _around(self, poses: Float[np.ndarray, "K 7"], thetas: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K G 3"]:
        """Corners of palm and fingers in the target's frame, opened for the target and opened wide."""
        upper = np.full(len(thetas), float(self.gripper.upper))
        opened = np.minimum(thetas + self._margin * self._travel, upper)
        parts = [part for theta in (opened, upper) for part in gripper_corners(self.gripper, poses, theta)]
        return np.concatenate(parts, axis=1)

    def _settling(self, found: list[Found], end: ReleaseCone | None) -> list[Found]:
        """Those whose fingers, opened wide, are not in the way of the target as it settles."""
        tilted = [
            each for each in found if each.release is not None and end is not None and each.release @ end.axis < 1
        ]
        if end is None or end.half_angle <= 0 or not tilted:
            return found
        poses = np.array([each.grasp.pose for each in tilted])
        _, *fingers = gripper_corners(self.gripper, poses, np.full(len(tilted), float(self.gripper.upper)))
        directions = np.array([each.release for each in tilted])
        pieces = [piece.hull_vertices() for piece in self.target.pieces]
        clearance = settling_clearance(pieces, fingers, end.axis, directions)
        blocked = {id(each) for each, gap in zip(tilted, clearance, strict=True) if gap < BLOCKED * self._length}
        return [each for each in found if id(each) not in blocked]

    def _grounds(
        self, bodies: Float[np.ndarray, "K G 3"], start: ReleaseCone | None, end: ReleaseCone | None
    ) -> tuple[list[Float[np.ndarray, " 3"] | None], Bool[np.ndarray, " K"], Float[np.ndarray, "K 2 4"]]:
        """Direction in which each grasp lets go, whether it clears the ground at both ends, and the planes."""
        count = len(bodies)
        narrow = bodies[:, : bodies.shape[1] // 2]
        clear = np.ones(count, bool)
        planes = np.tile(NO_PLANE, (count, 2, 1))
        release: list[Float[np.ndarray, " 3"] | None] = [None] * count
        if start is not None:
            planes[:, 0] = self._plane(start.axis)
            clear &= plane_clearance(self._hull, narrow, start.axis) >= self._margin
        if end is not None and end.half_angle > 0:
            down, free = relaxed_release(end, self._hull, bodies, self._margin)
        elif end is not None:
            down = np.tile(end.axis, (count, 1))
            free = plane_clearance(self._hull, narrow, end.axis) >= self._margin
        else:
            return release, clear, planes
        planes[:, 1] = self._plane(down)
        return list(down), clear & free, planes

    def _plane(self, down: Float[np.ndarray, "*K 3"]) -> Float[np.ndarray, "*K 4"]:
        return np.concatenate([down, (down @ self._hull.T).max(axis=-1)[..., None]], axis=-1)

    def _evaluate(self, new: Sequence[int]) -> None:
        """One evaluation of each of these starts, without the ground."""
        index = np.resize(np.asarray(new), BATCH)
        starts = self._starts
        scaled = starts.thetas[index][:, None] / self._stroke
        terms = jax.device_get(evaluate(starts.poses[index], scaled, starts.taken[index], self._problem))
        self.evaluations += len(new)
        self._known |= {i: Terms(*(leaf[k] for leaf in terms)) for k, i in enumerate(new)}

    def _solve(
        self,
        poses: Float[np.ndarray, "B 7"],
        thetas: Float[np.ndarray, " B"],
        taken: Int[np.ndarray, " B"],
        grounds: Float[np.ndarray, "B 2 4"],
        evaluations: int,
    ) -> tuple[Float[np.ndarray, "B 7"], Terms, Int[np.ndarray, " B"]]:
        scaled = thetas[:, None] / self._stroke
        solved = refine(poses, scaled, taken, grounds, self._problem, evaluations, length=self._length)
        return jax.device_get(solved)

    def _grasp(self, pose: Float[np.ndarray, " 7"], terms: Terms) -> Grasp | None:
        """The grasp, if it is feasible."""
        if not np.isfinite(terms.violation) or terms.violation > VIOLATION:
            return None
        self._contact_found = True
        if terms.quality < self.options.quality_threshold:
            return None
        theta = float(terms.closing[0]) * self._stroke
        opening = min(theta + self._margin * self._travel, float(self.gripper.upper))
        return Grasp(np.asarray(pose), theta, float(opening), float(terms.quality), float(terms.clearance))

    # --- refinement ---------------------------------------------------------------------------------------------------

    def _promising(self, tried: Sequence[int], clear: Bool[np.ndarray, " K"], asked: Sequence[Reachable]) -> list[int]:
        """Starts to refine: of those tried the nearest to feasible, then such as only the ground is in the way of."""
        if self.evaluations >= self.options.budget:
            return []
        if self.options.starts is StartKind.UNIFORM:
            return [int(i) for i in self._order]
        merit = {
            i: self._known[i].lacking - 0.2 * self._known[i].quality
            for i in tried
            if self._grasp(self._starts.poses[i], self._known[i]) is None
        }
        chosen = sorted(merit, key=lambda i: merit[i])[: self.options.refined]
        untried = np.setdiff1d(self._order, np.asarray(tried, int), assume_unique=True)
        others = untried[np.argsort(~clear[untried], kind="stable")][:REACH_CHUNK]
        others = others[self._grades(others, asked) > 0] if len(chosen) < self.options.refined else others[:0]
        return [*chosen, *(int(i) for i in others)][: self.options.refined]

    def _refined(
        self, chosen: Sequence[int], start: ReleaseCone | None, end: ReleaseCone | None
    ) -> Iterator[list[Found]]:
        """Algorithm 1, and where the ground may tilt Algorithm 3, from the chosen starts."""
        rounds = OUTER_ROUNDS if end is not None and end.half_angle > 0 else 1
        for begin in range(0, len(chosen), BATCH):
            count = len(chosen[begin : begin + BATCH])
            index = np.resize(np.asarray(chosen[begin : begin + BATCH]), BATCH)
            poses, thetas = self._starts.poses[index], self._starts.thetas[index]
            terms: Terms | None = None
            for _ in range(rounds):
                _, _, planes = self._grounds(self._around(poses, thetas), start, end)
                evaluations = self.options.max_evaluations // rounds
                poses, terms, spent = self._solve(poses, thetas, self._starts.taken[index], planes, evaluations)
                thetas = np.asarray(terms.closing)[:, 0] * self._stroke
                self.evaluations += int(spent[:count].sum())
            assert terms is not None
            each = [Terms(*(leaf[k] for leaf in terms)) for k in range(count)]
            self._improved += [(pose, one) for pose, one in zip(poses, each, strict=False) if self._grasp(pose, one)]
            if found := self._cleared(poses[:count], thetas[:count], each, start, end):
                yield found


def generate_grasps(
    target: Body, scenes: Sequence[Scene], gripper: Gripper, options: GraspGenOptions | None = None, seed: int = 0
) -> GraspResult:
    """Grasps that hold the target and keep clear of the obstacles of all ``scenes`` (Alg. 1).

    Args:
        target: the body to take, convex pieces in its own frame.
        scenes: scenes the same grasp must be feasible in, such as pick and place.
        gripper: the two-finger gripper.
        options: see `GraspGenOptions`.
        seed: of the uniform starts, where the options ask for those.

    Returns:
        `GraspResult`; without a feasible grasp it is empty and says why.
    """
    search = GraspSearch(target, scenes, gripper, options, seed=seed)
    length = float(gripper.max_opening)
    grasps: list[Grasp] = []
    for batch in search.grasps():
        grasps = _distinct([*grasps, *(found.grasp for found in batch)], length)
        if len(grasps) >= search.options.enough:
            break
    if not grasps:
        return GraspResult((), search.evaluations, search.reason)
    # A grasp near the centre of mass has less of a torque to hold: an opening's distance counts as 0.3 of quality.
    grasps.sort(
        key=lambda grasp: 0.3 * float(np.linalg.norm(grasp.pose[4:] - target.center_of_mass)) / length - grasp.quality
    )
    return GraspResult(tuple(grasps), search.evaluations, "")


def _spread(poses: Float[np.ndarray, "K 7"], distance: float) -> tuple[list[int], list[int]]:
    """Indices of poses that differ from all before by 20° or by ``distance``, and the others."""
    first: list[int] = []
    rest: list[int] = []
    for i in range(len(poses)):
        same = np.abs(poses[first, :4] @ poses[i, :4]) > np.cos(np.radians(10))
        near = np.linalg.norm(poses[first, 4:] - poses[i, 4:], axis=1) < distance
        (rest if (same & near).any() else first).append(i)
    return first, rest


def _distinct(grasps: Sequence[Grasp], length: float) -> list[Grasp]:
    """The grasps, but for those within 0.05 rad and 5 % of ``length`` of another one."""
    kept: list[Grasp] = []
    for grasp in grasps:
        alike = (
            abs(float(grasp.pose[:4] @ other.pose[:4])) > np.cos(0.025)
            and np.linalg.norm(grasp.pose[4:] - other.pose[4:]) < 0.05 * length
            for other in kept
        )
        if not any(alike):
            kept.append(grasp)
    return kept
