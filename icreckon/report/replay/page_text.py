"""Text of a comparison's page, made from its results only."""

import math
from collections.abc import Mapping
from itertools import combinations
from typing import Any

from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.base.errors import OF_LEFT_OUT, OF_ROBOT_FILE
from icreckon.replay.comparison.fixes import OF_FIXES
from icreckon.replay.comparison.known_bias import GYRO
from icreckon.replay.comparison.results import Results
from icreckon.report.printable import change, change_range

# Sentence after the contradictions of a log to a robot file.
CHECK_HINT = "icreckon check says what each of these costs, and what to set"

NEES = ("nees_pose_mean", "nees_position_mean")
MUCH_NOISE = 0.4  # drift by noise of the truth over the least drift, from which it is reported
ALIKE = 5e-4  # difference of drifts, over each other, below which they are the same [-]
CLEAR_RATIO, LARGE_RATIO = 1.5, 10.0  # largest error at the end over the least, if reported
LEAST_END_ERROR = 1.0  # smaller errors at the end are not compared [m]


def page_title(results: Results) -> str:
    """Robot and log; one name alone if both have it."""
    robot, log = results["robot"]["name"], results["log"]["name"]
    return str(log) if robot.casefold() == log.casefold() else f"{robot} on {log}"


def headline(results: Results) -> str:
    """Verdict, its caveats, and a bias of the gyro that was not known."""
    parts = (_verdict, imu_text, noise_text, ends_text, holes_text, bias_text)
    return " ".join(filter(None, (part(results) for part in parts)))


def imu_text(results: Results) -> str:
    """Statement that no IMU was read, without which `gyro` is the wheels alone."""
    if results["log"]["imu_samples"]:
        return ""
    return f"No IMU was read, so {GYRO} is the wheels alone; [log.imu] in the robot file maps one."


def holes_text(results: Results) -> str:
    """Holes of the log, and the parts of it that are scored."""
    holes = results["log"]["holes_s"]
    if not holes:
        return ""
    lengths = [end - start for start, end in holes]
    longest, whole = number(max(lengths)), number(sum(lengths))
    several = f" in {len(holes)} holes, the longest of {longest} s" if len(holes) > 1 else ""
    moved = results["log"]["moved_in_holes_m"] or 0.0
    several += f", in which the truth moves {number(moved)} m" if moved > LEAST_END_ERROR else ""
    scores = (
        "; drift and RMSE are scored between holes, NEES up to the first"
        if results["truth"]
        else ""
    )
    return f"The log has no track speeds or IMU samples for {whole} s{several}{scores}."


def noise_text(results: Results) -> str:
    """Drift that comes from noise of the truth, if that is much of the best variant's."""
    verdict, truth = results["verdict"], results["truth"]
    if not verdict or not truth:
        return ""
    noise = (truth.get("noise_drift_percent") or {}).get(verdict["horizon"])
    if noise is None or noise < MUCH_NOISE * verdict["drift_percent"]:
        return ""
    perfect = f"against positions as noisy, a perfect path drifts {number(noise)} %"
    return f"Much of it is noise of the truth: {perfect}."


def ends_text(results: Results) -> str:
    """Position errors at the end, if they contradict the verdict, or differ tenfold."""
    errors = _known(results["variants"], "final_position_error_m")
    best = str((results["verdict"] or {}).get("best"))
    if not errors:
        return ""
    ordered = sorted((error, name) for name, error in errors.items())
    smallest, largest = ordered[0][0], ordered[-1][0]
    if errors.get(best) == largest > max(LEAST_END_ERROR, CLEAR_RATIO * smallest):
        return (
            f"At the end {best} is the farthest off, {number(errors[best])} m: that is the error of the "
            "whole path; drift begins at zero in each segment."
        )
    if largest < max(LEAST_END_ERROR, LARGE_RATIO * smallest):
        return ""
    texts = [f"{name} is {number(error)} m off" for error, name in ordered]
    return f"At the end the variants differ more: {texts[0]}, {texts[-1]}."


