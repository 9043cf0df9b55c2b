"""Healthy drives of the scoreboard: robots, grounds, ways of driving, IMU grades; friction is the truth.

Each robot's file is the one that its filter gets. Fixes of 5 cm come once a second for 100 s, then the
robot drives on for 200 s without. Every 10 s a motion of 30 s begins: its error over the distance is the
drift. NEES is the pose's since the last fix, every 10 s, over three degrees of freedom (1 is ideal).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
from _scoreboard_cells import SEED, Job, excluded, flags, interval_of_ratio, rules_disabled

from icreckon.estimator.base.array_types import Floats, Stamps
from icreckon.estimator.base.frames import relative, wrap_angle
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import interpolate_poses
from icreckon.estimator.log.series import PoseSeries, TrackSpeedSeries
from icreckon.estimator.robot.robot_file import Imu, Indices, Robot, Vehicle, load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.soil import Soil
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.contact.of_robot import contact_of, slow_turns
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate
from icreckon.simulation.truth.terrain import Patch, Terrain

FIXES_END, DURATION, HORIZON, MARK_EVERY = 100.0, 300.0, 30.0, 10.0
SECOND = 1_000_000_000
RUNS = 2
"""Runs of a cell, each with a seed of its own."""
SHIPPED = ("auriga-alpha", "husky", "jackal", "marmotte", "warthog")
"""Shipped robots; husky-deflated is a husky, and of wetexplorer no geometry is known."""
HEIGHT = 0.3
"""Height of the centre of mass over the gauge, of a robot whose file has none [-]."""
LOW = (0.04, 0.015, 0.3)
"""Centre of mass of auriga-alpha, whose own of 0.754 m tips it over on slopes [m]."""
USUAL = Soil(friction=0.8, rolling_resistance=0.05)
"""Ground of robots whose file has none."""
KERB = 0.4
"""Height of a kerb, over the highest that the simulator allows; it rises over the contact's length."""
SPOT_TURN, SPOT_STRAIGHT = (1.5, 4.0), (3.0, 6.0)
"""Durations of turns on the spot, and of the straight drives between them [s]."""


def built(name: str, gauge: float, mass: float, half: float, points: int, top: float) -> Robot:
    """Robot that is not shipped, with an IMU that is mounted square."""
    vehicle = Vehicle(
        mass=mass,
        track_gauge=gauge,
        sprocket_radius=0.1,
        centre_of_mass=(0.05 * half, 0.0, HEIGHT * gauge),
        half_contact_length=half,
        contact_points=points,
        max_track_speed=top,
    )
    imu = Imu(gyro_noise_density=0.001, accelerometer_noise_density=0.1)
    return Robot(name=name, vehicle=vehicle, imu=imu, soil=USUAL)


