"""Assembly of fits: the calibrated robot, its parameters, and a verdict."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import msgspec
import numpy as np

from icreckon.estimator.calibration import common_values
from icreckon.estimator.calibration.common_values import FRICTION_KEPT, KEPT, finite
from icreckon.estimator.calibration.fit import Fit
from icreckon.estimator.calibration.residuals import ACROSS, ALONG, SLIP
from icreckon.estimator.calibration.result import (
    Calibration,
    FoundParameter,
    ModelComparison,
    OfLog,
    Residuals,
    Status,
)
from icreckon.estimator.robot.robot_file import Robot

Refit = Callable[[str, dict[str, float], frozenset[str]], Fit]
"""Fit of a model: its name, initial values, parameters to hold at these."""

LEAST_SHIFT = 0.1  # least difference of found and written value to note, in standard errors [-]
LEAST_CHANGE = 1e-3
"""A larger shift of the centre of mass [m] changes the meaning of the inertia-based parameters; a larger
change of a scale [-] changes the meaning of all parameters."""
TITLES = {
    "differential": "ideal differential drive",
    "constant": "constant ICRs",
    "inertia": "inertia-based ICRs",
}
PLURAL_TITLES = ("constant", "inertia")
PLANE = ("forward", "left")  # axes of places
COMMON_NAMES = {
    "scale": "sprocket_radius",
    "gyro_scale": "imu.gyro_scale",
    "track_latency": "track_latency",
    "mounting_yaw": "imu.yaw",
    "imu_forward": "imu.forward",
    "imu_left": "imu.left",
}
"""Parameters of all models, apart from the difference of the radii: name in the results by name."""
BY_TRACKS_ALONE = (
    "models are compared by the tracks alone, and all of them go into the file; which filter variant to "
    "run, with the gyro, icreckon replay shows on a log that was not calibrated with"
)
"""Note on the verdict."""
MOUNTING_KEYS = {
    **dict.fromkeys(("roll", "pitch", "yaw"), "rotation_rpy_deg"),
    **dict.fromkeys(("forward", "left"), "position"),
}
"""Keys of the IMU's mounting, by the names of their parts in the results."""
# Spread of parameters between logs on other ground, with other load or tyre pressure, which one log does
# not contain. Measured for three robots by `benchmarks/between_logs.py`: four logs of a Warthog on
# grass and asphalt, four parts of a log each of the tracked Marmotte and of a Husky with deflated tyres.
SIGMA_SHARES = {
    "sprocket_radius": 0.01,
    "track_scale": 0.01,
    "effective_track": 0.02,
    "constant_icr.x_ICRl": 0.02,
    "constant_icr.x_ICRr": 0.02,
    "indices.eta0": 0.02,
    "indices.zeta1": 0.1,
}
"""Standard deviation between logs, as a share of the value [-]."""
SIGMA_SIZES = {
    "tracks.difference": 0.003,
    "track_latency": 0.012,
    "imu.roll": 0.5,
    "imu.pitch": 0.5,
    "imu.yaw": 4.0,
    "imu.left": 0.05,
    "truth.forward": 0.02,
    "truth.left": 0.015,
}
"""Standard deviation between logs, in the parameter's unit."""


