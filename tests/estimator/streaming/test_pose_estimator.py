"""The streaming estimator: known motions, bad measurements, and a way back."""

import math
import sys
from dataclasses import replace
from threading import Thread

import msgspec
import numpy as np
import pytest

from fed_estimators import feed_all, known, seconds, short_log
from icreckon import BodyVelocity, HeadingFix, ImuSample, Log, PoseFix, PositionFix, TrackSpeeds
from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import arc_factors, relative
from icreckon.estimator.log.series import TrackSpeedSeries
from icreckon.estimator.motion.motion_model import LEVEL, NO_SLIP
from icreckon.estimator.robot.robot_file import Slip, changed_robot, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import (
    VARIANTS,
    find_variant,
    initial_parameters,
    motion_model,
)
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

ALPHA = load_robot("auriga-alpha")
# Constant ICRs; gains that are all zero would be those of Coulomb friction.
FORCELESS = msgspec.structs.replace(ALPHA.constant_indices, eta2=1e-30, epsilon_F=0.0)
EPOCH = 1_700_000_000_123_456_789
STEP = 10_000_000  # 100 Hz, every other one with track speeds
GRAVITY = 9.81


def drive(estimator, start, duration, left, right, *, imu=True):
    """Feed driving at constant track speeds with sensors that agree with the robot file.

    Returns the last stamp. The forces build up from nothing, as they do in a filter that begins there.
    """
    variant = find_variant("inertia-fixed")
    model = motion_model(estimator.robot, variant)
    parameters = initial_parameters(estimator.robot, variant)
    stamp = start
    for k in range(round(duration * 100) + 1):
        stamp = start + k * STEP
        if k % 2 == 0:
            estimator.feed(TrackSpeeds(stamp, left, right))
        if k:
            model.begin_step(STEP * 1e-9, left, right, parameters, LEVEL)
        rightward, v_x, w = model.linearise(left, right, parameters, NO_SLIP, LEVEL)[0].twist
        v_y = -rightward
        if imu:
            estimator.feed(ImuSample(stamp, (0.0, 0.0, w), (-w * v_y, w * v_x, GRAVITY)))
    return stamp


def driven(variant="inertia-online", **options):
    """An estimator after a second in a bend, and the stamp it has reached."""
    estimator = PoseEstimator(ALPHA, variant, **options)
    return estimator, drive(estimator, EPOCH, 1.0, 0.3, 0.6)


