"""Text on several logs or robot files, made from their results only."""

from icreckon.replay.comparison.known_bias import GYRO
from icreckon.replay.comparison.results import Results
from icreckon.report.printable import change, change_range
from icreckon.report.replay import page_text

UNSCORED = (
    "No log has a ground truth, so nothing is scored. The page of each log compares its variants."
)
# Variant that the ROS 2 node runs unless another one is set.
LEARNS = "inertia-online"
# Horizon that stands for all where only one is shown.
USUAL_HORIZON = "30s"


def many_headline(results: Results) -> str:
    """Verdict over all logs: of the robot file, or of each against the first."""
    robots = list(results["pooled"])
    if len(robots) > 1:
        lines = [_ratio_text(results, robot) for robot in results["ratios"]]
        return " ".join(lines)
    return _robot_text(results["pooled"][robots[0]])


def many_remarks(results: Results) -> list[str]:
    """Verdicts by robot file if there are several, and caveats."""
    pooled = results["pooled"]
    lines = []
    if len(pooled) > 1:
        lines = [f"{robot}: {_robot_text(found)}" for robot, found in pooled.items()]
    if any(found["verdict"] for found in pooled.values()):
        lines.append(
            "Of all logs together: summed errors over summed distances. Intervals are over blocks of "
            "time of these logs. They do not cover other logs, days, grounds or robots, and the best was "
            "picked on the logs that it is scored on."
        )
    helped = [one["label"] for one in results["logs"] if one["gyro_bias"]]
    if helped:
        lines.append(
            f"{GYRO} ran with the gyro bias that the truth shows, in {', '.join(helped)}: neither "
            "standstill nor fixes showed it there."
        )
    return lines + list(results["notes"])


def _robot_text(found: Results) -> str:
    """Verdict of a robot file over all logs."""
    if found["verdict"] is not None:
        return page_text.verdict_text(found["verdict"], found["logs"])
    if found["logs"]:
        return (
            "Nowhere in these logs is there a stretch of dead reckoning long enough to score drift."
        )
    return UNSCORED


def _ratio_text(results: Results, robot: str) -> str:
    """Drift of a robot file over that of the first, of the variant that drifts least."""
    ratios, label = results["ratios"][robot], horizon_of(results)
    verdicts = [results["pooled"][one]["verdict"] for one in (robot, ratios["to"])]
    known = [one for one in verdicts if one and one["best"] in ratios["variants"]]
    if not known:
        return f"{robot} cannot be compared with {ratios['to']}: no segment is scored with both."
    best = min(known, key=lambda one: float(one["drift_percent"]))["best"]
    ratio, interval = (ratios["variants"][best][f"ratio_{label}{end}"] for end in ("", "_95"))
    than = (
        "as far as" if page_text.number(ratio) == page_text.number(1.0) else f"{change(ratio)} than"
    )
    said = (
        f"With {robot}, {best} drifts {than} with {ratios['to']}{change_range(interval)}, "
        f"{page_text.horizon_text(label)} of dead reckoning."
    )
    if interval is None:
        return f"{said} The logs are too short to say whether that is more than chance."
    if interval[0] <= 1.0 <= interval[1]:
        said += " That may be chance."
    return said + _learning_text(results, robot, best)


def _learning_text(results: Results, robot: str, best: str) -> str:
    """Ratio of the default variant, where another one is the best."""
    ratios, label = results["ratios"][robot], horizon_of(results)
    learns = ratios["variants"].get(LEARNS)
    if best == LEARNS or learns is None or learns[f"ratio_{label}"] is None:
        return ""
    ratio, interval = (learns[f"ratio_{label}{end}"] for end in ("", "_95"))
    return f" {LEARNS}, which learns as it drives, drifts {change(ratio)}{change_range(interval)}."


def horizon_of(results: Results) -> str:
    """Horizon of the verdicts, for figures of one horizon."""
    verdicts = [found["verdict"] for found in results["pooled"].values()]
    return next((str(one["horizon"]) for one in verdicts if one), USUAL_HORIZON)


def many_failures(results: Results) -> list[str]:
    """Logs and variants without a result, each with its reason."""
    lines = [
        f"ERROR: {_name(one['log'], one['robot'], results)} has no result: {one['reason']}"
        for one in results["failed"]
    ]
    for one in results["logs"]:
        name = _name(one["label"], one["robot"], results)
        lines += [f"{name}: {line}" for line in page_text.failures(one)]
    return lines


def many_doubts(results: Results) -> list[str]:
    """Contradictions of each log to the robot file that it was replayed with."""
    return [
        f"{_name(one['label'], one['robot'], results)}: {line}"
        for one in results["logs"]
        for line in page_text.doubts(one)
    ]


def _name(log: str, robot: str, results: Results) -> str:
    robots = {one["robot"] for part in ("logs", "failed") for one in results[part]}
    return f"{log} with {robot}" if len(robots) > 1 else log


def pooled_over(found: Results) -> str:
    """Logs, time and distance that scores of a robot file are from."""
    logs = f"{found['logs']} logs" if found["logs"] != 1 else "1 log"
    return f"{logs}, {page_text.number(found['duration_s'])} s, {page_text.number(found['distance_m'])} m"


def left_out(found: Results) -> list[str]:
    """Variants that lack a log which others have."""
    return [
        f"{name} is scored in {one['logs']} of {found['logs']} logs."
        for name, one in found["variants"].items()
        if one["logs"] < found["logs"]
    ]
