"""Text of a comparison's page, made from its results only."""

import math
from typing import Any

from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.base.errors import OF_ROBOT_FILE
from icreckon.replay.comparison.fixes import OF_FIXES
from icreckon.replay.comparison.known_bias import GYRO
from icreckon.replay.comparison.results import Results
from icreckon.report.printable import change, change_range

# Sentence after the contradictions of a log to a robot file.
CHECK_HINT = "icreckon check says what each of these costs, and what to set"

NEES = ("nees_pose_mean", "nees_position_mean")
# Share of the least drift from which noise of the truth is named, and ratio of the errors at the end.
MUCH_NOISE, TENFOLD = 0.4, 10.0


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
    """Holes of the log, and the part of it that NEES is of."""
    holes = results["log"]["holes_s"]
    if not holes:
        return ""
    longest, whole = (number(which(b - a for a, b in holes)) for which in (max, sum))
    several = f" in {len(holes)} holes, the longest of {longest} s" if len(holes) > 1 else ""
    nees = f"; NEES is that before {number(holes[0][0])} s" if results["truth"] else ""
    return f"The log has no track speeds or IMU samples for {whole} s{several}{nees}."


def noise_text(results: Results) -> str:
    """Drift by the noise of the truth, if much of the best variant's is that."""
    found = results["verdict"]
    known = (results["truth"] or {}).get("noise_drift_percent") or {}
    noise = known.get(found["horizon"]) if found else None
    if noise is None or noise < MUCH_NOISE * found["drift_percent"]:
        return ""
    perfect = f"against positions as noisy, a perfect path drifts {number(noise)} %"
    return f"Much of it is noise of the truth: {perfect}."


def ends_text(results: Results) -> str:
    """Errors at the end, if those of the variants differ tenfold."""
    ends = {name: one.get("final_position_error_m") for name, one in filtered(results).items()}
    known = sorted((float(end), name) for name, end in ends.items() if end is not None)
    if not known or known[-1][0] < max(1.0, TENFOLD * known[0][0]):
        return ""
    least, most = (f"{name} is {number(end)} m off" for end, name in (known[0], known[-1]))
    return f"At the end the variants differ more: {least}, {most}."


def bias_text(results: Results) -> str:
    """Bias of the gyro that `gyro` could not learn."""
    bias = results.get("gyro_bias")
    if bias is None:
        return ""
    error = bias["shown_sigma_rad_s"]
    # Two digits of the error.
    digits = min(6, max(4, 1 - math.floor(math.log10(error)))) if error > 0.0 else 6
    used, shown, sigma = (
        f"{value:.{digits}f}" for value in (bias["used_rad_s"], bias["shown_rad_s"], error)
    )
    return (
        f"{GYRO} ran with the gyro bias that the truth shows, {shown} rad/s (± {sigma}), in place of "
        f"{used}: neither standstill nor fixes showed it. Set gyro_bias = {shown} in [imu], and all "
        "variants begin with it."
    )


def _verdict(results: Results) -> str:
    if not results["truth"]:
        return _apart(results)
    found = results["verdict"]
    return _with_fixes_throughout(results) if found is None else verdict_text(found)


def verdict_text(found: Results, logs: int = 1) -> str:
    """Verdict on the drift in a number of logs."""
    this, short = (
        ("this log", "The log is") if logs == 1 else (f"these {logs} logs", "The logs are")
    )
    best, baseline = found["best"], found["baseline"]
    drifts = (
        f"{number(found['drift_percent'])} % of the distance {horizon_text(found['horizon'])} of dead "
        f"reckoning{interval_text(found['drift_percent_95'], '95 % interval ')}"
    )
    if not found["ratios_to_best"]:
        return f"{best} drifts {drifts}. Nothing else was run to compare it with."
    if best == baseline:
        return f"{best} drifts least: {drifts}. {_next_best(found, short)}"
    less, interval = change(found["ratio"]), found["ratio_95"]
    if interval is None:
        return (
            f"{best} drifts least: {drifts}, {less} than {baseline}. {short} too short to say whether "
            "that is more than chance."
        )
    if interval[1] >= 1.0:
        return (
            f"No variant drifts significantly less than {baseline} on {this}. {best} has the lowest "
            f"figure, {drifts}, {less} than {baseline}{change_range(interval)}: that may be chance."
        )
    share = (
        ""
        if logs == 1
        else f", and less in {found['logs_with_less']} of {found['logs_scored']} logs"
    )
    than = f"{less} than {baseline}{change_range(interval)}"
    return f"{best} drifts least: {drifts}. That is {than}{share}."


