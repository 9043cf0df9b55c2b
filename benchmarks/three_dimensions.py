"""Height, roll and pitch beside what people use, over simulated hills and the logs of a Warthog.

    python benchmarks/three_dimensions.py DATA [--runs 4] [--workers N]

- integration: speed of the wheels along the attitude of the IMU, yaw by the gyro
- robot_localization: its EKF in three dimensions on filterpy (position, attitude, speed, rates), fed with
  the speed of the wheels, all three gyros, and roll and pitch of the IMU
- `gyro` (no slopes), `constant-online`, `inertia-online`: with the files of the robots, as simulated

The attitude of the IMU is that of its driver: a complementary filter of all gyros and the direction of
the specific force, time constant 2 s: the best of 2, 8 and 30 s on the hills. Both know the biases of
the gyros by the first rest. Hills: 120 s of random driving, `--runs` runs of each of four robots. Roll
and pitch: RMS error after 10 s. Drift of the height after 30 s over the distance [%]: mean over all
segments, with a 95 % interval by runs. Height at the end: RMS error over the distance. NEES: that of the
height at the end. The truth of the Warthog is levelled for each estimator by its own mean vertical, in
the map and in the axes of the robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from _study import data_parser, mean_interval, spread, table
from accuracy import calibrated, cut, folds
from filterpy.kalman import ExtendedKalmanFilter

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.frames import rpy_to_matrix
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.estimator.streaming.run import run
from icreckon.replay.comparison.truth_alignment import align_truth
from icreckon.replay.comparison.truth_level import spatial_scores
from icreckon.replay.reading.read_log import read_log
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import Terrain

OURS = ("gyro", "constant-online", "inertia-online")
PEERS = ("integration", "robot_localization")
ROBOTS = ("auriga-alpha", "warthog", "husky", "jackal")
GROUNDS = {
    "plane of 10°": Terrain(slope_deg=10.0, uphill_deg=30.0),
    "rolling, 10°": Terrain(rolling_deg=10.0),
    "rolling, 5°": Terrain(rolling_deg=5.0),
}
DRIVER_TIME, SETTLED, SECONDS = 2.0, 10.0, 120.0
# Noise of the EKF: of driver angles [rad], speed [m/s], gyros [rad/s]; walks of speed and rates, per √s.
ANGLE, SPEED, RATE, SPEED_WALK, RATE_WALK = 0.02, 0.02, 0.01, 5.0, 10.0
WARTHOG = "Warthog logs"
Step = Callable[[float, float, Floats, Floats], tuple[Floats, Floats]]


class Score(NamedTuple):
    """Figures of a run: tilt [deg], drift and end of the height [%], its NEES."""

    tilt: float
    drift: float
    end: float
    nees: float


class Integration:
    """Position and attitude by wheels, gyros and the IMU's driver."""

    def __init__(self) -> None:
        self._position, self._yaw = np.zeros(3), 0.0

    def step(self, dt: float, speed: float, rates: Floats, tilt: Floats) -> tuple[Floats, Floats]:
        """Move by a sample of the IMU; return position and roll, pitch, yaw."""
        roll, pitch = tilt.tolist()
        turning = rates[1] * math.sin(roll) + rates[2] * math.cos(roll)
        self._yaw += turning / math.cos(pitch) * dt
        rpy = np.array([roll, pitch, self._yaw])
        self._position = self._position + rpy_to_matrix(roll, pitch, self._yaw)[:, 0] * speed * dt
        return self._position, rpy


class RobotLocalization:
    """EKF of position, attitude, forward speed and three rates, as robot_localization's."""

    def __init__(self) -> None:
        self._ekf = ExtendedKalmanFilter(dim_x=10, dim_z=6)
        self._ekf.x = np.zeros(10)
        self._ekf.P = np.diag([0.0] * 3 + [0.1, 0.1, 0.0] + [1.0] * 4)
        self._H = np.zeros((6, 10))
        self._H[range(6), (3, 4, 6, 7, 8, 9)] = 1.0
        self._R = np.diag(np.square([ANGLE, ANGLE, SPEED, RATE, RATE, RATE]))

    @staticmethod
    def _rate(x: Floats) -> Floats:
        """Time derivative of a state."""
        roll, pitch, yaw = x[3:6]
        sin, cos = np.sin(roll), np.cos(roll)
        along = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
        turning = x[8] * sin + x[9] * cos
        angles = [x[7] + turning * np.tan(pitch), x[8] * cos - x[9] * sin, turning / np.cos(pitch)]
        return np.array([*(along * x[6]), *angles, *([0.0] * 4)])

    def step(self, dt: float, speed: float, rates: Floats, tilt: Floats) -> tuple[Floats, Floats]:
        """Predict, update by a sample; return position and roll, pitch, yaw."""
        ekf, small = self._ekf, 1e-20
        steps = ekf.x + 1j * small * np.eye(10)
        by_state = np.array([self._rate(one).imag / small for one in steps]).T
        F = np.eye(10) + by_state * dt
        walks = np.array([0.0] * 6 + [SPEED_WALK] + [RATE_WALK] * 3)
        ekf.x = ekf.x + self._rate(ekf.x) * dt
        ekf.P = F @ ekf.P @ F.T + np.diag(walks**2 * dt)
        z = np.array([*tilt, speed, *rates])
        ekf.update(z, lambda _: self._H, lambda x: self._H @ x, R=self._R)
        return ekf.x[:3], ekf.x[3:6]


