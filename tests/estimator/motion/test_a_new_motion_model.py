"""A motion model that is no part of the package: tracks that turn the robot less at speed."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from complex_step import assert_derivatives
from fed_estimators import feed_all, known
from icreckon import FilterSpec, Log, PoseEstimator, Scenario, compare, run, run_many, simulate
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import BatchError, EstimatorError
from icreckon.estimator.log.measurements import ImuSample, Measurement, TrackSpeeds
from icreckon.estimator.motion.bounds import ETA0, index_bounds
from icreckon.estimator.motion.icr import IndexValues, Number, PaperTwist
from icreckon.estimator.motion.motion_model import (
    LEVEL,
    Gravity,
    Motion,
    TwistDerivatives,
    Unremembering,
    VehicleConstants,
)
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.variants import VARIANTS, Variant, motion_model, register
from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.simulation.base.errors import SimulationError

# --- the motion model ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class FastTurns(Unremembering):
    """Constant ICRs whose steering efficiency index grows with speed: eta = eta0 + gain V_m²."""

    vehicle: VehicleConstants
    gain: float = 0.5  # [s²/m²]

    @property
    def bounds(self) -> Floats:
        """Bounds of the parameters: eta0 at least 1, ICRs on both sides of the robot."""
        return index_bounds(self.vehicle.gauge)

    def steering_efficiency(self, parameters: Any) -> float:
        """Steering efficiency index at rest."""
        return float(parameters[ETA0])

    @property
    def taught_by_imu(self) -> tuple[int, ...]:
        """Places of the parameters that the IMU moves: eta0, which the yaw rate shows."""
        return (ETA0,)

    def linearise(
        self,
        V_l: Number,
        V_r: Number,
        parameters: Any,
        slip: tuple[Number, Number, Number],
        gravity: Gravity,  # noqa: ARG002 - all motion models have it
    ) -> tuple[Motion, TwistDerivatives]:
        """Compute the twist w = D / (L eta), v_x = w zeta, v_y = V_m - w epsilon and its derivatives."""
        zeta, epsilon, eta0 = parameters[1], parameters[3], parameters[ETA0]
        D, V_m = V_r - V_l, 0.5 * (V_l + V_r)
        eta = eta0 + self.gain * V_m * V_m
        per_D = 1.0 / (self.vehicle.gauge * eta)
        w, per_eta = D * per_D, -D * per_D / eta
        twist = PaperTwist(w * zeta + slip[0], V_m - w * epsilon + slip[1], w + slip[2])
        by_eta = (per_eta * zeta, -per_eta * epsilon, per_eta)
        by_V_m = tuple(2.0 * self.gain * V_m * one for one in by_eta)
        # By D and V_m, of the inputs; D = V_r - V_l, V_m = (V_l + V_r) / 2.
        by_D = np.array([per_D * zeta, -per_D * epsilon, per_D])
        half = 0.5 * np.array([by_V_m[0], by_V_m[1] + 1.0, by_V_m[2]])
        by_parameters = np.zeros((3, 9), np.result_type(by_D, half))
        by_parameters[0, 1], by_parameters[1, 3], by_parameters[:, ETA0] = w, -w, by_eta
        by_speeds = np.stack([half - by_D, half + by_D], axis=-1)
        motion = Motion(twist, IndexValues(zeta, epsilon, eta), u=0.0, force=0.0)
        return motion, TwistDerivatives(by_parameters, by_speeds, np.eye(3))


def fast_turns(robot: Robot) -> FastTurns:
    return FastTurns(robot.constants)


# --- its tests ----------------------------------------------------------------------------------------

ALPHA = load_robot("auriga-alpha")
OWN, SHIPPED = "fast-turns-online", "constant-online"


@pytest.fixture(autouse=True)
def variants() -> Iterator[None]:
    """Two variants with the parameters of constant ICRs: the model, and the model without its gain."""
    register(Variant(OWN, "constant", online=True, motion=fast_turns))
    without = Variant(
        "no-gain", "constant", online=True, motion=lambda _: FastTurns(ALPHA.constants, 0.0)
    )
    register(without)
    yield
    del VARIANTS["no-gain"], VARIANTS[OWN]


def test_its_derivatives_are_those_of_a_complex_step():
    rng = np.random.default_rng(1)
    for V_l, V_r in rng.uniform(-1.2, 1.2, (20, 2)).tolist():
        slip = tuple(rng.normal(scale=0.1, size=3).tolist())
        parameters = ALPHA.constant_indices.as_array() * rng.uniform(0.7, 1.3, 9)
        assert_derivatives(FastTurns(ALPHA.constants), V_l, V_r, parameters, slip)


def test_without_its_gain_it_is_the_model_of_constant_icrs():
    log = simulate(Scenario(duration=0.5, truth="kinematic", seed=3), ALPHA)
    shipped, own = (PoseEstimator(ALPHA, name) for name in (SHIPPED, "no-gain"))
    for measurement in log.measurements():
        assert own.feed(measurement) == shipped.feed(measurement)
    sigma = np.sqrt(np.diagonal(shipped.covariance))
    estimated = sigma > 0.0
    assert np.abs((own.state - shipped.state)[estimated] / sigma[estimated]).max() < 1e-9
    assert own.parameters.keys() == shipped.parameters.keys()
    assert own.indices == pytest.approx(shipped.indices, abs=1e-9)


def drive(seconds: float) -> Log:
    """Bends at 0.2 to 1.2 m/s by a robot that moves as the model does, with an exact gyro."""
    truth, parameters = FastTurns(ALPHA.constants), ALPHA.constant_indices.as_array()
    found: list[Measurement] = []
    for k in range(round(seconds * 50)):
        stamp = 1_700_000_000_000_000_000 + k * 20_000_000
        forward, apart = 0.7 - 0.5 * np.cos(0.01 * k), 0.3 * np.sin(0.05 * k)
        left, right = float(forward - apart), float(forward + apart)
        motion, _ = truth.linearise(left, right, parameters, (0.0, 0.0, 0.0), LEVEL)
        found += [TrackSpeeds(stamp, left, right), ImuSample(stamp, (0.0, 0.0, motion.twist.w))]
    return Log.from_measurements(found, "bends")


def test_it_predicts_its_own_motion_better_than_the_shipped_model():
    log = drive(3.0)
    own, shipped = (
        np.sqrt(np.mean(run(log, ALPHA, name).innovations[50:, 0] ** 2)) for name in (OWN, SHIPPED)
    )
    assert own < 0.2 * shipped


def test_a_saved_estimator_goes_on_with_it(tmp_path):
    measurements = list(drive(1.4).measurements())
    before = feed_all(PoseEstimator(ALPHA, OWN), measurements[:100])
    before.save(tmp_path / "saved.json")
    after = PoseEstimator.restore(tmp_path / "saved.json", ALPHA)
    assert isinstance(motion_model(ALPHA, after.variant), FastTurns)
    for estimator in (before, after):
        feed_all(estimator, measurements[100:])
    assert known(before) == known(after)


def test_replays_stream_it_and_lanes_and_studies_refuse_it():
    log = drive(1.0)
    found = compare(log, ALPHA, [OWN, SHIPPED], smooth=True).runs
    assert list(found) == [OWN, SHIPPED, OWN + SMOOTHED, SHIPPED + SMOOTHED]
    with pytest.raises(BatchError, match="'fast-turns-online' cannot run side by side"):
        run_many([log], ALPHA, OWN)
    with pytest.raises(SimulationError, match="'fast-turns-online' has one of its own"):
        FilterSpec(variant=OWN)


def test_what_cannot_be_a_variant_is_refused():
    with pytest.raises(EstimatorError, match="'constant-online': there is such a variant already"):
        register(Variant(SHIPPED, "constant", online=True, motion=fast_turns))
    with pytest.raises(EstimatorError, match="no model named 'constnat'; did you mean 'constant'"):
        register(Variant("mine", "constnat", online=True))  # type: ignore[arg-type]