def bias_text(results: Results) -> str:
    """Advice to set the gyro bias that the truth shows, since the log did not show it.

    Empty if the variant `gyro` found its bias at standstill or from fixes.
    """
    bias = results.get("gyro_bias")
    if bias is None:
        return ""
    sigma = bias["shown_sigma_rad_s"]
    # Two digits of the standard error.
    decimals = min(6, max(4, 1 - math.floor(math.log10(sigma)))) if sigma > 0.0 else 6
    numbers = (bias["used_rad_s"], bias["shown_rad_s"], sigma)
    used, shown, error = (f"{value:.{decimals}f}" for value in numbers)
    return (
        f"{GYRO} ran with the gyro bias that the truth shows, {shown} rad/s (± {error}), in place of "
        f"{used}: neither standstill nor fixes showed it. Set gyro_bias = {shown} in [imu], and all "
        "variants begin with it."
    )


def _verdict(results: Results) -> str:
    """Verdict on the drift, or on the ends of the paths where no drift is scored."""
    if not results["truth"]:
        return _apart(results)
    if results["verdict"] is not None:
        return verdict_text(results["verdict"])
    ends = _known(results["variants"], "final_position_error_m")
    nothing = "Nowhere in this log is there a stretch of dead reckoning long enough to score drift"
    if not ends:
        return f"{nothing}."
    best = min(ends, key=lambda name: ends[name])
    return f"{nothing}. At its end, {best} is closest to the truth: {number(ends[best])} m off."


def verdict_text(verdict: Results, logs: int = 1) -> str:
    """Verdict on the drift, from results["verdict"] of a log or of several together."""
    this = "this log" if logs == 1 else f"these {logs} logs"
    short = "The log is" if logs == 1 else "The logs are"
    best, baseline = verdict["best"], verdict["baseline"]
    drifts = (
        f"{number(verdict['drift_percent'])} % of the distance {horizon_text(verdict['horizon'])} of "
        f"dead reckoning{interval_text(verdict['drift_percent_95'])}"
    )
    if not verdict["ratios_to_best"]:
        return f"{best} drifts {drifts}. Nothing else was run to compare it with."
    if best == baseline:
        return f"{best} drifts least: {drifts}. {_next_best(verdict, short)}"
    less, interval = change(verdict["ratio"]), verdict["ratio_95"]
    if interval is None:
        return (
            f"{best} drifts least: {drifts}, {less} than {baseline}. {short} too short to say whether "
            "that is more than chance."
        )
    than = f"{less} than {baseline}{change_range(interval)}"
    if interval[1] >= 1.0:
        ratios = verdict["ratios_to_best"]
        worse = [name for name in ratios if name not in verdict["not_shown_worse"]]
        worst = max(worse, key=lambda name: float(ratios[name]), default=None)
        return (
            f"No variant drifts significantly less than {baseline} on {this}. {best} has the lowest "
            f"figure, {drifts}, {than}: that may be chance."
            + (f" {worst} drifts {change(ratios[worst])}." if worst else "")
        )
    if logs > 1:
        than += f", and less in {verdict['logs_with_less']} of {verdict['logs_scored']} logs"
    return f"{best} drifts least: {drifts}. That is {than}."


def _next_best(verdict: Results, short: str) -> str:
    """Lead of the baseline over the others; `short` is "The log is" or "The logs are"."""
    if verdict["drift_percent_95"] is None:
        return f"{short} too short to say whether the others drift more by more than chance."
    perhaps_equal, ratios = verdict["not_shown_worse"], verdict["ratios_to_best"]
    if all(abs(ratio - 1.0) < ALIKE for ratio in ratios.values()):
        return "All others drift the same."
    name = min(perhaps_equal or ratios, key=lambda variant: float(ratios[variant]))
    more = f"{change(ratios[name])}{change_range(verdict['ratios_to_best_95'][name])}"
    if not perhaps_equal:
        return f"All others drift more; next is {name} with {more}."
    others = [variant for variant in perhaps_equal if variant != name]
    rest = f", nor {'is' if len(others) == 1 else 'are'} {', '.join(others)}" if others else ""
    return f"But {name}, with {more}, is not shown to drift more{rest}."


