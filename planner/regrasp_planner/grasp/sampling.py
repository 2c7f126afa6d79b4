"""The sampling baseline: many random grasps, each judged exactly in all scenes (the paper's §IV-A 1).

A grasp is drawn from a uniform orientation, an approach distance from the target's centre of mass, an offset across the
fingers, and an opening of the fingers. The fingers then close: the gripper gives way along its closing axis until both
pads touch, and the finger coordinate of that contact is worked out (`closing`). So each sample comes as near to a grasp
as it can, and only what no closing can mend speaks against it. The rules are those of GraspGen: quality of eq. (4),
depth of the grasp centre, clearance δ_col of the open gripper; and no finger but its pad may reach into the target.

Most samples are dismissed by bounds that cannot err: lines through the pads tell how far the fingers close at most,
and spheres and facet planes which bodies are apart. What is left is measured (`body_bounds`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import RigidTransform, Rotation

from regrasp_planner.collision.fixed_bodies import FixedBodies
from regrasp_planner.geometry.hull import hull_planes, minimal_width
from regrasp_planner.grasp.closing import Pads, Poses, clipped, close_fingers, reaches, soft_points
from regrasp_planner.grasp.grasp import Grasp, GraspResult, NoGraspReason
from regrasp_planner.grasp.problem import graspable_parts, union_obstacles
from regrasp_planner.pose import IDENTITY, rigid
from regrasp_planner.robot.gripper import finger_coordinate, reduce_gripper
from regrasp_planner.robot.model import Gripper
from regrasp_planner.task import Body, Scene

BLOCK = 2048
"""Samples looked at together, so that their arrays fit into the processor's cache."""
TOUCHING = 1e-4
"""How far from the target a pad that touches may be, and how deep in it the rest of a finger, metres."""
FINGER_GAP = 0.125
"""Least clearance of the open fingers from the target, as a share of δ_col."""
ALIKE_ANGLE, ALIKE_SHIFT = 0.1, 0.1
"""Grasps nearer to a better one than this (radians, gripper openings) are not returned."""


@dataclass(frozen=True)
class SamplingOptions:
    """Options of `sample_grasps`.

    Attributes:
        count: grasps sampled.
        margin, depth, quality_threshold: as in `GraspGenOptions`.
        max_grasps: feasible grasps returned at most.
    """

    count: int = 50_000
    margin: float = 0.06
    depth: float = 0.5
    quality_threshold: float = 1.85
    max_grasps: int = 200


def sample_grasps(
    target: Body, scenes: Sequence[Scene], gripper: Gripper, options: SamplingOptions | None = None, seed: int = 0
) -> GraspResult:
    """Feasible grasps among ``options.count`` random ones, best first.

    Args:
        target: the body to take, convex pieces in its own frame.
        scenes: scenes the same grasp must be feasible in, such as pick and place.
        gripper: the two-finger gripper.
        options: see `SamplingOptions`.
        seed: of the samples. More samples of one seed contain the fewer ones.

    Returns:
        `GraspResult`; ``evaluations`` is the number of samples, or 0 if the target is too wide to begin with.
    """
    sampler = _Sampler(target, scenes, gripper, options or SamplingOptions())
    if sampler.narrowest >= float(gripper.upper):
        return GraspResult((), 0, NoGraspReason.TOO_WIDE)
    closed = sampler.closed(sampler.drawn(seed))
    grasps = sampler.best(closed)
    reason = NoGraspReason.ENCLOSED if len(closed.theta) else NoGraspReason.POOR_QUALITY
    return GraspResult(grasps, sampler.options.count, None if grasps else reason)


class _Samples(NamedTuple):
    """N samples, and what the fingers are opened to; ``part``, an index into `graspable_parts`, is to be taken."""

    poses: Poses
    opening: Float[np.ndarray, " N"]
    part: Int[np.ndarray, " N"]

    def at(self, index: np.ndarray | slice) -> _Samples:
        return _Samples(Poses(*(leaf[index] for leaf in self.poses)), self.opening[index], self.part[index])


