"""Several logs, or several robot files: scores of all logs together."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import IcreckonError
from icreckon.estimator.base.plain_data import json_types
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.lost import described
from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.comparison import bootstrap, drift_table
from icreckon.replay.comparison.bootstrap import PairedDrift
from icreckon.replay.comparison.compare import DEFAULT_VARIANTS, Comparison, compare
from icreckon.replay.comparison.drift_table import Drifts
from icreckon.replay.comparison.fixes import LogPart
from icreckon.replay.comparison.results import FORMAT, Results, summarise, versions
from icreckon.replay.reading.read_log import read_log

NEXT_PART = 5.0  # longest time between the end and the start of parts of one recording [s]
NO_RATIO = bootstrap.Estimate(math.nan, None)
# Results of each log that the results of several have.
OF_LOG = ("log", "truth", "verdict", "gyro_bias", "failed", "reference_variant", "variants")
# Drift of the variants of a log, over the same segments, by the label of the horizon.
LogDrifts = Mapping[str, PairedDrift]


class Case(NamedTuple):
    """Labels of a log and of a robot file that is run over it."""

    log: str
    robot: str


@dataclass(frozen=True)
class CaseScores:
    """Scores of a robot file over a log, without the runs."""

    case: Case  # labels of both
    results: Results  # output of `summarise`, without the series
    drifts: Drifts  # drift of all variants, see `Comparison.drifts`; empty without a truth
    lag: float  # lag of the truth that was removed [s]


def compare_many(
    logs: Sequence[Log | Path | str],
    robots: Robot | Mapping[str, Robot],
    variants: Sequence[str] | str = DEFAULT_VARIANTS,
    *,
    settings: Settings | None = None,
    fixes: LogPart | str | None = None,
    smooth: bool = False,
    workers: int = 1,
    on_comparison: Callable[[Case, Comparison], None] | None = None,
) -> Results:
    """Run filter variants over several logs, and score them together.

    Runs are scored, given to `on_comparison`, and dropped, log by log. A log that fails is listed
    under "failed", and the others continue.

    Args:
        logs: the logs; paths are read with each robot, since radius and gauge turn wheel rates to speeds.
        robots: the robot, or several by their labels. The others are compared with the first, on the
            same segments.
        variants: names of filter variants, or one name.
        settings: settings of the pose estimator.
        fixes: part of each log in which fixes are used, as for `compare`.
        smooth: whether each run is smoothed, too.
        workers: number of threads for the variants of a log.
        on_comparison: called with labels and runs of each log and robot.

    Returns:
        Plain data, as results.json of `icreckon replay LOG LOG ...`: see `summarise_many`.

    Raises:
        ReplayError: there is no log or no robot, or no log has results.
    """
    named = {robots.name: robots} if isinstance(robots, Robot) else dict(robots)
    if not logs or not named:
        raise ReplayError("no log or no robot: give at least one of each")
    labels = unique([log.name if isinstance(log, Log) else label_of(Path(log)) for log in logs])
    options: Any = {"settings": settings, "fixes": fixes, "smooth": smooth, "workers": workers}
    scored: list[CaseScores] = []
    failed: list[Results] = []
    for label, given in zip(labels, logs, strict=True):
        for name, robot in named.items():
            case = Case(label, name)
            try:
                log = given if isinstance(given, Log) else read_log(given, robot)
                comparison = compare(log, robot, variants, **options)
                summary = summarise(comparison, robot, command="compare_many", series=False)
                scored.append(case_scores(case, comparison, summary))
            except Exception as problem:
                failed.append(failed_case(case, problem))
                continue
            if on_comparison is not None:
                on_comparison(case, comparison)
    return summarise_many(scored, failed, command="compare_many", configuration={})


def label_of(path: Path) -> str:
    """Label of a log or a robot file: its name without suffix."""
    path = path if path.name.strip(".") else path.resolve()
    return path.name if path.is_dir() else path.stem


def unique(labels: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Append numbers to labels that repeat or are taken, upper and lower case alike."""
    numbered: list[str] = []
    used = {label.casefold() for label in taken}
    for label in labels:
        name, number = label, 1
        while name.casefold() in used:
            number += 1
            name = f"{label}-{number}"
        used.add(name.casefold())
        numbered.append(name)
    return numbered


