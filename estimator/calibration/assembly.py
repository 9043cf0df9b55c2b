"""Assembly of fits: the calibrated robot, its parameters, and a verdict."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.calibration.common_values import (
    KEPT,
    OF_FRICTION,
    common_bias,
    finite,
    mounting_turns,
    with_common,
    written_difference,
)
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

Again = Callable[[str, Robot, dict[str, float], frozenset[str]], Fit]

MOVED = 1e-3
"""A larger shift of the centre of mass [m] changes the meaning of the inertia-based parameters; a larger
change of a scale [-] changes the meaning of all parameters."""
CALLED = {
    "differential": "ideal differential drive",
    "constant": "constant ICRs",
    "inertia": "inertia-based ICRs",
}
PLURAL = ("constant", "inertia")
COMMON = {
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
OF_MOUNTING = {
    **dict.fromkeys(("roll", "pitch", "yaw"), "rotation_rpy_deg"),
    **dict.fromkeys(("forward", "left"), "position"),
}
"""Keys of the IMU's mounting, by the names of their parts in the results."""
# Spread of parameters between logs: other ground, load, tyre pressure. One log cannot show it. The
# figures are those of three robots, measured by `benchmarks/between_logs.py`: four logs of a Warthog on
# grass and asphalt, four parts of a log each of the tracked Marmotte and of a Husky with deflated tyres.
SHARES = {
    "sprocket_radius": 0.01,
    "track_scale": 0.01,
    "effective_track": 0.02,
    "constant_icr.x_ICRl": 0.02,
    "constant_icr.x_ICRr": 0.02,
    "indices.eta0": 0.02,
    "indices.zeta1": 0.1,
}
"""Standard deviation between logs, as a share of the value [-]."""
SIZES = {
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
    again: Again,
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
        again: refits a model: its name, the robot, initial values, names that are held there.
        speeds_by_radius: True if the scale of the track speeds corrects the sprocket radius.
    """
    main = shared[comparison.supported]
    notes = []
    may_be_right = _supported_fits(fits, comparison)
    common = [name for name in COMMON if name in main.problem.names]
    # What one model takes for a latency another explains by inertia: all that may be right must agree.
    kept = frozenset[str]().union(*(one.not_contradicted(common) for one in may_be_right))
    new = with_common(robot, main, radii, may_be_right, speeds_by_radius, kept)
    if not speeds_by_radius and not robot.log:
        notes.append(
            f"track speeds are not by sprocket_radius: scale_sigma covers {main.value('scale'):.4f}"
        )
    written = main.with_start_of(kept)
    scaled = {name: written.value(name) for name in {"scale", *kept}}
    scaled["difference"] = new.tracks.difference
    stays = {COMMON[name] for name in kept}
    usable = dict(shared)
    for name in ("constant", "inertia"):
        if name not in fits:
            continue
        usable[name] = _refitted(shared[name], name, robot, scaled, again)
        own = usable[name].not_contradicted(
            one.name for one in usable[name].problem.model.parameters
        )
        start = dict(zip(usable[name].problem.names, usable[name].problem.start, strict=True))
        filed = {one: float(start[one]) for one in own}
        new = _put(_refitted(usable[name], name, robot, scaled | filed, again, bool(own)), new)
        stays |= _rows_of(name, own)
    parameters = _parameters(robot, new, fits, usable, main, radii, speeds_by_radius)
    if not speeds_by_radius:
        stays -= {"sprocket_radius"}
    parameters = tuple(
        replace(
            _with_other_logs(one, len(main.problem.recording.motions)),
            note="; ".join(
                filter(None, [one.note, _kept(one, new) if one.sigma and one.name in stays else ""])
            ),
            is_default=one.before is not None and _is_default(robot, one.name),
        )
        for one in parameters
    )
    names, correlations = _correlations(fits.get("inertia", fits["constant"]))
    return Calibration(
        new,
        parameters,
        names,
        correlations,
        _logs(main),
        comparison,
        _verdict(comparison),
        _residuals(shared["constant"], main),
        (*notes, BY_TRACKS_ALONE),
    )


def _kept(one: FoundParameter, new: Robot) -> str:
    """Note on a parameter that the logs do not contradict, by what the new file has."""
    key = one.name.removeprefix("indices.")
    of_friction = key != one.name and getattr(new.indices, key) != one.before
    return OF_FRICTION if of_friction else KEPT


def _with_other_logs(one: FoundParameter, logs: int) -> FoundParameter:
    """Add the standard error for other logs of the same robot.

    Args:
        one: the parameter.
        logs: number of logs it was found from.
    """
    if one.sigma is None:
        return one
    between = SHARES.get(one.name, 0.0) * abs(one.value) + SIZES.get(one.name, 0.0)
    return replace(one, sigma_other_logs=math.hypot(one.sigma, between / math.sqrt(logs)))


def _is_default(robot: Robot, name: str) -> bool:
    """True if the robot file need not state a parameter, by its name in the results."""
    table_name, _, key = name.rpartition(".")
    tables: dict[str, msgspec.Struct] = {
        "": robot.vehicle, "imu": robot.imu, "tracks": robot.tracks, "indices": robot.indices,
    }  # fmt: skip
    table = tables.get(table_name)
    fields = () if table is None else msgspec.structs.fields(table)
    key = OF_MOUNTING.get(key, key)
    return any(
        one.name == key and not one.required and getattr(table, key) == one.default
        for one in fields
    )


def _rows_of(model: str, names: frozenset[str]) -> set[str]:
    """Names in the results of parameters of a model that stay as in the robot file."""
    if model == "inertia":
        return {f"indices.{name}" for name in names}
    rows = {"constant_icr.y_ICR"} if "zeta0" in names else set()
    rows |= {"effective_track"} if "eta0" in names else set()
    if {"epsilon0", "eta0"} <= names:
        rows |= {"constant_icr.x_ICRl", "constant_icr.x_ICRr"}
    return rows


def with_difference(
    fits: Mapping[str, Fit], difference: float, robot: Robot, again: Again
) -> dict[str, Fit]:
    """Fit of each model with a given difference of the radii [-]."""
    given = {"difference": difference}
    return {name: _refitted(one, name, robot, given, again) for name, one in fits.items()}


def as_found(robot: Robot, found: Fit) -> Robot:
    """Robot with the model's parameters and the gyro's scale of a fit."""
    imu = msgspec.structs.replace(robot.imu, gyro_scale=found.value("gyro_scale"))
    return _put(found, msgspec.structs.replace(robot, imu=imu))


def _refitted(
    found: Fit, name: str, robot: Robot, given: dict[str, float], again: Again, needed: bool = False
) -> Fit:
    """Fit with given parameters; no new one if it nearly has them and none is needed."""
    if not needed and all(abs(found.value(one) - to) <= MOVED for one, to in given.items()):
        return found
    start = dict(zip(found.problem.names, found.values.tolist(), strict=True)) | given
    return again(name, robot, start, frozenset(given))


def _put(found: Fit, robot: Robot) -> Robot:
    return found.problem.model.put_into(robot, found.problem.own(found.values))


def _supported_fits(fits: Mapping[str, Fit], comparison: ModelComparison) -> list[Fit]:
    """Fits of the models that may be right, the supported one included."""
    chosen = comparison.supported

    def may_be_right(name: str) -> bool:
        pair = comparison.difference(chosen, name)
        return pair.drift_low <= 0.0 <= pair.drift_high

    return [one for name, one in fits.items() if name == chosen or may_be_right(name)]


def _parameters(
    robot: Robot,
    new: Robot,
    fits: Mapping[str, Fit],
    usable: Mapping[str, Fit],
    main: Fit,
    radii: Fit,
    speeds_by_radius: bool,
) -> tuple[FoundParameter, ...]:
    radius = robot.vehicle.sprocket_radius
    found = [
        _plain(main, "scale", "sprocket_radius", "m", factor=radius, before=radius)
        if speeds_by_radius
        else _plain(main, "scale", "track_scale", "-", before=1.0, note="times log.tracks.scale"),
        _plain(
            radii,
            "difference",
            "tracks.difference",
            "-",
            before=robot.tracks.difference,
            note=written_difference(robot, radii)[1],
        ),
        _plain(main, "gyro_scale", "imu.gyro_scale", "-", before=robot.imu.gyro_scale),
    ]
    found[-1] = replace(found[-1], value=new.imu.gyro_scale)
    found.append(_bias(robot, main))
    before, after = robot.imu.rotation_rpy_deg, new.imu.rotation_rpy_deg
    for at, (_, error) in enumerate(mounting_turns(main)):
        name, known = ("imu.roll", "imu.pitch", "imu.yaw")[at], np.isfinite(error)
        status: Status = "shown" if known else "held"
        sigma = float(np.degrees(error)) if known else None
        found.append(FoundParameter(name, "deg", after[at], sigma, status, before[at]))
    found += [
        _plain(main, name, name.replace("imu_", "imu."), "m", before=0.0)
        for name in ("imu_forward", "imu_left")
        if name in main.problem.names
    ]
    found += [
        _plain(main, f"lever_arm_{name}", f"truth.{name}", "m") for name in ("forward", "left")
    ]
    note = "extra delay, added to log.tracks.latency"
    found.append(_plain(main, "track_latency", "track_latency", "s", note=note))
    found += _constant(robot, usable["constant"], fits["constant"])
    if "inertia" in usable:
        found += _inertia(robot, usable["inertia"], fits["inertia"])
    return tuple(found)


def _bias(robot: Robot, main: Fit) -> FoundParameter:
    """Initial gyro bias: mean over the logs."""
    bias = common_bias(robot, main)
    note = "" if bias.written == bias.mean else KEPT
    status: Status = "held" if bias.error is None else "shown"
    before = robot.imu.gyro_bias
    return FoundParameter("imu.gyro_bias", "rad/s", bias.mean, bias.error, status, before, note)


def _status(found: Fit, name: str) -> Status:
    if not found.is_free(name):
        return "held"
    return "shown" if found.shown[found.problem.place(name)] else "conditional"


def _plain(
    found: Fit,
    name: str,
    called: str,
    unit: str,
    *,
    factor: float = 1.0,
    before: float | None = None,
    note: str = "",
    sigmas: Fit | None = None,
) -> FoundParameter:
    """Parameter of a fit; its standard error is from the fit `sigmas`, if given."""
    of = sigmas or found
    return FoundParameter(
        called,
        unit,
        factor * found.value(name) if of.is_free(name) or before is None else before,
        factor * of.sigma(name) if of.is_free(name) else None,
        _status(of, name),
        before,
        note,
    )


def _constant(robot: Robot, found: Fit, free: Fit) -> list[FoundParameter]:
    """ICRs of the constant model from its indices."""
    gauge, before = robot.vehicle.track_gauge, robot.constant_indices
    epsilon, eta = (free.problem.place(name) for name in ("epsilon0", "eta0"))
    order: tuple[Status, ...] = ("held", "conditional", "shown")
    worst = min((_status(free, name) for name in ("epsilon0", "eta0")), key=order.index)
    if worst == "held" and free.is_free("eta0"):
        worst = "conditional"
    result = []
    for name, side in (("x_ICRl", -0.5), ("x_ICRr", 0.5)):
        gradient = np.zeros(len(free.values))
        gradient[epsilon], gradient[eta] = 1.0, side * gauge
        variance = float(gradient @ free.covariance @ gradient)
        # The variances that the jackknife adds to either enter in full.
        extra = sum(
            (slope * free.sigmas[at]) ** 2 - slope**2 * free.covariance[at, at]
            for at, slope in ((epsilon, 1.0), (eta, side * gauge))
            if free.free[at]
        )
        sigma = float(np.sqrt(max(variance, 0.0) + max(float(extra), 0.0)))
        result.append(
            FoundParameter(
                f"constant_icr.{name}",
                "m",
                found.value("epsilon0") + side * gauge * found.value("eta0"),
                None if worst == "held" else sigma,
                worst,
                before.epsilon0 + side * gauge * before.eta0,
                "" if free.is_free("epsilon0") else "spacing estimated, midpoint from the file",
            )
        )
    return [
        *result,
        _plain(found, "zeta0", "constant_icr.y_ICR", "m", before=before.zeta0, sigmas=free),
        _plain(
            found,
            "eta0",
            "effective_track",
            "m",
            factor=gauge,
            before=gauge * before.eta0,
            note="eta0 of constant ICRs times the gauge",
            sigmas=free,
        ),
    ]


def _inertia(robot: Robot, found: Fit, free: Fit) -> list[FoundParameter]:
    indices = robot.indices
    x_CM = free.problem.model.vehicle.x_CM
    gauge = robot.vehicle.track_gauge
    half = 0.5 * gauge * found.value("eta0")
    epsilon = found.value("epsilon0")
    implied = (half - epsilon + x_CM) / (half + epsilon - x_CM)
    note = f"acts in the literal form only; the ICRs found imply {implied:.3f}"
    return [
        FoundParameter("indices.H", "-", indices.H, None, "held", indices.H, note),
        *(
            _plain(
                found,
                parameter.name,
                f"indices.{parameter.name}",
                parameter.unit,
                before=getattr(indices, parameter.name),
                sigmas=free,
            )
            for parameter in free.problem.model.parameters
        ),
    ]


def _correlations(found: Fit) -> tuple[tuple[str, ...], Floats]:
    at = np.flatnonzero(found.free)
    covariance = found.covariance[np.ix_(at, at)]
    sigma = np.sqrt(np.diag(covariance))
    return tuple(found.problem.names[place] for place in at), covariance / np.outer(sigma, sigma)


def _logs(main: Fit) -> tuple[OfLog, ...]:
    recording = main.problem.recording
    speeds = np.abs(recording.speeds(0.0).mean(axis=-1)).sum(axis=1) * recording.cell
    result = []
    for log, motion in enumerate(recording.motions):
        own, lag = recording.log == log, f"lag[{log}]"
        result.append(
            OfLog(
                motion.log.name,
                (main.value(f"gyro_bias[{log}]"), finite(main.sigma(f"gyro_bias[{log}]"))),
                (main.value(lag), finite(main.sigma(lag))) if main.is_free(lag) else None,
                int((own & recording.moving).sum()),
                int((own & ~recording.moving).sum()),
                float(main.value("scale") * speeds[own & recording.moving].sum()),
            )
        )
    return tuple(result)


def _residuals(constant: Fit, main: Fit) -> Residuals:
    """Residuals by the robot file's ICRs and radius, and by the supported model."""
    problem, recording = constant.problem, constant.problem.recording
    values = constant.values.copy()
    for parameter in problem.parameters:
        # Parameters of truth and IMU are kept: only the robot's are reset to its file.
        if not parameter.name.startswith(("lever", "lag", "gyro", "offset", "mounting", "imu")):
            values[problem.place(parameter.name)] = parameter.start
    rows = [ALONG, ACROSS, SLIP]
    moving = recording.moving
    middle = recording.edges.mean(axis=1)
    begin = np.zeros(len(recording.motions))
    begin[1:] = np.cumsum([one.log.duration for one in recording.motions])[:-1]
    return Residuals(
        (middle + begin[recording.log])[moving],
        (recording.turned[:, -1] - recording.turned[:, 0])[moving],
        problem.rows(values)[moving][:, rows],
        main.residuals[moving][:, rows],
    )


def _verdict(comparison: ModelComparison) -> str:
    chosen = comparison.supported
    score = comparison.score(chosen)
    verdict = (
        f"The data support {CALLED[chosen]}. Held-out drift of dead reckoning by the tracks alone is "
        f"{score.drift_percent:.1f} % (95 % interval {score.drift_low:.1f} to {score.drift_high:.1f})."
    )
    parts = []
    for other in comparison.scores:
        name = other.model
        if name == chosen:
            continue
        pair = comparison.difference(chosen, name)
        low, high = pair.drift_low, pair.drift_high
        if pair.model == chosen:
            low, high = -high, -low
        sides = "worse" if other.drift_percent > score.drift_percent else "better"
        word = "worse" if low > 0.0 else "better" if high < 0.0 else f"not clearly {sides}"
        parts.append(
            f"{CALLED[name]} {'are' if name in PLURAL else 'is'} {word} "
            f"({other.drift_percent:.1f} %, difference {low:+.1f} to {high:+.1f})"
        )
    if not parts:
        return verdict
    others, more = ", ".join(parts), ""
    if " not clearly better " in others:
        more = " These logs cannot separate the models."
    return f"{verdict} {others[0].upper()}{others[1:]}.{more}"
