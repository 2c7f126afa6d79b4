"""Collisions of paths and configurations by coal, without the planner's own distances.

Bodies, pairs and allowed overlaps are those of a planner's collision model. Kinematics, culling and distances are
independent of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import RigidTransform, Rotation

from regrasp_bench.peers.coal_shapes import polytope
from regrasp_bench.peers.optional import import_peer

if TYPE_CHECKING:
    from regrasp_planner.collision.model import CollisionModel

Path = Callable[[Float[np.ndarray, " N"]], Float[np.ndarray, "N n"]]
"""Configurations (N, n), radians, at N numbers from 0 to 1."""

BODY_STEP, JOINT_STEP = 0.01, np.deg2rad(1.0)
"""Largest motion of a point of any body (metres), and of any joint (radians), between two checked configurations."""
_ROUNDING = 1e-9
_FAR = 1.0
"""Clearance (metres) that is reported where everything is further away."""


class ExactChecker:
    """Exact distances of a collision model's hulls, swept by their radii, at a finger coordinate.

    A pair collides if its distance is below 0, or below its margin if that is negative (an allowed overlap). Positive
    margins are those that a planner keeps in addition; they do not count here.

    Args:
        model: bodies, and the pairs that must not touch.
        theta: finger coordinate.

    Attributes:
        lower, upper: (n,) joint limits, radians.
        axes: (n, 3) joint axes in their own frames.
        pairs: (P, 2) numbers of the bodies of each pair.
        margin, floor: (P,) margin of each pair, and the least distance without collision, metres.

    Raises:
        BenchError: coal is not installed.
    """

    def __init__(self, model: CollisionModel, theta: float):
        self._coal: Any = import_peer("coal")
        self._set_arm(model)
        self._set_bodies(model, theta)
        self._distance_request = self._coal.DistanceRequest()
        self._distance_request.enable_signed_distance = True

    def free(self, q: Float[np.ndarray, "N n"]) -> bool:
        """Whether N configurations (radians) are all free of collisions; stops at the first that is not."""
        turn, shift = self._poses(q)
        sample, pair = np.nonzero(self._bounds(turn, shift) < 0)
        places: dict[tuple[int, int], Any] = {}
        for i, k in zip(sample.tolist(), pair.tolist(), strict=True):
            if self._collide(k, *(self._place(places, turn, shift, i, body) for body in self.pairs[k])):
                return False
        return True

    def keeps_margins(self, q: Float[np.ndarray, "N n"]) -> Bool[np.ndarray, " N"]:
        """Which of N configurations keep the whole margin of every pair, as a planner has to."""
        beyond = self.margin - self.floor
        return np.asarray((self.clearances(q, cap=float(beyond.max(initial=0.0))) >= beyond).all(axis=1))

    def clearances(self, q: Float[np.ndarray, "N n"], cap: float = 0.0) -> Float[np.ndarray, "N P"]:
        """Distances of all pairs at N configurations beyond the least allowed ones, metres.

        Pairs that are further apart than ``cap`` (at least 0, metres) may be reported as 1 m.
        """
        turn, shift = self._poses(q)
        out = np.full((len(q), len(self.pairs)), _FAR)
        places: dict[tuple[int, int], Any] = {}
        result = self._coal.DistanceResult()
        for i, k in zip(*(rows.tolist() for rows in np.nonzero(self._bounds(turn, shift) < cap)), strict=True):
            result.clear()
            a, b = (self._place(places, turn, shift, i, body) for body in self.pairs[k])
            distance = self._distance[k](a, b, self._distance_request, result)
            out[i, k] = min(distance - self.floor[k], _FAR)
        return out

    def collisions(
        self, path: Path, allowed: float | Float[np.ndarray, " P"] = 0.0, batch: int = 256
    ) -> list[tuple[str, str, float]]:
        """Names and depth (metres) of the pairs that overlap by more than ``allowed`` on a path, deepest first.

        The checked configurations are at most `BODY_STEP` and `JOINT_STEP` apart.
        """
        at = self.samples(path)
        worst = np.full(len(self.pairs), _FAR)
        for start in range(0, len(at), batch):
            worst = np.minimum(worst, self.clearances(path(at[start : start + batch])).min(axis=0))
        found = [(*self.names(k), float(-worst[k])) for k in np.flatnonzero(worst < -1e-6 - np.asarray(allowed))]
        return sorted(found, key=lambda entry: -entry[2])

    def samples(self, path: Path) -> Float[np.ndarray, " N"]:
        """Where to check a path, 0 and 1 included, so that nothing moves by more than the steps in between."""
        at = np.linspace(0.0, 1.0, 33)
        while True:
            turned = np.abs(np.diff(path(at), axis=0))
            # No point of the robot is further than the lever from the axis of any joint.
            parts = np.maximum(turned.max(axis=1) / JOINT_STEP, turned.sum(axis=1) * self._lever / BODY_STEP)
            if (parts <= 1.0).all():
                return at
            counts = np.maximum(np.ceil(parts * 1.0001).astype(int), 1)
            within = [a + (b - a) * np.arange(n) / n for a, b, n in zip(at[:-1], at[1:], counts, strict=True)]
            at = np.append(np.concatenate(within), 1.0)

    def frames(self, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N F 4 4"]:
        """World poses of links 0 … n, the gripper (n + 1), and the world (n + 2), as matrices."""
        count, dof = q.shape
        joints = np.zeros((count, dof, 4, 4))
        sin, cos = np.sin(q)[..., None, None], np.cos(q)[..., None, None]
        joints[..., :3, :3] = np.eye(3) + sin * self._cross + (1 - cos) * self._cross_squared
        joints[..., 3, 3] = 1.0
        joints = self._origins @ joints
        frames = np.empty((count, dof + 3, 4, 4))
        frames[:, 0] = self._base
        for i in range(dof):
            frames[:, i + 1] = frames[:, i] @ joints[:, i]
        frames[:, dof + 1] = frames[:, dof] @ self._tool
        frames[:, dof + 2] = np.eye(4)
        return frames

    def names(self, pair: int) -> tuple[str, str]:
        """Names of the two bodies of a pair."""
        a, b = self.pairs[pair]
        return self._body_names[a], self._body_names[b]

    # --- the model ----------------------------------------------------------------------------------------------------

    def _set_arm(self, model: CollisionModel) -> None:
        arm = model.arrays.robot.arm
        self.lower: Float[np.ndarray, " n"] = np.asarray(arm.lower, float)
        self.upper: Float[np.ndarray, " n"] = np.asarray(arm.upper, float)
        self._origins = _matrices(np.asarray(arm.origins))
        self._base, self._tool = _matrices(np.asarray(arm.base)), _matrices(np.asarray(arm.tool))
        self.axes: Float[np.ndarray, "n 3"] = np.asarray(arm.axes)
        self._cross = np.stack([np.cross(np.eye(3), axis) for axis in self.axes])
        self._cross_squared = self._cross @ self._cross

    def _set_bodies(self, model: CollisionModel, theta: float) -> None:
        arrays, robot = model.arrays, model.arrays.robot
        used = np.asarray(arrays.valid)
        listed = model.pairs[used]
        # Moving bodies first.
        mover = np.asarray(arrays.mover)
        self._bodies = np.array(sorted(np.unique(listed), key=lambda i: (mover[i] == 0, i)))
        number = np.full(len(model.body_names), -1)
        number[self._bodies] = np.arange(len(self._bodies))
        self.pairs: Int[np.ndarray, "P 2"] = np.sort(number[listed], axis=1)
        self.margin: Float[np.ndarray, " P"] = np.asarray(arrays.margin, float)[used]
        self.floor: Float[np.ndarray, " P"] = np.minimum(self.margin, 0.0)
        self._body_names = [model.body_names[i] for i in self._bodies]

        # Each body is fixed to a frame: link 0 … n, the gripper (n + 1), or the world (n + 2).
        dof, local = robot.arm.dof, _matrices(np.asarray(arrays.local_poses))
        links, palms = robot.links.batch_size, robot.gripper.palm.batch_size
        fingers = np.asarray(robot.gripper.finger_of)
        frame = np.where(mover == 0, dof + 2, dof + 1)
        frame[:links] = np.asarray(robot.link_of)
        start = links + palms
        local[:start] = np.eye(4)
        # Scipy's exponential coordinates have the rotation first.
        twists = np.roll(np.asarray(robot.gripper.screws, float) * theta, 3, axis=1)
        local[start : start + len(fingers)] = RigidTransform.from_exp_coords(twists).as_matrix()[fingers]
        self._frame, self._local = frame[self._bodies], local[self._bodies]

        shapes = [arrays.bodies[int(i)] for i in self._bodies]
        self._radius = np.array([float(shape.radius) for shape in shapes])
        corners = [shape.hull_vertices() for shape in shapes]
        low, high = (np.stack([pick(points, axis=0) for points in corners]) for pick in (np.min, np.max))
        self._center, self._half = 0.5 * (low + high), 0.5 * (high - low)
        self._set_still(int((mover[self._bodies] > 0).sum()))
        self._ball = np.linalg.norm(self._half, axis=1) + self._radius
        steps = np.linalg.norm(self._origins[:, :3, 3], axis=1).sum() + np.linalg.norm(self._tool[:3, 3])
        riding = np.linalg.norm(self._local[:, :3, 3], axis=1) + np.linalg.norm(self._center, axis=1) + self._ball
        self._lever = float(steps + riding[self._frame <= dof + 1].max())

        geometries = [polytope(points) for points in corners]
        for geometry, radius in zip(geometries, self._radius, strict=True):
            geometry.setSweptSphereRadius(radius)
        both = [(geometries[a], geometries[b]) for a, b in self.pairs]
        self._distance = [self._coal.ComputeDistance(a, b) for a, b in both]
        self._collision = [self._coal.ComputeCollision(a, b) for a, b in both]
        self._requests = [self._request(floor) for floor in self.floor]
        self._kept = geometries

    def _set_still(self, moving: int) -> None:
        """Precompute what is the same in every configuration, for the bodies that stand still."""
        self._moving, self._still = moving, np.arange(moving, len(self._bodies))
        self._fixed: Bool[np.ndarray, " P"] = self.pairs[:, 1] >= moving
        turn, shift = self._poses(np.zeros((1, len(self._origins))))
        turn, shift = turn[0, moving:], shift[0, moving:]
        center = (turn @ self._center[moving:, :, None])[..., 0] + shift
        self._axes_of_still = turn.transpose(1, 0, 2).reshape(3, -1)
        self._places_of_still = (center[:, None, :] @ turn)[:, 0].ravel()

    def _request(self, floor: float) -> Any:
        request = self._coal.CollisionRequest()
        request.security_margin = floor
        return request

    # --- a configuration ----------------------------------------------------------------------------------------------

    def _poses(self, q: Float[np.ndarray, "N n"]) -> tuple[Float[np.ndarray, "N B 3 3"], Float[np.ndarray, "N B 3"]]:
        poses = self.frames(q)[:, self._frame] @ self._local
        return poses[..., :3, :3], poses[..., :3, 3]

    def _bounds(
        self, turn: Float[np.ndarray, "N B 3 3"], shift: Float[np.ndarray, "N B 3"]
    ) -> Float[np.ndarray, "N P"]:
        """Lower bounds of positive distances, ball about one body to box about the other; negative in overlap."""
        center = (turn @ self._center[:, :, None])[..., 0] + shift
        out = np.empty((len(turn), len(self.pairs)))
        # Against still bodies, all at once: the centres along the axes of each box are one matrix product.
        still = self._still
        along = center[:, : self._moving].reshape(-1, 3) @ self._axes_of_still - self._places_of_still
        gap = np.maximum(np.abs(along) - self._half[still].ravel(), 0.0).reshape(len(turn), self._moving, len(still), 3)
        apart = np.sqrt(np.einsum("nasi,nasi->nas", gap, gap))
        a, b = self.pairs[self._fixed].T
        out[:, self._fixed] = apart[:, a, b - self._moving] - self._ball[a] - self._radius[b]
        # Among moving bodies, from both sides.
        first, second = self.pairs[~self._fixed].T
        bounds: list[Float[np.ndarray, "N S"]] = []
        for a, b in ((first, second), (second, first)):
            along = ((center[:, a] - center[:, b])[..., None, :] @ turn[:, b])[..., 0, :]
            gap = np.maximum(np.abs(along) - self._half[b], 0.0)
            bounds.append(np.sqrt(np.einsum("nsi,nsi->ns", gap, gap)) - self._ball[a] - self._radius[b])
        out[:, ~self._fixed] = np.maximum(*bounds)
        return out - _ROUNDING

    def _place(
        self,
        places: dict[tuple[int, int], Any],
        turn: Float[np.ndarray, "N B 3 3"],
        shift: Float[np.ndarray, "N B 3"],
        sample: int,
        body: int,
    ) -> Any:
        key = (sample, int(body))
        if key not in places:
            places[key] = self._coal.Transform3s(turn[key], shift[key])
        return places[key]

    def _collide(self, pair: int, place_a: Any, place_b: Any) -> bool:
        result = self._coal.CollisionResult()
        return bool(self._collision[pair](place_a, place_b, self._requests[pair], result))


def _matrices(poses: Float[np.ndarray, "*batch 7"]) -> Float[np.ndarray, "*batch 4 4"]:
    out = np.zeros((*poses.shape[:-1], 4, 4))
    flat = Rotation.from_quat(poses[..., :4].reshape(-1, 4), scalar_first=True).as_matrix()
    out[..., :3, :3] = flat.reshape(*poses.shape[:-1], 3, 3)
    out[..., :3, 3] = poses[..., 4:]
    out[..., 3, 3] = 1.0
    return out
