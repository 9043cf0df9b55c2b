"""Text on several logs or robot files, made from their results only."""

from icreckon.replay.comparison.known_bias import GYRO
from icreckon.replay.comparison.results import Results
from icreckon.report.printable import change, change_range
from icreckon.report.replay import page_text

UNSCORED = (
    "No log has a ground truth, so nothing is scored. The page of each log compares its variants."
)
DEFAULT_VARIANT = "inertia-online"  # variant that the ROS 2 node runs unless another one is set
USUAL_HORIZON = "30s"  # horizon that stands for all where only one is shown


def many_headline(results: Results) -> str:
    """Verdict over all logs: of the robot file, or of each against the first."""
    robots = list(results["pooled"])
    if len(robots) > 1:
        return " ".join(_ratio_text(results, robot) for robot in results["ratios"])
    return _robot_text(results["pooled"][robots[0]])


def many_remarks(results: Results) -> list[str]:
    """Verdicts by robot file if there are several, and caveats."""
    robots = results["pooled"]
    lines = []
    if len(robots) > 1:
        lines = [f"{robot}: {_robot_text(pooled)}" for robot, pooled in robots.items()]
    if any(pooled["verdict"] for pooled in robots.values()):
        lines.append(
            "Of all logs together: summed errors over summed distances. Intervals are over blocks of "
            "time of these logs. They do not cover other logs, days, grounds or robots, and the best was "
            "picked on the logs that it is scored on."
        )
    with_known_bias = [log["label"] for log in results["logs"] if log["gyro_bias"]]
    if with_known_bias:
        lines.append(
            f"{GYRO} ran with the gyro bias that the truth shows, in {', '.join(with_known_bias)}: "
            "neither standstill nor fixes showed it there."
        )
    return lines + list(results["notes"])


def _robot_text(pooled: Results) -> str:
    """Verdict of a robot file over all logs."""
    if pooled["verdict"] is not None:
        return page_text.verdict_text(pooled["verdict"], pooled["logs"])
    if pooled["logs"]:
        return (
            "Nowhere in these logs is there a stretch of dead reckoning long enough to score drift."
        )
    return UNSCORED


def _ratio_text(results: Results, robot: str) -> str:
    """Drift with a robot file over that with the first, of the best variant."""
    first, variants = results["ratios"][robot]["to"], results["ratios"][robot]["variants"]
    horizon = horizon_of(results)
    verdicts = [results["pooled"][name]["verdict"] for name in (robot, first)]
    compared = [verdict for verdict in verdicts if verdict and verdict["best"] in variants]
    if not compared:
        return f"{robot} cannot be compared with {first}: no segment is scored with both."
    best = min(compared, key=lambda verdict: float(verdict["drift_percent"]))["best"]
    key = f"ratio_{horizon}"
    ratio, interval = variants[best][key], variants[best][f"{key}_95"]
    is_equal = page_text.number(ratio) == page_text.number(1.0)
    than = "as far as" if is_equal else f"{change(ratio)} than"
    text = (
        f"With {robot}, {best} drifts {than} with {first}{change_range(interval)}, "
        f"{page_text.horizon_text(horizon)} of dead reckoning."
    )
    if interval is None:
        return f"{text} The logs are too short to say whether that is more than chance."
    if interval[0] <= 1.0 <= interval[1]:
        text += " That may be chance."
    ratios = variants.get(DEFAULT_VARIANT, {key: None})
    if best != DEFAULT_VARIANT and ratios[key] is not None:
        drifts = f"drifts {change(ratios[key])}{change_range(ratios[f'{key}_95'])}"
        text += f" {DEFAULT_VARIANT}, which learns as it drives, {drifts}."
    return text


def horizon_of(results: Results) -> str:
    """Horizon of the first verdict, as "30s", for figures of one horizon."""
    verdicts = [pooled["verdict"] for pooled in results["pooled"].values()]
    return next((str(verdict["horizon"]) for verdict in verdicts if verdict), USUAL_HORIZON)


def many_failures(results: Results) -> list[str]:
    """Logs and variants without a result, each with its reason."""
    lines = []
    for case in results["failed"]:
        name = _log_name(case["log"], case["robot"], results)
        lines.append(f"ERROR: {name} has no result: {case['reason']}")
    for log in results["logs"]:
        name = _log_name(log["label"], log["robot"], results)
        lines += [f"{name}: {line}" for line in page_text.failures(log)]
    return lines


def many_doubts(results: Results) -> list[str]:
    """Contradictions of each log to the robot file that it was replayed with."""
    return [
        f"{_log_name(log['label'], log['robot'], results)}: {doubt}"
        for log in results["logs"]
        for doubt in page_text.doubts(log)
    ]


def _log_name(log: str, robot: str, results: Results) -> str:
    """Label of a log; with that of the robot file if there are several."""
    robots = {case["robot"] for part in ("logs", "failed") for case in results[part]}
    return f"{log} with {robot}" if len(robots) > 1 else log


def pooled_over(pooled: Results) -> str:
    """Logs, time and distance that scores of a robot file are from."""
    logs = f"{pooled['logs']} logs" if pooled["logs"] != 1 else "1 log"
    seconds, metres = page_text.number(pooled["duration_s"]), page_text.number(pooled["distance_m"])
    return f"{logs}, {seconds} s, {metres} m"


def left_out(pooled: Results) -> list[str]:
    """Variants that lack a log which others have."""
    return [
        f"{name} is scored in {scores['logs']} of {pooled['logs']} logs."
        for name, scores in pooled["variants"].items()
        if scores["logs"] < pooled["logs"]
    ]