BUILT = {
    "small": built("small", 0.4, 20.0, 0.15, 2, 1.0),
    "large": built("large", 2.0, 3000.0, 1.2, 7, 1.5),
    "fast": built("fast", 0.8, 120.0, 0.35, 2, 4.0),
}
ROBOTS = (*SHIPPED, *BUILT)
DRIVES = ("gentle", "random", "aggressive", "on the spot")
GRADES = ("nominal", "consumer", "industrial", "tactical")
# What the data sheet of a grade states, in the units of `[imu]`; as in the study imu-grades.
DATA_SHEETS: dict[str, dict[str, float]] = {
    "nominal": {},
    "consumer": {
        "gyro_range": 8.7,
        "gyro_noise_density": 1.7e-4,
        "gyro_bias_sigma": 1.7e-2,
        "gyro_bias_walk": 6e-5,
        "gyro_scale_sigma": 0.01,
        "accelerometer_bias_sigma": 0.5,
        "accelerometer_bias_walk": 1.5e-3,
    },
    "industrial": {
        "gyro_range": 7.8,
        "gyro_noise_density": 1.2e-4,
        "gyro_bias_sigma": 3.5e-3,
        "gyro_bias_walk": 7e-6,
        "gyro_scale_sigma": 3e-3,
        "accelerometer_bias_sigma": 0.05,
        "accelerometer_bias_walk": 1e-4,
    },
    "tactical": {
        "gyro_range": 7.0,
        "gyro_noise_density": 4.4e-5,
        "gyro_bias_sigma": 5e-5,
        "gyro_bias_walk": 3e-7,
        "gyro_scale_sigma": 5e-4,
        "accelerometer_bias_sigma": 0.02,
        "accelerometer_bias_walk": 1e-4,
    },
}
ICE, SOFT = 0.25, 0.15
"""Friction, and rolling resistance, of ground that begins on the way [-]."""
# Grass, gravel and a slippery stretch in turn.
CHANGING = tuple(
    Patch(time=(20.0 * k, 20.0 * (k + 1)), friction=friction, rolling_resistance=rolling)
    for k, (friction, rolling) in enumerate(((0.9, 0.07), (0.6, 0.03), (0.4, 0.1)) * 5)
)
UNDER, AFTER = (40.0, DURATION + 1.0), (140.0, DURATION + 1.0)
GROUNDS: dict[str, tuple[Terrain, tuple[Patch, ...]]] = {
    "level": (Terrain(), ()),
    **{
        f"plane {slope}° to {uphill}°": (Terrain(slope_deg=slope, uphill_deg=uphill), ())
        for slope in (3, 6, 10)
        for uphill in (30, 120)
    },
    "rolling 5°": (Terrain(rolling_deg=5.0), ()),
    "rolling 10°": (Terrain(rolling_deg=10.0), ()),
    "kerbs": (Terrain(kerb_height=KERB), ()),
    "ice under fixes": (Terrain(), (Patch(time=UNDER, friction=ICE),)),
    "ice after fixes": (Terrain(), (Patch(time=AFTER, friction=ICE),)),
    "soft under fixes": (Terrain(), (Patch(time=UNDER, rolling_resistance=SOFT),)),
    "soft after fixes": (Terrain(), (Patch(time=AFTER, rolling_resistance=SOFT),)),
    "changes every 20 s": (Terrain(), CHANGING),
}


class Cell(NamedTuple):
    """A healthy cell: level of each factor."""

    robot: str
    ground: str
    drive: str
    grade: str

    @property
    def name(self) -> str:
        """Its name."""
        return " | ".join(self)


