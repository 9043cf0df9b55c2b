"""What the estimator says about its own condition."""

import math
from dataclasses import fields

import numpy as np
import pytest

from fed_estimators import feed_all
from icreckon import Finding, PoseEstimator, Scenario, Slip, load_robot, simulate
from icreckon.estimator.base import state as s
from icreckon.estimator.filter.gate import Gate
from icreckon.estimator.filter.health import (
    EXCITED,
    Health,
    JudgedInnovation,
    NoiseHealth,
    ParameterHealth,
    SensorHealth,
    TiltHealth,
    TrackLatencyHealth,
    WanderHealth,
)
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)
from icreckon.estimator.robot.settings import GateSettings, Settings

ALPHA = load_robot("auriga-alpha")
SLIP = Slip(0.05, 0.01, 0.1, driving_x=0.0, driving_y=0.0, driving_w=0.0)
STEP = 10_000_000
# epsilon_F, too, acts in any turn: against the rolling resistance.
OFFSETS = {"zeta0", "epsilon0", "eta0", "epsilon_F"}
GAINS = {"zeta1", "epsilon1", "eta1", "eta2"}
FULL = Health(
    sensors={
        "gyro": SensorHealth(
            *(1, {"gate": 2}, 3.0, 4, 5, 6, 7.0, 8.0, (9, 0, (1.0,), ((2.0,),)), 10)
        )
    },
    standstill_updates=1,
    track_gaps=2,
    clock_steps=4,
    track_latency=TrackLatencyHealth(0.1),
    noise={"gyro": NoiseHealth(1.0, 2.0, 3.0)},
    findings=[Finding("robot", "", "carried", 1, None, "shaken", "none")],
    times={"carried": 1},
    slip_factor=2.0,
    wander=WanderHealth(1.0, 2.0, 3.0),
    tilt=TiltHealth(1.0, 2.0, 3.0, is_wrong=True),
)


@pytest.mark.parametrize(
    ("full", "empty"), [(FULL, Health()), (FULL.sensors["gyro"], SensorHealth())]
)
def test_a_copy_has_all_fields_and_shares_no_counts(full, empty):
    for one in fields(full):
        assert getattr(full, one.name) != getattr(empty, one.name), one.name
    copied = full.copy()
    assert copied == full
    for one in fields(full):
        value = getattr(full, one.name)
        assert not isinstance(value, dict | list) or getattr(copied, one.name) is not value


def excited(left, right, variant="inertia-online"):
    estimator = PoseEstimator(ALPHA, variant, settings=Settings(slip=SLIP))
    # The force of inertia builds up within a second.
    for k in range(51):
        estimator.feed(TrackSpeeds(k * 2 * STEP, left, right))
    return {name for name, one in estimator.parameter_health.items() if one.excited}


def test_turns_show_parameters_and_the_harder_the_more():
    """Hard ones all but H, gentle ones the offsets, straight driving none."""
    assert excited(0.1, 1.0) == OFFSETS | GAINS
    assert excited(0.05, 0.06) == OFFSETS
    for speed in (0.0, 0.1, 1.0, -0.5):
        assert excited(speed, speed) == set()


@pytest.mark.parametrize("variant", ["differential", "constant-fixed", "inertia-fixed"])
def test_what_is_not_estimated_is_not_excited_and_has_no_share(variant):
    assert excited(0.1, 0.9, variant) == set()
    rows = PoseEstimator(ALPHA, variant).parameter_health.values()
    assert all(math.isnan(row.share) and row.sigma_at_start == 0.0 for row in rows)


def test_excitation_is_what_a_deviation_does_to_the_twist_against_the_slip():
    estimator = PoseEstimator(ALPHA, "constant-online", settings=Settings(slip=SLIP))
    for k in range(200):
        estimator.feed(TrackSpeeds(10_000_000 * k, 0.1, 0.9))
        estimator.feed(ImuSample(10_000_000 * k, (0.0, 0.0, estimator.twist[2])))
    row = estimator.parameter_health["zeta0"]
    # v_y = -zeta w, and slip by the difference of the track speeds.
    slip = SLIP.turning_y * 0.8
    expected = row.sigma_at_start * abs(estimator.twist[2]) / slip
    assert row.excitation == pytest.approx(expected, rel=1e-3)
    assert ParameterHealth(0.1, 0.2, EXCITED).excited
    assert not ParameterHealth(0.1, 0.2, 0.99 * EXCITED).excited


