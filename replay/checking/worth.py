"""Worth of what a check of a robot file found, as drift on the log."""

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
from icreckon.replay.comparison.scores import truths_of
from icreckon.replay.live.manoeuvres import missing_manoeuvres

VARIANT = "inertia-online"
# Horizons of the drift, the first that fits the log [s].
HORIZONS = (30.0, 10.0)
# Smallest cost that counts [% of the distance].
LEAST_COST = 0.05


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
    # manoeuvres that would show what this log does not, see `missing_manoeuvres`
    missing: tuple[str, ...] = ()


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
    wrong = [one for one in checks if one.problem]
    count = 2 + len(wrong)
    horizon = next((one for one in HORIZONS if log.duration > 2.0 * one), HORIZONS[-1])
    run, truth = _run(*corrected(log, robot, wrong))
    best = run.trajectory.pose_series
    reference = best if truth is None else truth
    drift_of_best = drift(best, reference, horizon).percent_mean
    report(1 / count)

    def drift_without(errors_corrected: Sequence[Check]) -> float:
        try:
            other, own_truth = _run(*corrected(log, robot, errors_corrected))
        except ReplayError:
            return float("nan")
        path = other.trajectory.pose_series
        return drift(path, reference if own_truth is None else own_truth, horizon).percent_mean

    as_it_is, costs = drift_without([]) if wrong else drift_of_best, []
    for place, one in enumerate(wrong):
        report((2 + place) / count)
        others = [other for other in wrong if other is not one]
        without = drift_without(others) if others and one.correction else as_it_is
        costs.append(without - drift_of_best if one.correction else float("nan"))
    report(1.0)
    missing = missing_manoeuvres(run.state_names, run.state_sigmas[-1])
    known = drift_of_best if truth is not None else np.nan
    return Worth(horizon, as_it_is, known, tuple(costs), tuple(missing))


def judged(
    log: Log, robot: Robot, checks: Sequence[Check], progress: Callable[[float], None] | None = None
) -> tuple[list[Check], Worth, list[str]]:
    """Checks without those that only make the drift larger, worth, and notes on these.

    Raises:
        ReplayError: as of `worth_of`.
    """
    worth, notes = worth_of(log, robot, checks, progress), []
    wrong = [one for one in checks if one.problem]
    kept = list(checks)
    for one, cost in zip(wrong, worth.costs, strict=True):
        if one.name == LATENCY and log.truth is not None and cost < -LEAST_COST:
            notes.append(
                f"{one.problem}; but with that set {VARIANT} drifts {-cost:.1f} points more after "
                f"{worth.horizon:g} s: file value kept"
            )
            kept[kept.index(one)] = replace(one, problem="", correction=None, settings={})
    return (kept, worth_of(log, robot, kept, progress) if notes else worth, notes)


def mean_drift(logs: Sequence[Log], robot: Robot, variant: str, horizon: float) -> float:
    """Drift without fixes, mean over logs [% of distance]; NaN for no result."""
    found = []
    for log in logs:
        with suppress(ReplayError):
            one, truth = _run(replace(log, fixes=None), robot, variant)
            path = one.trajectory.pose_series
            found += [] if truth is None else [drift(path, truth, horizon).percent_mean]
    return float(np.mean(found)) if len(found) == len(logs) else float("nan")


def _run(log: Log, robot: Robot, variant: str = VARIANT) -> tuple[Run, PoseSeries | None]:
    """Run of a filter, and the truth aligned to it, if there is one."""
    found = compare(log, robot, (variant,))
    truth = None if found.log.truth is None else truths_of(found)[variant].truth.poses
    return found.runs[variant], truth
