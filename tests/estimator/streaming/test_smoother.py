"""Smoothing: the best linear estimate from all measurements, and as sure as it may be."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.linalg import block_diag

from conftest import holed
from icreckon import FixSpec, Scenario, changed_robot, load_robot, run, simulate, smooth
from icreckon.estimator.base import state as s
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.measurements import BodyVelocity, PoseFix, ZeroVelocity
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import FixSeries
from icreckon.estimator.streaming import smoother

ALPHA = load_robot("auriga-alpha")
START = {"start": (0.1, -0.1, 0.05), "start_sigma": (0.1, 0.1, 0.05)}


@pytest.fixture(scope="module")
def log():
    """Half a minute, with fixes at both ends of an outage."""
    scenario = Scenario(
        duration=30.0, seed=9, trajectory="slalom", track_rate=25.0, imu_rate=50.0, truth_rate=10.0,
        outages=((8.0, 26.0),),
    )  # fmt: skip
    return simulate(scenario, ALPHA)


@pytest.fixture(scope="module")
def both(log):
    return smooth(log, ALPHA, "inertia-online", **START)


def errors(one, log, begin, end):
    """(n, 3) errors of the pose between two times [s]."""
    stamps = log.truth.poses.stamps
    seconds = (stamps - log.start) * 1e-9
    stamps = stamps[(seconds >= begin) & (seconds <= end)]
    found = interpolate_poses(one.trajectory.pose_series, stamps)
    apart = found - interpolate_poses(log.truth.poses, stamps)
    apart[:, 2] = wrap_angle(apart[:, 2])
    return apart


def test_the_forward_pass_is_the_filter_itself(log, both):
    """To rounding: the smoother observes each part of a step, a run takes it as a whole."""
    plain, found = run(log, ALPHA, "inertia-online", **START), both.filtered
    unit = np.where(plain.state_sigmas > 0.0, plain.state_sigmas, 1.0)
    assert (np.abs(plain.states - found.states) < 1e-9 * unit).all()
    assert found.state_sigmas == pytest.approx(plain.state_sigmas, rel=1e-9, abs=1e-14)
    assert found.indices == pytest.approx(plain.indices, rel=1e-9)
    assert (plain.stamps == found.stamps).all()
    for name in ("pose_covariances", "twists", "twist_covariances"):
        one, other = getattr(plain.trajectory, name), getattr(found.trajectory, name)
        assert other == pytest.approx(one, rel=1e-7, abs=1e-12)
    assert found.health == both.smoothed.health
    assert found.health.rejections() == plain.health.rejections()
    for name, sensor in plain.health.sensors.items():
        other = found.health.sensors[name]
        assert (sensor.used, sensor.degrees) == (other.used, other.degrees)
        assert sensor.nis_sum == pytest.approx(other.nis_sum, rel=1e-9)
    assert (both.smoothed.stamps == plain.stamps).all()
    assert both.smoothed.variant == "inertia-online-smoothed"


def test_the_path_through_an_outage_is_tied_to_the_fixes_at_both_ends(log, both):
    before, after = (errors(one, log, 12.0, 26.0) for one in both)
    rms = [np.sqrt(np.mean(each**2, axis=0)) for each in (before, after)]
    assert np.hypot(*rms[1][:2]) < 0.5 * np.hypot(*rms[0][:2])


def test_all_rows_hold_together(both):
    after = both.smoothed
    assert (after.trajectory.poses == after.states[:, s.POSE]).all()
    variances = np.diagonal(after.trajectory.pose_covariances, axis1=1, axis2=2)
    assert after.state_sigmas[:, s.POSE] == pytest.approx(np.sqrt(variances), rel=1e-12)
    # A path without jumps: it is driven with the twist that stands beside it.
    dt = np.diff(after.stamps)[:, None] * 1e-9
    steps = np.diff(after.trajectory.poses, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    speeds = np.hypot(after.trajectory.twists[1:, 0], after.trajectory.twists[1:, 1])
    assert lengths == pytest.approx(speeds * dt[:, 0], abs=1e-3)
    assert steps[:, 2] == pytest.approx(after.trajectory.twists[1:, 2] * dt[:, 0], abs=1e-2)


class _Sources(smoother._Tape):
    """Notes the error of the filter's state as a sum of independent sources.

    These are the start, the noise of each step, each fast slip, and the noise of each measurement.
    """

    def __init__(self, ekf, fastest):
        super().__init__(ekf, fastest)
        self.covariances, self.error = [], np.zeros((s.SIZE, 0))
        self.seen, self.errors = [], []
        self._add(ekf.P.copy(), np.eye(s.SIZE))

    def _add(self, covariance, entry):
        self.covariances.append(covariance)
        self.error = np.hstack([self.error, entry])

    def moved(self, step):
        super().moved(step)
        self.error = step.F @ self.error
        self._add(step.Q.copy(), np.eye(s.SIZE))

    def renewed(self, covariance):
        super().renewed(covariance)
        self.error[s.FAST_SLIP] = 0.0
        self._add(covariance.copy(), np.eye(s.SIZE)[:, s.FAST_SLIP])

    def inflated(self, states, covariance, yaw=None):
        super().inflated(states, covariance, yaw)
        self._add(covariance.copy(), np.eye(s.SIZE)[:, list(states)])

    def updated(self, change):
        super().updated(change)
        self._add(np.array([[change.r]]), np.zeros((s.SIZE, 1)))
        innovation = change.h @ self.error
        innovation[-1] = 1.0
        self.error = self.error - np.outer(change.gain, innovation)
        self.seen.append((innovation, change.z, s.X not in change.fixed))

    def record_row(self, track_speeds):
        super().record_row(track_speeds)
        self.errors.append((self.error.copy(), len(self.seen)))

    def solve(self):
        """Yield errors (SIZE,) and covariances at the rows, by each later fix of the pose in turn."""
        of_sources = block_diag(*self.covariances)
        count = len(of_sources)
        seen = [(padded(row, count), *others) for row, *others in self.seen]
        for error, so_far in self.errors:
            error, mean = padded(error, count), np.zeros(s.SIZE)
            for row, z, moves_pose in seen[so_far:]:
                if moves_pose:
                    gain = error @ of_sources @ row / (row @ of_sources @ row)
                    error, mean = error - np.outer(gain, row), mean + gain * z
            yield mean, error @ of_sources @ error.T

    def solve_at_once(self):
        """Yield errors (SIZE,) and covariances at the rows, given all measurements: least squares."""
        of_sources = block_diag(*self.covariances)
        H = np.array([padded(row, len(of_sources)) for row, _, _ in self.seen])
        y = np.array([z for _, z, _ in self.seen])
        gain = np.linalg.solve(H @ of_sources @ H.T, H @ of_sources).T
        covariance = of_sources - gain @ H @ of_sources
        for error, _ in self.errors:
            error = padded(error, len(of_sources))
            yield error @ gain @ y, error @ covariance @ error.T


def padded(rows, count):
    """Rows (..., count) with zeros for the sources after them."""
    return np.concatenate([rows, np.zeros((*rows.shape[:-1], count - rows.shape[-1]))], axis=-1)


def said(begin, poses):
    """Further measurements: at a stamp of the IMU, and between two."""
    covariance = ((4e-4, 1e-4, 0.0), (1e-4, 4e-4, 1e-4), (0.0, 1e-4, 1e-3))
    at = begin + np.array([240, 390, 450, 530]) * 10**6
    return (
        ZeroVelocity(int(at[0]), (1.0, 0.5, 0.7)),
        PoseFix(int(at[1]), *poses[2].tolist(), covariance),
        BodyVelocity(int(at[2]), 0.3, 0.0, 0.04),
        ZeroVelocity(int(at[3]), (1.0, 0.5, 0.7)),
    )


@pytest.mark.parametrize("variant", ["constant-online", "inertia-online"])
@pytest.mark.parametrize("kinds", ["tracks", "IMU", "all"])
def test_smoothed_is_the_solution_by_brute_force(variant, kinds, log, monkeypatch):
    """A second of slalom with fixes. Without an IMU all gains are optimal: it is least squares."""
    made = []

    def noted(ekf, fastest):
        made.append(_Sources(ekf, fastest))
        return made[-1]

    begin = log.start + 5 * 10**9
    stamps = begin + np.array([50, 220, 390, 560], dtype=np.int64) * 10**6
    poses = interpolate_poses(log.truth.poses, stamps)
    short = replace(
        log.between(begin, begin + 6 * 10**8 - 1),
        truth=None,
        fixes=FixSeries(stamps, poses, np.tile([1e-4, 1e6], (4, 1))),
        others=said(begin, poses) if kinds == "all" else (),
    )
    if kinds == "tracks":
        short = replace(short, imu=None)
    start = tuple(interpolate_poses(log.truth.poses, np.array([begin]))[0].tolist())
    monkeypatch.setattr(smoother, "_Tape", noted)
    before, after = smooth(short, ALPHA, variant, start=start, start_sigma=(0.1, 0.1, 0.2))
    assert before.health.sensors["position"].used == 4
    assert sum(before.health.rejections().values()) == 0
    assert ("pose" in before.health.sensors) is (kinds == "all")
    solutions = [made[0].solve()] + [made[0].solve_at_once()] * (kinds == "tracks")
    for solution in solutions:
        for row, (mean, covariance) in enumerate(solution):
            scale = np.sqrt(np.maximum(covariance.diagonal(), 1e-30))
            apart = after.states[row] - before.states[row] - mean
            assert np.abs(apart / scale)[scale > 1e-9].max() < 1e-6
            assert after.state_sigmas[row] == pytest.approx(scale, rel=1e-6, abs=1e-8)
            assert after.trajectory.pose_covariances[row] == pytest.approx(
                covariance[s.POSE, s.POSE], rel=1e-6, abs=1e-12
            )


def test_the_smoothed_yaw_is_as_sure_as_it_may_be():
    """Of a robot whose gyro may have a scale, with precise fixes."""
    changes = {"imu.gyro_scale_sigma": 0.003, "imu.gyro_noise_density": 1e-4}
    robot = changed_robot(ALPHA, changes)
    fixes, rates = FixSpec(sigma=0.02), {"track_rate": 25.0, "imu_rate": 50.0, "fix_rate": 5.0}
    scenario = Scenario(duration=40.0, seed=1, noise="industrial", fixes=fixes, **rates)
    drive = simulate(scenario, robot)
    runs = smooth(drive, robot, "inertia-online")
    before, after = (np.sqrt(np.mean(errors(one, drive, 10.0, 38.0)[:, 2] ** 2)) for one in runs)
    sigma = runs.smoothed.state_sigmas[:, s.YAW]
    assert after < before
    assert after < 1.5 * sigma.mean()


def test_after_the_last_fix_a_smoothed_estimate_is_that_of_the_filter(log):
    before, after = smooth(replace(log, fixes=None, truth=None), ALPHA, "inertia-online")
    np.testing.assert_allclose(after.states, before.states, rtol=1e-12, atol=1e-12)


def test_an_accelerometer_that_reads_too_much_does_not_stretch_the_path(log):
    """Fixed parameters, as the track scale, stay without fixes, as in the filter."""
    imu = log.imu
    forces = imu.linear_acceleration * [1.3, 1.3, 1.0]
    alone = replace(log, fixes=None, truth=None, imu=replace(imu, linear_acceleration=forces))
    robot = changed_robot(ALPHA, {"tracks.scale_sigma": 0.1})
    before, after = smooth(alone, robot, "inertia-online")
    fixed = [s.TRACK_SCALE, s.PARAMETERS.start + 1, s.PARAMETERS.start + 3]
    np.testing.assert_allclose(after.states[:, fixed], before.states[:, fixed], atol=1e-9)
    ways = [
        np.hypot(*np.diff(one.trajectory.poses[:, :2], axis=0).T).sum() for one in (before, after)
    ]
    assert ways[1] == pytest.approx(ways[0], rel=0.03)


def test_where_the_heading_is_lost_nothing_is_smoothed_across():
    scenario = Scenario(
        duration=60.0, seed=9, trajectory="slalom", track_rate=25.0, imu_rate=50.0,
        fixes=FixSpec(heading_sigma=0.02), outages=((14.0, 53.0),),
    )  # fmt: skip
    whole = simulate(scenario, ALPHA)
    hole = (whole.start + round(one * 1e9) for one in (15.0, 50.0))
    before, after = smooth(holed(whole, *hole), ALPHA, "inertia-online")
    lost = before.state_sigmas[:, s.YAW] > 1.1 * smoother.LOST_YAW
    assert lost.any()
    assert (after.trajectory.poses[lost] == before.trajectory.poses[lost]).all()
    assert np.isfinite(after.states).all()
    assert (after.state_sigmas >= 0.0).all()
    # What was before is smoothed all the same.
    filtered, smoothed = (errors(one, whole, 5.0, 14.0) for one in (before, after))
    assert np.hypot(*smoothed.T[:2]).mean() < np.hypot(*filtered.T[:2]).mean()


def test_smoothed_parameters_are_inside_their_bounds(log):
    """Of a robot that turns almost as an ideal differential drive would."""
    robot = msgspec.structs.replace(ALPHA, constant_icr=None)
    wide = changed_robot(robot, {"vehicle.track_gauge": 1.4, "indices.eta0": 1.01})
    before, after = smooth(log, wide, "constant-online", **START)
    assert before.states[:, s.ETA0].min() < 1.0 + 1e-9, "or there is nothing to see here"
    assert after.states[:, s.ETA0].min() >= 1.0 - 1e-9


def test_standing_still_is_as_certain_as_can_be():
    scenario = Scenario(duration=12.0, seed=2, trajectory="stop-and-go", fix_rate=0.0)
    before, after = smooth(simulate(scenario, ALPHA), ALPHA, "inertia-online")
    assert before.health.standstill_updates > 50
    assert np.isfinite(after.states).all()
    # To the accelerometers fixed parameters are noise, and to the filter consider states. So are slopes
    # to the gyro, which shows in the first micrometres after a stop.
    slack = np.full(s.SIZE, 1e-12)
    slack[s.POSE] = 1e-7
    assert (after.state_sigmas <= before.state_sigmas * (1.0 + 1e-3) + slack).all()
