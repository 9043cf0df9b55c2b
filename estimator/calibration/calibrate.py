"""Calibration of a robot from logs, from segments to a calibrated robot file."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.calibration.assembly import as_fitted, assembled, with_difference
from icreckon.estimator.calibration.common_values import with_common
from icreckon.estimator.calibration.cross_validation import validate
from icreckon.estimator.calibration.fit import Fit, fit
from icreckon.estimator.calibration.ground_forces import ground_forces
from icreckon.estimator.calibration.models import MODELS, model_of
from icreckon.estimator.calibration.residuals import ALONG, TRACK_PARAMETERS, Problem, problem_of
from icreckon.estimator.calibration.result import Calibration
from icreckon.estimator.calibration.segments import Recording, motion_of, record
from icreckon.estimator.log import lag
from icreckon.estimator.log.failed_sensors import rates_at, stuck_sides
from icreckon.estimator.log.lever_arm import headings_and_lever_arm
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault, headings_by_path
from icreckon.estimator.log.scores import path_length
from icreckon.estimator.log.series import PoseSeries, require_part, running_integral
from icreckon.estimator.robot.robot_file import Robot, require_robot
from icreckon.estimator.sensors.sensor_models import SensorModels

SEGMENT = 3.0  # length of a segment [s]
SHORTEST_SEGMENT, LONGEST_SEGMENT = 1.0, 20.0  # limits of that length [s]
# A truth is at rest below this share of the distance of the tracks [-], if that is longer than this [m].
LEAST_MOVED_SHARE, LEAST_DRIVEN = 0.02, 1.0
CLEAR_CORRELATION, OTHER_UNIT_RATIO = 0.8, 2.0
"""Correlation of turning by gyro and truth that shows their ratio, and a ratio that no scale explains."""
STEEP_SLOPE = 0.03  # from here headings by a path lean downhill: they show no gyro scale [rad]
OPPOSITE_CORRELATION = -0.3  # of a motion by gyro or tracks with the truth: one has the wrong sign


def calibrate(
    logs: Sequence[Log] | Log,
    robot: Robot,
    *,
    segment: float = SEGMENT,
    lever_arm: tuple[float, float] | None = None,
    models: Sequence[str] = MODELS,
    speeds_by_radius: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Calibrate a robot's parameters from logs with a pose truth.

    Headings of a truth of positions alone (RTK GPS, a total station) are found from the path.

    The method is maximum likelihood over segments. The two tracks may have different effective radii.
    The truth may lag, and may be of another point of the robot than base_link. If neither this point nor
    the IMU's position is known (the robot file's default [0, 0, 0] counts as unknown), the turning centre
    in the robot is unobservable. Then the parameters that place it (zeta0, epsilon0) are held, and the
    lever arm is relative to them.

    Args:
        logs: a log or several of one robot, each with track speeds [m/s] made with the robot's sprocket
            radius, IMU samples and a truth; slices of logs are allowed.
        robot: the robot as described by its file; unobservable parameters keep these values.
        segment: length of a segment [s].
        lever_arm: point of the truth in base_link, forward and left [m], if known.
        models: models of `MODELS` to fit and compare, "constant" among them.
        speeds_by_radius: True if the track speeds were made with the sprocket radius, so that their scale
            corrects it; otherwise that in `log.tracks`, or without a log `tracks.scale_sigma` and a note.
        progress: called with the share done, 0 to 1.

    Returns:
        The calibrated robot, every parameter with its standard error, the observable parameters, and
        the supported model.

    Raises:
        EstimatorError: no log, a log without truth, IMU or tracks, too little driving or turning,
            signs or units that contradict each other, a truth that turns differently from the gyro, or
            an invalid option.
    """
    require_robot(robot)
    logs = [logs] if isinstance(logs, Log) else logs
    for log in logs:
        require_part("each of logs", log, Log)
    chosen = _in_order(models)
    if not logs:
        raise EstimatorError("no log to calibrate from; give one or more")
    if not SHORTEST_SEGMENT <= segment <= LONGEST_SEGMENT:
        limits = f"{SHORTEST_SEGMENT:g} to {LONGEST_SEGMENT:g} s"
        raise EstimatorError(f"segments must be {limits} long, found {segment!r}")
    report_share = progress or (lambda _: None)
    _check_logs(logs, robot)
    headed = [_with_headings(log, robot) for log in logs]
    motions = [replace(motion_of(log, robot), own_headings=not remarks) for log, remarks in headed]
    slopes = [
        0.0 if m.own_headings else ground_forces(m.log, robot, 1.0, 0.0).slope for m in motions
    ]
    is_steep = max(slopes) > STEEP_SLOPE
    held_always = frozenset({"gyro_scale"} if is_steep else ())

    def problem(name: str, recording: Recording) -> Problem:
        place_known = any(robot.imu.position)
        model = model_of(name, robot)
        return problem_of(recording, model, robot, lever_arm=lever_arm, imu_place_known=place_known)

    # First with the initial lags; then the truth is carried over to knots with the estimated ones.
    first_recording = record(motions, robot, segment, difference=robot.tracks.difference)
    first = _first_fit(problem("constant", first_recording), held_always)
    report_share(0.1)
    recording = _recorded_again(first_recording, robot, first)

    def fit_again(name: str, start: dict[str, float], held: frozenset[str]) -> Fit:
        return fit(problem(name, recording), initial=start, held=held | held_always)

    fits: dict[str, Fit] = {}
    for number, name in enumerate(chosen):
        fits[name] = fit_again(name, first.by_name, frozenset())
        report_share(0.1 + 0.6 * (number + 1) / len(chosen))
    # The radii are the robot's, not a model's: a model that lacks an effect must not hide it in them.
    likeliest = max(validate(fits).scores, key=lambda score: score.log_likelihood)
    radii = fits[likeliest.model]
    shared = with_difference(fits, radii.value("difference"), fit_again)
    comparison = validate(shared)
    report_share(0.9)
    calibration = assembled(
        robot, fits, shared, radii, comparison, fit_again, speeds_by_radius=speeds_by_radius
    )
    report_share(1.0)
    remarks = [*chain.from_iterable(log_remarks for _, log_remarks in headed)]
    if is_steep:
        remarks.append(
            f"the ground slopes by {math.degrees(max(slopes)):.0f}°: headings from a path lean downhill "
            "there, so the gyro's scale is held"
        )
    return replace(calibration, notes=(*calibration.notes, *remarks))