def test_the_share_falls_as_a_parameter_is_learnt():
    estimator = PoseEstimator(ALPHA)
    assert {row.share for name, row in estimator.parameter_health.items() if name != "H"} == {1.0}
    scenario = Scenario(duration=120.0, seed=3, trajectory="aggressive", truth="kinematic")
    feed_all(estimator, simulate(scenario, ALPHA))
    shares = {name: row.share for name, row in estimator.parameter_health.items()}
    assert shares["eta0"] < 0.5
    assert shares["epsilon0"] < 0.6
    sigma = math.sqrt(estimator.covariance[s.ETA0, s.ETA0])
    assert estimator.parameter_health["eta0"].sigma == sigma
    assert shares["eta0"] == pytest.approx(sigma / 0.4)


def test_what_is_read_does_not_go_on_counting():
    estimator = PoseEstimator(ALPHA)
    estimator.feed(TrackSpeeds(0, 0.1, 0.1))
    health = estimator.health
    health.sensor("tracks").used = 99
    estimator.feed(TrackSpeeds(1, np.nan, 0.1))
    assert health.rejections() == {}
    assert estimator.health.sensor("tracks").used == 1
    assert estimator.health.rejections() == {"tracks: left is not finite": 1}


def test_recent_innovations_tell_a_fault_that_the_mean_since_the_start_hides():
    gate = Gate(2, 1000.0)
    for _ in range(5000):
        gate.judge(2.0, 1.0)
    assert gate.health().recent_nis == pytest.approx(1.0)
    residual, covariance = (3.0, 4.0), ((1.0, 0.5), (0.5, 2.0))
    for _ in range(300):
        gate.keep(7, gate.judge(60.0, 1.0), np.array(residual), np.array(covariance))
    health = gate.health()
    assert health.newest == JudgedInnovation(7, "rejected", residual, covariance)
    assert health.newest_nis == 60.0
    assert health.nis_per_degree == pytest.approx(1.0)
    assert health.recent_nis == pytest.approx(30.0, rel=0.1)


def one_of_each():
    """An estimator that was fed each kind of measurement, and what each was, by its sensor."""
    settings = Settings(gates=GateSettings(patience=0.3e-9))
    estimator = PoseEstimator(ALPHA, settings=settings, start_sigma=(0.1, 0.2, 0.3))
    scenario = Scenario(duration=8.0, seed=3, trajectory="slalom", fix_rate=0.0, imu_rate=50.0)
    feed_all(estimator, simulate(scenario, ALPHA))
    at, (x, y, yaw) = estimator.stamp, estimator.pose
    forward, left, w = estimator.twist
    fed = {
        "position": PositionFix(at, x + 0.3, y - 0.2, 0.04),
        "heading": HeadingFix(at, yaw + 2.0 * math.pi - 0.1, 0.02),
        "body velocity": BodyVelocity(at, forward + 0.02, left - 0.01, 0.01),
        "pose": PoseFix(at, x + 0.1, y, yaw, np.diag([0.04, 0.05, 0.06])),
        "zero velocity": ZeroVelocity(at, (0.5, 0.1, 0.9)),
    }
    for measurement in fed.values():
        assert estimator.feed(measurement)
    assert estimator.feed(ImuSample(at + STEP, (0.0, 0.0, w), (0.0, forward * w, 9.81)))
    return estimator, fed


def test_the_newest_innovation_of_each_sensor_is_what_its_gate_has_judged():
    estimator, fed = one_of_each()
    sensors = estimator.health.sensors
    for name in ("gyro", "accelerometer_x", "accelerometer_y", *fed):
        newest = sensors[name].newest
        assert newest.verdict == "admitted"
        residual, covariance = np.array(newest.residual), np.array(newest.covariance)
        assert covariance == pytest.approx(covariance.T)
        assert (np.linalg.eigvalsh(covariance) > 0.0).all()
        nis = residual @ np.linalg.solve(covariance, residual)
        assert nis == pytest.approx(sensors[name].newest_nis, rel=1e-9)
    at = fed["position"].stamp
    assert [sensors[name].newest.stamp for name in ("gyro", *fed)] == [at + STEP] + [at] * 5
    assert sensors["position"].newest.residual == pytest.approx((0.3, -0.2))
    variances = np.diagonal(sensors["position"].newest.covariance)
    assert (variances > 0.04 + 0.1**2).all()
    # Wrapped.
    assert sensors["heading"].newest.residual[0] == pytest.approx(-0.1, abs=0.2)
    assert np.shape(sensors["pose"].newest.covariance) == (3, 3)
    assert sensors["zero velocity"].newest.residual[0] == pytest.approx(-0.6, abs=0.5)
    assert sensors["tracks"].newest is None


