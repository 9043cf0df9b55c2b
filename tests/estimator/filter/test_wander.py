"""Position fixes whose error wanders: two more states, exact between fixes."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

from fed_estimators import feed_all
from icreckon import FixSpec, Log, Scenario, load_robot, pose_nees, run, simulate, smooth
from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.log.measurements import BodyVelocity, HeadingFix, PoseFix
from icreckon.estimator.robot.settings import FixWander, Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator

ALPHA = load_robot("auriga-alpha")
WANDER = FixWander(1.2, 60.0)
GPS = FixSpec(sigma=0.3, wander_sigma=1.2, wander_time=60.0)
SECOND = 1_000_000_000
START = {"start": (1.0, -2.0, 0.4), "start_sigma": (0.5, 0.5, 0.1)}


@pytest.fixture(scope="module")
def log() -> Log:
    """A drive with plain GPS, and some of every other kind of fix, between the steps too."""
    made = simulate(Scenario(duration=20.0, seed=4, fix_rate=2.0, fixes=GPS), ALPHA)
    others = []
    begin, end = made.start + 2 * SECOND + 3_000_000, made.start + 19 * SECOND
    for k, stamp in enumerate(range(begin, end, 3 * SECOND)):
        at = int(np.searchsorted(made.truth.poses.stamps, stamp))
        x, y, yaw = made.truth.poses.poses[at].tolist()
        spread = ((4.0, 0.5, 0.0), (0.5, 4.0, 0.0), (0.0, 0.0, 0.1))
        others += [
            HeadingFix(stamp, yaw, 0.05),
            BodyVelocity(stamp + 1, 0.3, 0.0, 0.25),
            PoseFix(stamp + SECOND + 2 * k, x, y, yaw, spread),
        ]
    return replace(made, truth=None, others=tuple(others))


def settings(wander: FixWander | None = WANDER) -> Settings:
    return Settings(wander=wander)


def fed(log: Log, given: Settings, marks: bool = False):
    estimator = PoseEstimator(ALPHA, settings=given, **START)
    for number, measurement in enumerate(log.measurements()):
        estimator.feed(measurement)
        if marks and number in (200, 900):
            estimator.mark()
    return estimator


def known(estimator: PoseEstimator) -> tuple[object, ...]:
    found, health = estimator._reckoning.checkpoint(), estimator.health
    arrays = found.state.tobytes(), found.covariance.tobytes()
    return estimator.stamp, health.sensors, health.wander, *arrays


def assert_close(found: PoseEstimator, expected: PoseEstimator) -> None:
    """State and covariance agree, in standard deviations."""
    a, b = found._reckoning.checkpoint(), expected._reckoning.checkpoint()
    sigma = np.sqrt(np.maximum(b.covariance.diagonal(), 1e-20))
    assert np.abs((a.state - b.state) / sigma).max() < 1e-8
    assert np.abs((a.covariance - b.covariance) / np.outer(sigma, sigma)).max() < 1e-8


def test_wander_that_is_forgotten_at_once_is_white_noise(log: Log) -> None:
    """An independent check of propagation, cross-covariance and gate: the filter without wander."""
    log = replace(log, others=())
    more = log.fixes.variances + np.array([WANDER.sigma**2, 0.0])
    white = replace(log, fixes=replace(log.fixes, variances=more))
    found = fed(log, settings(FixWander(WANDER.sigma, 1e-6)))
    expected = fed(white, settings(None))
    sigma = np.sqrt(expected.covariance.diagonal()) + 1e-12
    assert np.abs((found.state - expected.state) / sigma).max() < 1e-7
    scale = np.outer(sigma, sigma)
    assert np.abs((found.covariance - expected.covariance) / scale).max() < 1e-7
    a, b = (one.health.sensors["position"] for one in (found, expected))
    assert (a.used, a.rejected) == (b.used, b.rejected)
    assert a.nis_sum == pytest.approx(b.nis_sum, rel=1e-8)


@pytest.mark.thorough
def test_consider_states_and_marks_beside_the_wander(log: Log) -> None:
    given = msgspec.structs.replace(settings(), considered=("gyro_scale", "eta0"))
    found = fed(log, given, marks=True)
    assert_close(fed(log, given), found)
    first, second = found.marks
    for end in (None, second):
        motion = found.relative_motion(first, end)
        assert np.linalg.eigvalsh(motion.covariance).min() > 0.0


def test_without_wander_nothing_is_added(log: Log) -> None:
    found, expected = fed(log, settings(FixWander())), fed(log, settings(None))
    assert known(found) == known(expected)
    assert found._reckoning.checkpoint().state.shape == (s.SIZE,)
    assert found.health.wander is None


def test_another_frame_changes_nothing(log: Log) -> None:
    """The wander lies along the axes of the frame of the fixes, and is the same along both."""
    log = replace(log, others=())
    fixes = log.fixes

    def estimated(log: Log, start: tuple[float, float, float]) -> PoseEstimator:
        estimator = PoseEstimator(
            ALPHA, "constant-online", settings=settings(), start=start, start_sigma=(0.5, 0.5, 0.1)
        )
        feed_all(estimator, log)
        return estimator

    one = estimated(log, (1.0, -2.0, 0.4))
    angle = 1.1
    turned = fixes.poses.copy()
    turned[:, :2] = rotate(fixes.poses[:, :2], np.full(len(turned), angle))
    start = rotate(np.array([[1.0, -2.0]]), np.array([angle]))[0].tolist()
    other = estimated(
        replace(log, fixes=replace(fixes, poses=turned)), (start[0], start[1], 0.4 + angle)
    )
    by_angle = np.array([angle])
    assert rotate(one.pose[None, :2], by_angle)[0] == pytest.approx(other.pose[:2], abs=1e-8)
    at = np.array([[one.health.wander.x, one.health.wander.y]])
    there = other.health.wander
    assert rotate(at, by_angle)[0] == pytest.approx([there.x, there.y], abs=1e-8)


def test_smoothing_the_wander(log: Log) -> None:
    log = log.part(0.0, 8.0)
    both = smooth(log, ALPHA, "constant-online", settings=settings(), **START)
    forward = run(log, ALPHA, "constant-online", settings=settings(), **START)
    assert both.filtered.states == pytest.approx(forward.states, abs=1e-8)
    assert (both.smoothed.state_sigmas[:, :2] <= both.filtered.state_sigmas[:, :2] * 1.001).all()


def nees(given: Settings, runs: int) -> float:
    """Mean NEES of the pose over runs of two minutes with plain GPS, from 30 s on."""
    found = []
    for index in range(runs):
        scenario = Scenario(duration=120.0, seed=21, fix_rate=1.0, fixes=GPS, truth="kinematic")
        log = simulate(scenario, ALPHA, run_index=index)
        result = run(log, ALPHA, "constant-online", settings=given)
        errors = pose_nees(result.trajectory, log.truth.poses)
        found.append(errors[len(errors) // 4 :].mean())
    return float(np.mean(found))


@pytest.mark.thorough
def test_wander_as_it_is_makes_the_filter_as_sure_as_it_may_be() -> None:
    runs = 8
    white, wander = nees(settings(None), runs), nees(settings(), runs)
    # Errors are correlated over the wander's time: about one and a half samples of three in each run.
    upper = chi2.ppf(0.999, 3 * 1.5 * runs) / (1.5 * runs)
    assert wander < upper
    assert wander > 1.0
    assert white > 20.0


def test_wander_of_the_robot_file_and_of_the_settings() -> None:
    table = {"topic": "/fix", "wander_sigma": 1.5, "wander_time": 45.0}
    of_bags = msgspec.structs.replace(ALPHA, log={"fixes": table})
    of_tables = msgspec.structs.replace(ALPHA, log={"columns": {"fixes": table}})
    for robot in (of_bags, of_tables):
        assert FixWander.of(robot) == FixWander(1.5, 45.0)
        assert PoseEstimator(robot, "gyro").health.wander == (0.0, 0.0, 1.5)
        assert PoseEstimator(robot, "gyro", settings=settings()).health.wander[2] == 1.2
        assert PoseEstimator(robot, "gyro", settings=settings(FixWander())).health.wander is None
    assert FixWander.of(ALPHA) == FixWander()
    wrong = msgspec.structs.replace(ALPHA, log={"fixes": table | {"wander_time": -1.0}})
    with pytest.raises(EstimatorError, match="from 0 to 1e6 s"):
        PoseEstimator(wrong)
    with pytest.raises(EstimatorError, match=r"Settings\.wander must be FixWander"):
        Settings(wander=1.2)  # type: ignore[arg-type]