# --- known motions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", VARIANTS)
def test_straight_line_is_as_long_as_its_tracks_say(variant):
    estimator = PoseEstimator(ALPHA, variant)
    drive(estimator, EPOCH, 20.0, 0.5, 0.5)
    elapsed = (estimator.stamp - EPOCH) * 1e-9
    assert elapsed == pytest.approx(20.0, abs=0.03)
    assert estimator.pose == pytest.approx([0.5 * elapsed, 0.0, 0.0], abs=1e-9 * elapsed)
    assert estimator.twist == pytest.approx([0.5, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("variant", "tracks"),
    [
        ("inertia-fixed", (0.3, 0.6)),
        ("inertia-online", (-0.2, 0.4)),
        ("inertia-online", (-0.5, -0.1)),
    ],
)
def test_bend_is_the_circle_of_the_model(variant, tracks):
    """Of the two estimators, one drives 20 s longer, when the forces have built up."""
    estimator, other = PoseEstimator(ALPHA, variant), PoseEstimator(ALPHA, variant)
    drive(estimator, EPOCH, 25.0, *tracks)
    drive(other, EPOCH, 5.0, *tracks)
    forward, left, angle = estimator.twist * (estimator.stamp - other.stamp) * 1e-9
    a, b = arc_factors(angle)
    way = [a * forward - b * left, b * forward + a * left]
    assert relative(other.pose, estimator.pose)[:2] == pytest.approx(way, abs=1e-9)
    # Full turns count.
    assert estimator.pose[2] - other.pose[2] == pytest.approx(angle, abs=1e-9)
    assert estimator.parameters == pytest.approx(PoseEstimator(ALPHA, variant).parameters)


# Forces build up in steps, and without IMU these are twice as long.
@pytest.mark.parametrize(("indices", "slack"), [(FORCELESS, 1e-9), (ALPHA.indices, 2e-6)])
def test_without_an_imu_the_tracks_alone_are_reckoned_with(indices, slack):
    robot = msgspec.structs.replace(ALPHA, indices=indices)
    with_imu, without = PoseEstimator(robot), PoseEstimator(robot)
    drive(with_imu, EPOCH, 10.0, 0.3, 0.6)
    drive(without, EPOCH, 10.0, 0.3, 0.6, imu=False)
    assert with_imu.stamp == without.stamp
    assert without.pose == pytest.approx(with_imu.pose, abs=slack)
    assert without.pose_covariance[2, 2] > 5.0 * with_imu.pose_covariance[2, 2]


def test_at_the_icr_a_track_does_not_slip():
    estimator, _ = driven()
    v_x, v_y, w = estimator.twist
    for (x, y), speed in zip(estimator.icrs, (0.3, 0.6), strict=True):
        assert v_x - w * y == pytest.approx(speed, abs=1e-9)
        assert v_y + w * x == pytest.approx(0.0, abs=1e-9)


# --- bad measurements -------------------------------------------------------------------------------

NAN, INF = math.nan, math.inf
LATER = 7_000_000
LONG_AGO = seconds(1.5)
BAD = [
    ("tracks: left is not finite", lambda t: TrackSpeeds(t + LATER, NAN, 0.5)),
    ("tracks: duplicate stamp", lambda t: TrackSpeeds(t, 0.9, 0.1)),
    ("tracks: older than Settings.history", lambda t: TrackSpeeds(t - LONG_AGO, 0.9, 0.1)),
    ("imu: angular_velocity is not finite", lambda t: ImuSample(t + LATER, (INF, 0.0, 0.0))),
    (
        "imu: linear_acceleration is not finite",
        lambda t: ImuSample(t + LATER, (0.0, 0.0, 0.1), (0.0, INF, 9.8)),
    ),
    ("imu: absurd rate", lambda t: ImuSample(t + LATER, (0.0, -101.0, 0.1))),
    ("imu: absurd force", lambda t: ImuSample(t + LATER, (0.0, 0.0, 0.1), (0.0, 1e9, 9.8))),
    ("imu: duplicate stamp", lambda t: ImuSample(t, (0.0, 0.0, 3.0))),
    ("imu: older than Settings.history", lambda t: ImuSample(t - LONG_AGO, (0.0, 0.0, 3.0))),
    ("position: variance not positive", lambda t: PositionFix(t + LATER, 0.0, 0.0, 0.0)),
    ("position: variance not positive", lambda t: PositionFix(t + LATER, 0.0, 0.0, NAN)),
    ("position: older than Settings.history", lambda t: PositionFix(t - LONG_AGO, 0.0, 0.0, 0.01)),
    ("heading: variance not positive", lambda t: HeadingFix(t + LATER, 0.0, 0.0)),
    ("body velocity: absurdly fast", lambda t: BodyVelocity(t + LATER, 0.1, -1e8, 0.01)),
    ("body velocity: variance not positive", lambda t: BodyVelocity(t + LATER, 0.1, 0.0, -0.1)),
    ("position: gate", lambda t: PositionFix(t, 20.0, 0.0, 0.01)),
    ("heading: gate", lambda t: HeadingFix(t, 2.5, 0.001)),
    ("pose: gate", lambda t: PoseFix(t, 20.0, 0.0, 0.0, 0.01 * np.eye(3))),
]


@pytest.mark.parametrize(("reason", "make"), BAD)
def test_measurement_that_cannot_be_right_is_counted_and_changes_nothing(reason, make):
    estimator, stamp = driven()
    before = known(estimator)
    assert estimator.feed(make(stamp)) is False
    assert known(estimator) == before
    assert estimator.health.rejections() == {reason: 1}


@pytest.mark.parametrize(
    "fix",
    [HeadingFix(EPOCH, -3.1, 0.04), PoseFix(EPOCH, 0.0, 0.0, -3.1, np.diag([1.0, 1.0, 0.04]))],
)
def test_a_heading_is_taken_across_the_turn_of_the_angle(fix):
    estimator = PoseEstimator(ALPHA, start=(0.0, 0.0, 3.1), start_sigma=(0.1, 0.1, 0.2))
    estimator.feed(TrackSpeeds(EPOCH, 0.0, 0.0))
    assert estimator.feed(fix) is True
    # Half way between 3.1 and -3.1 + 2 pi.
    assert estimator.pose[2] == pytest.approx(np.pi)


# --- gaps -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("imu", [True, False], ids=["with IMU", "without IMU"])
def test_gap_in_the_track_speeds_grows_the_uncertainty_with_its_length(imu):
    sigmas, yaw_sigmas = [], []
    for gap in (0.02, 1.0, 2.0, 9.0):
        estimator = PoseEstimator(ALPHA)
        stamp = drive(estimator, EPOCH, 2.0, 0.5, 0.5, imu=imu)
        if imu:
            for k in range(1, round(gap * 100)):
                estimator.feed(ImuSample(stamp + k * STEP, (0.0, 0.0, 0.0), (0.0, 0.0, GRAVITY)))
        drive(estimator, stamp + seconds(gap), 0.1, 0.5, 0.5, imu=imu)
        sigmas.append(math.sqrt(estimator.pose_covariance[0, 0]))
        yaw_sigmas.append(math.sqrt(estimator.pose_covariance[2, 2]))
    # The speed may change by gap_acceleration = 1 m/s per root second after hold = 0.3 s ...
    for sigma, gap in zip(sigmas[1:3], (1.0, 2.0), strict=True):
        assert sigma == pytest.approx(math.sqrt((gap - 0.3) ** 3 / 3.0), rel=0.05)
    # ... but no path is longer than that at full speed.
    assert sigmas[3] == pytest.approx(8.7, rel=0.05)
    assert sigmas[0] < 0.02
    if not imu:
        # One track forward and one backward: the yaw rate is off by twice that over the gauge that
        # the robot turns with. After a whole turn nothing is known of the yaw.
        effective = 0.42 * load_robot("auriga-alpha").indices.eta0
        assert yaw_sigmas[1] == pytest.approx(2.0 / effective * sigmas[1], rel=0.05)
        assert yaw_sigmas[3] == pytest.approx(math.pi / math.sqrt(3.0), rel=0.05)


def test_a_long_gap_after_a_turn_adds_no_more_to_the_yaw_than_not_knowing_it():
    """Errors of the parameters turn the robot only as long as the old speeds last: it was 13 rad."""
    estimator = PoseEstimator(ALPHA, "constant-online")
    stamp = drive(estimator, EPOCH, 3.0, -0.6, 0.6)
    before = estimator.pose_covariance[2, 2]
    drive(estimator, stamp + seconds(35.0), 0.1, 0.0, 0.0)
    unknown = math.pi / math.sqrt(3.0)
    added = math.sqrt(estimator.pose_covariance[2, 2] - before)
    assert unknown * 0.99 < added < 1.3 * unknown


def test_a_gap_is_bridged_with_the_speeds_before_it_dying_away():
    estimator = PoseEstimator(ALPHA)
    stamp = drive(estimator, EPOCH, 2.0, 0.5, 0.5, imu=False)
    drive(estimator, stamp + seconds(4.0), 1.0, 0.5, 0.5, imu=False)
    # Held for 0.3 s, then dying away with 2 s, until the new speeds speak for their own 0.02 s.
    dying = 4.0 - 0.3 - 0.02
    expected = 0.5 * (7.0 - dying) + 0.5 * 2.0 * (1.0 - math.exp(-dying / 2.0))
    assert estimator.pose == pytest.approx([expected, 0.0, 0.0], abs=1e-6)


def test_imu_samples_before_the_first_track_speeds_say_nothing_of_the_bias():
    """The usual start order of a robot: the IMU is there first, and the robot may be moving."""
    V_l, V_r = 0.3, 0.6
    estimator = PoseEstimator(ALPHA, "inertia-fixed")
    drive(estimator, EPOCH, 5.0, V_l, V_r, imu=False)
    rate = float(estimator.twist[2])
    estimator = PoseEstimator(ALPHA)
    for k in range(300):
        assert not estimator.feed(ImuSample(EPOCH + k * STEP, (0.0, 0.0, rate), None))
    assert estimator.health.rejections() == {"imu: before the first track speeds": 300}
    start = EPOCH + 300 * STEP
    for k in range(1, 3001):
        if k % 2 == 0:
            estimator.feed(TrackSpeeds(start + k * STEP, V_l, V_r))
        estimator.feed(ImuSample(start + k * STEP, (0.0, 0.0, rate), None))
    assert estimator.pose[2] == pytest.approx(rate * 29.98, abs=0.02)
    assert abs(estimator.biases["gyro_bias"]) < 1e-3


def test_without_fixes_the_imu_does_not_move_the_track_scale(robot):
    unsure = changed_robot(robot, {"tracks.scale_sigma": 0.03})
    log = simulate(Scenario(duration=60.0, seed=3, fix_rate=0.0), robot)
    estimator = feed_all(PoseEstimator(unsure, "differential"), log)
    assert estimator.biases["track_scale"] == 0.0
    with_fixes = simulate(Scenario(duration=120.0, seed=3, truth="kinematic"), robot)
    scale = 1.05
    tracks = TrackSpeedSeries(with_fixes.tracks.stamps, with_fixes.tracks.speeds / scale)
    slow = Log("slow", tracks, with_fixes.imu, with_fixes.fixes)
    estimator = feed_all(PoseEstimator(unsure, "inertia-online"), slow)
    sigma = math.sqrt(estimator.covariance[s.TRACK_SCALE, s.TRACK_SCALE])
    assert sigma < 0.015
    assert estimator.biases["track_scale"] == pytest.approx(scale - 1.0, abs=3.0 * sigma)


def test_fixes_of_another_clock_are_refused_and_a_clock_of_all_sensors_is_believed() -> None:
    estimator = PoseEstimator(ALPHA)
    stamp = drive(estimator, EPOCH, 2.0, 0.5, 0.5)
    for k in range(30):
        assert not estimator.feed(PositionFix(stamp + seconds(3600.0 + k), 1.0, 0.0, 0.01))
    assert estimator.health.sensor("position").rejected == {"stamp far ahead": 30}
    stamp = drive(estimator, stamp + STEP, 1.0, 0.5, 0.5)
    assert estimator.pose[0] == pytest.approx(1.5, abs=0.02)
    # One stamp far ahead is refused, too, but a clock that stays there is believed.
    ahead = stamp + seconds(3600.0)
    assert not estimator.feed(ImuSample(ahead, (0.0, 0.0, 0.0), None))
    assert estimator.health.sensor("imu").rejected == {"stamp far ahead": 1}
    drive(estimator, ahead, 1.0, 0.5, 0.5)
    assert estimator.stamp == ahead + seconds(1.0)


# --- house-keeping ----------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", VARIANTS)
def test_only_online_variants_change_their_parameters(variant):
    estimator = PoseEstimator(ALPHA, variant)
    start = estimator.parameters
    feed_all(estimator, short_log())
    changed = {name for name, value in estimator.parameters.items() if value != start[name]}
    model, online = VARIANTS[variant].model, VARIANTS[variant].online
    constant = {"zeta0", "epsilon0", "eta0"}
    wanted = constant if model == "constant" else set(start) - {"H"}
    assert changed == (wanted if online else set())
    assert np.isfinite(estimator.state).all()


def test_what_is_read_is_a_copy():
    estimator, _ = driven()
    before = known(estimator)
    for array in (estimator.pose, estimator.pose_covariance, estimator.state, estimator.covariance):
        array[:] = 99.0
    assert known(estimator) == before


def test_slip_of_a_variant_that_there_is_not_is_refused(robot):
    misspelt = msgspec.structs.replace(robot, slip={"inertia-onlin": Slip()})
    with pytest.raises(EstimatorError, match="did you mean 'inertia-online'"):
        PoseEstimator(misspelt, "differential")


@pytest.mark.parametrize(
    ("back", "rates"), [(3600.0, (50.0, 100.0)), (3.0, (30.0, 200.0)), (3600.0, (10.0, 400.0))]
)
def test_a_clock_that_is_set_back_for_good_is_followed(back, rates):
    """Also where the IMU is dozens of times as fast as the tracks."""
    track_rate, imu_rate = rates
    scenario = Scenario(duration=20.0, seed=3, track_rate=track_rate, imu_rate=imu_rate)
    log = replace(simulate(scenario, ALPHA), fixes=None)
    turn = log.start + seconds(10.0)
    estimators = []
    for by in (0, seconds(back)):
        estimator = PoseEstimator(ALPHA)
        estimators.append(estimator)
        for measurement in log.measurements():
            stamp = measurement.stamp - (by if measurement.stamp > turn else 0)
            estimator.feed(replace(measurement, stamp=stamp))
    whole, stepped = estimators
    assert stepped.health.clock_steps == 1
    assert stepped.health.rejections() == {}
    assert stepped.stamp == whole.stamp - seconds(back)
    assert stepped.pose == pytest.approx(whole.pose, abs=1e-6)
    assert stepped.pose_covariance == pytest.approx(whole.pose_covariance, rel=1e-3)


@pytest.mark.parametrize("by", [-3600.0, 3600.0])
def test_a_clock_that_is_set_during_a_standstill_keeps_the_quiet_readings(by):
    whole, stepped = PoseEstimator(ALPHA), PoseEstimator(ALPHA)
    rng, noise = np.random.default_rng(4), 0.3 * ALPHA.imu.gyro_noise_density
    for k in range(600):
        if k == 300:
            assert whole.stands
            stepped.set_clock(seconds(by))
        stamp, rate = EPOCH + k * 10_000_000, 0.02 + noise * rng.normal()
        for m in (TrackSpeeds(stamp, 0.0, 0.0), ImuSample(stamp, (0.0, 0.0, rate), None)):
            whole.feed(m)
            stepped.feed(replace(m, stamp=stamp + (seconds(by) if k >= 300 else 0)))
    assert stepped.stamp == whole.stamp + seconds(by)
    assert stepped.state.tobytes() == whole.state.tobytes()
    assert stepped.covariance.tobytes() == whole.covariance.tobytes()


def test_one_sensor_that_is_late_is_no_clock_set_back():
    log = replace(simulate(Scenario(duration=10.0, seed=3), ALPHA), fixes=None)
    estimator = PoseEstimator(ALPHA)
    for measurement in log.measurements():
        late = isinstance(measurement, TrackSpeeds) and measurement.stamp > log.start + seconds(5.0)
        stamp = measurement.stamp - (seconds(3.0) if late else 0)
        estimator.feed(replace(measurement, stamp=stamp))
    assert estimator.health.clock_steps == 0
    assert estimator.health.rejections()["tracks: older than Settings.history"] > 100
    # A flood of old samples of one sensor, with nothing else between them, is none either.
    for k in range(100):
        assert not estimator.feed(ImuSample(log.start + 1000 + k, (0.0, 0.0, 0.0)))
    assert estimator.health.clock_steps == 0


def test_a_clock_that_is_set_back_before_the_first_track_speeds():
    """An IMU sample of tomorrow, then a drive of today: it went on in a circle until Python gave up."""
    estimator = PoseEstimator(ALPHA, "gyro", settings=Settings(history=0.0))
    estimator.feed(ImuSample(EPOCH + 86_400_000_000_000, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)))
    drive(estimator, EPOCH, 5.0, 0.5, 0.5)
    assert estimator.health.clock_steps == 1
    assert estimator.pose[0] == pytest.approx(2.5, abs=0.6)


def test_two_threads_at_once_are_refused_and_change_nothing():
    """Without a lock the pose became NaN, for good and without a word."""
    estimator, refusals, interval = PoseEstimator(ALPHA), [], sys.getswitchinterval()
    drive(estimator, EPOCH, 1.0, 0.3, 0.6)

    def driver(first: int) -> None:
        for k in range(1500):
            stamp = EPOCH + seconds(1.0) + (2 * k + first) * 1_000_000
            try:
                estimator.feed(TrackSpeeds(stamp, 0.3, 0.6))
            except EstimatorError as problem:
                refusals.append(str(problem))

    threads = [Thread(target=driver, args=(first,)) for first in range(2)]
    sys.setswitchinterval(1e-6)
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert refusals
    assert all("two threads feed this estimator at once" in text for text in refusals)
    assert np.isfinite(estimator.covariance).all()
    assert estimator.feed(TrackSpeeds(EPOCH + seconds(5.0), 0.3, 0.6))
