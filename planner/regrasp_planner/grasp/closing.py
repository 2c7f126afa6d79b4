"""Fingers that close on a target: where both pads touch while the gripper gives way along its closing axis.

With the gripper's orientation held, a pose is its shift s along the closing axis, and the contact of both pads is two
equations, d_k(θ, s) = 0, in two unknowns. By the envelope theorem ∂d_k is x_k·v_k, the contact normal times the pad's
velocity, so Newton's method takes one distance per pad and step. For sliding fingers d_k depends on the travel of
finger k alone and is convex in it: the steps never overshoot, and on polyhedra they end after a few. Lines through the
pads along the closing axis say beforehand where the contact is about, and how far open the fingers stay at least.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import RigidTransform, Rotation

from regrasp_planner.geometry.distance import hull_gap, separation
from regrasp_planner.geometry.hull import hull_planes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.robot.model import Gripper

STEPS = 2
"""Newton steps of all grasps of a batch; after them only those go on that do not touch yet."""
ROUNDS = 6
BATCH = 1024
VERTICES = 64
TOLERANCE = 1e-6
"""Distance of a pad from the target at which it touches, metres."""
LINES = 7
"""Lines along either side of a pad."""
SOFTNESS = 5e-4
"""How far a pad gives way under its contact, metres."""


def clipped(
    points: Float[np.ndarray, "N 3"],
    directions: Float[np.ndarray, "N 3"],
    planes: Float[np.ndarray, "F 4"],
    depth: float = 0.0,
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Where the lines point + s·direction enter and leave a convex body n·x ≤ b, metres; (∞, −∞) if never.

    With a ``depth`` it is the part of the line that lies so deep below the facets, but for those that the line passes
    straight through: for each facet the distance across the line counts, depth · √(1 − (n·direction)²).
    """
    speed = directions @ planes[:, :3].T
    gap = planes[:, 3] - points @ planes[:, :3].T
    if depth:
        gap -= depth * np.sqrt(np.maximum(1.0 - speed**2, 1e-6))
    # A line along a facet is outside for ever or never: an infinity of the right sign.
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = gap / speed
    enter = np.where(speed < 0, crossing, np.where((speed == 0) & (gap < 0), np.inf, -np.inf)).max(axis=1)
    leave = np.where(speed > 0, crossing, np.inf).min(axis=1)
    hit = enter < leave
    return np.where(hit, enter, np.inf), np.where(hit, leave, -np.inf)


@dataclass(frozen=True)
class Pads:
    """The inner faces of both pads, as lines along the closing axis see them.

    Attributes:
        faces: for each finger (L, 3) points of its pad's face in the gripper frame at θ = 0, metres.
        few: indices of the points at the corners and in the middle.
        axis: (3,) the closing axis in the gripper frame.
        screws: (2, 6) of the fingers, see `Gripper`.
        sides: (2,) +1 for the finger that opens towards the axis, −1 for the other.
        speeds: (2,) speed of the faces away from the middle, metres per unit of θ.
        slide: whether both fingers move straight along the axis.
    """

    faces: tuple[Float[np.ndarray, "L 3"], ...]
    few: Int[np.ndarray, " C"]
    axis: Float[np.ndarray, " 3"]
    screws: Float[np.ndarray, "2 6"]
    sides: Float[np.ndarray, " 2"]
    speeds: Float[np.ndarray, " 2"]
    slide: bool

    @staticmethod
    def of(gripper: Gripper) -> Pads:
        """The pads of a gripper."""
        axis, screws = np.asarray(gripper.width_axis, float), np.asarray(gripper.screws, float)
        lateral = np.linalg.svd(axis[None])[2][1:]
        # A hair inside, so that no line slips past a side of the pad.
        share = np.linspace(-1, 1, LINES) * (1 - 1e-6)
        grid = np.stack(np.meshgrid(share, share, indexing="ij"), axis=-1).reshape(-1, 2)
        extreme = np.abs(grid)
        few = np.flatnonzero((extreme.min(axis=1) > 0.9) | (extreme.max(axis=1) < 0.1))
        faces: list[np.ndarray] = []
        velocities: list[float] = []
        for k, screw in zip(np.asarray(gripper.contact), screws, strict=True):
            pad = gripper.fingers[int(k)]
            velocity = float((screw[:3] + np.cross(screw[3:], np.asarray(pad.center))) @ axis)
            across = pad.hull_vertices() @ lateral.T
            low, high = across.min(axis=0), across.max(axis=0)
            points = (0.5 * (low + high) + 0.5 * grid * (high - low)) @ lateral
            enter, leave = clipped(points, np.broadcast_to(axis, points.shape), hull_planes(pad.hull_vertices()))
            # Lines that miss a pad that is no box touch nothing: their points are far out.
            height = np.where(enter < leave, enter if velocity > 0 else leave, np.sign(velocity))
            faces.append(points + np.outer(height - np.sign(velocity) * float(pad.radius), axis))
            velocities.append(velocity)
        straight = screws[:, :3] - np.outer(screws[:, :3] @ axis, axis)
        slide = bool(max(np.abs(straight).max(), np.abs(screws[:, 3:]).max()) < 1e-9)
        return Pads(tuple(faces), few, axis, screws, np.sign(velocities), np.abs(velocities), slide)

    def nearly(
        self, reaches: Float[np.ndarray, "N 2"], upper: float
    ) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
        """θ and shift at which the faces are moved out by ``reaches``, metres; of jaws that swing only a start."""
        if not self.slide:
            return np.full(len(reaches), upper), 0.5 * self.sides[0] * (reaches[:, 0] - reaches[:, 1])
        theta = reaches.sum(axis=1) / self.speeds.sum()
        return theta, self.sides[0] * (reaches[:, 0] - self.speeds[0] * theta)