def assembled(
    robot: Robot,
    fits: Mapping[str, Fit],
    shared: Mapping[str, Fit],
    radii: Fit,
    comparison: ModelComparison,
    refit: Refit,
    *,
    speeds_by_radius: bool,
) -> Calibration:
    """Assemble the calibration from its parts.

    Args:
        robot: the robot as described by its file.
        fits: fit of each model, with its own difference of the radii.
        shared: fit of each model with the difference of the likeliest one.
        radii: fit of the likeliest model.
        comparison: comparison of the models in `shared`.
        refit: refits a model.
        speeds_by_radius: True if the scale of the track speeds corrects the sprocket radius.
    """
    chosen = shared[comparison.supported]
    supported = _supported_fits(fits, comparison)
    common_names = [name for name in COMMON_NAMES if name in chosen.problem.names]
    # One model explains by a latency what another explains by inertia: a value of the file is kept unless
    # all models that may be right contradict it.
    kept = frozenset[str]().union(*(fit.not_contradicted(common_names) for fit in supported))
    new = common_values.with_common(robot, chosen, radii, supported, speeds_by_radius, kept)
    notes = [BY_TRACKS_ALONE]
    if not speeds_by_radius and not robot.log:
        scale = f"{chosen.value('scale'):.4f}"
        notes.insert(0, f"track speeds are not by sprocket_radius: scale_sigma covers {scale}")
    written = chosen.with_start_of(kept)
    held = {name: written.value(name) for name in {"scale", *kept}}
    held["difference"] = new.tracks.difference
    kept_names = {COMMON_NAMES[name] for name in kept}
    if not speeds_by_radius:
        kept_names -= {"sprocket_radius"}
    refitted = dict(shared)
    for name in ("constant", "inertia"):
        if name in fits:
            refitted[name], new, kept_indices = _to_write(shared[name], name, new, held, refit)
            kept_names |= _result_names(name, kept_indices, shared[name])
    rows = _parameters(robot, new, fits, refitted, chosen, radii, speeds_by_radius)
    richest = fits.get("inertia", fits["constant"])
    free = np.flatnonzero(richest.free)
    covariance = richest.covariance[np.ix_(free, free)]
    sigmas = np.sqrt(np.diag(covariance))
    return Calibration(
        robot=new,
        parameters=tuple(_completed(row, robot, new, kept_names, chosen) for row in rows),
        correlation_names=tuple(richest.problem.names[place] for place in free),
        correlations=covariance / np.outer(sigmas, sigmas),
        logs=_logs(chosen),
        comparison=comparison,
        verdict=_verdict(comparison),
        residuals=_residuals(shared["constant"], chosen),
        notes=tuple(notes),
    )


def _to_write(
    shared_fit: Fit, name: str, new: Robot, held: dict[str, float], refit: Refit
) -> tuple[Fit, Robot, frozenset[str]]:
    """Refit a model with held common values, and put it into the new robot file.

    Also returns the names of parameters that the logs do not contradict, which keep the file's values.
    """
    model_fit = _refitted(shared_fit, name, held, refit)
    problem = model_fit.problem
    kept = model_fit.not_contradicted(p.name for p in problem.model.parameters)
    kept_values = {key: float(problem.start[problem.place(key)]) for key in kept}
    final = _refitted(model_fit, name, held | kept_values, refit, always=bool(kept))
    return model_fit, _put(final, new), kept


def _completed(
    row: FoundParameter, robot: Robot, new: Robot, kept_names: set[str], chosen: Fit
) -> FoundParameter:
    """Complete a row: error for other logs, note if it is kept, and `is_default`."""
    kept_note = ""
    if row.sigma and row.name in kept_names:
        table, _, key = row.name.rpartition(".")
        by_friction = table == "indices" and getattr(new.indices, key) != row.before
        kept_note = FRICTION_KEPT if by_friction else KEPT
    elif row.sigma and row.name.startswith("indices."):
        written = getattr(new.indices, row.name.removeprefix("indices."))
        if abs(written - row.value) > LEAST_SHIFT * row.sigma:
            kept_note = f"written: {written:.5g}, found again with those that are kept"
    if row.sigma is not None:
        between = SIGMA_SHARES.get(row.name, 0.0) * abs(row.value) + SIGMA_SIZES.get(row.name, 0.0)
        logs = len(chosen.problem.recording.motions)
        row = replace(row, sigma_other_logs=math.hypot(row.sigma, between / math.sqrt(logs)))
    note = "; ".join(filter(None, [row.note, kept_note]))
    is_default = row.before is not None and _is_default(robot, row.name)
    return replace(row, note=note, is_default=is_default)


def _is_default(robot: Robot, name: str) -> bool:
    """True if the robot file need not state a parameter, by its name in the results."""
    table_name, _, key = name.rpartition(".")
    tables: dict[str, msgspec.Struct] = {
        "": robot.vehicle, "imu": robot.imu, "tracks": robot.tracks, "indices": robot.indices,
    }  # fmt: skip
    table = tables.get(table_name)
    fields = () if table is None else msgspec.structs.fields(table)
    field = {field.name: field for field in fields}.get(MOUNTING_KEYS.get(key, key))
    return bool(field and not field.required and getattr(table, field.name) == field.default)