def _apart(results: Results) -> str:
    """Largest distance between the ends of two variants, without a truth."""
    variants, reference = filtered(results["variants"]), results["reference_variant"]
    sigma = results["variants"][reference]["end_sigma_m"]
    unsure = f"{reference} gives its end no uncertainty"
    if sigma is not None:
        unsure = f"{reference} itself gives its end a standard deviation of {number(sigma)} m"
    distances = [scores["distance_m"] for scores in variants.values()]
    shortest, longest = number(min(distances)), number(max(distances))
    after = f"after {shortest} m" if shortest == longest else f"after {shortest} to {longest} m"
    if len(variants) < 2:
        return f"No ground truth, so the accuracy of {reference} is unknown: {after}, {unsure}."
    ends = {name: (scores["end_x_m"], scores["end_y_m"]) for name, scores in variants.items()}
    pairs = combinations(sorted(ends), 2)
    distance, first, second = max((math.dist(ends[a], ends[b]), a, b) for a, b in pairs)
    return (
        f"No ground truth, so none can be called best. The variants end up to {number(distance)} m "
        f"apart, {after} ({first} and {second}); {unsure}."
    )


def calibration_hint(results: Results) -> list[str]:
    """Command that calibrates the robot, as one line; empty if it does not apply."""
    # It takes a truth other than the fixes. Index gains that are all zero show no calibration.
    truth, configuration = results["truth"], results["configuration"]
    indices = results["robot"]["indices"]
    gains = [indices[name] for name in ("zeta1", "epsilon1", "eta1", "eta2", "epsilon_F")]
    if not truth or results["command"] != "replay" or truth["source"] == OF_FIXES or any(gains):
        return []
    log, robot = configuration["log"], configuration["robot"]
    logs = log if isinstance(log, str) else " ".join(log)
    command = f"icreckon calibrate {logs} --robot {robot} --write calibrated.toml"
    return [f"The robot file is not calibrated: {command}"]


def has_yaw_errors(results: Results) -> bool:
    """Return True if there is a ground truth, and it has headings."""
    truth = results["truth"]
    return truth is not None and truth.get("headings", True)


def failures(results: Results) -> list[str]:
    """Variants without a result, those of one reason together."""
    names: dict[str, list[str]] = {}
    for name, failure in results["failed"].items():
        names.setdefault(failure["reason"], []).append(name)
    return [
        f"ERROR: {', '.join(variants)} {'have' if len(variants) > 1 else 'has'} no result: {reason}"
        for reason, variants in names.items()
    ]


def remarks(results: Results) -> list[str]:
    """Caveats of the verdict; without a truth, the streams that may give one."""
    verdict = results["verdict"]
    if not results["truth"]:
        return [note for note in results["log"]["notes"] if note.startswith(OF_LEFT_OUT)]
    if verdict is None:
        return []
    best, perhaps_equal = verdict["best"], verdict["not_shown_worse"]
    lines = []
    if perhaps_equal and best != verdict["baseline"]:
        lines.append(f"Not significantly worse than {best}: {', '.join(perhaps_equal)}.")
    nees = results["variants"][best]["nees_pose_mean"]
    if nees is not None:
        lines.append(
            f"Errors of {best} are {change(math.sqrt(nees / 3.0))} than it predicts (pose "
            f"NEES {number(nees)}, ideal 3)."
        )
    lines.append(
        "One log is one run, and the best was picked on the log it is scored on."
        if verdict["drift_percent_95"] is None
        else "The intervals are over the time of this one log (block bootstrap). They do not cover "
        "other days, grounds or robots, and the best was picked on the log it is scored on."
    )
    return lines