class Poses(NamedTuple):
    """N gripper poses in the target's frame that may give way along ``width``, the closing axis."""

    quaternion: Float[np.ndarray, "N 4"]
    origin: Float[np.ndarray, "N 3"]
    width: Float[np.ndarray, "N 3"]


def reaches(
    planes: Sequence[Float[np.ndarray, "F 4"]], part: Int[np.ndarray, " N"], pads: Pads, poses: Poses
) -> tuple[Float[np.ndarray, "N 2"], Int[np.ndarray, "N 2"]]:
    """How far each pad has to be moved out, along lines through its corners and its middle, to be off the target.

    Args:
        planes: facets of the target's pieces.
        part: piece that counts, or the number of pieces for all of them.
        pads: of the gripper.
        poses: of the gripper.

    Returns:
        Travel of both pads from θ = 0, metres, never more than they travel until they touch (if they slide); −∞ where
        no line meets a piece. And the piece that asks for it.
    """
    rotation = Rotation.from_quat(poses.quaternion, scalar_first=True)
    farthest = np.full((len(part), 2), -np.inf)
    touched = np.zeros((len(part), 2), int)
    for finger, face in enumerate(pads.faces):
        for corner in face[pads.few]:
            points = poses.origin + rotation.apply(corner)
            for k, facets in enumerate(planes):
                rows = np.flatnonzero((part == len(planes)) | (part == k))
                enter, leave = clipped(points[rows], poses.width[rows], facets)
                beyond = leave if pads.sides[finger] > 0 else -enter
                farther = beyond > farthest[rows, finger]
                farthest[rows[farther], finger] = beyond[farther]
                touched[rows[farther], finger] = k
    return farthest, touched


class Contacts(NamedTuple):
    """N grasps in which both pads touch; index 0 and 1 are the fingers.

    Attributes:
        theta: (N,) finger coordinate.
        shift: (N,) way of the gripper along its closing axis, metres.
        gaps: (N, 2) distances of the pads' hulls from those of the pieces, metres; about 0 where they touch.
        normals: (N, 2, 3) outward normals of the target at the contacts.
        points: (N, 2, 3) the contacts on the target, metres.
    """

    theta: Float[np.ndarray, " N"]
    shift: Float[np.ndarray, " N"]
    gaps: Float[np.ndarray, "N 2"]
    normals: Float[np.ndarray, "N 2 3"]
    points: Float[np.ndarray, "N 2 3"]


def soft_points(
    planes: Sequence[Float[np.ndarray, "F 4"]],
    touched: Int[np.ndarray, "N 2"],
    pads: Pads,
    poses: Poses,
    contacts: Contacts,
) -> Float[np.ndarray, "N 2 3"]:
    """Middles of the patches in which the pads touch when they give way by `SOFTNESS`, (N, 2, 3) metres.

    Two flat faces a little out of parallel touch at a corner, but a soft pad touches with much of its face.
    """
    rotation = Rotation.from_quat(poses.quaternion, scalar_first=True)
    origin = poses.origin + contacts.shift[:, None] * poses.width
    middles = contacts.points.copy()
    for finger, (face, screw, side) in enumerate(zip(pads.faces, pads.screws, pads.sides, strict=True)):
        moved = RigidTransform.from_exp_coords(np.outer(contacts.theta, np.roll(screw, 3)))
        along = rotation.apply(moved.rotation.apply(pads.axis))
        total, weighted = np.zeros(len(origin)), np.zeros((len(origin), 3))
        for point in face:
            start = origin + rotation.apply(moved.apply(point))
            for k, facets in enumerate(planes):
                rows = np.flatnonzero(touched[:, finger] == k)
                enter, leave = clipped(start[rows], along[rows], facets)
                surface = leave if side > 0 else enter
                pressed = np.maximum(side * surface + SOFTNESS, 0.0)
                surface = np.where(pressed > 0, surface, 0.0)
                total[rows] += pressed
                weighted[rows] += pressed[:, None] * (start[rows] + surface[:, None] * along[rows])
        hit = total > 0
        middles[hit, finger] = weighted[hit] / total[hit, None]
    return middles