def case_scores(case: Case, comparison: Comparison, summary: Results) -> CaseScores:
    """Scores of a comparison that the summary of several logs needs."""
    alignment = comparison.alignment
    lag = 0.0 if alignment is None or alignment.lag is None else alignment.lag
    without_series = {key: value for key, value in summary.items() if key != "series"}
    return CaseScores(case, without_series, comparison.drifts, lag)


def failed_case(case: Case, problem: Exception) -> Results:
    """Row of "failed": a log without results, and the message of the error."""
    is_own_error = isinstance(problem, IcreckonError)
    reason = " ".join(str(problem).split()) if is_own_error else described(problem)
    return case._asdict() | {"reason": reason}


def summarise_many(
    scored: Sequence[CaseScores],
    failed: Sequence[Results],
    *,
    command: str,
    configuration: dict[str, Any],
) -> Results:
    """Summarise several logs, or several robot files.

    "logs" lists each log and robot with its own scores. "pooled" holds, by robot, summed errors over
    summed distances of all logs, with intervals over blocks of all logs. "ratios" compares each robot
    with the first, by variant, on the same segments.

    Raises:
        ReplayError: no log has results.
    """
    if not scored:
        reasons = "; ".join(f"{failure['log']}: {failure['reason']}" for failure in failed)
        raise ReplayError(f"no log has a result: {reasons}")
    robots = list(dict.fromkeys(scores.case.robot for scores in scored))
    names = dict.fromkeys(name for scores in scored for name in scores.results["variants"])
    baseline = drift_table.baseline_of([name for name in names if not name.endswith(SMOOTHED)])
    results: Results = {
        "format": FORMAT,
        "command": command,
        "configuration": configuration,
        "versions": versions(),
        "inputs": dict(item for scores in scored for item in scores.results["inputs"].items()),
        "robots": {scores.case.robot: scores.results["robot"] for scores in scored},
        "horizons": list(drift_table.horizon_labels()),
        "baseline_variant": baseline,
        "logs": [
            {"label": scores.case.log, "robot": scores.case.robot}
            | {key: scores.results[key] for key in OF_LOG}
            for scores in scored
        ],
        "failed": list(failed),
        "notes": list(_consecutive(scored)),
        "pooled": {
            robot: _pooled([scores for scores in scored if scores.case.robot == robot], baseline)
            for robot in robots
        },
        "ratios": _ratios(scored, robots),
    }
    return json_types(results)


def _consecutive(scored: Sequence[CaseScores]) -> Iterator[str]:
    """Note logs that begin where another ends: parts of one recording."""
    spans = {}
    for scores in scored:
        log = scores.results["log"]
        spans[scores.case.log] = (log["start_ns"], log["start_ns"] + log["duration_s"] / NANOSECOND)
    by_start = sorted(spans.items(), key=lambda item: item[1])
    for (earlier, (_, end)), (later, (start, _)) in pairwise(by_start):
        pause = (start - end) * NANOSECOND
        if abs(pause) < NEXT_PART:
            side = "before" if pause < 0.0 else "after"
            place = f"{abs(pause):.1f} s {side} the end of {earlier}"
            advice = "--one-log reads them as one, if they are parts of one recording"
            yield f"{later} begins {place}: {advice}"


def _pooled(scored: Sequence[CaseScores], baseline: str) -> Results:
    """Scores of a robot file over all logs with a truth, and the verdict."""
    # A log without a stretch of dead reckoning has nothing to pool.
    all_pairs = [(case, drift_table.paired_drifts(case.drifts)) for case in scored]
    pairs = [pair for pair in all_pairs if any(len(drift.distances) for drift in pair[1].values())]
    logs = [drifts for _, drifts in pairs]
    names = list(dict.fromkeys(name for case in scored for name in case.results["variants"]))
    variants: dict[str, Results] = {}
    for name in names:
        with_variant = _with_variants(logs, name)
        variants[name] = {"logs": len(with_variant)} | _nees(scored, name)
        if with_variant:
            joined = _joined(with_variant, [name])
            variants[name] |= drift_table.drift_scores(joined, name, name)
        with_both = _with_variants(logs, name, baseline)
        joined = _joined(with_both, [name, baseline]) if with_both else {}
        for label in drift_table.horizon_labels():
            ratio = joined[label].ratio(name, baseline) if joined else NO_RATIO
            variants[name][f"drift_ratio_{label}"] = ratio.value
            variants[name][f"drift_ratio_{label}_95"] = drift_table.listed(ratio)
    return {
        "logs": len(logs),
        "distance_m": sum(case.results["truth"]["distance_m"] for case, _ in pairs),
        "duration_s": sum(case.results["log"]["duration_s"] for case, _ in pairs),
        "verdict": _pooled_verdict(logs, names, baseline) if logs else None,
        "variants": variants,
    }