def _first_fit(problem: Problem, held: frozenset[str]) -> Fit:
    """Fit with the initial lags; reject signs, units and clocks that are wrong."""
    _check_signs(problem)
    for motion in problem.recording.motions:
        if motion.no_lag == lag.NOWHERE:
            raise EstimatorError(
                f"log {motion.log.name!r}: truth and gyro turn otherwise, at whatever lag: "
                f"{motion.no_lag.reason}; check topic, yaw and clock of [log.truth]"
            )
    return fit(problem, held=held)


def _recorded_again(recording: Recording, robot: Robot, first: Fit) -> Recording:
    """Cut logs again, with the lags, biases, radii and ground forces of a first fit."""
    scale, difference, latency = (first.value(name) for name in TRACK_PARAMETERS)
    fitted = as_fitted(robot, first)
    # The ground forces need the fitted mounting of the IMU.
    mounted = with_common(fitted, first, radii=first, supported=[first], speeds_by_radius=True)
    motions = [
        replace(
            motion,
            lag=first.value(f"lag[{log}]"),
            bias=first.value(f"gyro_bias[{log}]"),
            forces=ground_forces(motion.log, mounted, scale, latency),
        )
        for log, motion in enumerate(recording.motions)
    ]
    return record(motions, fitted, recording.length, scale=scale, difference=difference)


def _check_logs(logs: Sequence[Log], robot: Robot) -> None:
    """Reject logs with a stuck side, or with a truth at rest while the tracks drive."""
    for log in logs:
        turning = None  # V_r - V_l by the gyro [m/s]
        if log.imu is not None:
            rates = SensorModels(robot).yaw_rates(log.imu.angular_velocity)
            turning = robot.effective_track * rates_at(log.tracks, log.imu.stamps, rates)
        if stuck := stuck_sides(log.tracks, turning):
            raise EstimatorError(
                f"log {log.name!r}: {stuck[0].text}; look at its sensor, cable and topic"
            )
        if log.truth is None or len(log.tracks.stamps) < 2 or len(log.truth.poses.stamps) < 2:
            continue
        speeds = np.abs(log.tracks.speeds.mean(axis=1))
        driven = float(running_integral(log.tracks.stamps, speeds)[-1])
        moved = float(path_length(log.truth.poses)[-1])
        if driven > LEAST_DRIVEN and moved < LEAST_MOVED_SHARE * driven:
            raise EstimatorError(
                f"log {log.name!r}: its truth moves {moved:.3g} m while the tracks drive {driven:.3g} m; "
                "look at its topic, unit and receiver"
            )


