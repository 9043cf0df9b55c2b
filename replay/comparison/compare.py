"""Comparison of several filter variants over one log."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import zip_longest
from typing import TypeVar

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import IcreckonError
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault
from icreckon.estimator.log.scores import drift, interpolate_poses
from icreckon.estimator.log.series import require_part
from icreckon.estimator.log.trajectory import Trajectory
from icreckon.estimator.robot.robot_file import Robot, require_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import VARIANTS, find_variant
from icreckon.estimator.sensors.sensor_models import SensorModels
from icreckon.estimator.streaming.lost import LostFilter, described, loss_of
from icreckon.estimator.streaming.outputs import Run
from icreckon.estimator.streaming.run import run
from icreckon.estimator.streaming.smoother import smooth as smooth_run
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.base.start import EXACT_ORIGIN, Start
from icreckon.replay.comparison.drift_table import Drifts, horizon_labels
from icreckon.replay.comparison.fixes import (
    OF_FIXES,
    LogPart,
    parse_part,
    with_fixes_within,
    with_truth_of_fixes,
)
from icreckon.replay.comparison.holes import scored_parts
from icreckon.replay.comparison.initial_pose import lateness, start_from_fixes, start_from_truth
from icreckon.replay.comparison.known_bias import GYRO, KnownBias, known_bias
from icreckon.replay.comparison.truth_alignment import (
    TruthAlignment,
    align_truth,
    in_frame_of_fixes,
    own_alignment,
)

DEFAULT_VARIANTS = tuple(VARIANTS)
ALIGNMENT_VARIANT = "constant-online"  # variant that lag and lever arm are estimated by

Progress = Callable[[float], None]
# Run of a variant, with the smoothed one if requested; instead of a run, the failure.
Outcome = tuple[Run | LostFilter, ...]
Result = TypeVar("Result")


@dataclass(frozen=True)
class Comparison:
    """Runs of several variants over one log; truths and drifts are computed once.

    Attributes:
        log: the log, with the fixes that were used and the truth that was scored against.
        runs: runs by name of the variant, in the order requested; then the smoothed ones, if requested,
            as "inertia-online-smoothed".
        alignment: lag and lever arm removed from a logged truth; None for a simulated truth or none.
        failed: failures by name of the variant; never all of them.
        known_bias: bias of the gyro by the truth, with which `gyro` ran; None if it could learn its own.
    """

    log: Log
    runs: dict[str, Run]
    alignment: TruthAlignment | None
    failed: dict[str, LostFilter] = field(default_factory=dict)
    known_bias: KnownBias | None = None

    @cached_property
    def truths(self) -> dict[str, TruthAlignment]:
        """Truth for each run, by name; a logged one with the run's own lever arm."""
        if self.log.truth is None:
            return {}
        if self.alignment is None:
            return dict.fromkeys(self.runs, TruthAlignment(0.0, (0.0, 0.0), self.log.truth))
        alignment, runs = self.alignment, self.runs.items()
        return {name: own_alignment(alignment, run.trajectory) for name, run in runs}

    @cached_property
    def drifts(self) -> Drifts:
        """Drift of all runs against the truth, by horizon and name; empty without a truth."""
        if self.log.truth is None:
            return {}
        scored = scored_parts(self.log)
        pairs = {name: (self.runs[name].trajectory, self.truths[name].truth) for name in self.runs}
        return {
            label: {
                name: drift(path.pose_series, truth.poses, horizon, unit=unit, within=scored)
                for name, (path, truth) in pairs.items()
            }
            for label, (horizon, unit) in horizon_labels().items()
        }