def by_peer(log: Log, robot: Robot, step: Step) -> Trajectory:
    """Run a peer over a log."""
    assert log.imu is not None  # noqa: S101 - all logs here have one
    assert log.imu.linear_acceleration is not None  # noqa: S101
    turn, stamps = robot.imu_rotation, log.imu.stamps
    rates, forces = log.imu.angular_velocity @ turn.T, log.imu.linear_acceleration @ turn.T
    radii = np.array([1.0 - 0.5 * robot.tracks.difference, 1.0 + 0.5 * robot.tracks.difference])
    speeds = np.interp(stamps, log.tracks.stamps, log.tracks.speeds @ radii * 0.5)
    resting = np.abs(speeds) < 1e-3
    first = int(np.argmin(resting)) if resting[0] else 0
    rates = rates - (rates[:first].mean(axis=0) if first > 100 else np.zeros(3))
    rates[:, 2] /= robot.imu.gyro_scale
    if first <= 100:
        rates[:, 2] -= robot.imu.gyro_bias
    up, rows = forces[0] / np.linalg.norm(forces[0]), []
    for k, (dt, speed) in enumerate(zip(np.diff(stamps) * NANOSECOND, speeds[1:], strict=True)):
        share = forces[k + 1] / max(np.linalg.norm(forces[k + 1]), 1.0)
        up = up - np.cross(rates[k + 1], up) * dt + (share - up) * (dt / DRIVER_TIME)
        up = up / np.linalg.norm(up)
        tilt = np.array([math.atan2(up[1], up[2]), -math.asin(min(1.0, max(-1.0, up[0])))])
        position, rpy = step(dt, speed, rates[k + 1], tilt)
        rows.append([*position, *rpy])
    found = np.array(rows)
    nothing, none = np.zeros((len(found), 3, 3)), np.full((len(found), 3), np.nan)
    poses, spatial = found[:, [0, 1, 5]], found[:, [2, 3, 4]]
    return Trajectory(stamps[1:], poses, nothing, none, nothing, spatial, none)


def scores(log: Log, robot: Robot, *, level: bool) -> dict[str, Score]:
    """Scores of all estimators over a log."""
    assert log.truth is not None  # noqa: S101 - all logs here have one
    blind = replace(log, truth=None)
    paths = {name: run(blind, robot, name).trajectory for name in OURS}
    peers: tuple[Step, ...] = (Integration().step, RobotLocalization().step)
    for name, step in zip(PEERS, peers, strict=True):
        paths[name] = by_peer(blind, robot, step)
    found = {}
    for name, path in paths.items():
        truth = (align_truth(log.truth, path).truth if level else log.truth).poses
        settled = log.start + int(SETTLED / NANOSECOND)
        late = truth.rows(truth.stamps > settled)
        of_tilt = spatial_scores(path, late, [])
        whole = spatial_scores(path, truth, [(log.start, log.end)])
        distance = float(np.hypot(*np.diff(truth.poses[:, :2], axis=0).T).sum())
        end, sigma = whole["final_height_error_m"], whole["final_height_sigma_m"]
        tilt = math.hypot(of_tilt["rms_roll_deg"], of_tilt["rms_pitch_deg"]) / math.sqrt(2.0)
        drift = whole["height_drift_percent_30s_mean"]
        found[name] = Score(tilt, drift, 100.0 * end / distance, (end / sigma) ** 2)
    return found


def simulated(case: tuple[str, str, int]) -> dict[str, Score]:
    """Scores over a simulated drive."""
    robot_name, ground, seed = case
    robot = load_robot(robot_name)
    scenario = Scenario(duration=SECONDS, seed=seed, truth="friction", terrain=GROUNDS[ground])
    return scores(simulate(scenario, robot), robot, level=False)


def main() -> None:
    """Print the table."""
    parser = data_parser(__doc__)
    parser.add_argument("--runs", type=int, default=4)
    given = parser.parse_args()
    cases = [
        (robot, ground, k) for ground in GROUNDS for robot in ROBOTS for k in range(given.runs)
    ]
    runs = spread(simulated, cases, given.workers)
    found = [(ground, one) for (_, ground, _), one in zip(cases, runs, strict=True)]
    for fold in folds():
        if "warthog" in fold.scored.log:
            robot, _ = calibrated(given.data, fold)
            log = cut(read_log(given.data / fold.scored.log, robot), fold.scored)
            found.append((WARTHOG, scores(log, robot, level=True)))
    rows = []
    for ground in (*GROUNDS, WARTHOG):
        for name in (*PEERS, *OURS):
            of = [one[name] for where, one in found if where == ground]
            tilt, drift, end, nees = (np.array(one) for one in zip(*of, strict=True))
            rows.append(
                (
                    ground,
                    name if name in PEERS else f"`{name}`",
                    f"{np.sqrt(np.mean(tilt**2)):.2f}",
                    "{:.2f} ({:.2f} to {:.2f})".format(*mean_interval(drift)),
                    f"{np.sqrt(np.mean(end**2)):.2f}",
                    "" if name in PEERS else f"{nees.mean():.1f}",
                )
            )
    head = (
        "ground",
        "estimator",
        "roll, pitch: RMS deg",
        "drift of the height, 30 s, %",
        "height at the end, RMS %",
        "NEES (1)",
    )
    table(head, rows)


if __name__ == "__main__":
    main()
