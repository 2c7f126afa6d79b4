"""Closing fingers against coal."""

import jaxlie
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_planner.geometry.hull import hull_planes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp.closing import TOLERANCE, Pads, Poses, close_fingers, reaches
from regrasp_planner.robot.model import Gripper

ORIGIN = np.array([1.0, 0, 0, 0, 0, 0, 0])


def drawn_poses(rng, count, spread):
    turn = Rotation.random(count, rng=rng)
    return Poses(turn.as_quat(scalar_first=True), rng.normal(size=(count, 3)) * spread, turn.apply([0, 1.0, 0]))


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_fingers_close_until_both_touch_and_lines_bound_how_far(panda, bodies, hand, coal_oracle, seed):
    rng = np.random.default_rng(seed)
    target, count = bodies.stone(seed, 30), 64
    piece, gripper, pads = target.pieces[0], panda.gripper, Pads.of(panda.gripper)
    poses = drawn_poses(rng, count, 0.008)
    travel, touched = reaches([hull_planes(piece.hull_vertices())], np.ones(count, int), pads, poses)
    hit = np.flatnonzero(np.isfinite(travel).all(axis=1))
    poses = Poses(*(leaf[hit] for leaf in poses))
    theta, shift = pads.nearly(travel[hit], 0.04)
    found = close_fingers([piece], touched[hit], gripper, poses, theta, shift)
    met = np.flatnonzero((np.abs(found.gaps) < TOLERANCE).all(axis=1))
    assert len(met) > 0.95 * len(hit) > 5
    assert (found.theta[met] > theta[met] - 1e-6).all()
    for i in met[:6]:
        pose = np.concatenate([poses.quaternion[i], poses.origin[i] + found.shift[i] * poses.width[i]])
        for body, at in hand.fingers(gripper, pose, found.theta[i]):
            assert abs(coal_oracle.distance(piece, ORIGIN, body, at)) < 1e-4


def jaws():
    """Two jaws that swing about hinges 4 cm to either side of the palm; θ is the angle of each."""
    pad = np.array([[x, y, z] for x in (-0.02, 0.02) for y in (0.0, 0.01) for z in (-0.02, 0.02)])
    screws = []
    for side in (1.0, -1.0):
        hinge, axis = np.array([0.0, 0.04 * side, -0.12]), np.array([-side, 0.0, 0.0])
        screws.append([*-np.cross(axis, hinge), *axis])
    bodies = [ConvexBody.from_vertices(pad * [1, side, 1]) for side in (1.0, -1.0)]
    return Gripper(
        palm=ConvexBody.stack(
            [ConvexBody.box((0.05, 0.12, 0.02)).transformed(jaxlie.SE3(ORIGIN - [0, 0, 0, 0, 0, 0, 0.13]))]
        ),
        fingers=ConvexBody.stack(bodies),
        finger_of=np.array([0, 1]),
        contact=np.array([0, 1]),
        screws=np.array(screws),
        lower=np.array(-0.1),
        upper=np.array(0.6),
        width_axis=np.array([0, 1.0, 0]),
        approach_axis=np.array([0, 0, 1.0]),
        max_opening=np.array(0.12),
    )


def test_swinging_jaws_close_until_both_touch(bodies, hand, coal_oracle):
    rng, gripper, target = np.random.default_rng(5), jaws(), bodies.stone(4, 30)
    pads, count = Pads.of(gripper), 128
    assert not pads.slide
    poses = drawn_poses(rng, count, 0.004)
    piece = target.pieces[0]
    travel, touched = reaches([hull_planes(piece.hull_vertices())], np.zeros(count, int), pads, poses)
    start = pads.nearly(np.where(np.isfinite(travel), travel, 0.0), float(gripper.upper))
    found = close_fingers([piece], touched, gripper, poses, *start)
    met = np.flatnonzero((np.abs(found.gaps) < TOLERANCE).all(axis=1))
    assert len(met) > 0.9 * count
    for i in met[::16]:
        pose = np.concatenate([poses.quaternion[i], poses.origin[i] + found.shift[i] * poses.width[i]])
        for body, at in hand.fingers(gripper, pose, found.theta[i]):
            assert abs(coal_oracle.distance(piece, ORIGIN, body, at)) < 1e-4
