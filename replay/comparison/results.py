"""Results of a comparison as plain data: the content of `results.json`.

`variants` holds one object for each filter variant with its scores, units in the key names; `series`
holds decimated time series for the plots. A score that is not available is null.
"""

import hashlib
import json
import math
import platform
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.plain_data import json_types, package_versions
from icreckon.estimator.filter.fault_table import CORRELATED
from icreckon.estimator.filter.health import Health
from icreckon.estimator.log.scores import Interval, interpolate_poses, path_length
from icreckon.estimator.log.series import Truth
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.comparison import drift_table
from icreckon.replay.comparison.compare import Comparison
from icreckon.replay.comparison.holes import holes_of, scored_parts
from icreckon.replay.comparison.plot_series import series_of
from icreckon.replay.comparison.scores import differences, noise_drifts, scores
from icreckon.replay.comparison.truth_alignment import far_fixes_note
from icreckon.replay.mapping.topics import topic_map

FORMAT = 1
ENOUGH_FIXES = 30  # number of fixes that show a correlation of successive innovations
# Lists of numbers are written on one line; no string holds a line break.
NUMBERS = re.compile(r"\[\n[-+.\deE\s,nul]*\]")
PACKAGES = ("icreckon", "numpy", "scipy", "filterpy", "rosbags", "msgspec")

Results = dict[str, Any]


def summarise(
    comparison: Comparison,
    robot: Robot,
    *,
    command: str = "",
    configuration: dict[str, Any] | None = None,
    seed: int | None = None,
    inputs: dict[str, Path] | None = None,
    series: bool = True,
) -> Results:
    """Summarise scores, series and provenance of a comparison for `write_results`.

    Args:
        comparison: the runs.
        robot: the robot.
        command: name of the command; empty from Python.
        configuration: options of the command.
        seed: seed of a simulated log.
        inputs: bags that were read, by their displayed names, for their hashes.
        series: whether to include the time series of the plots.
    """
    log = comparison.log
    scored, holes = scored_parts(log), holes_of(log)
    filters = [name for name in comparison.runs if not name.endswith(SMOOTHED)]
    baseline = drift_table.baseline_of(filters)
    reference = filters[-1]
    headline, lever_arm = reference, (0.0, 0.0)
    verdict = None
    variants = {}
    if log.truth is not None:
        paired = drift_table.paired_drifts(comparison.drifts)
        verdict = drift_table.verdict(paired, baseline)
        headline = reference if verdict is None else verdict["best"]
        lever_arm = comparison.truths[headline].lever_arm
        for name in comparison.runs:
            variants[name] = scores(comparison, name, holes)
            variants[name] |= drift_table.drift_scores(paired, name, baseline)
    else:
        for name, run in comparison.runs.items():
            variants[name] = differences(run, comparison.runs[reference])
    for name, run in comparison.runs.items():
        variants[name]["fault_spans_s"] = {
            f"{fault}: {part}": _in_seconds(spans.tolist(), log.start)
            for (fault, part), spans in run.fault_spans().items()
        }
    results: Results = {
        "format": FORMAT,
        "command": command,
        "configuration": configuration or {},
        "seed": seed,
        "versions": versions(),
        "inputs": {name: digest(path) for name, path in (inputs or {}).items()},
        "robot": msgspec.to_builtins(robot),
        "log": {
            "name": log.name,
            "duration_s": log.duration,
            "track_samples": len(log.tracks.stamps),
            "imu_samples": 0 if log.imu is None else len(log.imu.stamps),
            "fixes": 0 if log.fixes is None else len(log.fixes.stamps),
            "dropped": log.dropped,
            "holes_s": _in_seconds(holes, log.start),
            "moved_in_holes_m": _moved_in(holes, log.truth),
            "notes": [*log.notes, *_findings(comparison, robot)],
            "start_ns": log.start,
            "origin": log.origin,
        },
        "truth": _truth_summary(comparison, robot, scored, lever_arm),
        "reference_variant": None if log.truth is not None else reference,
        "baseline_variant": None if log.truth is None else baseline,
        "horizons": list(drift_table.horizon_labels()),
        "verdict": verdict,
        "gyro_bias": _gyro_bias(comparison),
        "failed": {
            name: {"reason": lost.reason, "since_s": lost.seconds}
            for name, lost in comparison.failed.items()
        },
        "variants": variants,
        "series": series_of(comparison, robot, headline) if series else {},
    }
    return json_types(results)


def write_results(path: Path, results: Results) -> None:
    """Write results, which have types of JSON alone (`json_types`), as JSON."""
    text = json.dumps(results, indent=1, allow_nan=False)
    text = NUMBERS.sub(lambda numbers: "".join(numbers[0].split()), text)
    path.write_text(text + "\n", encoding="utf-8")


def _moved_in(holes: Sequence[Interval], truth: Truth | None) -> float | None:
    """Distance of the truth from begin to end of all holes [m]; None without one."""
    if truth is None:
        return None
    known, ends = truth.poses.stamps, np.array(holes, dtype=np.int64).reshape(-1, 2)
    places = interpolate_poses(truth.poses, ends.clip(known[0], known[-1]).ravel())[:, :2]
    return float(np.hypot(*(places[1::2] - places[::2]).T).sum())


