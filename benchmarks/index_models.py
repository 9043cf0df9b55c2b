"""How well two index models explain the velocity of a robot that friction moves.

Each robot is drawn anew: friction, rolling resistance, contact length and centre of mass differ from the
robot file. Constant ICRs and the inertia-based parameters are fitted to a training run of the transient
truth, and scored on another run of the same kind of driving, both without noise, at 50 Hz. RMSE as in
Table II of the paper: mean over the robots, and the ratio to constant ICRs with its 95 % bootstrap
interval. Drift is the mean position error after 30 s from the errors of v_x and v_y alone, % of the
distance.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np
from analysis.fitting import KnownMotion, fit_constant, fit_inertia
from numpy.random import Generator

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.motion.icr import PaperTwist
from icreckon.estimator.motion.motion_model import LEVEL, NO_SLIP
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.variants import find_variant, initial_parameters, motion_model
from icreckon.simulation.contact.contact import Contact
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.drives.drives import aggressive, random_driving
from icreckon.simulation.drives.trajectories import Command
from icreckon.simulation.truth.friction import TRACK_LAG, draw_contact, drive, follow

RATE, KEPT = 200.0, 4
TRAINING, SCORING, HORIZON = 200.0, 300.0, 30.0
DRIVING: dict[str, Callable[[float, Robot, Generator], Command]] = {
    "everyday forward": lambda *of: random_driving(*of, reverse=0.0),
    "aggressive": aggressive,
}
MODELS = ("constant", "inertia")


@dataclass(frozen=True)
class Drive:
    """Track speeds (n, 2) and their rates at `RATE`, and the true twist (n, 3) in the paper's axes."""

    speeds: Floats
    rates: Floats
    twists: Floats

    @property
    def known(self) -> KnownMotion:
        """What a fit may see of it."""
        kept = slice(0, None, KEPT)
        V_l, V_r = self.speeds[kept].T
        return KnownMotion(V_l, V_r, PaperTwist(*self.twists[kept].T))


def true_drive(
    driving: str, seconds: float, robot: Robot, contact: Contact, rng: Generator
) -> Drive:
    """A run of the transient truth."""
    times = np.arange(int(seconds * RATE) + 1) / RATE
    speeds, rates = follow(DRIVING[driving](seconds, robot, rng)(times), 1.0 / RATE, TRACK_LAG)
    twists = drive(contact, robot.yaw_inertia, speeds, rates, 1.0 / RATE).twists
    return Drive(speeds, rates, twists)


def modelled(model: str, robot: Robot, run: Drive) -> Floats:
    """Twists (n, 3) that a fitted robot's model gives for the track speeds of a run."""
    variant = find_variant(f"{model}-fixed")
    parameters, motion = initial_parameters(robot, variant), motion_model(robot, variant)
    twists = []
    for V_l, V_r in run.speeds.tolist():
        motion.begin_step(1.0 / RATE, V_l, V_r, parameters, LEVEL)
        twists.append(motion.linearise(V_l, V_r, parameters, NO_SLIP, LEVEL)[0].twist)
    return np.array(twists)


def scores_of(model: str, robot: Robot, run: Drive) -> list[float]:
    """RMSE of v_x, v_y [m/s] and w [rad/s], and drift [%]."""
    error = modelled(model, robot, run) - run.twists
    yaw = np.cumsum(run.twists[:, 2]) / RATE
    cos, sin = np.cos(yaw), np.sin(yaw)
    x = np.cumsum(cos * error[:, 1] + sin * error[:, 0]) / RATE
    y = np.cumsum(sin * error[:, 1] - cos * error[:, 0]) / RATE
    way = np.cumsum(np.hypot(run.twists[:, 0], run.twists[:, 1])) / RATE
    ahead = int(HORIZON * RATE)
    drifted = np.hypot(x[ahead:] - x[:-ahead], y[ahead:] - y[:-ahead]).mean()
    rmse = np.sqrt((error[::KEPT] ** 2).mean(axis=0))
    return [*rmse.tolist(), 100.0 * float(drifted / (way[ahead:] - way[:-ahead]).mean())]


def interval(ratios: np.ndarray, rng: Generator) -> str:
    """Ratio of means with its 95 % bootstrap interval; (n, 2) numerator, denominator."""
    draws = ratios[rng.integers(0, len(ratios), (4000, len(ratios)))].sum(axis=1)
    low, high = np.quantile(draws[:, 0] / draws[:, 1], [0.025, 0.975])
    return f"{ratios[:, 0].sum() / ratios[:, 1].sum():.2f} ({low:.2f} to {high:.2f})"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--robot", default="auriga-alpha")
    parser.add_argument("--robots", type=int, default=20, help="drawn robots")
    parser.add_argument("--spread", type=float, default=0.15)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    nominal = load_robot(arguments.robot)
    parts = ("v_x", "v_y", "w", "drift")
    print(
        "| driving | rolling resistance | model | v_x mm/s | v_y mm/s | w mrad/s | drift % | ",
        end="",
    )
    print(" | ".join(f"{part} ratio" for part in parts), "|")
    print("| --- " * (7 + len(parts)) + "|")
    units = np.array([1e3, 1e3, 1e3, 1.0])
    for driving in DRIVING:
        for resistance in (False, True):
            soil = contact_of(nominal).soil
            if not resistance:
                soil = msgspec.structs.replace(soil, rolling_resistance=0.0)
            robot = msgspec.structs.replace(nominal, soil=soil)
            scores: dict[str, list[list[float]]] = {model: [] for model in MODELS}
            for index in range(arguments.robots):
                rng = np.random.default_rng([arguments.seed, index])
                contact = draw_contact(robot, arguments.spread, rng)
                training = true_drive(driving, TRAINING, robot, contact, rng).known
                scored = true_drive(driving, SCORING, robot, contact, rng)
                fitted = fit_inertia(fit_constant(robot, training), training)
                for model, rows in scores.items():
                    rows.append(scores_of(model, fitted, scored))
            of_constant = np.array(scores["constant"])
            for model, rows in scores.items():
                values, rng = np.array(rows), np.random.default_rng(arguments.seed)
                ratios = [""] * len(parts)
                if model != "constant":
                    ratios = [
                        interval(np.stack([values[:, part], of_constant[:, part]], axis=-1), rng)
                        for part in range(len(parts))
                    ]
                means = [
                    f"{value:.{1 + (unit == 1.0)}f}"
                    for value, unit in zip(units * values.mean(axis=0), units, strict=True)
                ]
                with_or_without = "with" if resistance else "without"
                print(
                    "|",
                    " | ".join([driving, with_or_without, model, *means, *ratios]),
                    "|",
                    flush=True,
                )


if __name__ == "__main__":
    main()
