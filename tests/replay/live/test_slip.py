"""Slip of the tracks, and manoeuvres that are missing, while a robot drives."""

import math

import numpy as np
import pytest

from icreckon import STATE_NAMES, PoseEstimator, Settings, load_robot
from icreckon.estimator.log.measurements import ImuSample, PositionFix, TrackSpeeds
from icreckon.replay.live.diagnostic_status import OK, WARN, DiagnosticStatus
from icreckon.replay.live.manoeuvres import missing_manoeuvres
from icreckon.replay.live.slip import SlipWatch
from icreckon.replay.live.statuses import parameter_statuses

ROBOT = load_robot("auriga-alpha")
GAUGE = ROBOT.vehicle.track_gauge
STEP = 10_000_000


def driven(*parts: tuple[int, float, float, float]) -> tuple[PoseEstimator, TrackSpeeds]:
    """Estimator after parts of so many steps with speeds of both tracks and a yaw rate.

    The robot itself never accelerates along its axis.
    """
    estimator = PoseEstimator(ROBOT, "inertia-online", settings=Settings())
    tracks, stamp = TrackSpeeds(0, 0.0, 0.0), 0
    for steps, left, right, rate in parts:
        for _ in range(steps):
            stamp += STEP
            tracks = TrackSpeeds(stamp, left, right)
            estimator.feed(tracks)
            wobble = 1e-3 * (stamp // STEP % 5)
            estimator.feed(ImuSample(stamp, (0.0, 0.0, rate + wobble), (wobble, 0.0, 9.81)))
    return estimator, tracks


def by_name(estimator: PoseEstimator, tracks: TrackSpeeds) -> dict[str, DiagnosticStatus]:
    """Statuses of the second look at one estimate."""
    watch = SlipWatch(GAUGE)
    first = {one.name: one for one in watch.look(estimator, tracks)}
    assert first["stuck"].level == OK
    return {one.name: one for one in watch.look(estimator, tracks)}


@pytest.mark.parametrize(("eta", "steps"), [(ROBOT.indices.eta0, 300), (3.5, 3000)])
def test_turning_on_the_spot_ratios_are_those_of_the_ground_to_the_tracks(eta, steps):
    """The robot is not stuck, not even against much friction."""
    speed = 0.4
    found = by_name(*driven((steps, -speed, speed, 2.0 * speed / (eta * GAUGE))))
    ratios = [float(found["slip"].values[f"{side}_ratio"]) for side in ("left", "right")]
    # About a point beside the centre: one side slips more than the other.
    assert sum(ratios) / 2.0 == pytest.approx(1.0 / eta, abs=0.05)
    assert [found[name].level for name in ("slip", "stuck", "spinning", "sliding")] == [OK] * 4
    assert found["stuck"].message == "no"


def test_tracks_that_rest_have_no_ratio() -> None:
    found = by_name(*driven((100, 0.0, 0.0, 0.0)))
    assert math.isnan(float(found["slip"].values["left_ratio"]))
    assert found["stuck"].level == OK


def test_tracks_that_spin_up_before_a_wall_are_a_stuck_robot() -> None:
    found = by_name(*driven((1000, 0.0, 0.0, 0.0), (20, 1.2, 1.2, 0.0)))
    assert found["sliding"].level == WARN
    assert "slower than its tracks" in found["sliding"].message
    assert found["stuck"].level == WARN
    # Averages over 0.05 s have 0.7 of a change that takes no time.
    assert abs(float(found["slip"].values["left_ratio"])) < 0.35


def test_tracks_that_are_silent_show_no_stuck_robot() -> None:
    estimator, tracks = driven((100, 0.8, 0.8, 0.0))
    for k in range(1, 600):
        estimator.feed(ImuSample(tracks.stamp + k * STEP, (0.0, 0.0, 0.001), (0.0, 0.0, 9.81)))
    found = by_name(estimator, tracks)
    assert found["stuck"].level == OK
    assert math.isnan(float(found["slip"].values["left_ratio"]))


@pytest.mark.parametrize("every", [10, 20])
def test_fixes_that_stay_while_the_tracks_drive_are_a_stuck_robot(every: int) -> None:
    estimator, watch, levels = PoseEstimator(ROBOT, "inertia-online"), SlipWatch(GAUGE), []
    sigmas = (0.003, 0.05, 0.05, 0.02, 0.02)
    noise = np.random.default_rng(1).normal(0.0, sigmas, (2000, 5)).tolist()
    for k, (rate, forward, left, x, y) in enumerate(noise):
        stamp = (k + 1) * STEP
        tracks = TrackSpeeds(stamp, 0.5, 0.5)
        estimator.feed(tracks)
        estimator.feed(ImuSample(stamp, (0.0, 0.0, rate), (forward, left, 9.81)))
        if k % every == 0:
            estimator.feed(PositionFix(stamp, 0.005 * min(k, 1000) + x, y, 0.02**2))
        if k % 20 == 0:
            levels.append(watch.look(estimator, tracks)[1].level)
    assert levels[:50] == [OK] * 50
    assert levels[60:].count(WARN) > 30  # of 40, from two seconds after


def test_a_manoeuvre_is_missing_until_it_was_driven() -> None:
    def missing(estimator: PoseEstimator) -> list[str]:
        return missing_manoeuvres(STATE_NAMES, np.sqrt(estimator.covariance.diagonal()))

    new = missing(driven((1, 0.0, 0.0, 0.0))[0])
    assert any("turn on the spot once to each side (eta0 ± " in one for one in new)
    assert any("stand still" in one for one in new)
    rate = 0.8 / (ROBOT.indices.eta0 * GAUGE)
    turned, _ = driven((1000, 0.0, 0.0, 0.0), (1500, -0.4, 0.4, rate), (1500, 0.4, -0.4, -rate))
    assert missing(turned) == []


def test_fixes_are_asked_for_where_there_are_some() -> None:
    sigmas = {"zeta0": 0.06, "epsilon0": 0.07, "track_scale": 0.0, "eta0": 0.1}
    assert missing_manoeuvres(sigmas, sigmas.values()) == []
    (text,) = missing_manoeuvres(sigmas, sigmas.values(), fixes=True)
    assert text.startswith("drive bends to both sides with position fixes (zeta0 ± 0.06 m, ")


def test_parameters_of_another_model_have_its_names() -> None:
    estimator = PoseEstimator(ROBOT, "full-linear")
    names = {one.name for one in parameter_statuses(estimator)}
    assert {*estimator.parameters} <= names
    assert "eta0" not in names


def test_parameters_have_values_and_standard_deviations() -> None:
    estimator, _ = driven((10, 0.2, 0.2, 0.0))
    found = {one.name: one.values for one in parameter_statuses(estimator)}
    assert {*estimator.parameters, *estimator.biases} == set(found)
    place = STATE_NAMES.index("eta0")
    assert float(found["eta0"]["value"]) == pytest.approx(estimator.parameters["eta0"])
    assert float(found["eta0"]["sigma"]) ** 2 == pytest.approx(estimator.covariance[place, place])
    assert float(found["eta0"]["share"]) == pytest.approx(1.0, abs=0.01)
