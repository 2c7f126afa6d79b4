"""A Panda-like robot built from published figures, so that the planner's tests need no simulator."""

from types import SimpleNamespace

import jaxlie
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.pose import rigid
from regrasp_planner.robot.model import Arm, Gripper, Robot
from regrasp_planner.task import Body, Obstacle, ReleaseArea, Scene, Task

HALF_PI = np.pi / 2


def pose(xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)):
    """Pose (7,) from a translation and roll, pitch, yaw."""
    quaternion = Rotation.from_euler("xyz", rpy).as_quat(scalar_first=True)
    return np.concatenate([quaternion, np.asarray(xyz, float)])


def panda_arm():
    """Joint origins, limits, velocities and accelerations of franka_ros (Apache-2.0)."""
    origins = [
        pose((0, 0, 0.333)),
        pose(rpy=(-HALF_PI, 0, 0)),
        pose((0, -0.316, 0), (HALF_PI, 0, 0)),
        pose((0.0825, 0, 0), (HALF_PI, 0, 0)),
        pose((-0.0825, 0.384, 0), (-HALF_PI, 0, 0)),
        pose(rpy=(HALF_PI, 0, 0)),
        pose((0.088, 0, 0), (HALF_PI, 0, 0)),
    ]
    return Arm(
        origins=np.array(origins),
        axes=np.tile([0.0, 0.0, 1.0], (7, 1)),
        lower=np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]),
        upper=np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]),
        max_velocity=np.array([2.175] * 4 + [2.61] * 3),
        max_acceleration=np.array([15, 7.5, 10, 12.5, 15, 20, 20.0]),
        base=pose(),
        tool=pose((0, 0, 0.107 + 0.1034), (0, 0, -np.pi / 4)),
        joint_names=tuple(f"joint{i}" for i in range(1, 8)),
    )


def _capsule(radius, length, xyz, rpy=(0.0, 0.0, 0.0)):
    return ConvexBody.capsule(radius, length, jaxlie.SE3(pose(xyz, rpy)))


def panda_robot():
    """Arm, capsules on its links, and a parallel gripper of boxes."""
    along_x, along_y = (0, HALF_PI, 0), (HALF_PI, 0, 0)
    turn = jaxlie.SE3(pose(rpy=(0, 0, np.pi / 4)))
    links = [
        (0, _capsule(0.06, 0.03, (-0.075, 0, 0.06), along_x)),
        (1, _capsule(0.06, 0.283, (0, 0, -0.1915))),
        (2, _capsule(0.06, 0.12, (0, 0, 0))),
        (3, _capsule(0.06, 0.15, (0, 0, -0.145))),
        (4, _capsule(0.06, 0.12, (0, 0, 0))),
        (5, _capsule(0.06, 0.10, (0, 0, -0.26))),
        (5, _capsule(0.025, 0.14, (0, 0.08, -0.13))),
        (6, _capsule(0.05, 0.08, (0, 0, -0.03))),
        (7, _capsule(0.04, 0.14, (0, 0, 0.01)).transformed(turn)),
    ]
    tip = 0.1034
    palm = [_capsule(0.03, 0.1, (0, 0, 0.03 - tip), along_y), _capsule(0.02, 0.1, (0, 0, 0.05 - tip), along_y)]
    pad = 0.0584 + 0.04525 - tip
    fingers = [ConvexBody.box((0.0175, 0.0152, 0.0185), jaxlie.SE3(pose((0, side * 0.0076, pad)))) for side in (1, -1)]
    bodies = 9 + 2
    moving = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 5, 6: 5, 7: 6, 8: 7, 9: 8, 10: 8}
    pairs = [(a, b) for a in range(bodies) for b in range(a) if abs(moving[a] - moving[b]) > 2]
    return Robot(
        arm=panda_arm(),
        gripper=Gripper(
            palm=ConvexBody.stack(palm),
            fingers=ConvexBody.stack(fingers),
            finger_of=np.array([0, 1]),
            contact=np.array([0, 1]),
            screws=np.array([[0, 1.0, 0, 0, 0, 0], [0, -1.0, 0, 0, 0, 0]]),
            lower=np.array(0.0),
            upper=np.array(0.04),
            width_axis=np.array([0, 1.0, 0]),
            approach_axis=np.array([0, 0, 1.0]),
            max_opening=np.array(0.08),
        ),
        links=ConvexBody.stack([body for _, body in links]),
        link_of=np.array([link for link, _ in links]),
        self_pairs=np.array(pairs),
        home=np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, HALF_PI, np.pi / 4]),
        name="panda-like",
    )


def box_obstacle(name, size, xyz, rpy=(0.0, 0.0, 0.0)):
    return Obstacle(Body(name, (ConvexBody.box(size),), np.zeros(3)), pose(xyz, rpy))


