import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.path.optimizer import bspline
from regrasp_planner.path.trajectory import Trajectory, interpolating_path, time_parametrize

VELOCITY = np.array([2.175] * 4 + [2.61] * 3)
ACCELERATION = np.array([15, 7.5, 10, 12.5, 15, 20, 20.0])


def random_path(seed):
    rng = np.random.default_rng(seed)
    return interpolating_path(np.cumsum(rng.normal(scale=0.6, size=(rng.integers(2, 9), 7)), axis=0))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 1.0), st.floats(0.1, 1.0))
def test_limits_hold_at_one_kilohertz(seed, velocity_scale, acceleration_scale):
    trajectory = time_parametrize(random_path(seed), VELOCITY, ACCELERATION, velocity_scale, acceleration_scale)
    t = np.arange(0.0, trajectory.duration, 1e-3)
    q = trajectory.at(t)
    velocity = np.diff(q, axis=0) / 1e-3
    acceleration = np.diff(q, 2, axis=0) / 1e-6
    assert (np.abs(velocity) <= VELOCITY * velocity_scale * (1 + 1e-6)).all()
    assert (np.abs(acceleration) <= ACCELERATION * acceleration_scale * (1 + 1e-4) + 1e-6).all()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_timed_motion_stays_on_the_path_and_rests_at_its_ends(seed):
    path = random_path(seed)
    trajectory = time_parametrize(path, VELOCITY, ACCELERATION)
    np.testing.assert_allclose(trajectory.start, path(0.0), atol=1e-12)
    np.testing.assert_allclose(trajectory.goal, path(1.0), atol=1e-12)
    assert np.abs(trajectory.velocities[[0, -1]]).max() == 0.0
    dense = path(np.linspace(0, 1, 20001))
    for q in trajectory.at(np.linspace(0, trajectory.duration, 97)):
        assert np.linalg.norm(dense - q, axis=1).min() < 1e-3


@pytest.mark.parametrize("distance", [0.05, 0.4, 2.5])
def test_one_joint_moves_in_the_least_possible_time(distance):
    """Rest to rest on a line the optimum is known: full acceleration, cruise at the limit, full deceleration."""
    goal = np.zeros(7)
    goal[1] = distance
    v, a = VELOCITY[1], ACCELERATION[1]
    least = 2 * np.sqrt(distance / a) if distance < v**2 / a else distance / v + v / a
    trajectory = time_parametrize(interpolating_path(np.stack([np.zeros(7), goal])), VELOCITY, ACCELERATION, 1.0, 1.0)
    assert least * (1 - 1e-6) <= trajectory.duration <= least * 1.03


def test_derivatives_belong_to_the_positions():
    trajectory = time_parametrize(random_path(3), VELOCITY, ACCELERATION)
    t = np.random.default_rng(0).uniform(0.01, trajectory.duration - 0.01, 200)
    h = 1e-6
    slope = (trajectory.at(t + h) - trajectory.at(t - h)) / (2 * h)
    np.testing.assert_allclose(trajectory.velocity_at(t), slope, atol=1e-5)
    bend = (trajectory.velocity_at(t + h) - trajectory.velocity_at(t - h)) / (2 * h)
    away = np.abs(t[:, None] - trajectory.times).min(axis=1) > 2 * h
    np.testing.assert_allclose(trajectory.acceleration_at(t)[away], bend[away], atol=1e-4)


def test_peaks_are_those_of_dense_sampling():
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.uniform(0.05, 0.3, 12))
    trajectory = Trajectory(times, rng.normal(size=(12, 3)), rng.normal(size=(12, 3)))
    limits = np.array([1.0, 2.0, 3.0])
    t = np.linspace(times[0], times[-1], 200001)
    velocity, acceleration = trajectory.peak_ratios(limits, limits)
    assert velocity == pytest.approx((np.abs(trajectory.velocity_at(t)) / limits).max(), rel=1e-3)
    assert acceleration == pytest.approx((np.abs(trajectory.acceleration_at(t)) / limits).max(), rel=1e-3)


def test_resampled_reversed_and_stretched_are_the_same_motion():
    trajectory = time_parametrize(random_path(8), VELOCITY, ACCELERATION)
    t = np.linspace(0, trajectory.duration, 50)
    even = trajectory.resampled(0.02)
    np.testing.assert_allclose(np.diff(even.times)[:-1], 0.02, atol=1e-12)
    np.testing.assert_allclose(even.at(even.times), trajectory.at(even.times), atol=1e-12)
    assert even.duration == pytest.approx(trajectory.duration)
    np.testing.assert_allclose(trajectory.reversed().at(t), trajectory.at(trajectory.duration - t), atol=1e-9)
    np.testing.assert_allclose(trajectory.stretched(2.0).at(2 * t), trajectory.at(t), atol=1e-9)


def test_outside_its_time_a_trajectory_rests_at_its_ends():
    trajectory = time_parametrize(random_path(1), VELOCITY, ACCELERATION)
    np.testing.assert_array_equal(trajectory.at(-1.0), trajectory.start)
    np.testing.assert_allclose(trajectory.at(trajectory.duration + 5), trajectory.goal, atol=1e-12)
    assert not trajectory.velocity_at(np.array([-1.0, trajectory.duration + 1])).any()


def test_a_path_of_no_length_is_a_short_rest():
    q = np.linspace(-1, 1, 7)
    trajectory = time_parametrize(bspline(np.repeat(q[None], 6, axis=0)), VELOCITY, ACCELERATION)
    np.testing.assert_allclose(trajectory.at(trajectory.duration / 2), q)


@pytest.mark.parametrize("scale", [0.0, -1.0, 1.5, np.nan])
def test_limit_scales_must_be_fractions(scale):
    with pytest.raises(ValueError, match="scales"):
        time_parametrize(random_path(0), VELOCITY, ACCELERATION, scale)


def test_malformed_trajectories_are_refused():
    with pytest.raises(ValueError, match="increase"):
        Trajectory(np.array([0.0, 0.0]), np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="needs times"):
        Trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="no two neighbours equal"):
        interpolating_path(np.zeros((3, 2)))
