"""What the estimator says about its own condition."""

import math

import numpy as np
import pytest

from estimator import state as s
from estimator.gating import ADMITTED, REJECTED
from estimator.health import EXCITED, Health, ParameterHealth, SensorHealth
from estimator.measurements import TrackSpeeds
from estimator.pose_estimator import PoseEstimator
from estimator.robot import Slip, load_robot
from estimator.settings import Settings
from simulation.scenario import Scenario, simulate

ALPHA = load_robot("auriga-alpha")
SLIP = Slip(0.05, 0.01, 0.1, driving_x=0.0, driving_y=0.0, driving_w=0.0)
OFFSETS = {"zeta0", "epsilon0", "eta0"}
GAINS = {"zeta1", "epsilon1", "eta1", "eta2"}


def excited(left, right, variant="inertia-online", **options):
    estimator = PoseEstimator(ALPHA, variant, settings=Settings(slip=SLIP, **options))
    estimator.feed(TrackSpeeds(0, left, right))
    return {name for name, one in estimator.parameter_health.items() if one.excited}


def test_standing_and_straight_driving_show_no_parameter():
    for speed in (0.0, 0.1, 1.0, -0.5):
        assert excited(speed, speed) == set()


def test_hard_turns_show_all_but_H():
    assert excited(0.1, 0.9) == OFFSETS | GAINS
    assert excited(0.1, 0.9, form="literal") == OFFSETS | GAINS


def test_gentle_turns_show_the_offsets_only():
    assert excited(0.05, 0.06) == OFFSETS


@pytest.mark.parametrize("variant", ["differential", "constant-fixed", "inertia-fixed"])
def test_what_is_not_estimated_is_not_excited_and_has_no_share(variant):
    assert excited(0.1, 0.9, variant) == set()
    rows = PoseEstimator(ALPHA, variant).parameter_health.values()
    assert all(math.isnan(row.share) and row.sigma_at_start == 0.0 for row in rows)


def test_excitation_is_what_a_deviation_does_to_the_twist_against_the_slip():
    estimator = PoseEstimator(ALPHA, "constant-online", settings=Settings(slip=SLIP))
    estimator.feed(TrackSpeeds(0, 0.1, 0.9))
    row = estimator.parameter_health["zeta0"]
    # v_y = -zeta w, and slip by the difference of the track speeds.
    slip = SLIP.turning_y * 0.8
    expected = row.sigma_at_start * abs(estimator.twist[2]) / slip
    assert row.excitation == pytest.approx(expected)
    assert ParameterHealth(0.1, 0.2, EXCITED).excited
    assert not ParameterHealth(0.1, 0.2, 0.99 * EXCITED).excited


def test_the_share_falls_as_a_parameter_is_learnt():
    estimator = PoseEstimator(ALPHA)
    assert {row.share for name, row in estimator.parameter_health.items() if name != "H"} == {1.0}
    scenario = Scenario(duration=60.0, seed=3, trajectory="aggressive", truth="kinematic")
    for measurement in simulate(scenario, ALPHA).measurements():
        estimator.feed(measurement)
    shares = {name: row.share for name, row in estimator.parameter_health.items()}
    assert shares["eta0"] < 0.5
    assert shares["epsilon0"] < 0.5
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
    assert estimator.health.rejections() == {"tracks: not finite": 1}


def test_counts_add_up():
    one = Health({"gyro": SensorHealth(3, {"gate": 1}, 2.5, 3, 1)}, 4)
    other = Health(
        {"gyro": SensorHealth(2, {"gate": 2, "x": 1}, 1.0, 2), "imu": SensorHealth(1)}, 1
    )
    total = one.copy()
    total.add(other)
    assert total.sensors["gyro"] == SensorHealth(5, {"gate": 3, "x": 1}, 3.5, 5, 1)
    assert total.sensors["imu"].used == 1
    assert total.standstill_updates == 5
    assert one.sensors["gyro"].rejected == {"gate": 1}
    assert other.sensors["gyro"].rejected == {"gate": 2, "x": 1}


def test_recent_innovations_tell_a_fault_that_the_mean_since_the_start_hides():
    health = SensorHealth()
    for _ in range(5000):
        health.judged(ADMITTED, 2.0, degrees=2)
    assert health.recent_nis == pytest.approx(1.0)
    for _ in range(300):
        health.judged(REJECTED, 60.0, degrees=2)
    assert health.newest_nis == 60.0
    assert health.nis_per_degree == pytest.approx(1.0)
    assert health.recent_nis == pytest.approx(30.0, rel=0.1)
    assert health.copy() == health
    both = SensorHealth()
    both.add(health)
    assert both == health
