"""Coverage of the intervals of `icreckon calibrate`: simulated robots whose parameters are known.

    python benchmarks/calibration.py [--seeds 100] [--workers 2]

Each seed is another robot (the eight parameters off the file by 15 %, radius by 3 %, the right radius
off the left by 2 %, gyro scale by 1 %, a gyro bias of 0.01 rad/s, an IMU that is turned by a degree or
two), another drive of 300 s, and another truth: 0.1 to 0.4 s late, of a point up to 0.3 m off, with 1 cm
and 0.002 rad of noise at 20 Hz. It is moved by the inertia-based kinematics, so that the eight parameters
are true. For each parameter that is reported as shown: in how many seeds its 95 % interval holds the
truth, the mean error, and the standard deviation of the errors over the mean standard error. Then drives
that do not excite: straight lines, and one circle at constant speed. All figures are of simulations.
"""

from __future__ import annotations

import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import msgspec
import numpy as np
from _study import script_parser, table

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.calibration import Calibration, calibrate
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, PoseSeries, TrackSpeedSeries, Truth
from icreckon.estimator.robot.robot_file import PAPER_PARAMETERS, Robot, load_robot
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import EncoderSpec
from icreckon.simulation.simulate import run_scenario

DURATION = 300.0
DRIVES = ("aggressive", "random", "arcs", "slalom")
PLACE = (0.1, -0.05, 0.2)
LEAST = 90.0


@dataclass(frozen=True)
class Case:
    """A simulated robot, its log, and what is true of it.

    Attributes:
        log: as read with the robot file.
        robot: the robot file, which is not quite right.
        true: the true values of parameters, by the names of a calibration.
        read: (3,) what the gyro reads where the robot turns at 1 rad/s [rad/s].
    """

    log: Log
    robot: Robot
    true: dict[str, float]
    read: Floats


def make_case(seed: int, drive: str, options: dict[str, float], duration: float) -> Case:
    """A robot that differs from its file, and a log of it."""
    rng = np.random.default_rng([seed, 77])
    file = load_robot("auriga-alpha")
    file = msgspec.structs.replace(file, imu=msgspec.structs.replace(file.imu, position=PLACE))
    angles = tuple(float(value) for value in rng.normal(0.0, 1.5, 3))
    mounted = msgspec.structs.replace(
        file, imu=msgspec.structs.replace(file.imu, rotation_rpy_deg=angles)
    )
    scenario = Scenario(
        trajectory=drive,
        trajectory_options=options,
        duration=duration,
        seed=seed,
        truth="kinematic",
        fix_rate=0.0,
        truth_rate=20.0,
        encoders=EncoderSpec(),
    )
    run = run_scenario(scenario, mounted)
    log, poses = run.log, run.log.truth.poses if run.log.truth else None
    if log.imu is None or poses is None or run.motion.parameters is None:
        raise ValueError("the scenario has no IMU, truth or parameters")
    radius, gyro_scale = np.exp(0.03 * rng.standard_normal()), 1.0 + 0.01 * rng.standard_normal()
    lag, lever = rng.uniform(0.1, 0.4), rng.uniform(-0.3, 0.3, 2)
    # The true rates are scaled about the IMU's z axis, which is nearly the vertical.
    scales = np.array([1.0, 1.0, gyro_scale])
    rates = log.imu.angular_velocity * scales
    imu = ImuSeries(log.imu.stamps, rates, log.imu.linear_acceleration)
    true = poses.poses.copy()
    cos, sin = np.cos(true[:, 2]), np.sin(true[:, 2])
    true[:, 0] += cos * lever[0] - sin * lever[1]
    true[:, 1] += sin * lever[0] + cos * lever[1]
    true += rng.normal(0.0, 1.0, true.shape) * np.array([0.01, 0.01, 0.002])
    late = PoseSeries(poses.stamps + round(lag * 1e9), true)
    difference = 0.02 * float(rng.standard_normal())
    radii = radius * (1.0 + difference * np.array([-0.5, 0.5]))
    tracks = TrackSpeedSeries(log.tracks.stamps, log.tracks.speeds / radii)
    bias = float(np.mean(run.gyro_bias[:, 2]))
    values = {
        f"indices.{name}": float(getattr(run.motion.parameters, name)) for name in PAPER_PARAMETERS
    }
    values |= {
        "sprocket_radius": file.vehicle.sprocket_radius * float(radius),
        "tracks.difference": difference,
        "imu.gyro_scale": float(gyro_scale),  # with the mounting that is true; see `compared`
        "imu.yaw": angles[2],
        "truth.forward": float(lever[0]),
        "truth.left": float(lever[1]),
        "truth.lag": float(lag),
        "gyro_bias": bias * float(gyro_scale),
        "imu.gyro_bias": bias,
    }
    changed = replace(
        log, name=f"{drive} {seed}", tracks=tracks, imu=imu, truth=Truth(late, source="simulated")
    )
    return Case(changed, file, values, scales * mounted.imu_rotation[2])