def shelf_scene(seed=0, clutter=5):
    """A table, a two-board shelf and boxes and prisms on the table."""
    rng = np.random.default_rng(seed)
    obstacles = [
        box_obstacle("table", (1.2, 1.6, 0.04), (0.4, 0, -0.03)),
        box_obstacle("shelf board", (0.3, 0.8, 0.02), (0.65, 0, 0.35)),
        box_obstacle("shelf roof", (0.3, 0.8, 0.02), (0.65, 0, 0.75)),
        box_obstacle("shelf back", (0.02, 0.8, 0.42), (0.81, 0, 0.55)),
    ]
    angles = 2 * np.pi * np.arange(12) / 12
    for i in range(clutter):
        at = (*rng.uniform([0.3, -0.45], [0.6, 0.45]), 0.06)
        if i % 2:
            size = (*rng.uniform(0.04, 0.1, 2), 0.12)
            obstacles.append(box_obstacle(f"box{i}", size, at, (0, 0, rng.uniform(0, np.pi))))
        else:
            radius = rng.uniform(0.025, 0.04)
            ring = radius * np.stack([np.cos(angles), np.sin(angles)], 1)
            prism = np.concatenate([np.column_stack([ring, np.full(12, z)]) for z in (-0.06, 0.06)])
            obstacles.append(Obstacle(Body(f"can{i}", (ConvexBody.from_vertices(prism),), np.zeros(3)), pose(at)))
    return tuple(obstacles)


BRICK_SIZE = np.array([0.04, 0.05, 0.12])


def lying_brick(x, y, yaw, upside_down=False):
    """Pose of the brick lying on the table on one of its larger sides, or on the opposite one."""
    return pose((x, y, BRICK_SIZE[1] / 2), (-HALF_PI if upside_down else HALF_PI, 0, yaw))


@pytest.fixture(scope="session")
def panda():
    return panda_robot()


@pytest.fixture(scope="session")
def build():
    """The functions that make poses, obstacles and scenes."""
    return SimpleNamespace(pose=pose, box_obstacle=box_obstacle, shelf_scene=shelf_scene, lying_brick=lying_brick)


@pytest.fixture(scope="session")
def make_task(build, panda):
    """Tasks that move a brick lying on a table."""
    brick = Body("brick", (ConvexBody.box(BRICK_SIZE),), np.zeros(3), 0.3)

    def make(goal, target=brick, start=None):
        # Below the base, so that the arm's lowest capsule is clear of it.
        table = build.box_obstacle("table", (1.0, 1.6, 0.04), (0.65, 0, -0.02))
        return Task(
            target=target,
            pick=Scene("pick", build.lying_brick(0.5, -0.25, 0.3), (table,)),
            place=Scene("place", np.asarray(goal, float), (table,)),
            release=ReleaseArea(np.array([0.5, 0.0, 0.0]), np.array([0.14, 0.12])),
            start=np.asarray(panda.home if start is None else start, float),
            supports=frozenset({"table"}),
        )

    return make


@pytest.fixture(scope="session")
def flipped_task(make_task, build):
    """The brick has to lie on the opposite side: what was below is above."""
    return make_task(build.lying_brick(0.5, 0.25, 0.3, upside_down=True))


class CoalOracle:
    """Distances of bodies by coal, metres."""

    def __init__(self):
        import coal

        self._coal, self._shapes = coal, {}

    def shape(self, body):
        """The hull of a body without its sweep."""
        vertices = body.hull_vertices()
        key = vertices.tobytes()
        if key not in self._shapes:
            points, triangles = self._coal.StdVec_Vec3s(), self._coal.StdVec_Triangle()
            points.extend(list(vertices))
            simplices = ConvexHull(vertices).simplices
            triangles.extend([self._coal.Triangle(*map(int, simplex)) for simplex in simplices])
            self._shapes[key] = self._coal.Convex(points, triangles)
        return self._shapes[key]

    def placed(self, turn, position):
        return self._coal.Transform3s(turn, position)

    def gap(self, first, first_at, second, second_at):
        """Distance of two shapes, 0 or less if they overlap."""
        request, result = self._coal.DistanceRequest(), self._coal.DistanceResult()
        return self._coal.distance(first, first_at, second, second_at, request, result)

    def distance(self, first, first_pose, second, second_pose):
        """Signed distance of two bodies."""
        request, result = self._coal.DistanceRequest(), self._coal.DistanceResult()
        request.enable_signed_distance = True
        self._distance(first, first_pose, second, second_pose, request, result)
        return result.min_distance - float(first.radius) - float(second.radius)

    def nearest_points(self, first, first_pose, second, second_pose):
        """The nearest points of two bodies that are apart."""
        result = self._coal.DistanceResult()
        self._distance(first, first_pose, second, second_pose, self._coal.DistanceRequest(), result)
        return result.getNearestPoint1(), result.getNearestPoint2()

    def normal(self, *pair):
        """Unit normal from the first body to the second, which have to be apart."""
        one, two = self.nearest_points(*pair)
        return (two - one) / np.linalg.norm(two - one)

    def _distance(self, first, first_pose, second, second_pose, request, result):
        at = [self.placed(rigid(p).rotation.as_matrix(), np.asarray(p)[4:]) for p in (first_pose, second_pose)]
        self._coal.distance(self.shape(first), at[0], self.shape(second), at[1], request, result)


@pytest.fixture(scope="session")
def coal_oracle():
    """Distances by coal."""
    return CoalOracle()