def _result_names(model: str, kept_indices: frozenset[str], fit: Fit) -> set[str]:
    """Names of results whose free indices are all kept at the file's values."""
    if model == "inertia":
        return {f"indices.{name}" for name in kept_indices}
    both = {"epsilon0", "eta0"}
    indices_of = {"constant_icr.x_ICRl": both, "constant_icr.x_ICRr": both}
    indices_of |= {"constant_icr.y_ICR": {"zeta0"}, "effective_track": {"eta0"}}
    free = {result: set(filter(fit.is_free, indices)) for result, indices in indices_of.items()}
    return {result for result, indices in free.items() if indices and indices <= kept_indices}


def with_difference(fits: Mapping[str, Fit], difference: float, refit: Refit) -> dict[str, Fit]:
    """Fit of each model with a given difference of the radii [-]."""
    held = {"difference": difference}
    return {name: _refitted(fit, name, held, refit) for name, fit in fits.items()}


def as_fitted(robot: Robot, fit: Fit) -> Robot:
    """Robot with the parameters of a fit's model, and with its scale of the gyro."""
    imu = msgspec.structs.replace(robot.imu, gyro_scale=fit.value("gyro_scale"))
    return _put(fit, msgspec.structs.replace(robot, imu=imu))


def _refitted(
    fit: Fit, name: str, held: dict[str, float], refit: Refit, always: bool = False
) -> Fit:
    """Refit the model `name` with held parameters, unless `fit` nearly has them."""
    changes = [abs(fit.value(key) - value) for key, value in held.items()]
    if not always and max(changes) <= LEAST_CHANGE:
        return fit
    return refit(name, fit.by_name | held, frozenset(held))


def _put(fit: Fit, robot: Robot) -> Robot:
    """Robot with the parameters of a fit's motion model."""
    return fit.problem.model.put_into(robot, fit.problem.own(fit.values))


def _supported_fits(fits: Mapping[str, Fit], comparison: ModelComparison) -> list[Fit]:
    """Fits of the models that may be right, the supported one included."""
    supported = comparison.supported

    def may_be_right(name: str) -> bool:
        pair = comparison.difference(supported, name)
        return pair.drift_low <= 0.0 <= pair.drift_high

    return [fit for name, fit in fits.items() if name == supported or may_be_right(name)]


def _parameters(
    robot: Robot,
    new: Robot,
    fits: Mapping[str, Fit],
    refitted: Mapping[str, Fit],
    chosen: Fit,
    radii: Fit,
    speeds_by_radius: bool,
) -> tuple[FoundParameter, ...]:
    """Rows of the results; values are of `refitted`, standard errors of `fits`."""
    radius, difference = robot.vehicle.sprocket_radius, robot.tracks.difference
    rows = [
        _row(chosen, "scale", "sprocket_radius", "m", factor=radius, before=radius)
        if speeds_by_radius
        else _row(chosen, "scale", "track_scale", "-", before=1.0, note="times log.tracks.scale")
    ]
    _, note = common_values.written_difference(robot, radii)
    rows.append(_row(radii, "difference", "tracks.difference", "-", before=difference, note=note))
    gyro_scale = _row(chosen, "gyro_scale", "imu.gyro_scale", "-", before=robot.imu.gyro_scale)
    value = float(common_values.vertical_gyro_scale(robot, chosen, new.imu_rotation))
    rows += [replace(gyro_scale, value=value), _bias(robot, chosen)]
    before, after = robot.imu.rotation_rpy_deg, new.imu.rotation_rpy_deg
    for axis, (_, error) in enumerate(common_values.mounting_turns(chosen)):
        name, is_known = ("imu.roll", "imu.pitch", "imu.yaw")[axis], np.isfinite(error)
        status: Status = "shown" if is_known else "held"
        sigma = float(np.degrees(error)) if is_known else None
        # The same angle within half a turn of the file's.
        value = before[axis] + math.remainder(after[axis] - before[axis], 360.0)
        rows.append(FoundParameter(name, "deg", value, sigma, status, before[axis]))
    if "imu_forward" in chosen.problem.names:
        rows += [_row(chosen, f"imu_{name}", f"imu.{name}", "m", before=0.0) for name in PLANE]
    rows += [_row(chosen, f"lever_arm_{name}", f"truth.{name}", "m") for name in PLANE]
    note = "extra delay, added to log.tracks.latency"
    rows.append(_row(chosen, "track_latency", "track_latency", "s", note=note))
    rows += _constant(robot, refitted["constant"], fits["constant"])
    if "inertia" in refitted:
        rows += _inertia(robot, refitted["inertia"], fits["inertia"])
    return tuple(rows)