def estimates(found: Calibration) -> dict[str, tuple[float, float, str]]:
    """Value, standard error and status of each parameter that a case knows the truth of."""
    result = {one.name: (one.value, one.sigma or np.inf, one.status) for one in found.parameters}
    first = found.logs[0]
    result["truth.lag"] = (*(first.lag or (0.0, np.inf)), "shown")
    result["gyro_bias"] = (*first.gyro_bias, "shown")
    return result


def compared(case: Case, found: Calibration) -> dict[str, tuple[float, float, str]]:
    """Error, standard error and status by name."""
    known = estimates(found)
    # What the gyro reads of turning, by the mounting that was found, is to be scaled right.
    true = case.true | {"imu.gyro_scale": float(found.robot.imu_rotation[2] @ case.read)}
    return {
        name: (known[name][0] - value, known[name][1], known[name][2])
        for name, value in true.items()
        if name in known
    }


def one_seed(seed: int, duration: float) -> dict[str, tuple[float, float, str]]:
    """Error, standard error and status by name, for one simulated robot."""
    case = make_case(seed, DRIVES[seed % len(DRIVES)], {}, duration)
    found = calibrate([case.log], case.robot, models=("constant", "inertia"))
    return compared(case, found)


def main() -> None:
    """Print the tables."""
    parser = script_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--duration", type=float, default=DURATION)
    arguments = parser.parse_args()
    began = time.perf_counter()
    with ProcessPoolExecutor(arguments.workers) as pool:
        seeds = list(
            pool.map(partial(one_seed, duration=arguments.duration), range(arguments.seeds))
        )
    rows = []
    for name in seeds[0]:
        shown = [seed[name][:2] for seed in seeds if seed[name][2] == "shown"]
        if not shown:
            rows.append((name, "0", "", "", ""))
            continue
        errors, sigmas = np.array(shown).T
        inside = 100.0 * float(np.mean(np.abs(errors) <= 1.96 * sigmas))
        mark = "" if inside >= LEAST else " !"
        rows.append(
            (
                name,
                str(len(shown)),
                f"{inside:.0f} %{mark}",
                f"{errors.mean():.2g} ± {errors.std() / np.sqrt(len(errors)):.1g}",
                f"{errors.std() / sigmas.mean():.2f}",
            )
        )
    table(("parameter", "shown in", "inside 95 %", "mean error", "sd / standard error"), rows)
    print(f"\n{arguments.seeds} seeds in {time.perf_counter() - began:.0f} s\n")
    unexcited()


def unexcited() -> None:
    """What drives that do not excite show."""
    case = make_case(0, "straight", {}, 120.0)
    try:
        calibrate([case.log], case.robot)
        print("straight lines: calibrated!")
    except EstimatorError as error:
        print(f"straight lines: {error}")
    counts: Counter[tuple[str, str]] = Counter()
    for seed in range(5):
        case = make_case(seed, "circle", {}, 120.0)
        found = calibrate([case.log], case.robot, models=("constant", "inertia"))
        counts.update((one.name, one.status) for one in found.parameters)
    names = [name for name, _ in counts if name.startswith(("indices", "truth"))]
    rows = [
        (name, *(str(counts[name, status]) for status in ("shown", "conditional", "held")))
        for name in dict.fromkeys(names)
    ]
    print("\nfive circles at constant speed:\n")
    table(("parameter", "shown", "conditional", "held"), rows)


if __name__ == "__main__":
    main()