def _in_seconds(spans: Sequence[Interval], start: int) -> list[list[float]]:
    """Intervals of stamps [ns] as seconds since the start of the log."""
    return [[(begin - start) * NANOSECOND, (end - start) * NANOSECOND] for begin, end in spans]


def _findings(comparison: Comparison, robot: Robot) -> list[str]:
    """Notes on the sensors by the filters: fixes, IMU tilt."""
    runs, notes = comparison.runs, []
    healths = {name: runs[name].health for name in runs if not name.endswith(SMOOTHED)}
    wanders = {name: health.wander for name, health in healths.items() if health.wander}
    if wanders:
        name, wander = [*wanders.items()][-1]
        estimate = f"by {name}: its estimate of the wander of the fixes"
        notes.append(f"the last fix was off by {wander.text}, {estimate}")
    notes += _scatter_note(list(healths.values()))
    all_tilts = (health.tilt for health in healths.values())
    tilts = [tilt for tilt in all_tilts if tilt is not None and tilt.is_wrong]
    if tilts:
        notes.append(
            f"the gyros show the IMU tilted by {tilts[0].text} beyond rotation_rpy_deg of "
            "[imu]: correct it, as its gyro turns with it"
        )
    correlations = filter(None, map(fix_correlation, comparison.runs.values()))
    least = min(correlations, default=0.0)
    # A filter that estimates the wander leaves a correlation if the stated sigma exceeds the white noise.
    # Fixes of a truth, which the robot file lacks, do not wander.
    are_own = topic_map(robot).keys_of("fixes") is not None
    if least > CORRELATED and not wanders and are_own:
        notes.append(
            f"successive innovations of the position fixes have a correlation of {least:.2f}, "
            "those of fixes with white errors have none: they wander, or come late; set wander_sigma and "
            "wander_time where icreckon inspect proposes them, else least_sigma: 2.0 for plain GPS"
        )
    return notes if wanders else [*notes, *far_fixes_note(comparison.log)]


def _scatter_note(healths: list[Health]) -> list[str]:
    """Note on fixes that scatter more than stated, by the filter with most of them."""
    most = max((health.times.get("scattering", 0) for health in healths), default=0)
    if not most:
        return []
    final = (finding for health in healths for finding in health.findings)
    sigmas = sorted(finding.size or 0.0 for finding in final if finding.fault == "scattering")
    median = f", at the end {sigmas[len(sigmas) // 2]:.2g} m" if sigmas else ""
    return [
        f"position fixes scatter more than stated: {most} were used with a larger sigma{median}; a wrong "
        "position of the antenna or offset_deg of a heading looks like it (icreckon check). Else set "
        "least_sigma in [log.fixes], or wander_sigma and wander_time where inspect proposes them"
    ]


def fix_correlation(run: Run) -> float | None:
    """Correlation of successive normalised innovations of a run's position fixes.

    The mean is over the axes x and y with at least `ENOUGH_FIXES` innovations; None without any.
    """
    by_axis = []
    for name in ("position_x", "position_y"):
        if name in run.innovation_names:
            column = run.innovations[:, run.innovation_names.index(name)].astype(float)
            values = column[np.isfinite(column)]
            if len(values) >= ENOUGH_FIXES:
                by_axis.append(float(values[1:] @ values[:-1] / (values @ values)))
    return sum(by_axis) / len(by_axis) if by_axis else None


def _truth_summary(
    comparison: Comparison, robot: Robot, scored: list[Interval], lever_arm: tuple[float, float]
) -> Results | None:
    truth, alignment = comparison.log.truth, comparison.alignment
    if truth is None:
        return None
    return {
        "source": truth.source,
        "headings": truth.headings,
        "distance_m": float(path_length(truth.poses)[-1]),
        "lag_s": 0.0 if alignment is None else alignment.lag,
        "lag_sigma_s": None if alignment is None else alignment.lag_sigma,
        "lever_arm_m": list(lever_arm),
        "tilt_deg": 0.0 if alignment is None else math.degrees(alignment.tilt),
        "noise_drift_percent": noise_drifts(comparison, robot),
        "scored_s": _in_seconds(scored, comparison.log.start),
    }


def _gyro_bias(comparison: Comparison) -> Results | None:
    """Bias of the gyro that the truth shows, if `gyro` could not estimate it; or None."""
    bias = comparison.known_bias
    if bias is None:
        return None
    return {"used_rad_s": bias.used, "shown_rad_s": bias.shown, "shown_sigma_rad_s": bias.sigma}


def versions(packages: Sequence[str] = PACKAGES) -> dict[str, str]:
    """Versions of Python and of the packages that determine a result."""
    return {"python": platform.python_version()} | package_versions(packages)


def digest(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder in the order of their names."""
    sha256 = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                hashlib.file_digest(stream, lambda: sha256)
    return f"sha256:{sha256.hexdigest()}"