def close_fingers(
    pieces: Sequence[ConvexBody],
    touched: Int[np.ndarray, "N 2"],
    gripper: Gripper,
    poses: Poses,
    theta: Float[np.ndarray, " N"],
    shift: Float[np.ndarray, " N"],
) -> Contacts:
    """Contacts of both pads with given pieces of the target.

    Args:
        pieces: of the target, in its frame.
        touched: which piece each finger touches.
        gripper: the gripper.
        poses: of the gripper before it gives way.
        theta, shift: to start from.
    """
    stack = ConvexBody.stack([piece.thinned(VERTICES) for piece in pieces]).padded_to(vertices=VERTICES)
    pads = gripper.fingers[np.asarray(gripper.contact)]
    count = len(theta)
    found = Contacts(
        np.array(theta), np.array(shift), np.full((count, 2), np.inf), np.zeros((count, 2, 3)), np.zeros((count, 2, 3))
    )
    pending = np.arange(count)
    for _ in range(ROUNDS):
        for begin in range(0, len(pending), BATCH):
            rows = pending[begin : begin + BATCH]
            some = np.resize(rows, BATCH)
            pair = stack[touched[some].T.reshape(-1)]
            state = (
                poses.quaternion[some],
                poses.origin[some],
                found.theta[some],
                found.shift[some],
                found.normals[some],
            )
            result = _close(pair, pads, np.asarray(gripper.screws), np.asarray(gripper.width_axis), *state)
            for all_, part in zip(found, jax.device_get(result), strict=True):
                all_[rows] = part[: len(rows)]
        pending = np.flatnonzero(~(np.abs(found.gaps) < TOLERANCE).all(axis=1))
    return found


class _State(NamedTuple):
    theta: Array
    shift: Array
    next_theta: Array
    next_shift: Array
    gaps: Array
    normals: Array
    points: Array


@jax.jit
def _close(
    pieces: ConvexBody,
    pads: ConvexBody,
    screws: Float[Array, "2 6"],
    width_axis: Float[Array, " 3"],
    quaternion: Float[Array, "N 4"],
    origin: Float[Array, "N 3"],
    theta: Float[Array, " N"],
    shift: Float[Array, " N"],
    normals: Float[Array, "N 2 3"],
) -> Contacts:
    """`STEPS` steps of Newton's method. ``pieces`` are those of finger 0 of all grasps, then those of finger 1."""
    count = quaternion.shape[0]
    finger = jnp.repeat(jnp.arange(2), count)
    pad, screw = pads[finger], screws[finger]
    width = jaxlie.SO3(quaternion) @ jnp.broadcast_to(width_axis, (count, 3))
    still = jnp.broadcast_to(jaxlie.SE3.identity().wxyz_xyz, (2 * count, 7))

    def step(_: int, state: _State) -> _State:
        theta, shift = state.next_theta, state.next_shift
        hand = jaxlie.SE3(_twice(jnp.concatenate([quaternion, origin + shift[:, None] * width], axis=1)))
        poses = (hand @ jaxlie.SE3.exp(_twice(theta)[:, None] * screw)).wxyz_xyz
        apart = separation(pieces, still, pad, poses, state.normals, thorough=False)
        x = apart.direction
        gaps = hull_gap(x, pieces, still, pad, poses)
        # Velocity of the pad's contact by θ: v + ω × r in the gripper frame.
        arm = hand.inverse() @ apart.point_b
        velocity = hand.rotation() @ (screw[:, :3] + jnp.cross(screw[:, 3:], arm))
        by_theta, by_shift = (x * velocity).sum(-1), (x * _twice(width)).sum(-1)
        (t0, t1), (s0, s1), (g0, g1) = (part.reshape(2, count) for part in (by_theta, by_shift, gaps))
        determinant = t0 * s1 - t1 * s0
        # Where the pads do not press against each other there is nothing to close on.
        presses = jnp.abs(determinant) > 0.1 * jnp.sqrt((t0**2 + s0**2) * (t1**2 + s1**2))
        safe = jnp.where(presses, determinant, 1.0)
        by = jnp.where(presses, g1 * s0 - g0 * s1, 0.0) / safe, jnp.where(presses, g0 * t1 - g1 * t0, 0.0) / safe
        return _State(theta, shift, theta + by[0], shift + by[1], gaps, x, apart.point_a)

    normals = normals.transpose(1, 0, 2).reshape(-1, 3)
    begin = _State(theta, shift, theta, shift, jnp.zeros(2 * count), normals, jnp.zeros((2 * count, 3)))
    end = jax.lax.fori_loop(0, STEPS, step, begin)
    gaps = end.gaps.reshape(2, count).T
    both = (part.reshape(2, count, 3).transpose(1, 0, 2) for part in (end.normals, end.points))
    return Contacts(end.theta, end.shift, gaps, *both)


def _twice(values: Array) -> Array:
    return jnp.concatenate([values, values])
