"""Dense antipodal grasps of a target alone: the candidates of the oracle, computed once per target.

Nothing is optimised. Rays from many surface points give closing axes. About each axis, the gripper is turned, moved
sideways and pushed in by small steps. A dense cloud of surface points tells where the pads touch, and the exact hulls
tell whether palm and fingers keep their margins from the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import RigidTransform

from regrasp_bench.peers.coal_shapes import PosedShapes, Shape, keeps_margins
from regrasp_planner import Body, Gripper
from regrasp_planner.geometry.hull import qhull
from regrasp_planner.robot.gripper import finger_coordinate, reduce_gripper

_ROUND = 0.3
"""Contacts on a round pad are up to this share of its radius off its middle: sides slant by up to 15°."""

_TOUCH = 5e-4
"""Surface points within this distance (metres) of the touching point belong to the contact."""


@dataclass(frozen=True)
class AntipodalOptions:
    """How densely grasps are sampled, and what counts as a grasp. The last four are as in GraspGen.

    Attributes:
        rays: number of surface points with a ray to the opposite side.
        cloud: number of surface points that tell contacts.
        cone: half-angle of the friction cone, radians.
        axis_step: closing axes nearer to each other than this count as one, radians.
        angles: number of approach angles about each axis.
        across: step between positions across the fingers, metres.
        depths: number of depths, from just deep enough to as deep as the palm allows.
        quality: least f = f_anti + f_align (the paper's eq. 1–3).
        depth: least depth of the grasp centre in the target, as a share of the fingers' length beyond that centre.
        margin: margin of the open gripper from obstacles, and of its palm from the target, per metre of opening.
        finger_margin: margin of the open fingers from the target, metres.
    """

    rays: int = 1500
    cloud: int = 6000
    cone: float = 0.26
    axis_step: float = 0.1
    angles: int = 36
    across: float = 0.012
    depths: int = 5
    quality: float = 1.85
    depth: float = 0.5
    margin: float = 0.06
    finger_margin: float = 0.0005


@dataclass(frozen=True, eq=False)
class Candidates:
    """N grasps of a target that are feasible without obstacles.

    Attributes:
        rotations, positions: (N, 3, 3) and (N, 3) gripper frames in the target's frame.
        thetas: (N,) finger coordinates at which both pads touch: exact on flat sides, and too small by up to about 3 mm
            on slanting ones, where the point of first contact may lie between those of the cloud.
        openings: (N,) finger coordinates of the open gripper.
    """

    rotations: Float[np.ndarray, "N 3 3"]
    positions: Float[np.ndarray, "N 3"]
    thetas: Float[np.ndarray, " N"]
    openings: Float[np.ndarray, " N"]


class GripperShapes:
    """A gripper's bodies as exact shapes, at any finger coordinate."""

    def __init__(self, gripper: Gripper) -> None:
        palms = [gripper.palm[i] for i in range(gripper.palm.batch_size)]
        fingers = [gripper.fingers[i] for i in range(gripper.fingers.batch_size)]
        self.shapes = [Shape.of(body) for body in (*palms, *fingers)]
        self.palms = len(palms)
        screws = np.asarray(gripper.screws)[np.asarray(gripper.finger_of)]
        # Scipy's exponential coordinates have the rotation first.
        self._twists = np.concatenate([np.zeros((self.palms, 6)), np.roll(screws, 3, axis=1)])

    def at(
        self,
        rotations: Float[np.ndarray, "N 3 3"],
        positions: Float[np.ndarray, "N 3"],
        thetas: Float[np.ndarray, " N"],
    ) -> PosedShapes:
        """The bodies at N poses of the gripper frame and N finger coordinates."""
        count = len(self.shapes)
        local = RigidTransform.from_exp_coords((thetas[:, None, None] * self._twists).reshape(-1, 6))
        shifts = local.translation.reshape(-1, count, 3) @ np.swapaxes(rotations, 1, 2)
        turns = rotations[:, None] @ local.rotation.as_matrix().reshape(-1, count, 3, 3)
        return PosedShapes(self.shapes, turns, positions[:, None] + shifts)


def sample_grasps(target: Body, gripper: Gripper, options: AntipodalOptions | None = None) -> Candidates:
    """All grasps of a dense grid that hold the target with palm and fingers clear of it.

    Each stands for itself and for the one with the fingers exchanged (a half turn about the approach axis), which
    occupies the same space.

    Args:
        target: convex pieces in the target's frame.
        gripper: a gripper that this half turn leaves unchanged.
        options: see `AntipodalOptions`.
    """
    options = options or AntipodalOptions()
    rng = np.random.default_rng(0)
    surface = _Surface(target)
    axes = _closing_axes(surface, rng, float(gripper.max_opening), options)
    if any(float(gripper.fingers[int(k)].radius) > 0 for k in gripper.contact):
        # Round pads can also hold a corner.
        axes = _spread(np.concatenate([axes, surface.normals]), options.axis_step)
    cloud = surface.cloud(rng, options.cloud)
    parts = [_about_axis(axis, cloud, surface, gripper, options) for axis in axes]
    frame = np.stack([np.asarray(gripper.width_axis), np.asarray(gripper.approach_axis)], axis=1)
    frame = np.column_stack([frame, np.cross(frame[:, 0], frame[:, 1])])
    if not parts:
        return Candidates(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    axes_of, positions, thetas = (np.concatenate(column) for column in zip(*parts, strict=True))
    rotations = axes_of @ frame.T
    spread = options.margin * float(gripper.max_opening) * reduce_gripper(gripper).travel
    opened = np.minimum(thetas + spread, float(gripper.upper))
    shapes = GripperShapes(gripper)
    margins = np.full((len(shapes.shapes), len(target.pieces)), options.finger_margin)
    margins[: shapes.palms] = options.margin * float(gripper.max_opening)
    pieces = [Shape.of(piece) for piece in target.pieces]
    still = PosedShapes(pieces, np.tile(np.eye(3), (len(pieces), 1, 1)), np.zeros((len(pieces), 3)))
    free = keeps_margins(shapes.at(rotations, positions, opened), still, margins)
    return Candidates(rotations[free], positions[free], thetas[free], opened[free])


class _Surface:
    """The boundary of a union of convex pieces."""

    def __init__(self, target: Body) -> None:
        self.center_of_mass = np.asarray(target.center_of_mass, float)
        self.hulls = [qhull(piece.hull_vertices()) for piece in target.pieces]
        self.planes = [hull.equations for hull in self.hulls]
        self.normals = np.concatenate([planes[:, :3] for planes in self.planes])

    def depth(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
        """Depth of points in the piece in which they are deepest, metres; negative outside."""
        return np.max([-(points @ e[:, :3].T + e[:, 3]).max(1) for e in self.planes], axis=0)

    def cloud(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "N 3"]:
        """Points spread over the boundary, and all its corners."""
        points, _ = self.sample(rng, count)
        corners = np.concatenate([hull.points[hull.vertices] for hull in self.hulls])
        return np.concatenate([points, corners[self.depth(corners) < 1e-6]])

    def sample(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) points, uniform by area, and (N, 3) outward normals, without those inside another piece."""
        triangles = np.concatenate([hull.points[hull.simplices] for hull in self.hulls])
        normals = np.concatenate([hull.equations[:, :3] for hull in self.hulls])
        areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
        chosen = rng.choice(len(triangles), count, p=areas / areas.sum())
        weights = rng.dirichlet(np.ones(3), count)
        points = np.einsum("nk,nki->ni", weights, triangles[chosen])
        # Rays from the middles of the facets find the exact pairs of facets.
        points = np.concatenate([points, triangles.mean(1)])
        chosen = np.concatenate([chosen, np.arange(len(triangles))])
        out = self.depth(points) < 1e-6
        return points[out], normals[chosen[out]]

    def opposite(self, points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) at which rays into the target leave it for good, and outward normals there (N, 3)."""
        best, normal = np.zeros(len(points)), np.zeros((len(points), 3))
        for e in self.planes:
            speed = directions @ e[:, :3].T
            height = points @ e[:, :3].T + e[:, 3]
            time = -height / np.where(np.abs(speed) < 1e-12, 1e-12, speed)
            leave = np.where(speed > 1e-12, time, np.inf)
            enter = np.where(speed < -1e-12, time, -np.inf).max(1)
            facet = leave.argmin(1)
            exits = leave[np.arange(len(points)), facet]
            hit = (enter < exits) & (exits > best)
            best[hit], normal[hit] = exits[hit], e[facet[hit], :3]
        return best, normal


def _closing_axes(
    surface: _Surface, rng: np.random.Generator, opening: float, options: AntipodalOptions
) -> Float[np.ndarray, "m 3"]:
    """Axes of antipodal pairs, and axes halfway between their normals."""
    points, normals = surface.sample(rng, options.rays)
    width, far = surface.opposite(points, -normals)
    taken = (width > 0) & (width < opening) & ((-normals * far).sum(1) > np.cos(options.cone))
    between = far[taken] - normals[taken]
    axes = np.concatenate([-normals[taken], between / np.linalg.norm(between, axis=1, keepdims=True)])
    return _spread(axes, options.axis_step)


def _spread(axes: Float[np.ndarray, "m 3"], step: float) -> Float[np.ndarray, "k 3"]:
    """The first of any axes that are nearer to each other than ``step`` radians."""
    chosen: list[np.ndarray] = []
    for axis in axes:
        if all(abs(axis @ other) < np.cos(step) for other in chosen):
            chosen.append(axis)
    return np.array(chosen).reshape(-1, 3)


def _about_axis(
    axis: np.ndarray, cloud: np.ndarray, surface: _Surface, gripper: Gripper, options: AntipodalOptions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames (axis, approach, across), grasp centres and finger coordinates about one closing axis."""
    reduced = reduce_gripper(gripper)
    approach_axis, width_axis = np.asarray(gripper.approach_axis), np.asarray(gripper.width_axis)
    sideways = np.cross(width_axis, approach_axis)
    corners = _pad(gripper, float(finger_coordinate(gripper, np.ptp(cloud @ axis))))
    pad_low, pad_high = (corners @ approach_axis).min(), (corners @ approach_axis).max()
    pad_half = np.abs(corners @ sideways).max()
    palm = np.abs(np.asarray(gripper.palm[0].hull_vertices()) @ sideways).max()
    palm_middle = float(np.asarray(gripper.palm[0].hull_vertices()).mean(0) @ approach_axis)
    clearance = options.margin * float(gripper.max_opening)
    least = options.depth * reduced.tip_length
    first = np.linalg.svd(axis[None])[2][1]
    second = np.cross(axis, first)
    frames: list[np.ndarray] = []
    centers: list[np.ndarray] = []
    thetas: list[float] = []
    level = cloud @ axis
    for turn in np.arange(options.angles) * (2 * np.pi / options.angles):
        approach = np.cos(turn) * first + np.sin(turn) * second
        across = np.cross(axis, approach)
        along, side = cloud @ approach, cloud @ across
        for offset in _steps(side.min() + 0.5 * pad_half, side.max() - 0.5 * pad_half, options.across):
            lane = np.abs(side - offset) < pad_half
            wide = np.abs(side - offset) < palm + clearance
            if lane.sum() < 4:
                continue
            near = along[lane].min()
            deepest = along[wide].min() + reduced.finger_length - clearance - 2e-4
            for depth in np.linspace(near + least, min(deepest, along[lane].max() - least), options.depths):
                touched = lane & (along > depth + pad_low) & (along < depth + pad_high)
                if touched.sum() < 4:
                    continue
                high, low = level[touched].max(), level[touched].min()
                theta = float(finger_coordinate(gripper, high - low))
                if theta >= float(gripper.upper) or theta <= float(gripper.lower):
                    continue
                center = 0.5 * (high + low) * axis + depth * approach + offset * across
                line = cloud[touched & (level > high - _TOUCH)].mean(0) - cloud[touched & (level < low + _TOUCH)].mean(
                    0
                )
                towards = surface.center_of_mass - (center + palm_middle * approach)
                quality = 1 + line @ axis / np.linalg.norm(line) - 0.5 * (axis @ towards) ** 2 / (towards @ towards)
                if quality >= options.quality:
                    frames.append(np.column_stack([axis, approach, across]))
                    centers.append(center)
                    thetas.append(theta)
    if not frames:
        return np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0)
    deep = surface.depth(np.array(centers)) >= least - 1e-9
    return np.array(frames)[deep], np.array(centers)[deep], np.array(thetas)[deep]


def _pad(gripper: Gripper, theta: float) -> Float[np.ndarray, "N 3"]:
    """Corners of a pad's face in the gripper frame; of a round pad, as far round as a slanting side touches it."""
    pad = gripper.fingers[int(gripper.contact[0])]
    corners, radius = pad.hull_vertices(), float(pad.radius)
    if radius > 0:
        corners = (corners[:, None] + _ROUND * radius * np.vstack([np.eye(3), -np.eye(3)])).reshape(-1, 3)
    twist = np.roll(np.asarray(gripper.screws)[0], 3)
    return RigidTransform.from_exp_coords(theta * twist).apply(corners)


def _steps(low: float, high: float, step: float) -> Float[np.ndarray, " n"]:
    """Evenly spaced positions at most a step apart, ends and middle included."""
    if high <= low:
        return np.array([0.5 * (low + high)])
    return np.linspace(low, high, 2 * int(np.ceil(0.5 * (high - low) / step)) + 1)