def _bias(robot: Robot, chosen: Fit) -> FoundParameter:
    """Initial gyro bias: mean over the logs."""
    bias = common_values.common_bias(robot, chosen)
    note = "" if bias.written == bias.mean else KEPT
    status: Status = "held" if bias.error is None else "shown"
    before = robot.imu.gyro_bias
    return FoundParameter("imu.gyro_bias", "rad/s", bias.mean, bias.error, status, before, note)


def _status(fit: Fit, name: str) -> Status:
    """Status: held, shown by the logs, or shown on condition that held ones are right."""
    if not fit.is_free(name):
        return "held"
    return "shown" if fit.shown[fit.problem.place(name)] else "conditional"


def _row(
    fit: Fit,
    name: str,
    result_name: str,
    unit: str,
    *,
    factor: float = 1.0,
    before: float | None = None,
    note: str = "",
    sigmas: Fit | None = None,
) -> FoundParameter:
    """Row of a parameter: value of `fit`, standard error of `sigmas` if given.

    Value and error are times `factor`. A held one has the file's value `before`, if there is one.
    """
    errors = sigmas or fit
    is_free = errors.is_free(name)
    return FoundParameter(
        name=result_name,
        unit=unit,
        value=factor * fit.value(name) if is_free or before is None else before,
        sigma=factor * errors.sigma(name) if is_free else None,
        status=_status(errors, name),
        before=before,
        note=note,
    )


def _constant(robot: Robot, fit: Fit, sigmas: Fit) -> list[FoundParameter]:
    """ICRs of the constant model by its indices; standard errors are of `sigmas`."""
    gauge, before = robot.vehicle.track_gauge, robot.constant_indices
    epsilon, eta = (sigmas.problem.place(name) for name in ("epsilon0", "eta0"))
    order: tuple[Status, ...] = ("held", "conditional", "shown")
    status = min((_status(sigmas, name) for name in ("epsilon0", "eta0")), key=order.index)
    # With epsilon0 held, the ICRs still follow from eta0.
    if status == "held" and sigmas.is_free("eta0"):
        status = "conditional"
    note = "" if sigmas.is_free("epsilon0") else "spacing estimated, midpoint from the file"
    rows = []
    # x_ICR = epsilon0 + side * gauge * eta0.
    for name, side in (("x_ICRl", -0.5), ("x_ICRr", 0.5)):
        gradient = np.zeros(len(sigmas.values))
        gradient[epsilon], gradient[eta] = 1.0, side * gauge
        variance = float(gradient @ sigmas.covariance @ gradient)
        # The variances that the jackknife adds to either enter in full.
        extra = sum(
            (slope * sigmas.sigmas[place]) ** 2 - slope**2 * sigmas.covariance[place, place]
            for place, slope in ((epsilon, 1.0), (eta, side * gauge))
            if sigmas.free[place]
        )
        sigma = float(np.sqrt(max(variance, 0.0) + max(float(extra), 0.0)))
        rows.append(
            FoundParameter(
                name=f"constant_icr.{name}",
                unit="m",
                value=fit.value("epsilon0") + side * gauge * fit.value("eta0"),
                sigma=None if status == "held" else sigma,
                status=status,
                before=before.epsilon0 + side * gauge * before.eta0,
                note=note,
            )
        )
    y_ICR = _row(fit, "zeta0", "constant_icr.y_ICR", "m", before=before.zeta0, sigmas=sigmas)
    old_width = gauge * before.eta0
    width = _row(fit, "eta0", "effective_track", "m", factor=gauge, before=old_width, sigmas=sigmas)
    return [*rows, y_ICR, replace(width, note="eta0 of constant ICRs times the gauge")]