def test_verdicts_are_told_in_words_and_a_copy_is_the_same():
    estimator, fed = one_of_each()
    far, told = fed["position"], []
    for k in range(1, 4):
        fix = PositionFix(far.stamp + k, far.x + 50.0, far.y, 1e-4)
        estimator.feed(fix)
        newest = estimator.health.sensors["position"].newest
        assert newest.stamp == fix.stamp
        assert newest.residual[0] == pytest.approx(50.0, abs=0.5)
        # Of what was expected then, not of what was made uncertain on account of it.
        assert newest.covariance[0][0] < 1.0
        told.append(newest.verdict)
    assert told == ["rejected", "rejected", "reacquired"]


def test_what_comes_too_late_is_not_among_what_comes_late():
    estimator, fed = one_of_each()
    position = fed["position"]
    for late in (0.1, 0.5, 1.5, 2.5, 3.5):
        stamp = position.stamp - round(late * 1e9)
        estimator.feed(PositionFix(stamp, position.x, position.y, 100.0))
    sensor = estimator.health.sensors["position"]
    assert (sensor.late, sensor.too_late) == (2, 3)
    assert estimator.health.sensors["gyro"].too_late == 0


def test_gaps_and_stuck_tracks_are_counted_once_each():
    estimator = PoseEstimator(ALPHA)
    rng, told = np.random.default_rng(0), []
    for k in range(1500):
        left, right = (0.4 + 0.01 * rng.normal(size=2)).tolist()
        if 300 <= k < 320 or 700 <= k < 760:
            continue
        if 400 <= k < 500 or 900 <= k < 1000:
            left = 0.4
        if 1100 <= k < 1200:
            right = 0.4
        estimator.feed(TrackSpeeds(k * STEP, left, right))
        told.append((k, estimator.health.track_gaps, estimator.health.times.get("stuck", 0)))
    gaps, stuck = told[-1][1:]
    # The first hole is shorter than `Settings.hold`.
    assert (gaps, stuck) == (1, 3)
    assert {at: row for at, *row in told}[430] == [0, 0]
    assert {at: row for at, *row in told}[499] == [0, 1]
    assert {at: row for at, *row in told}[760] == [1, 1]


def test_fixes_that_are_rejected_in_a_row_are_a_finding():
    estimator = PoseEstimator(ALPHA, "constant-online")
    for k in range(100):
        estimator.feed(TrackSpeeds(1 + k * STEP, 0.4, 0.4))
        estimator.feed(ImuSample(1 + k * STEP, (0.0, 0.0, 0.0)))
    newest = 1 + 99 * STEP
    found = []
    for k, x in enumerate((50.0, -40.0, 50.0, 0.4)):
        used = estimator.feed(PositionFix(newest + k, x, 0.0, 0.01))
        assert used is (k == 3)
        found.append(estimator.health.finding("rejected") is not None)
    assert found == [False, False, True, False]


def test_an_imu_of_which_no_sample_is_used_is_found() -> None:
    estimator = PoseEstimator(load_robot("husky"))
    for k in range(40):
        estimator.feed(TrackSpeeds(10**18 + k * 10**7, 0.5, 0.5))
        estimator.feed(ImuSample(10**15 + k * 10**7, (0.0, 0.0, 0.01)))
    (found,) = estimator.health.findings
    assert (found.sensor, found.fault) == ("imu", "silent")
    assert "older than Settings.history" in found.text
    for k in range(40, 43):
        estimator.feed(ImuSample(10**18 + k * 10**7, (0.0, 0.0, 0.01)))
    assert not estimator.health.findings


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda t: PositionFix(t - 1_200_000_000, 0.0, 0.0, 1.0), "raise Settings.history"),
        (lambda t: PositionFix(t, 0.0, np.nan, 1.0), "y is not finite; correct the driver"),
        (lambda t: HeadingFix(t, 0.0, 0.0), "variance not positive"),
        (lambda t: ImuSample(t, (0.0, np.nan, 0.0)), "imu are refused: angular_velocity is not"),
    ],
)
def test_a_stream_that_is_refused_is_found(make, text):
    estimator = PoseEstimator(ALPHA)
    for stamp in range(2_000_000_000, 3_900_000_000, 50_000_000):
        estimator.feed(TrackSpeeds(stamp, 0.1, 0.1))
        assert bool(estimator.health.findings) == (stamp > 2_950_000_000)
        estimator.feed(make(stamp))
    (found,) = estimator.health.findings
    assert text in found.text
