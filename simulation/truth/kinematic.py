"""Kinematic truth, in the filter's own form: inertia-based, with a slip residual.

The robot differs from its file. This truth tests the filter under a correct model; it has no friction
effects beyond that model.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import WRONG_SIZE
from icreckon.estimator.base.frames import paper_to_rep103
from icreckon.estimator.base.state import PARAMETER_COUNT as COUNT
from icreckon.estimator.motion.bounds import ETA0
from icreckon.estimator.motion.lagged_index_model import evaluate, memory_after
from icreckon.estimator.motion.motion_model import VehicleConstants
from icreckon.estimator.robot.robot_file import Indices, Robot
from icreckon.estimator.robot.variants import find_variant, initial_parameters, vehicle_constants
from icreckon.simulation.drives.trajectories import Command
from icreckon.simulation.truth.true_motion import (
    DEFAULT_SPREAD,
    TRUE_SLIP,
    TrueMotion,
    grid_times,
    slip_residual,
    true_motion,
)


@dataclass(frozen=True)
class KinematicTruth:
    """Inertia-based kinematics, plus a slip residual, of a robot unlike its file.

    The tracks follow their commands without lag.
    """

    name: ClassVar[str] = "kinematic"
    spread: float = DEFAULT_SPREAD  # relative spread of the true parameters; see `draw_parameters`
    slip_noise: float = 1.0  # factor on the slip residual `true_motion.TRUE_SLIP` [-]

    def run(
        self, command: Command, duration: float, robot: Robot, rng: Generator, *, rate: float
    ) -> TrueMotion:
        """Simulate the motion; see `FrictionTruth.run`, and `draw_parameters`."""
        parameters = draw_parameters(robot, self.spread, rng)
        speeds = command(grid_times(duration, rate))
        vehicle = vehicle_constants(robot, "inertia")
        from icreckon.estimator.tracing.jit_kernel import entry

        paper_twists = np.empty((len(speeds), 3))
        decay = float(np.exp(-1.0 / (rate * vehicle.load_lag)))
        values = parameters.as_array()
        entry(lagged_twists)(np.ascontiguousarray(speeds), decay, values, vehicle, paper_twists)
        v_x, v_y = paper_to_rep103(paper_twists[:, 0], paper_twists[:, 1])
        effective_gauge = robot.vehicle.track_gauge * parameters.eta0
        slip = slip_residual(speeds, TRUE_SLIP, effective_gauge, 1.0 / rate, rng)
        twists = np.stack([v_x, v_y, paper_twists[:, 2]], axis=-1) + self.slip_noise * slip
        return true_motion(rate, twists, speeds, self.name, parameters)


def draw_parameters(robot: Robot, spread: float, rng: Generator) -> Indices:
    """Draw index parameters: the robot's, each multiplied by a log-normal factor.

    H stays as it is; eta0 is at least 1, since the ICRs of turning tracks lie outside them. `spread` is
    the standard deviation of the logarithm of each factor [-].
    """
    H, *nominal = initial_parameters(robot, find_variant("inertia-fixed")).tolist()
    factors = np.exp(spread * rng.standard_normal(len(nominal)))
    drawn = np.array([H, *(nominal * factors)])
    drawn[ETA0] = max(drawn[ETA0], 1.0)
    return Indices(*drawn.tolist())


def lagged_twists(
    speeds: Floats, decay: float, parameters: Floats, vehicle: VehicleConstants, twists: Floats
) -> None:
    """Compute twists by the filter's index model on level ground, from rest.

    Track speeds (n, 2) [m/s] have an even step, in which the lagged forces decay by the factor `decay`
    [-]. There are 9 index parameters; twists (n, 3), in the paper's axes, are overwritten.

    Raises:
        ValueError: an array has the wrong size.
    """
    if speeds.shape[1] != 2 or twists.shape != (len(speeds), 3) or len(parameters) != COUNT:
        raise ValueError(WRONG_SIZE)
    memory, level = (0.0, 0.0, 0.0, 0.0), (0.0, 0.0)
    for row in range(len(speeds)):
        left, right = speeds[row, 0], speeds[row, 1]
        memory = memory_after(memory, decay, (left, right), parameters, level, vehicle)
        twist = evaluate(left, right, parameters, level, vehicle, memory).kinematic
        twists[row, 0], twists[row, 1], twists[row, 2] = twist.v_x, twist.v_y, twist.w
