"""How well three index models explain the velocity of a robot that friction moves.

Each robot is drawn anew: friction, rolling resistance, contact length and centre of mass differ from the
robot file. Constant ICRs, the inertia-based parameters and the contact of the friction model are fitted
to a training run of the transient truth, and scored on another run of the same kind of driving, both
without noise, at 50 Hz. RMSE as in Table II of the paper: mean over the robots, and the ratio to constant
ICRs with its 95 % bootstrap interval.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import msgspec
import numpy as np
from numpy.random import Generator

from estimator.contact import Contact
from estimator.fitting import KnownMotion, fit_constant, fit_friction, fit_inertia
from estimator.kinematics import PaperTwist
from estimator.robot import Robot, load_robot
from estimator.variants import find_variant, initial_indices, motion_model
from simulation.drives import aggressive, random_driving
from simulation.dynamics import TRACK_LAG, draw_contact, drive, follow
from simulation.trajectories import Command

RATE, KEPT = 200.0, 4
TRAINING, SCORING = 200.0, 300.0
DRIVING: dict[str, Callable[[float, Robot, Generator], Command]] = {
    "everyday forward": lambda *of: random_driving(*of, reverse=0.0),
    "aggressive": aggressive,
}
MODELS = ("constant", "inertia", "friction")


def known_motion(
    driving: str, seconds: float, robot: Robot, contact: Contact, rng: Generator
) -> KnownMotion:
    """True track speeds and twists of a run of the transient truth."""
    times = np.arange(int(seconds * RATE) + 1) / RATE
    speeds, rates = follow(DRIVING[driving](seconds, robot, rng)(times), 1.0 / RATE, TRACK_LAG)
    twists = drive(contact, robot.yaw_inertia, speeds, rates, 1.0 / RATE).twists
    kept = slice(0, None, KEPT)
    return KnownMotion(speeds[kept, 0], speeds[kept, 1], PaperTwist(*twists[kept].T))


def errors_of(model: str, robot: Robot, motion: KnownMotion) -> list[float]:
    """RMSE of v_x, v_y [m/s] and w [rad/s] of a fitted robot's model."""
    variant = find_variant(f"{model}-fixed")
    parameters = initial_indices(robot, variant).as_array()
    found, _ = motion_model(robot, variant).linearise(
        motion.V_l, motion.V_r, parameters, (0.0, 0.0, 0.0)
    )
    return [
        float(np.sqrt(np.mean((ours - true) ** 2)))
        for ours, true in zip(found.twist, motion.twist, strict=True)
    ]


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
    row = "{:>17s} {:>11s} {:>9s} {:>9s} {:>9s} {:>9s}   {:<22s} {:<22s} {:<22s}"
    print(
        row.format(
            "driving", "resistance", "model", "v_x mm/s", "v_y mm/s", "w mrad/s",
            "v_x to constant", "v_y to constant", "w to constant",
        )
    )  # fmt: skip
    for driving in DRIVING:
        for resistance in (False, True):
            soil = nominal.contact.soil
            if not resistance:
                soil = msgspec.structs.replace(soil, rolling_resistance=0.0)
            robot = msgspec.structs.replace(nominal, soil=soil)
            scores: dict[str, list[list[float]]] = {model: [] for model in MODELS}
            for index in range(arguments.robots):
                rng = np.random.default_rng([arguments.seed, index])
                contact = draw_contact(robot, arguments.spread, rng)
                training = known_motion(driving, TRAINING, robot, contact, rng)
                scored = known_motion(driving, SCORING, robot, contact, rng)
                fitted = fit_friction(
                    fit_inertia(fit_constant(robot, training), training), training
                )
                for model in MODELS:
                    scores[model].append(errors_of(model, fitted, scored))
            for model in MODELS:
                values, of_constant = np.array(scores[model]), np.array(scores["constant"])
                rng = np.random.default_rng(arguments.seed)
                ratios = [
                    interval(np.stack([values[:, axis], of_constant[:, axis]], axis=-1), rng)
                    for axis in range(3)
                ]
                print(
                    row.format(
                        driving,
                        "with" if resistance else "without",
                        model,
                        *(f"{1e3 * value:.1f}" for value in values.mean(axis=0)),
                        *(ratios if model != "constant" else [""] * 3),
                    ),
                    flush=True,
                )


if __name__ == "__main__":
    main()