class _Closed(NamedTuple):
    """N grasps whose pads touch the target."""

    pose: Float[np.ndarray, "N 7"]
    theta: Float[np.ndarray, " N"]
    opening: Float[np.ndarray, " N"]
    quality: Float[np.ndarray, " N"]

    def at(self, index: np.ndarray) -> _Closed:
        return _Closed(*(leaf[index] for leaf in self))

    @staticmethod
    def together(several: Sequence[_Closed]) -> _Closed:
        return _Closed(*(np.concatenate(leaves) for leaves in zip(*several, strict=True)))


class _Sampler:
    """One call of `sample_grasps`."""

    def __init__(self, target: Body, scenes: Sequence[Scene], gripper: Gripper, options: SamplingOptions):
        self.target, self.scenes, self.gripper, self.options = target, scenes, gripper, options
        self.length = float(gripper.max_opening)
        self.margin = options.margin * self.length
        self.reduced = reduce_gripper(gripper)
        self.depth = options.depth * self.reduced.tip_length
        self.pads = Pads.of(gripper)
        self.parts = [hull_planes(part) for part in graspable_parts(target)]
        # As lines see them the pieces are without their sweep, which is a fraction of a millimetre.
        self.planes = self.parts[: len(target.pieces)]
        self.hand = [gripper.palm[k] for k in range(gripper.palm.batch_size)]
        self.hand += [gripper.fingers[k] for k in range(gripper.fingers.batch_size)]
        least = min(minimal_width(piece.hull_vertices()) + 2 * float(piece.radius) for piece in target.pieces)
        # Nothing narrower than this goes round the target, or a piece of it.
        self.narrowest = float(finger_coordinate(gripper, least + 2 * FINGER_GAP * self.margin))

    @cached_property
    def pieces(self) -> FixedBodies:
        return FixedBodies(self.target.pieces, np.tile(IDENTITY, (len(self.target.pieces), 1)))

    @cached_property
    def obstacles(self) -> FixedBodies:
        corners = np.concatenate([self.reduced.hand[k].hull_vertices() for k in range(3)])
        reach = np.linalg.norm(self.target.hull_vertices(), axis=1).max() + self.length + self.margin
        return FixedBodies(*union_obstacles(self.scenes, float(reach + np.linalg.norm(corners, axis=1).max())))

    # --- drawing ------------------------------------------------------------------------------------------------------

    def drawn(self, seed: int) -> _Samples:
        """Samples, each from eight uniform numbers."""
        u = np.random.default_rng(seed).random((self.options.count, 8))
        # Uniform on the unit quaternions (Shoemake, Graphics Gems III, 1992).
        near, far = np.sqrt(1 - u[:, 0]), np.sqrt(u[:, 0])
        one, two = 2 * np.pi * u[:, 1], 2 * np.pi * u[:, 2]
        quaternion = np.stack([near * np.sin(one), near * np.cos(one), far * np.sin(two), far * np.cos(two)], axis=1)
        turn = Rotation.from_quat(quaternion, scalar_first=True)
        approach, width = turn.apply(np.asarray(self.gripper.approach_axis, float)), turn.apply(self.pads.axis)
        across = np.cross(width, approach)
        # Half of the samples take the target as a whole, the others one of its pieces.
        whole = len(self.parts) - 1
        part = np.where(u[:, 6] < 0.5, whole, (u[:, 7] * whole).astype(int))
        origin = np.zeros((len(u), 3))
        for k, vertices in enumerate(graspable_parts(self.target)):
            rows = np.flatnonzero(part == k)
            anchor = self.target.center_of_mass if k == whole else np.asarray(self.target.pieces[k].center)
            behind = -(approach[rows] @ (vertices - anchor).T).min(axis=1)
            sideways = across[rows] @ (vertices - anchor).T
            low, high = sideways.min(axis=1), sideways.max(axis=1)
            origin[rows] = anchor - (u[rows, 3] * behind)[:, None] * approach[rows]
            origin[rows] += (low + u[rows, 4] * (high - low))[:, None] * across[rows]
        opening = self.narrowest + u[:, 5] * (float(self.gripper.upper) - self.narrowest)
        return _Samples(Poses(quaternion, origin, width), opening, part)

    # --- closing ------------------------------------------------------------------------------------------------------

    def closed(self, samples: _Samples) -> _Closed:
        """Those of the samples that hold the target well when closed, whatever else the gripper touches."""
        upper, count = float(self.gripper.upper), len(samples.opening)
        left: list[tuple[np.ndarray, ...]] = []
        for begin in range(0, count, BLOCK):
            rows = np.arange(begin, min(begin + BLOCK, count))
            # The closing axis has to pass through the part, deep enough in it; and no line through a pad may be longer
            # within the target than the fingers are open.
            rows = rows[self._deep(samples.poses.origin[rows], samples.at(rows))]
            some = samples.at(rows)
            travel, touched = reaches(self.planes, some.part, self.pads, some.poses)
            hit = np.isfinite(travel.min(axis=1))
            theta, shift = self.pads.nearly(np.where(hit[:, None], travel, 0.0), upper)
            kept = hit & (theta <= some.opening) if self.pads.slide else hit
            left.append((rows[kept], touched[kept], theta[kept], shift[kept]))
        rows, touched, theta, shift = (np.concatenate(leaves) for leaves in zip(*left, strict=True))
        some = samples.at(rows)
        found = close_fingers(self.target.pieces, touched, self.gripper, some.poses, theta, shift)

        origin = some.poses.origin + found.shift[:, None] * some.poses.width
        first, second = found.normals[:, 0], found.normals[:, 1]
        kept = (np.abs(found.gaps) < TOUCHING).all(axis=1) & self._deep(origin, some, at_once=True)
        kept &= (found.theta >= float(self.gripper.lower)) & (found.theta <= some.opening)
        # The other terms of eq. (4) add up to 1 at most.
        kept &= -(first * second).sum(axis=1) >= self.options.quality_threshold - 1
        rows = np.flatnonzero(kept)
        some, touched, found = some.at(rows), touched[rows], type(found)(*(leaf[rows] for leaf in found))
        quality = self._quality(some.poses, found.shift, found.normals, found.points)
        soft = np.flatnonzero(quality < self.options.quality_threshold)
        part, contacts = some.at(soft).poses, type(found)(*(leaf[soft] for leaf in found))
        middles = soft_points(self.planes, touched[soft], self.pads, part, contacts)
        quality[soft] = self._quality(part, contacts.shift, contacts.normals, middles)
        poses = np.concatenate([some.poses.quaternion, origin[rows]], axis=1)
        grasps = _Closed(poses, found.theta, some.opening, quality)
        return grasps.at(quality >= self.options.quality_threshold)

    def _deep(
        self, origin: Float[np.ndarray, "N 3"], samples: _Samples, at_once: bool = False
    ) -> Bool[np.ndarray, " N"]:
        """Whether the line along the closing axis comes deep enough into the part; ``at_once``: at its origin."""
        deep = np.zeros(len(origin), bool)
        for k, planes in enumerate(self.parts):
            rows = np.flatnonzero(samples.part == k)
            enter, leave = clipped(origin[rows], samples.poses.width[rows], planes, self.depth)
            deep[rows] = (enter <= 0) & (leave >= 0) if at_once else enter < leave
        return deep

    def _quality(
        self,
        poses: Poses,
        shift: Float[np.ndarray, " N"],
        normals: Float[np.ndarray, "N 2 3"],
        points: Float[np.ndarray, "N 2 3"],
    ) -> Float[np.ndarray, " N"]:
        """f of eq. (4)."""
        palm = Rotation.from_quat(poses.quaternion, scalar_first=True).apply(np.asarray(self.reduced.hand[0].center))
        palm += poses.origin + shift[:, None] * poses.width
        line, towards = points[:, 0] - points[:, 1], self.target.center_of_mass - palm
        line /= np.maximum(np.linalg.norm(line, axis=1), 1e-9)[:, None]
        towards /= np.maximum(np.linalg.norm(towards, axis=1), 1e-9)[:, None]
        antipodal = (normals[:, 0] * (line - normals[:, 1])).sum(axis=1)
        return antipodal - 0.5 * (poses.width * towards).sum(axis=1) ** 2

    # --- clearance ----------------------------------------------------------------------------------------------------

    def free(self, closed: _Closed) -> Int[np.ndarray, " K"]:
        """Indices of the grasps whose gripper keeps clear of the target, as far as it should, and of all obstacles."""
        palm, fingers = self.gripper.palm.batch_size, self.gripper.fingers.batch_size
        # Palm, open fingers, and fingers closed on the target.
        bodies = self.hand + self.hand[palm:]
        kept = np.arange(len(closed.theta))
        from_target = np.repeat([self.margin, FINGER_GAP * self.margin, -TOUCHING], [palm, fingers, fingers])
        from_obstacles = np.repeat([self.margin, 0.0], [palm + fingers, fingers])
        for fixed, needed in ((self.pieces, from_target), (self.obstacles, from_obstacles)):
            slack = fixed.least_slack(bodies, self._placed(closed.at(kept)), np.tile(needed, (len(fixed.bodies), 1)).T)
            kept = kept[slack >= 0]
        return kept

    def _placed(self, closed: _Closed) -> list[RigidTransform]:
        """Poses of the palm's bodies, of the open and of the closed fingers', in the target's frame."""
        hand = rigid(closed.pose)
        placed = [hand] * self.gripper.palm.batch_size
        for theta in (closed.opening, closed.theta):
            # Scipy's exponential coordinates have the rotation first.
            turns = [RigidTransform.from_exp_coords(np.outer(theta, np.roll(screw, 3))) for screw in self.pads.screws]
            placed += [hand * turns[int(k)] for k in np.asarray(self.gripper.finger_of)]
        return placed

    # --- the best of them ---------------------------------------------------------------------------------------------

    def best(self, closed: _Closed) -> tuple[Grasp, ...]:
        """Free grasps by quality and nearness to the centre of mass, without those much like a better one."""
        away = np.linalg.norm(closed.pose[:, 4:] - self.target.center_of_mass, axis=1) / self.length
        closed = closed.at(np.argsort(0.3 * away - closed.quality, kind="stable"))
        chosen: list[int] = []
        for begin in range(0, len(closed.theta), BLOCK):
            rows = np.arange(begin, min(begin + BLOCK, len(closed.theta)))
            for i in rows[self.free(closed.at(rows))]:
                others = closed.pose[chosen]
                # |q·r| = cos(angle / 2).
                alike = np.abs(others[:, :4] @ closed.pose[i, :4]) > np.cos(0.5 * ALIKE_ANGLE)
                near = np.linalg.norm(others[:, 4:] - closed.pose[i, 4:], axis=1) < ALIKE_SHIFT * self.length
                if not (alike & near).any():
                    chosen.append(int(i))
            if len(chosen) >= self.options.max_grasps:
                break
        some = closed.at(np.array(chosen[: self.options.max_grasps], int))
        values = zip(*some, self._clearance(some), strict=True)
        return tuple(Grasp(pose, float(t), float(o), float(f), float(c)) for pose, t, o, f, c in values)

    def _clearance(self, closed: _Closed) -> Float[np.ndarray, " N"]:
        """Least distance of the open gripper from the obstacles and of its palm from the target, metres; at most 1."""
        palm, placed = self.gripper.palm.batch_size, self._placed(closed)[: len(self.hand)]
        nothing = np.zeros((len(self.hand), len(self.obstacles.bodies)))
        around = self.obstacles.least_slack(self.hand, placed, nothing, cap=1.0)
        nothing = np.zeros((palm, len(self.pieces.bodies)))
        return np.minimum(around, self.pieces.least_slack(self.hand[:palm], placed[:palm], nothing, cap=1.0))