def compare(
    log: Log,
    robot: Robot,
    variants: Sequence[str] | str = DEFAULT_VARIANTS,
    *,
    settings: Settings | None = None,
    fixes: LogPart | str | None = None,
    smooth: bool = False,
    workers: int = 1,
    progress: Progress | None = None,
) -> Comparison:
    """Run filter variants over a log.

    The lag and lever arm of a logged truth (one without twists) are removed first, and it is moved to the
    frame of the fixes if it is in another one. Runs start at the truth's pose if there is one (without
    fixes at that by their own lever arm), to which dead reckoning leads back from a late truth, otherwise
    at the pose from the fixes or at the origin.

    A variant that is lost or raises an exception has no run; `Comparison.failed` lists it, and the others
    continue.

    If `gyro` is compared with others, and neither standstill nor fixes show it its bias, it runs with the
    bias that the truth shows; see `icreckon.replay.comparison.known_bias`.

    Args:
        log: the log.
        robot: the robot.
        variants: names of filter variants, or one name.
        settings: settings of the pose estimator.
        fixes: part of the log in which fixes are used, as "0:40%" or "12:90" (seconds), or from
            `parse_part`; None for all logged fixes. Without a truth, the others are scored against.
        smooth: whether each run is smoothed, too, see `icreckon.estimator.streaming.smoother`.
        workers: number of threads for the variants; 1 runs them in this one.
        progress: called periodically with the share that is done, 0 to 1.

    Raises:
        EstimatorError: no such variant, a log without track speeds, or an argument of another type.
        ReplayError: fixes were requested that the log lacks, or every variant failed.
    """
    require_part("log", log, Log)
    require_robot(robot)
    variants = (variants,) if isinstance(variants, str) else tuple(variants)
    fixes = parse_part(fixes) if isinstance(fixes, str) else fixes
    for name in variants:
        find_variant(name)
    if fixes is not None:
        log = with_truth_of_fixes(log)
    log = _without_false_headings(log, robot)
    log, alignment, reckoned = _aligned(log, robot, variants, settings)
    log = in_frame_of_fixes(log)
    if alignment is not None and log.truth is not None:
        alignment = replace(alignment, truth=log.truth)
    if fixes is not None:
        log = with_fixes_within(log, fixes)
    start = EXACT_ORIGIN
    if log.truth is not None and log.truth.source != OF_FIXES:
        start = start_from_truth(log, log.truth, reckoned)
        if alignment is not None:
            x, y, yaw = map(math.hypot, start.sigma, alignment.start_sigma)
            start = start._replace(sigma=(x, y, yaw))
    elif log.fixes is not None:
        begin = partial(start_from_fixes, log, robot, settings=settings)
        start = _first_successful(variants, begin)
    task = _Task(log, robot, settings, start, smooth)
    outcomes = _outcomes(task, variants, workers, progress or (lambda _: None))
    # All filtered runs precede the smoothed ones.
    results = [result for kind in zip_longest(*outcomes) for result in kind if result is not None]
    failed = {lost.variant: lost for lost in results if isinstance(lost, LostFilter)}
    runs = {result.variant: result for result in results if isinstance(result, Run)}
    if not runs:
        raise _all_failed([*failed.values()])
    is_compared = GYRO in runs and len(runs) > 1
    bias = known_bias(runs[GYRO], log, robot, scored_parts(log)) if is_compared else None
    if bias is not None:
        rerun = replace(task, robot=bias.robot(robot)).run(GYRO, lambda _: None)
        with_bias = {result.variant: result for result in rerun if isinstance(result, Run)}
        runs, bias = runs | with_bias, bias if GYRO in with_bias else None
    if alignment is not None and log.fixes is None:
        runs = {name: _from_own_start(runs[name], log, alignment) for name in runs}
    return Comparison(log, runs, alignment, failed, bias)


def _without_false_headings(log: Log, robot: Robot) -> Log:
    """Reduce the truth to positions if its headings contradict its path or the gyro."""
    truth, imu = log.truth, log.imu
    if truth is None or not truth.headings:
        return log
    gyro = None
    if imu is not None and len(imu.stamps) > 1:
        gyro = imu.stamps, SensorModels(robot).yaw_rates(imu.angular_velocity)
    fault = heading_fault(truth, gyro)
    if fault is None:
        return log
    note = f"headings of the truth {fault}: not used"
    return replace(log, truth=truth.positions_alone(), notes=(*log.notes, note))


