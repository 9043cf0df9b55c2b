"""Running a filter over a log is feeding it by hand and writing down what it says."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from icreckon import VARIANTS, Comparison, Log, PoseEstimator, Scenario, load_robot, run, simulate
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.series import ImuSeries, TrackSpeedSeries
from icreckon.estimator.streaming.smoother import smooth

ALPHA = load_robot("auriga-alpha")


@pytest.fixture(scope="module")
def log():
    return simulate(Scenario(duration=10.0, seed=3, trajectory="aggressive"), ALPHA)


@pytest.fixture(scope="module")
def result(log):
    return run(log, ALPHA, "inertia-online", start=(1.0, 2.0, 0.5), start_sigma=(0.1, 0.1, 0.05))


def test_a_rejected_fix_shows_as_far_off(log):
    poses = log.fixes.poses.copy()
    poses[5, :2] += 50.0
    found = run(replace(log, fixes=replace(log.fixes, poses=poses)), ALPHA, "inertia-online")
    x = found.innovations[:, found.innovation_names.index("position_x")]
    assert np.nanmax(np.abs(x)) > 100.0
    row = int(np.nanargmax(np.abs(x)))
    assert abs(found.stamps[row] - log.fixes.stamps[5]) < 30_000_000


@pytest.mark.parametrize("variant", VARIANTS)
def test_run_is_feeding_by_hand(log, variant):
    found = run(log, ALPHA, variant)
    estimator = PoseEstimator(ALPHA, variant)
    expected = {}
    for measurement in log.measurements():
        estimator.feed(measurement)
        # The newest word at each stamp is what counts.
        snapshot = estimator.snapshot()
        expected[estimator.stamp] = (snapshot.state, snapshot.twist, snapshot.indices)
    assert found.variant == variant
    assert found.stamps[-1] == estimator.stamp
    # A row for each pair of track speeds; the first of them may wait for the IMU.
    assert len(log.tracks.stamps) - len(found.stamps) in (0, 1)
    for row, stamp in enumerate(found.stamps.tolist()):
        state, twist, indices = expected[stamp]
        assert (found.states[row] == state).all()
        assert (found.trajectory.twists[row] == twist).all()
        assert (found.indices[row] == indices).all()
    assert (found.trajectory.pose_covariances[-1] == estimator.pose_covariance).all()
    assert found.trajectory.twist_covariances[-1] == pytest.approx(
        estimator.twist_covariance, rel=1e-12
    )
    assert found.health.rejections() == estimator.health.rejections()
    assert found.health.sensors["tracks"].used == len(log.tracks.stamps)


@pytest.mark.parametrize("rate", [19.0, 33.0])
def test_the_yaw_rate_is_the_gyros_also_between_its_samples(rate: float) -> None:
    """A row of new track speeds waits for the IMU, which shows their slip."""
    robot, errors = load_robot("auriga-alpha"), []
    for track_rate in (20.0, rate):
        scenario = Scenario(
            duration=20.0, seed=1, trajectory="aggressive", fix_rate=0.0, track_rate=track_rate
        )
        found = simulate(scenario, robot)
        rates, truth = run(found, robot, "inertia-online").trajectory, found.truth.twists
        true = np.interp(rates.stamps, truth.stamps, truth.twists[:, 2])
        errors.append(float(np.std(rates.twists[:, 2] - true)))
    assert errors[1] < 1.3 * errors[0]


def test_refused_track_speeds_have_no_row(log):
    speeds = log.tracks.speeds.copy()
    speeds[[100, 200]] = np.nan
    bad = Log(log.name, TrackSpeedSeries(log.tracks.stamps, speeds))
    found = run(bad, ALPHA, "inertia-online")
    assert found.stamps.tolist() == np.delete(log.tracks.stamps, [100, 200]).tolist()
    assert found.health.rejections() == {"tracks: left is not finite": 2}
    with_imu = run(Log(log.name, bad.tracks, log.imu), ALPHA, "inertia-online")
    assert len(with_imu.stamps) == len(run(log, ALPHA, "inertia-online").stamps) - 2


def test_log_without_track_speeds_says_what_is_missing():
    stamps = np.array([1, 2], dtype=np.int64)
    empty = TrackSpeedSeries(stamps[:0], np.zeros((0, 2)))
    imu = ImuSeries(stamps, np.zeros((2, 3)))
    for filtered, given in ((run, imu), (run, None), (smooth, imu)):
        with pytest.raises(EstimatorError, match="'imu only' holds no track speeds"):
            filtered(Log("imu only", empty, given), ALPHA, "inertia-online")


# The signatures of all compiled functions of a process, before and after a drive with every kind of
# measurement. Those that are loaded from disk count like those that are compiled.
SCRIPT = """
import gc
import icreckon
from numba.core.dispatcher import Dispatcher
from icreckon.estimator.tracing.machine_code import LIBRARIES

def measurements(seconds: float):
    # 50 Hz tracks, 100 Hz IMU, fixes of all kinds, a standstill and a gap.
    i = icreckon
    covariance = ((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01))
    for k in range(int(seconds * 100)):
        stamp, t = k * 10**7, k / 100.0
        stands, gap = 5.0 < t < 8.0, 12.0 < t < 13.0
        left, right = (0.0, 0.0) if stands else (0.3, 0.6)
        if k % 2 == 0 and not gap:
            yield i.TrackSpeeds(stamp, left, right)
        turn = 0.0 if stands else 0.2
        yield i.ImuSample(stamp, (0.0, 0.0, turn), (0.0, 0.45 * turn, 9.81))
        if k % 50 == 20:
            yield i.PositionFix(stamp - 10**9 // 20, 0.0, 0.0, 4.0)
            yield i.HeadingFix(stamp + 1000, 0.0, 4.0)
        if k % 100 == 40:
            yield i.BodyVelocity(stamp, 0.45 * (not stands), 0.0, 0.1)
            yield i.PoseFix(stamp + 2000, 0.0, 0.0, 0.0, covariance)
        if stands and k % 50 == 0:
            yield i.ZeroVelocity(stamp)

def signatures():
    found = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    functions = [(one.py_func.__qualname__, str(sig)) for one in found for sig in one.signatures]
    return sorted(functions) + [("kernels", str(len(LIBRARIES)))]

estimator = icreckon.PoseEstimator(icreckon.load_robot("auriga-alpha"), "inertia-online")
before = signatures()
drive = list(measurements(16.0))
for k, measurement in enumerate(drive):
    estimator.feed(measurement)
    # Steps with a mark are made part by part, those before it as a whole.
    if k == len(drive) - 100:
        estimator.mark()
names = " ".join(name for name, _ in before)
assert all(part in names for part in ("take_step", "evaluate_twist"))
print(sorted(set(signatures()) - set(before)))
"""


def test_feeding_compiles_nothing() -> None:
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_each_is_shown_on_one_line(log, result):
    estimator = PoseEstimator(ALPHA, start=(1.0, 2.0, 0.5))
    assert "no estimate yet: x 1.000 m" in repr(estimator)
    estimator.feed(next(log.measurements()))
    assert f"stamp {estimator.stamp}: x 1.000 m" in repr(estimator)
    rows = f"10.0 s: {len(result.stamps)} poses"
    assert rows in repr(result)
    assert rows in repr(result.trajectory)
    comparison = repr(Comparison(log, {"inertia-online": result}, None))
    assert repr(log) in comparison
    assert repr(result) in comparison
    assert "\n" not in comparison + repr(ALPHA)