def _inertia(robot: Robot, fit: Fit, sigmas: Fit) -> list[FoundParameter]:
    """Indices of the inertia-based model; standard errors are of `sigmas`."""
    indices, x_CM = robot.indices, sigmas.problem.model.vehicle.x_CM
    half_track = 0.5 * robot.vehicle.track_gauge * fit.value("eta0")
    epsilon = fit.value("epsilon0")
    # H is the ratio of the track speeds as the robot turns about its centre of mass.
    implied = (half_track - epsilon + x_CM) / (half_track + epsilon - x_CM)
    note = f"acts in the literal form only; the ICRs found imply {implied:.3f}"
    rows = [FoundParameter("indices.H", "-", indices.H, None, "held", indices.H, note)]
    for name, unit, *_ in sigmas.problem.model.parameters:
        before = getattr(indices, name)
        rows.append(_row(fit, name, f"indices.{name}", unit, before=before, sigmas=sigmas))
    return rows


def _logs(chosen: Fit) -> tuple[OfLog, ...]:
    """Parameters and segments of each log, by the supported model."""
    recording = chosen.problem.recording
    # Distance of each segment without the fitted scale of the track speeds [m].
    distances = np.abs(recording.speeds(0.0).mean(axis=-1)).sum(axis=1) * recording.cell
    logs = []
    for number, motion in enumerate(recording.motions):
        in_log, bias, lag = recording.log == number, f"gyro_bias[{number}]", f"lag[{number}]"
        moving = in_log & recording.moving
        logs.append(
            OfLog(
                name=motion.log.name,
                gyro_bias=(chosen.value(bias), finite(chosen.sigma(bias))),
                lag=(chosen.value(lag), finite(chosen.sigma(lag))) if chosen.is_free(lag) else None,
                segments=int(moving.sum()),
                still=int((in_log & ~recording.moving).sum()),
                distance=float(chosen.value("scale") * distances[moving].sum()),
            )
        )
    return tuple(logs)


def _residuals(constant: Fit, chosen: Fit) -> Residuals:
    """Residuals by the robot file's ICRs and radius, and by the supported model."""
    problem, recording = constant.problem, constant.problem.recording
    file_values = constant.values.copy()
    for parameter in problem.parameters:
        # Parameters of truth and IMU are kept: only the robot's are reset to its file.
        if not parameter.name.startswith(("lever", "lag", "gyro", "offset", "mounting", "imu")):
            file_values[problem.place(parameter.name)] = parameter.start
    columns, moving = [ALONG, ACROSS, SLIP], recording.moving
    middles = recording.edges.mean(axis=1)
    # Times of the logs one behind the other [s].
    begins = np.cumsum([0.0, *(motion.log.duration for motion in recording.motions)])
    return Residuals(
        seconds=(middles + begins[recording.log])[moving],
        turning=(recording.turned[:, -1] - recording.turned[:, 0])[moving],
        before=problem.rows(file_values)[moving][:, columns],
        after=chosen.residuals[moving][:, columns],
    )


def _verdict(comparison: ModelComparison) -> str:
    """Sentences on the supported model, and on each other one next to it."""
    supported = comparison.supported
    score = comparison.score(supported)
    verdict = (
        f"The data support {TITLES[supported]}. Held-out drift of dead reckoning by the tracks alone is "
        f"{score.drift_percent:.1f} % (95 % interval {score.drift_low:.1f} to {score.drift_high:.1f})."
    )
    clauses, is_unclear = [], False
    for other in (score for score in comparison.scores if score.model != supported):
        name = other.model
        pair = comparison.difference(supported, name)
        # Interval of the other model's drift less that of the supported one.
        low, high = pair.drift_low, pair.drift_high
        if pair.model == supported:
            low, high = -high, -low
        tendency = "worse" if other.drift_percent > score.drift_percent else "better"
        word = "worse" if low > 0.0 else "better" if high < 0.0 else f"not clearly {tendency}"
        is_unclear |= word == "not clearly better"
        clauses.append(
            f"{TITLES[name]} {'are' if name in PLURAL_TITLES else 'is'} {word} "
            f"({other.drift_percent:.1f} %, difference {low:+.1f} to {high:+.1f})"
        )
    if not clauses:
        return verdict
    sentence = ", ".join(clauses)
    more = " These logs cannot separate the models." if is_unclear else ""
    return f"{verdict} {sentence[0].upper()}{sentence[1:]}.{more}"