def _with_variants(logs: Sequence[LogDrifts], *names: str) -> list[LogDrifts]:
    """Logs over which all these variants have results."""
    return [log for log in logs if all({*names} <= {*drift.names} for drift in log.values())]


def _pooled_verdict(
    logs: Sequence[LogDrifts], names: Sequence[str], baseline: str
) -> Results | None:
    """Verdict over the variants that all logs have; None without a filter among them."""
    joined = _joined(logs, names)
    common = next(iter(joined.values())).names
    filters = [name for name in common if not name.endswith(SMOOTHED)]
    if not filters:
        return None
    if baseline not in common:
        baseline = drift_table.baseline_of(filters)
    verdict = drift_table.verdict(joined, baseline)
    if verdict is None:
        return None
    drifts = [log[verdict["horizon"]] for log in logs]
    ratios = [paired.ratio(verdict["best"], verdict["baseline"]).value for paired in drifts]
    known = [ratio for ratio in ratios if math.isfinite(ratio)]
    return verdict | {"logs_with_less": sum(r < 1.0 for r in known), "logs_scored": len(known)}


def _joined(logs: Sequence[LogDrifts], names: Sequence[str]) -> dict[str, PairedDrift]:
    """Drift of some variants in all logs, by the label of the horizon."""
    return {
        label: bootstrap.pooled_drift([log[label] for log in logs], names)
        for label in drift_table.horizon_labels()
    }


def _nees(scored: Sequence[CaseScores], name: str) -> Results:
    """Mean NEES of a variant over all logs, and number of poses and positions."""
    means: Results = {}
    for kind in ("nees_pose", "nees_position"):
        logs = [scores.results["variants"].get(name, {}) for scores in scored]
        known = [log for log in logs if log.get(f"{kind}_mean") is not None]
        poses = sum(log["nees_poses"] for log in known)
        # Each log counts by its number of poses.
        total = sum(log[f"{kind}_mean"] * log["nees_poses"] for log in known)
        means[f"{kind}_mean"] = total / poses if poses else math.nan
        means[f"{kind}_poses"] = poses
    return means


def _ratios(scored: Sequence[CaseScores], robots: Sequence[str]) -> Results:
    """Ratio of drift with each robot file to that with the first, same segments."""
    of_robot: dict[str, dict[str, CaseScores]] = {robot: {} for robot in robots}
    for scores in scored:
        if scores.drifts:
            of_robot[scores.case.robot][scores.case.log] = scores
    first_robot, *other_robots = robots
    first = of_robot[first_robot]
    by_robot: Results = {}
    for robot in other_robots:
        pairs = [(first[log], other) for log, other in of_robot[robot].items() if log in first]
        names = dict.fromkeys(name for _, other in pairs for name in other.results["variants"])
        common = {name: ratio for name in names if (ratio := _ratio(pairs, name))}
        by_robot[robot] = {"to": first_robot, "variants": common}
    return by_robot


def _ratio(logs: Sequence[tuple[CaseScores, CaseScores]], name: str) -> Results:
    """Ratio of a variant's drift with another robot file to that with the first.

    `logs` are the scores of each log with both files. Empty if no log has both for the variant.
    """
    ratios: Results = {}
    for label in drift_table.horizon_labels():
        pairs = []
        for first, other in logs:
            first_drifts, other_drifts = first.drifts[label], other.drifts[label]
            if name in first_drifts and name in other_drifts:
                # A larger lag moves the stamps of the truth further back.
                matched = bootstrap.matched_drifts(
                    first_drifts[name], other_drifts[name], later=first.lag - other.lag
                )
                pairs.append(bootstrap.paired_drift({"first": matched[0], "other": matched[1]}))
        if not pairs:
            return {}
        joined = bootstrap.pooled_drift(pairs)
        ratio = joined.ratio("other", "first")
        ratios[f"ratio_{label}"] = ratio.value
        ratios[f"ratio_{label}_95"] = drift_table.listed(ratio)
        ratios[f"segments_{label}"] = len(joined.distances)
    return ratios | {"logs": len(pairs)}
