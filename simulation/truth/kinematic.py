"""Kinematic truth, in the filter's own form: inertia-based, with a slip residual.

The robot differs from its file. This truth tests the filter under a correct model; it has no friction
effects beyond that model.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.random import Generator

from icreckon.estimator.base.frames import paper_to_rep103
from icreckon.estimator.motion.icr import direct, indices_at_signed_inertia, signed_inertia
from icreckon.estimator.motion.index_model import solve
from icreckon.estimator.robot.robot_file import PAPER_PARAMETERS, Indices, Robot, Slip
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.drives.trajectories import Command
from icreckon.simulation.truth.true_motion import (
    DEFAULT_SPREAD,
    TRUE_SLIP,
    TrueMotion,
    grid_times,
    slip_residual,
    true_motion,
)

# Parameters that are drawn: those of the paper but H.
DRAWN = PAPER_PARAMETERS[1:]
# Number of draws of the parameters, and resolution of the search for a second motion.
DRAWS = 100
SPEED_GRID = 31
FORCE_GRID = 150


@dataclass(frozen=True)
class KinematicTruth:
    """Inertia-based kinematics, plus a slip residual, of a robot unlike its file.

    The tracks follow their commands without lag.

    Attributes:
        spread: relative spread of the true parameters; see `draw_parameters`.
        slip: size and correlation time of the slip residual, a Gauss-Markov process.
        slip_noise: factor on its size [-].
    """

    spread: float = DEFAULT_SPREAD
    slip: Slip = TRUE_SLIP
    slip_noise: float = 1.0

    @property
    def name(self) -> str:
        """Name of the truth."""
        return "kinematic"

    def run(
        self, command: Command, duration: float, robot: Robot, rng: Generator, *, rate: float
    ) -> TrueMotion:
        """Simulate the motion; see `TruthModel.run`, and `draw_parameters` for errors."""
        parameters = draw_parameters(robot, self.spread, rng)
        speeds = command(grid_times(duration, rate))
        vehicle = robot.constants
        solved = solve(speeds[:, 0], speeds[:, 1], parameters.as_array(), vehicle).twist
        v_x, v_y = paper_to_rep103(solved.v_x, solved.v_y)
        effective_gauge = robot.vehicle.track_gauge * parameters.eta0
        slip = slip_residual(speeds, self.slip, effective_gauge, 1.0 / rate, rng)
        twists = np.stack([v_x, v_y, solved.w], axis=-1) + self.slip_noise * slip
        return true_motion(rate, twists, speeds, self.name, parameters)


def draw_parameters(robot: Robot, spread: float, rng: Generator) -> Indices:
    """Draw the robot's index parameters, each times its own log-normal factor.

    H is not changed, and eta0 >= 1. Parameters are drawn again if some track speeds have more than one
    steady motion: with them the vehicle would jump from one motion to the other.

    Args:
        robot: gives the nominal parameters, mass, geometry and speed range.
        spread: standard deviation of the logarithm of each factor [-].
        rng: draws the factors.

    Raises:
        SimulationError: none of `DRAWS` draws has a single motion.
    """
    for _ in range(DRAWS):
        factors = np.exp(spread * rng.standard_normal(len(DRAWN)))
        values = {
            name: float(factor * getattr(robot.indices, name))
            for name, factor in zip(DRAWN, factors, strict=True)
        }
        values["eta0"] = max(values["eta0"], 1.0)
        drawn = msgspec.structs.replace(robot.indices, **values)
        if spread == 0.0 or has_single_motion(drawn, robot):
            return drawn
    raise SimulationError(
        f"no true parameters of {robot.name!r} with a single motion for all track speeds in "
        f"{DRAWS} draws; lower truth_spread ({spread!r}) or the robot's max_track_speed"
    )


def has_single_motion(indices: Indices, robot: Robot) -> bool:
    """Return True if the implicit model has one solution for all allowed track speeds.

    Allowed are track speeds within max_track_speed.

    Args:
        indices: the parameters.
        robot: gives mass, geometry and speed range.
    """
    vehicle, top = robot.constants, robot.vehicle.max_track_speed
    grid = np.linspace(-top, top, SPEED_GRID)
    V_l, V_r = (speed.ravel() for speed in np.meshgrid(grid, grid))
    # The other half is these motions backward in time, with the same force of inertia.
    V_l, V_r = V_l[V_r > V_l, None], V_r[V_r > V_l, None]
    largest = 3.0 * top * robot.vehicle.mass * 2.0 * top / vehicle.gauge
    positive = np.geomspace(1e-5 * largest, largest, FORCE_GRID)
    force = np.concatenate([-positive[::-1], positive])
    free = indices_at_signed_inertia(force, 0.0, indices.as_array())
    values = free._replace(eta=np.maximum(free.eta, 1.0))
    twist = direct(V_l, V_r, values, vehicle.gauge)
    above = force > signed_inertia(twist, vehicle.mass, vehicle.x_CM)[0]
    return bool((np.count_nonzero(np.diff(above, axis=1), axis=1) == 1).all())