def _aligned(
    log: Log, robot: Robot, variants: Sequence[str], settings: Settings | None
) -> tuple[Log, TruthAlignment | None, Trajectory | None]:
    """Align a logged truth by dead reckoning, which is also returned.

    A truth is dropped if its headings are missing and cannot be found.
    """
    truth = log.truth
    if truth is None or (truth.twists is not None and truth.headings):
        return log, None, None  # a simulated truth has no lag and no lever arm
    without_fixes = _Task(replace(log, fixes=None), robot, settings)
    reckoned = _first_successful(variants, without_fixes.only_run).trajectory
    alignment = align_truth(truth, reckoned, imu=log.imu)
    headings = alignment.headings
    if not truth.headings and headings is None:
        note = (
            "the truth has no headings, and the robot moves too little to find them from its path: the "
            "truth is not used"
        )
        return replace(log, truth=None, notes=(*log.notes, note)), None, None
    notes = (*log.notes, *alignment.notes)
    if truth.source != OF_FIXES and (late := lateness(log, alignment.truth)):
        notes += (
            f"the truth begins {late:.1f} s after the log: dead reckoning leads back from its first pose "
            "to the start",
        )
    if truth.source == OF_FIXES:
        scatter = "" if headings is None else f" (they scatter by {headings.noise:.2f} m)"
        notes += (
            "without a truth, the fixes that are not used are scored against: their own errors"
            f"{scatter}, wander of metres with plain GPS, are in the figures, most of all in drift over "
            "short times",
            "the error at the end is that of one cut: other parts, as --fixes 0:20% and --fixes 0:60%, "
            "show how much it varies",
        )
    return replace(log, truth=alignment.truth, notes=notes), alignment, reckoned


def _from_own_start(unaided: Run, log: Log, common: TruthAlignment) -> Run:
    """Move a run without fixes to the truth's first position by its own lever arm."""
    if log.truth is None or log.truth.source == OF_FIXES:
        return unaided
    own = own_alignment(common, unaided.trajectory)
    # Positions alone: the yaw does not depend on the lever arm.
    at_start = [
        interpolate_poses(one.poses, np.array([log.start])) for one in (own.truth, log.truth)
    ]
    shift = (at_start[0] - at_start[1])[0] * (1.0, 1.0, 0.0)
    states = unaided.states.copy()
    states[:, s.POSE] += shift
    path = unaided.trajectory
    return replace(unaided, states=states, trajectory=replace(path, poses=path.poses + shift))


def _all_failed(failed: Sequence[LostFilter]) -> ReplayError:
    return ReplayError(f"no variant has a result: {'; '.join(map(str, failed))}")


def _first_successful(variants: Sequence[str], attempt: Callable[[str], Result]) -> Result:
    """Result for the alignment variant, or for the first one whose filter is not lost."""
    failed = []
    for name in dict.fromkeys((ALIGNMENT_VARIANT, *variants)):
        try:
            return attempt(name)
        except LostFilter as lost:
            failed.append(lost)
    raise _all_failed(failed)


@dataclass(frozen=True)
class _Task:
    """Runs of variants over a log: what does not depend on the variant."""

    log: Log
    robot: Robot
    settings: Settings | None
    start: Start = EXACT_ORIGIN
    smooth: bool = False

    def run(self, variant: str, progress: Progress) -> Outcome:
        """Run a variant; a lost filter or an unexpected exception is its outcome."""
        begin, length = self.log.start, max(1, self.log.end - self.log.start)
        runner = smooth_run if self.smooth else run
        try:
            result = runner(
                replace(self.log, truth=None),  # the filter must not see it
                self.robot,
                variant,
                settings=self.settings,
                start=self.start.pose,
                start_sigma=self.start.sigma,
                progress=lambda stamp: progress((stamp - begin) / length),
            )
        except LostFilter as lost:
            return (lost,)
        except (IcreckonError, MemoryError):
            raise
        except Exception as problem:
            return (LostFilter(variant, described(problem)),)
        runs = (result,) if isinstance(result, Run) else result
        # A run that ended in numbers that are not finite is a failure, too.
        return tuple(loss_of(each, begin) or each for each in runs)

    def only_run(self, variant: str) -> Run:
        """Run a variant without smoothing; raise its LostFilter if it has no result."""
        (result,) = self.run(variant, lambda _: None)
        if isinstance(result, LostFilter):
            raise result
        return result


def _outcomes(
    task: _Task, variants: Sequence[str], workers: int, progress: Progress
) -> list[Outcome]:
    """Run the variants, in threads if there are several workers."""
    shares = [0.0] * len(variants)

    def outcome(index: int) -> Outcome:
        def report(share: float) -> None:
            shares[index] = share
            progress(sum(shares) / len(shares))

        found = task.run(variants[index], report)
        report(1.0)
        return found

    indices = range(len(variants))
    if workers == 1 or len(variants) == 1:
        return [outcome(index) for index in indices]
    pool = ThreadPoolExecutor(workers, "variant")
    try:
        return [*pool.map(outcome, indices)]
    finally:
        # After an interrupt, for one, nothing waits for runs whose result nobody takes.
        pool.shutdown(wait=False, cancel_futures=True)