def _next_best(found: Results, short: str) -> str:
    """Lead of the best over the others, if the best is the baseline."""
    if found["drift_percent_95"] is None:
        return f"{short} too short to say whether the others drift more by more than chance."
    chance, ratios = found["not_shown_worse"], found["ratios_to_best"]
    name = min(chance or ratios, key=lambda one: float(ratios[one]))
    more = f"{change(ratios[name])}{change_range(found['ratios_to_best_95'][name])}"
    if not chance:
        return f"All others drift more; next is {name} with {more}."
    others = [one for one in chance if one != name]
    rest = f", nor {'is' if len(others) == 1 else 'are'} {', '.join(others)}" if others else ""
    return f"But {name}, with {more}, is not shown to drift more{rest}."


def _with_fixes_throughout(results: Results) -> str:
    known = {
        name: one["final_position_error_m"]
        for name, one in filtered(results).items()
        if one["final_position_error_m"] is not None
    }
    nothing = "Nowhere in this log is there a stretch of dead reckoning long enough to score drift"
    if not known:
        return f"{nothing}."
    best = min(known, key=lambda name: float(known[name]))
    return f"{nothing}. At its end, {best} is closest to the truth: {number(known[best])} m off."


def _apart(results: Results) -> str:
    """Distances between the variants, without a truth."""
    ends = {name: (one["end_x_m"], one["end_y_m"]) for name, one in filtered(results).items()}
    reference = results["reference_variant"]
    one = results["variants"][reference]
    unsure = (
        f"{reference} itself gives its end 3σ of {number(3.0 * one['end_sigma_m'])} m"
        if one["end_sigma_m"] is not None
        else f"{reference} gives its end no uncertainty"
    )
    driven = [
        number(edge(each["distance_m"] for each in filtered(results).values()))
        for edge in (min, max)
    ]
    after = f"after {' to '.join(dict.fromkeys(driven))} m"
    if len(ends) < 2:
        return f"No ground truth, so the accuracy of {reference} is unknown: {after}, {unsure}."
    distance, first, second = max(
        (math.dist(ends[a], ends[b]), a, b) for a in ends for b in ends if a < b
    )
    return (
        f"No ground truth, so none can be called best. The variants end up to {number(distance)} m "
        f"apart, {after} ({first} and {second}); {unsure}."
    )


def calibration_hint(results: Results) -> list[str]:
    """Line on a robot file that no calibration has changed, where there is a truth."""
    truth, given = results["truth"], results["configuration"]
    indices = results["robot"]["indices"]
    gains = [indices[name] for name in ("zeta1", "epsilon1", "eta1", "eta2", "epsilon_F")]
    if not truth or results["command"] != "replay" or truth["source"] == OF_FIXES or any(gains):
        return []
    logs = given["log"] if isinstance(given["log"], str) else " ".join(given["log"])
    return [
        "The robot file is not calibrated: icreckon calibrate "
        f"{logs} --robot {given['robot']} --write calibrated.toml"
    ]


def has_yaw_errors(results: Results) -> bool:
    """Return True if there is a ground truth, and it has headings."""
    truth = results["truth"]
    return truth is not None and truth.get("headings", True)


def failures(results: Results) -> list[str]:
    """Variants without a result, each with its reason."""
    return [
        f"ERROR: {name} has no result: {one['reason']}" for name, one in results["failed"].items()
    ]


def remarks(results: Results) -> list[str]:
    """Caveats of the verdict."""
    found, lines = results["verdict"], []
    if results["truth"] and found is not None:
        chance = found["not_shown_worse"]
        if chance and found["best"] != found["baseline"]:
            lines.append(f"Not significantly worse than {found['best']}: {', '.join(chance)}.")
        best = results["variants"][found["best"]]
        if best["nees_pose_mean"] is not None:
            nees = best["nees_pose_mean"]
            lines.append(
                f"Errors of {found['best']} are {change(math.sqrt(nees / 3.0))} than it predicts (pose "
                f"NEES {number(nees)}, ideal 3)."
            )
        lines.append(
            "One log is one run, and the best was picked on the log it is scored on."
            if found["drift_percent_95"] is None
            else "The intervals are over the time of this one log (block bootstrap). They do not cover "
            "other days, grounds or robots, and the best was picked on the log it is scored on."
        )
    return lines