def scored_text(results: Results) -> str:
    """Segments in which drift is scored."""
    spans = ", ".join(f"{start:.0f} to {end:.0f} s" for start, end in results["truth"]["scored_s"])
    measure = "Mean position error over mean distance, aligned at each segment's start"
    nees = nees_text(results)
    return f"{measure}; segments without fixes: {spans or 'none that is long enough'}.{nees}"


def nees_text(results: Results) -> str:
    """Reason for scores without NEES, with a blank before it; empty if there is some."""
    has_nees = any(_known(results["variants"], key) for key in NEES)
    return "" if has_nees else " No NEES: the errors of this truth are unknown."


def is_spatial(results: Results) -> bool:
    """Return True if height, roll and pitch of a run are scored."""
    return any("rms_roll_deg" in scores for scores in results["variants"].values())


def level_text(results: Results) -> str:
    """Correction of the vertical of the truth before it is scored."""
    tilt = results["truth"].get("tilt_deg", 0.0)
    if not tilt:
        return "Height error at end: estimate less truth."
    return (
        f"The vertical of the truth was off by {tilt:.1f}°. It is levelled before scoring, for each "
        "variant to its own mean vertical: constant errors of roll and pitch do not show. Height error "
        "at end: estimate less truth."
    )


def truth_correction(results: Results) -> str:
    """Lag and lever arm that were removed from the truth; empty if it is as it was."""
    truth = results["truth"]
    x, y = truth["lever_arm_m"]
    if truth["lag_s"] == x == y == 0.0:
        return ""
    if truth["lag_s"] is None:
        lag = "no lag, since none was found (a note says why)"
    else:
        sigma = truth.get("lag_sigma_s")
        error = "" if sigma is None else f" (± {sigma:.3f})"
        lag = f"{truth['lag_s']:.2f} s{error} of lag"
    arm = f"lever arm of {x:.2f} m forward and {y:.2f} m left"
    return f"{lag}, {arm} for {_leading(results)}, other variants by their own"


def _leading(results: Results) -> str:
    """Variant that stands for all: the best, or the last filter if none is scored."""
    verdict = results["verdict"]
    return str(verdict["best"]) if verdict else ["", *filtered(results["variants"])][-1]


def doubts(results: Results) -> list[str]:
    """Contradictions of the log to the robot file: notes with a prefix of their own."""
    doubting = (note for note in results["log"]["notes"] if note.startswith(OF_ROBOT_FILE))
    return [note.removeprefix(OF_ROBOT_FILE) for note in doubting]


def notes(results: Results) -> list[str]:
    """Findings about the log, and the corrections made."""
    lines, truth = [], results["truth"]
    if truth:
        if correction := truth_correction(results):
            lines.append(
                f"Truth ({truth['source']}) corrected before scoring: {correction}: the position of "
                "base_link depends on the filter."
            )
        else:
            lines.append(f"Truth: {truth['source']}, taken as it is.")
    return lines + list(results["log"]["notes"]) + fault_lines(results)


def provenance(results: Results) -> str:
    """Line with command, log and measurements of the run."""
    log, truth = results["log"], results["truth"]
    parts = [
        f"icreckon {results['command']}",
        f"{log['duration_s']:.0f} s",
        f"{truth['distance_m']:.0f} m" if truth else "",
        f"truth: {truth['source']}" if truth else "no ground truth",
        f"{log['track_samples']} track speeds",
        f"{log['imu_samples']} IMU samples",
        f"{log['fixes']} fixes used",
    ]
    return " · ".join(part for part in parts if part)


def filtered(variants: Mapping[str, Any]) -> dict[str, Any]:
    """Scores of the filtered variants, without smoothed ones."""
    return {name: scores for name, scores in variants.items() if not name.endswith(SMOOTHED)}


