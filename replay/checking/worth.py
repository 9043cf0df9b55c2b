"""Drift that each contradiction between a robot file and a log adds."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from icreckon.estimator.log.log import Log
from icreckon.estimator.log.scores import drift
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.streaming.outputs import Run
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.checking.check import LATENCY, Check, corrected
from icreckon.replay.comparison.compare import compare
from icreckon.replay.live.manoeuvres import missing_manoeuvres

VARIANT = "inertia-online"
HORIZONS = (30.0, 10.0)  # horizons of the drift, the first that fits the log [s]
LEAST_COST = 0.05  # smallest cost that counts [% of the distance]


@dataclass(frozen=True)
class Worth:
    """Drift of dead reckoning, as the file is and with its contradictions corrected.

    Without a truth all is relative to the path with everything corrected, whose own drift is unknown.
    """

    horizon: float  # time without fixes after which drift is taken [s]
    as_it_is: float  # drift with the file as it is [% of distance]; NaN if the filter has no result
    corrected: float  # drift with everything corrected [% of distance]; NaN without a truth
    # drift that each contradiction alone adds to that [% of distance], in the order of the checks;
    # NaN if it cannot be corrected, or the filter has no result with it
    costs: tuple[float, ...]
    missing: tuple[str, ...] = ()  # manoeuvres that the log lacks, see `missing_manoeuvres`


def worth_of(
    log: Log, robot: Robot, checks: Sequence[Check], progress: Callable[[float], None] | None = None
) -> Worth:
    """Run the filter with a robot file as it is, corrected, and with each error alone.

    Fixes are not used.

    Raises:
        ReplayError: the filter has no result with everything corrected.
    """
    report = progress or (lambda _: None)
    log = replace(log, fixes=None)
    wrong = [check for check in checks if check.problem]
    horizon = next((span for span in HORIZONS if log.duration > 2.0 * span), HORIZONS[-1])
    run, truth = _run(*corrected(log, robot, wrong))
    best_path = run.trajectory.pose_series
    reference = best_path if truth is None else truth
    best_drift = drift(best_path, reference, horizon).percent_mean

    def drift_with(corrections: Sequence[Check]) -> float:
        """Drift with some checks corrected [%]; the truth is aligned with each run."""
        try:
            run, truth = _run(*corrected(log, robot, corrections))
        except ReplayError:
            return float("nan")
        path = run.trajectory.pose_series
        return drift(path, reference if truth is None else truth, horizon).percent_mean

    report(1 / (2 + len(wrong)))
    as_it_is, costs = drift_with([]) if wrong else best_drift, []
    for index, check in enumerate(wrong):
        report((2 + index) / (2 + len(wrong)))
        others = [other for other in wrong if other is not check]
        if check.correction is None:
            costs.append(float("nan"))
        else:
            costs.append((drift_with(others) if others else as_it_is) - best_drift)
    report(1.0)
    missing = missing_manoeuvres(run.state_names, run.state_sigmas[-1])
    corrected_drift = best_drift if truth is not None else np.nan
    return Worth(horizon, as_it_is, corrected_drift, tuple(costs), tuple(missing))


def judged(
    log: Log, robot: Robot, checks: Sequence[Check], progress: Callable[[float], None] | None = None
) -> tuple[list[Check], Worth, list[str]]:
    """Withdraw latencies whose correction increases the drift against the truth.

    Returns the checks, with no problem where one was withdrawn, their worth, a note on each withdrawn
    one; raises what `worth_of` does.
    """
    worth, notes, judged_checks = worth_of(log, robot, checks, progress), [], list(checks)
    wrong = (check for check in checks if check.problem)
    for check, cost in zip(wrong, worth.costs, strict=True):
        # A negative cost: the correction increases the drift.
        if check.name == LATENCY and log.truth is not None and cost < -LEAST_COST:
            notes.append(
                f"{check.problem}; but with that set {VARIANT} drifts {-cost:.1f} points more after "
                f"{worth.horizon:g} s: file value kept"
            )
            withdrawn = replace(check, problem="", correction=None, settings={})
            judged_checks[judged_checks.index(check)] = withdrawn
    worth = worth_of(log, robot, judged_checks, progress) if notes else worth
    return judged_checks, worth, notes


def mean_drift(logs: Sequence[Log], robot: Robot, variant: str, horizon: float) -> float:
    """Mean drift over logs without fixes [%]; NaN if any lacks a result or a truth."""
    drifts = []
    for log in logs:
        with suppress(ReplayError):
            run, truth = _run(replace(log, fixes=None), robot, variant)
            path = run.trajectory.pose_series
            drifts += [] if truth is None else [drift(path, truth, horizon).percent_mean]
    return float(np.mean(drifts)) if len(drifts) == len(logs) else float("nan")


def _run(log: Log, robot: Robot, variant: str = VARIANT) -> tuple[Run, PoseSeries | None]:
    """Run of a filter, and the truth aligned to it, if there is one."""
    comparison = compare(log, robot, (variant,))
    aligned = comparison.truths.get(variant)
    return comparison.runs[variant], None if aligned is None else aligned.truth.poses