def scored_text(results: Results) -> str:
    """Segments in which drift is scored."""
    truth = results["truth"]
    parts = ", ".join(f"{start:.0f} to {end:.0f} s" for start, end in truth["scored_s"])
    what = "Mean position error over mean distance, aligned at each segment's start"
    return f"{what}; segments without fixes: {parts or 'none that is long enough'}.{nees_text(results)}"


def nees_text(results: Results) -> str:
    """Reason for scores without NEES, with a blank before it; empty if there is some."""
    known = any(one.get(key) is not None for one in filtered(results).values() for key in NEES)
    return "" if known else " No NEES: the errors of this truth are unknown."


def is_spatial(results: Results) -> bool:
    """Return True if height, roll and pitch of a run are scored."""
    return any("rms_roll_deg" in one for one in results["variants"].values())


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


def lag_text(truth: Results) -> str:
    """Lag that was removed from a truth, or that none was found."""
    if truth["lag_s"] is None:
        return "no lag, since none was found (a note says why)"
    sigma = truth.get("lag_sigma_s")
    error = "" if sigma is None else f" (± {sigma:.3f})"
    return f"{truth['lag_s']:.2f} s{error} of lag"


def arm_text(results: Results) -> str:
    """Lever arm of the truth, and the variant whose it is."""
    x, y = results["truth"]["lever_arm_m"]
    found = results["verdict"]
    name = [*filtered(results)][-1] if found is None else found["best"]
    return (
        f"lever arm of {x:.2f} m forward and {y:.2f} m left for {name}, other variants by their own"
    )


def doubts(results: Results) -> list[str]:
    """Contradictions of the log to the robot file."""
    found = results["log"]["notes"]
    return [one.removeprefix(OF_ROBOT_FILE) for one in found if one.startswith(OF_ROBOT_FILE)]


def notes(results: Results) -> list[str]:
    """Findings about the log, and the corrections made."""
    lines, truth = [], results["truth"]
    if truth:
        if truth["lag_s"] != 0.0 or any(truth["lever_arm_m"]):
            lines.append(
                f"Truth ({truth['source']}) corrected before scoring: {lag_text(truth)}, "
                f"{arm_text(results)}: the position of base_link depends on the filter."
            )
        else:
            lines.append(f"Truth: {truth['source']}, taken as it is.")
    return lines + list(results["log"]["notes"])


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


def filtered(results: Results) -> dict[str, Any]:
    """Filtered variants, without smoothed ones."""
    return {name: one for name, one in results["variants"].items() if not name.endswith(SMOOTHED)}


def lowest(variants: dict[str, Any], key: str) -> str | None:
    """Filter with the lowest value of a score."""
    known = {
        name: one[key]
        for name, one in filtered({"variants": variants}).items()
        if one.get(key) is not None
    }
    return min(known, key=lambda name: float(known[name])) if known else None


def horizon_text(label: str) -> str:
    """Format the horizon "30s" as "after 30 s"."""
    return f"after {label[:-1]} {label[-1]}"


def number(value: float | None) -> str:
    """Format a number to about three digits, with a true minus sign."""
    if value is None or not math.isfinite(value):
        return "–"
    size = abs(value)
    digits = 0 if size >= 100 else 1 if size >= 10 else 2 if size >= 0.1 or size == 0 else 3
    return f"{value:.{digits}f}".replace("-", "−")


def interval_text(interval: list[float] | None, before: str = "") -> str:
    """Format an interval in brackets; nothing for none."""
    if interval is None:
        return ""
    return f" ({before}{number(interval[0])} to {number(interval[1])})"


def all_rejections(results: Results) -> list[str]:
    """Most rejections of any variant by sensor and reason, in one line; or none."""
    most: dict[str, tuple[int, str]] = {}
    for one in filtered(results).values():
        for what, count in one["rejected"].items():
            text = rejections_text(one | {"rejected": {what: count}})
            most[what] = max(most.get(what, (0, "")), (count, text))
    texts = [text for _, text in most.values()]
    return [f"Rejected, at most by any variant: {', '.join(texts)}"] if texts else []


def rejections_text(one: Results) -> str:
    """Measurements that a variant rejected, of how many, by sensor and reason."""
    total = dict(one["used"])
    named = [(*what.partition(": ")[::2], count) for what, count in one["rejected"].items()]
    for sensor, _, count in named:
        total[sensor] = total.get(sensor, 0) + count
    return ", ".join(
        f"{count} of {total[sensor]} {sensor} ({reason})" for sensor, reason, count in named
    )