def _known(variants: dict[str, Any], key: str) -> dict[str, float]:
    """Value of a score by variant, of the filters that have it."""
    values = {name: scores.get(key) for name, scores in filtered(variants).items()}
    return {name: float(value) for name, value in values.items() if value is not None}


def lowest(variants: dict[str, Any], key: str) -> str | None:
    """Name of the filter with the lowest value of a score; None if none has the score."""
    known = _known(variants, key)
    return min(known, key=lambda name: known[name]) if known else None


def seconds_text(horizon: str) -> str:
    """Format the horizon "30s" as "30 s"."""
    return f"{horizon[:-1]} {horizon[-1]}"


def horizon_text(horizon: str) -> str:
    """Format the horizon "30s" as "after 30 s"."""
    return f"after {seconds_text(horizon)}"


def number(value: float | None) -> str:
    """Format a number to about three digits, with a true minus sign."""
    if value is None or not math.isfinite(value):
        return "–"
    size = abs(value)
    digits = 0 if size >= 100 else 1 if size >= 10 else 2 if size >= 0.1 or size == 0 else 3
    return f"{value:.{digits}f}".replace("-", "−")


def interval_text(interval: list[float] | None) -> str:
    """Format a 95 % interval in brackets; an empty text for None."""
    if interval is None:
        return ""
    return f" (95 % interval {number(interval[0])} to {number(interval[1])})"


def all_rejections(results: Results) -> list[str]:
    """Line with the largest count of rejections, by sensor and reason; or no line."""
    most: dict[str, tuple[int, str]] = {}
    for scores in filtered(results["variants"]).values():
        for sensor_and_reason, count in scores["rejected"].items():
            text = rejections_text(scores | {"rejected": {sensor_and_reason: count}})
            so_far = most.get(sensor_and_reason, (0, ""))
            most[sensor_and_reason] = max(so_far, (count, text))
    texts = ", ".join(text for _, text in most.values())
    return [f"Rejected, at most by any variant: {texts}"] if texts else []


# What the filters find of each fault; {} stands for the part of the sensor.
FAULT_TEXTS = {
    "stuck": "{} repeating the last reading",
    "spinning": "{} spinning, or its sensor failing",
    "wheel off": "{} disagreeing",
    "silent": "no samples of the {}",
    "failing": "{} failing (a jump, repeated readings or its range) and not used",
    "sliding": "{} sliding along its tracks",
    "carried": "{} shaken or turned with its tracks at rest: was it carried?",
    "departing": "{} departing from the path",
}


def found_faults(results: Results) -> tuple[str, dict[str, list[list[float]]]]:
    """Leading variant, and the spans [s] of the faults that it found."""
    name = _leading(results)
    return name, results["variants"].get(name, {}).get("fault_spans_s", {})


def fault_lines(results: Results) -> list[str]:
    """Faults that the best variant found: how often, how long and when."""
    name, faults = found_faults(results)
    lines = []
    for fault_and_part, spans in faults.items():
        fault, _, part = fault_and_part.partition(": ")
        text = FAULT_TEXTS[fault].format(part)
        times = "once" if len(spans) == 1 else f"{len(spans)} times"
        seconds = sum(end - begin for begin, end in spans)
        (first_begin, _), (_, last_end) = spans[0], spans[-1]
        period = f"{number(seconds)} s in all between {first_begin:.1f} and {last_end:.1f} s"
        lines.append(f"Found by the variant {name}: {text}; {times}, {period}")
    return lines


def rejections_text(scores: Results) -> str:
    """Rejected measurements of a variant, out of all, by sensor and reason."""
    total, rejected = dict(scores["used"]), []
    for key, count in scores["rejected"].items():
        sensor, _, reason = key.partition(": ")
        total[sensor] = total.get(sensor, 0) + count
        rejected.append((sensor, reason, count))
    parts = (f"{count} of {total[name]} {name} ({reason})" for name, reason, count in rejected)
    return ", ".join(parts)