def _with_headings(log: Log, robot: Robot) -> tuple[Log, tuple[str, ...]]:
    """Log with headings in its truth, and a remark if these are from the path."""
    truth, imu = log.truth, log.imu
    if truth is None or imu is None or len(imu.stamps) < 2 or len(log.tracks.stamps) < 2:
        return log, ()
    rates = SensorModels(robot).yaw_rates(imu.angular_velocity)
    fault = heading_fault(truth, (imu.stamps, rates)) if truth.headings else "are missing"
    if fault is None:
        return log, ()
    path = lag.plain_path(log.tracks, imu, rates)
    places, path_places = lag.places_of(truth.poses), lag.places_of(path)
    found_lag = lag.find_lag(places, path_places, least=lag.LEAST_SPEEDING)
    lag_ns = 0 if isinstance(found_lag, lag.NoLag) else round(found_lag.seconds / NANOSECOND)
    late_path = PoseSeries(path.stamps + lag_ns, path.poses)
    headings = headings_by_path(truth.poses, late_path)
    if headings is not None:
        # Lever arm and headings need a path of the right length.
        scaled = replace(late_path, poses=path.poses * (headings.scale, headings.scale, 1.0))
        found = headings_and_lever_arm(truth.poses, scaled)
        headings = None if found is None else found[0]
    if headings is None:
        raise EstimatorError(
            f"log {log.name!r}: the headings of the truth {fault}, and the robot moves too little to "
            "find them from its path; drive a longer way, or give a truth with headings"
        )
    remark = (
        f"{log.name}: the headings of the truth {fault}; they were found from the path of tracks and "
        f"gyro, ± {math.degrees(headings.sigma):.1f}°. Sideslip looks like a heading then: zeta0, zeta1, "
        "y_ICR and the difference of the radii are less certain than stated. Of the gyro such headings "
        "show nothing: its scale and bias are by the tracks and the positions"
    )
    # Twists of such a truth are not used. The place is that of the tracked point.
    inside = np.isin(truth.poses.stamps, headings.poses.stamps)
    columns = np.column_stack([truth.poses.poses[inside, :2], headings.poses.poses[:, 2]])
    poses = replace(headings.poses, poses=columns)
    truth = replace(truth, poses=poses, twists=None, headings=True)
    return replace(log, truth=truth), (remark,)


def _in_order(wanted: Sequence[str]) -> list[str]:
    """Names of the wanted models, checked, in the order of `MODELS`."""
    for name in wanted:
        if name not in MODELS:
            raise EstimatorError(f"no model named {name!r}; there are {', '.join(MODELS)}")
    if "constant" not in wanted:
        raise EstimatorError("the model 'constant' must be among those that are compared")
    return [name for name in MODELS if name in wanted]


def _check_signs(problem: Problem) -> None:
    """Reject gyro or tracks that turn or drive against the truth, or in another unit."""
    recording = problem.recording
    moving = recording.moving
    _, _, yaw = recording.knots(np.array([motion.lag for motion in recording.motions]))
    speeds = recording.speeds(0.0)[moving]
    # Turning in each segment: by the truth, the gyro, and the tracks (in an arbitrary unit).
    by_truth = (yaw[recording.ends] - yaw[recording.starts])[moving]
    by_gyro = (recording.turned[:, -1] - recording.turned[:, 0])[moving]
    by_tracks = (speeds[..., 1] - speeds[..., 0]).sum(axis=1)
    for sensor, turning, hint in (
        ("the gyro", by_gyro, "correct rotation_rpy_deg in [imu]: `icreckon inspect` proposes it"),
        ("the tracks", by_tracks, "left and right may be swapped in [log.tracks]"),
    ):
        if _correlation(turning, by_truth) < OPPOSITE_CORRELATION:
            raise EstimatorError(f"{sensor} turned against the truth; {hint}")
    square = float(by_truth @ by_truth)
    ratio = float(by_gyro @ by_truth) / square if square > 0.0 else 1.0
    is_ratio_known = _correlation(by_gyro, by_truth) >= CLEAR_CORRELATION
    if is_ratio_known and not 1.0 / OTHER_UNIT_RATIO < ratio < OTHER_UNIT_RATIO:
        raise EstimatorError(
            f"the gyro turns {ratio:.3g} times as far as the truth: one of them is in another unit "
            "(57.3: the gyro is in deg/s)"
        )
    forward = speeds.mean(axis=-1).sum(axis=1) * recording.cell
    # Residuals are truth less model.
    true_forward = problem.rows(problem.start)[moving][:, ALONG] + forward
    moves = np.abs(speeds.mean(axis=-1)).sum() > 0.0
    if _correlation(true_forward, forward) < OPPOSITE_CORRELATION and moves:
        raise EstimatorError(
            "the tracks drove against the truth; the sign of the track speeds, or the truth's yaw, is "
            "reversed"
        )


def _correlation(a: Floats, b: Floats) -> float:
    """Correlation about zero, not about the means; 0 if one series is constant."""
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    return float((a @ b) / np.sqrt((a @ a) * (b @ b)))
