"""Does it matter how often sensors sample? The same drive and noise at 50, 100, 200 and 400 Hz.

One true motion (friction, or the kinematics of the inertia-based model with --truth kinematic; everyday
driving of 60 s, a position fix each second for the first 40 s) is read by track-speed sensors and an
IMU, in step, at each rate. Their noise is drawn once, as increments at 400 Hz of noise of the robot
file's densities, of which a slower sensor sees the means. The final estimates are set against those at
400 Hz, in standard deviations that the filter gives at 400 Hz: RMS over the states of each kind, and
over the runs. Intervals are 95 % bootstrap intervals over the runs.

With --truth kinematic the true parameters are known, and the mean error of eta0 is printed as well.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
from _friction import ONLINE
from _study import bootstrap, mean_interval, spread, study_parser, table, told

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import FixSeries, ImuSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.robot.variants import find_variant, parameter_names
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import run_scenario
from icreckon.simulation.truth.by_name import TRUTHS

SEED = 20_246
FASTEST = 400
RATES = (50, 100, 200, FASTEST)
SECONDS, FIXES_END = 60, 40
FIX_SIGMA = 0.05
GROUPS = {
    "pose": (0, 3),
    "parameters": (s.PARAMETERS.start, s.PARAMETERS.stop),
    "eta0": (s.ETA0, s.ETA0 + 1),
    "biases": (s.GYRO_BIAS, s.ACCELEROMETER_BIAS_Y + 1),
}
Job = tuple[str, int, str, float]


def noisy_log(robot: Robot, rate: int, index: int, truth: str = "friction") -> tuple[Log, float]:
    """The drive as sensors of a rate see it [Hz], and the true eta0, NaN where there is none."""
    scenario = Scenario(
        duration=float(SECONDS),
        seed=SEED,
        noise="perfect",
        truth=truth,
        slip_noise=0.0,
        track_rate=float(rate),
        imu_rate=float(rate),
        outages=((float(FIXES_END), float(SECONDS)),),
    )
    simulation = run_scenario(scenario, robot, run_index=index)
    true, log = simulation.true_parameters, simulation.log
    imu, fixes = log.imu, log.fixes
    if imu is None or imu.linear_acceleration is None or fixes is None:
        raise ValueError("a simulated log has an IMU and fixes")
    rng = np.random.default_rng([SEED, index, 1])
    share, count = FASTEST // rate, SECONDS * FASTEST

    def means(width: int, density: float) -> Floats:
        """(n, width) what white noise of a density comes to in each sample but the first."""
        drawn = density * np.sqrt(FASTEST) * rng.standard_normal((count, width))
        averaged = drawn.reshape(-1, share, width).mean(axis=1)
        return np.concatenate([np.zeros((1, width)), averaged])

    speeds = log.tracks.speeds
    noise = means(2, robot.tracks.speed_noise_density)
    stands = (speeds == 0.0).all(axis=1)
    noise[stands] = 0.0
    rates = imu.angular_velocity + means(3, robot.imu.gyro_noise_density)
    forces = imu.linear_acceleration + means(3, robot.imu.accelerometer_noise_density)
    rates = rates + np.array([0.0, 0.0, 0.01]) * rng.standard_normal()
    forces = forces + np.array([0.0, 0.1, 0.0]) * rng.standard_normal()
    poses = fixes.poses + FIX_SIGMA * rng.standard_normal(fixes.poses.shape)
    poses[:, 2] = np.nan
    noisy = replace(
        log,
        tracks=TrackSpeedSeries(log.tracks.stamps, speeds + noise),
        imu=ImuSeries(imu.stamps, rates, forces),
        fixes=FixSeries(fixes.stamps, poses, np.full_like(fixes.variances, FIX_SIGMA**2)),
    )
    return noisy, np.nan if true is None else true.eta0


def score(job: Job) -> Floats:
    """(rates, groups + 1) mean squared difference to the fastest, and error of eta0, in sigmas."""
    variant, index, truth, factor = job
    robot = load_robot("auriga-alpha")
    density = factor * robot.tracks.speed_noise_density
    tracks = msgspec.structs.replace(robot.tracks, speed_noise_density=density)
    robot = msgspec.structs.replace(robot, tracks=tracks)
    finals, errors = [], []
    for rate in RATES:
        log, true = noisy_log(robot, rate, index, truth)
        estimator = PoseEstimator(robot, variant)
        for measurement in log.measurements():
            estimator.feed(measurement)
        state, sigma = estimator.state, np.sqrt(np.diagonal(estimator.covariance))
        finals.append((state, sigma))
        errors.append((state[s.ETA0] - true) / sigma[s.ETA0])
    reference, sigma = finals[-1]
    known = sigma > 0.0
    squares = np.full((len(RATES), s.SIZE), np.nan)
    for row, (state, _) in enumerate(finals):
        squares[row, known] = ((state - reference)[known] / sigma[known]) ** 2
    means = [[np.nanmean(row[first:last]) for first, last in GROUPS.values()] for row in squares]
    return np.column_stack([means, errors])


def main() -> None:
    """Print the table."""
    parser = study_parser(__doc__, 10, ONLINE)
    parser.add_argument("--truth", choices=TRUTHS, default="friction")
    parser.add_argument("--track-noise", type=float, default=1.0, help="factor on its density")
    arguments = parser.parse_args()
    jobs = [
        (name, index, arguments.truth, arguments.track_noise)
        for name in arguments.variants
        for index in range(arguments.runs)
    ]
    scores = np.array(spread(score, jobs, arguments.workers))
    scores = scores.reshape(len(arguments.variants), arguments.runs, len(RATES), -1)
    print(f"{arguments.runs} runs of {SECONDS} s for each row\n")
    rows = []
    for name, found in zip(arguments.variants, scores, strict=True):
        for column, group in enumerate(GROUPS):
            if group == "eta0" and group not in parameter_names(find_variant(name)):
                continue
            cells = [
                told(*bootstrap(lambda x: np.sqrt(x[..., 0].mean(-1)), found[:, row, [column]]))
                for row in range(len(RATES) - 1)
            ]
            rows.append([f"`{name}`", group, *cells])
    head = [f"{rate} Hz, sigma (95 %)" for rate in RATES[:-1]]
    table(("variant", "difference in", *head), rows)
    if arguments.truth != "kinematic":
        return
    print()
    table(
        ("variant", *(f"eta0 off at {rate} Hz, sigma (95 %)" for rate in RATES)),
        [
            [f"`{name}`", *(told(*mean_interval(row)) for row in found[:, :, -1].T)]
            for name, found in zip(arguments.variants, scores, strict=True)
        ],
    )


if __name__ == "__main__":
    main()