def cells() -> list[Cell]:
    """Balanced design of 240 cells: each pair of levels of two factors occurs.

    Each robot meets each ground twice, in two ways of driving and with two IMU grades.
    """
    found = []
    for r, robot in enumerate(ROBOTS):
        for g, ground in enumerate(GROUNDS):
            for k in range(2):
                drive = DRIVES[(r + g + 2 * k) % 4]
                grade = GRADES[(r // 2 + g + (g // 4) + k + 2 * (r % 2)) % 4]
                found.append(Cell(robot, ground, drive, grade))
    return found


@cache
def robot_of(name: str, *, sloped: bool) -> Robot:
    """Robot as simulated and as in the filter's file: its effective track is that of its contact."""
    if name == "auriga-alpha":
        robot = load_robot(name)
        if not sloped:
            return robot
        vehicle = msgspec.structs.replace(robot.vehicle, centre_of_mass=LOW)
        return msgspec.structs.replace(robot, vehicle=vehicle)
    robot = BUILT.get(name) or load_robot(name)
    vehicle = robot.vehicle
    if not vehicle.centre_of_mass[2]:
        x, y, _ = vehicle.centre_of_mass
        height = HEIGHT * vehicle.track_gauge
        vehicle = msgspec.structs.replace(vehicle, centre_of_mass=(x, y, height))
    robot = msgspec.structs.replace(
        robot,
        vehicle=vehicle,
        soil=USUAL if robot.soil == Soil() else robot.soil,
        indices=Indices(),
        constant_icr=None,
    )
    eta = float(np.mean(slow_turns(contact_of(robot)).eta))
    return msgspec.structs.replace(robot, indices=Indices(eta0=round(max(eta, 1.0), 3)))


def on_the_spot(robot: Robot, rng: np.random.Generator, duration: float) -> TrackSpeedSeries:
    """Turns on the spot to either side, with straight drives between them."""
    top = robot.vehicle.max_track_speed
    times, speeds, now = [0.0], [(0.0, 0.0)], 0.0
    while now < duration:
        for turns in (True, False):
            lasts = rng.uniform(*(SPOT_TURN if turns else SPOT_STRAIGHT))
            speed = top * rng.uniform(0.3, 0.6)
            side = rng.choice((-1.0, 1.0))
            pair = (-side * speed, side * speed) if turns else (speed, speed)
            ramp = 1.9 * (top + speed)
            now += ramp
            times.append(now)
            speeds.append(pair)
            now += lasts
            times.append(now)
            speeds.append(pair)
    stamps = np.round(np.array(times) * SECOND).astype(np.int64)
    return TrackSpeedSeries(stamps, np.array(speeds))


def drive_options(robot: Robot, drive: str) -> dict[str, Any]:
    """Keys of a scenario for a way of driving."""
    if drive == "gentle":
        gauge = robot.vehicle.track_gauge
        options = {"speed": 0.4, "tightest": 4.0 * gauge, "widest": 40.0 * gauge}
        return {"trajectory": "arcs", "trajectory_options": options}
    return {"trajectory": "recorded" if drive == "on the spot" else drive}


def simulated(cell: Cell, run: int) -> tuple[Log, Robot]:
    """Log of a run of a cell, and the robot file of its filters."""
    terrain, patches = GROUNDS[cell.ground]
    robot = robot_of(cell.robot, sloped=not terrain.is_level)
    if terrain.kerb_height:
        highest = robot.vehicle.half_contact_length * np.tan(np.radians(30.0))
        terrain = msgspec.structs.replace(terrain, kerb_height=float(KERB * highest))
    scenario = Scenario(
        duration=DURATION,
        seed=SEED,
        noise=cell.grade,
        outages=((FIXES_END, DURATION),),
        terrain=terrain,
        patches=patches,
        truth_rate=10.0,
        **drive_options(robot, cell.drive),
    )
    index = 1000 * cells().index(cell) + run
    recording = None
    if cell.drive == "on the spot":
        recording = on_the_spot(robot, np.random.default_rng([SEED, index]), DURATION)
    log = simulate(scenario, robot, run_index=index, recording=recording)
    imu = msgspec.structs.replace(robot.imu, **DATA_SHEETS[cell.grade])
    return log, msgspec.structs.replace(robot, imu=imu)


def score(job: Job) -> dict[str, Any]:
    """Figures of each variant in a run of a healthy cell."""
    log, robot = simulated(Cell(*job.cell.split(" | ")), job.run)
    measurements = list(log.measurements())
    with rules_disabled(job.without):
        return {name: scored(log, measurements, robot, name) for name in job.variants}


def scored(log: Log, measurements: list[Any], robot: Robot, variant: str) -> dict[str, Any]:
    """Errors [m], distances [m] and NEES of the motions, exclusions and flags of a variant."""
    estimator = PoseEstimator(robot, variant, settings=Settings(history=0.0))
    if log.truth is None or log.imu is None:
        raise ValueError("a simulated log has an IMU and a truth")
    times = np.arange(FIXES_END, DURATION - 0.5, MARK_EVERY)
    due = iter([*(log.start + round(at * SECOND) for at in times), log.end + SECOND])
    next_stamp, stamps, poses, covariances = next(due), [], [], []
    for measurement in measurements:
        estimator.feed(measurement)
        now = estimator.stamp
        if now is not None and now >= next_stamp:
            stamps.append(now)
            poses.append(estimator.pose)
            covariances.append(estimator.pose_covariance)
            next_stamp = next(due)
    health = estimator.health
    rules, gates = excluded(health)
    truth = log.truth.poses
    errors, distances = motions(np.array(stamps), np.array(poses), truth)
    off = np.array(poses) - interpolate_poses(truth, np.array(stamps))
    off[:, 2] = wrap_angle(off[:, 2])
    P = np.array(covariances) + 1e-12 * np.eye(3)
    nees = np.einsum("ij,ij->i", off, np.linalg.solve(P, off[..., None])[..., 0]) / 3.0
    return {
        "errors": errors,
        "distances": distances,
        "nees": nees[1:].tolist(),
        "rules": rules,
        "gates": gates,
        "readings": len(log.imu.stamps),
        "flags": flags(health),
        "hours": log.duration / 3600.0,
    }


def motions(stamps: Stamps, poses: Floats, truth: PoseSeries) -> tuple[list[float], list[float]]:
    """Errors and distances of motions over `HORIZON` between poses at `MARK_EVERY` [m]."""
    step = round(HORIZON / MARK_EVERY)
    errors, distances = [], []
    true = interpolate_poses(truth, stamps)
    for begin in range(len(stamps) - step):
        end = begin + step
        off = relative(poses[begin], poses[end]) - relative(true[begin], true[end])
        grid = np.linspace(stamps[begin], stamps[end], 61).round().astype(np.int64)
        path = interpolate_poses(truth, grid)[:, :2]
        errors.append(float(np.hypot(*off[:2])))
        distances.append(float(np.hypot(*np.diff(path, axis=0).T).sum()))
    return errors, distances


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of a cell by variant, of its runs."""
    found = {}
    of_gyro = blocks([one["gyro"] for one in runs])
    for name in runs[0]:
        own = [one[name] for one in runs]
        errors, distances = blocks(own)
        drift, low, high = interval_of_ratio(errors, distances)
        readings = sum(one["readings"] for one in own)
        hours = sum(one["hours"] for one in own)
        counted = {key: sum(one["flags"][key] for one in own) for key in own[0]["flags"]}
        ratio = interval_of_ratio(errors, of_gyro[0])
        found[name] = {
            "drift": 100.0 * drift,
            "drift_low": 100.0 * low,
            "drift_high": 100.0 * high,
            "ratio": ratio[0],
            "ratio_low": ratio[1],
            "ratio_high": ratio[2],
            "nees": float(np.mean([value for one in own for value in one["nees"]])),
            "rules_percent": 100.0 * share(own, "rules", readings),
            "gates_percent": 100.0 * share(own, "gates", readings),
            "flags": {key: value for key, value in counted.items() if value},
            "hours": hours,
            "rules": sorted({key for one in own for key in one["rules"]}),
            "runs": len(own),
        }
    return found


def share(own: list[dict[str, Any]], what: str, readings: int) -> float:
    """Rejected measurements over the number of IMU samples."""
    return float(sum(sum(one[what].values()) for one in own) / readings)


def blocks(own: list[dict[str, Any]]) -> tuple[Floats, Floats]:
    """Errors and distances summed over blocks of `HORIZON`, of all runs."""
    width = round(HORIZON / MARK_EVERY)
    parts: list[list[Floats]] = [
        [np.add.reduceat(one[key], range(0, len(one[key]), width)) for one in own]
        for key in ("errors", "distances")
    ]
    return np.concatenate(parts[0]), np.concatenate(parts[1])


def jobs(picked: list[Cell], variants: tuple[str, ...], without: tuple[str, ...]) -> Iterator[Job]:
    """Jobs of cells."""
    for cell in picked:
        for run in range(RUNS):
            yield Job("healthy", cell.name, run, variants, without)
