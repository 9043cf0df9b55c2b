"""Two faults at once, of different sensors; and faults in what comes late."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from _scoreboard_put import FAULTS, SECOND

from faulty_drives import errors, with_free_tracks
from icreckon import FixSpec, Log, Run, Scenario, load_robot, run, simulate
from icreckon.estimator.log.measurements import PositionFix
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from same_runs import assert_same_run, fed_one_by_one

ALPHA, VARIANT = load_robot("auriga-alpha"), "inertia-online"
TRACKS = (
    "stuck encoder, 3 s",
    "left encoder reads zero, 10 s",
    "left track spins, 3 s",
    "both tracks spin, 10 s",
    "wheel against its side, 3 s",
)
IMU = ("gyro frozen, 5 s", "gyro clipped, 10 s", "gyro reads 2 rad/s, 1 s")
FIXES = ("outliers of 10 m, 30 s", "fixes 50 m off, 5 s", "receiver repeats, 30 s")
BEGINS, LATE = 25.0, 57.0
SLIDE = "both tracks spin up"
OTHERS = {
    "bias + 0.05 rad/s, fixes": (BEGINS, 7.0),
    "fixes scatter by 0.5 m, 30 s": (BEGINS, 7.0),
    "carried at rest, 10 s": (2.8, 3.0),
    SLIDE: (30.0, 2.0),
}
"""Other faults, when they begin, and time from then on until the filter is saved [s]."""
FOUND = {
    TRACKS[0]: {"stuck"},
    TRACKS[2]: {"spinning"},
    TRACKS[4]: {"wheel off"},
    IMU[2]: {"failing"},
    "fixes scatter by 0.5 m, 30 s": {"scattering"},
    "carried at rest, 10 s": {"carried"},
    SLIDE: {"sliding"},
}
"""Findings of a filter that is saved in the midst of a fault."""


@cache
def drive() -> Log:
    fixes = FixSpec(sigma=0.05)
    scenario = Scenario(duration=66.0, seed=4, trajectory="random", fix_rate=2.0, fixes=fixes)
    return simulate(scenario, ALPHA)


def with_faults(*names: str, begins: float = BEGINS) -> Log:
    log, begin = drive(), drive().start + round(begins * SECOND)
    for name in names:
        end = begin + round(FAULTS[name].lasts * SECOND)
        log = FAULTS[name].put(log, begin, end, np.random.default_rng(len(name)))
    return log


def without_fixes(log: Log, lasts: float) -> Log:
    since = (log.fixes.stamps - log.start) / SECOND - BEGINS
    columns = {name: getattr(log.fixes, name) for name in ("stamps", "poses", "variances")}
    kept = (since < 0.0) | (since > lasts)
    return replace(log, fixes=replace(log.fixes, **{k: v[kept] for k, v in columns.items()}))


def at_end(one: Run) -> tuple[float, float]:
    """Largest error of the position from `LATE` on, in metres and in its own standard deviations."""
    seconds, distances, _ = errors(one, drive())
    late = seconds > LATE
    sigmas = np.hypot(*one.state_sigmas[late, :2].T)
    return float(distances[late].max()), float((distances[late] / sigmas).max())


@pytest.mark.parametrize("names", list(zip(TRACKS, 2 * IMU, strict=False)), ids=" and ".join)
def test_tracks_and_gyro_at_once_are_no_worse_than_both(names: tuple[str, str]) -> None:
    error, sigmas = at_end(run(with_faults(*names), ALPHA, VARIANT))
    alone = [at_end(run(with_faults(name), ALPHA, VARIANT))[0] for name in names]
    assert sigmas < 3.0 or error < 2.0 * sum(alone) + 0.2


@pytest.mark.parametrize("names", list(zip(TRACKS, 2 * FIXES, strict=False)), ids=" and ".join)
def test_wrong_fixes_beside_a_fault_of_the_tracks_are_no_worse_than_none(names):
    error, sigmas = at_end(run(with_faults(*names), ALPHA, VARIANT))
    alone = without_fixes(with_faults(names[0]), FAULTS[names[1]].lasts)
    assert sigmas < 3.0 or error < 2.0 * at_end(run(alone, ALPHA, VARIANT))[0] + 0.5


@pytest.mark.parametrize(
    "names",
    [(TRACKS[0], FIXES[2]), (TRACKS[2], IMU[2], FIXES[0]), (TRACKS[4], IMU[0], FIXES[1])],
    ids=" and ".join,
)
def test_a_log_at_once_is_that_sample_by_sample(names: tuple[str, ...]) -> None:
    log = with_faults(*names)
    assert_same_run(run(log, ALPHA, VARIANT), fed_one_by_one(log, ALPHA, VARIANT))


@pytest.mark.parametrize("name", [*TRACKS, *IMU, *FIXES, *OTHERS])
def test_late_fixes_and_a_restart_meet_a_fault_as_a_filter_in_time_does(name, tmp_path):
    """Each fix comes half a second late, so that all samples since are taken again."""
    begins, after = OTHERS.get(name) or (BEGINS, 0.7 * min(FAULTS[name].lasts, 10.0))
    in_time, late = (PoseEstimator(ALPHA, VARIANT) for _ in range(2))
    restored, seen = None, set()
    waiting: list[PositionFix] = []
    save = drive().start + round((begins + after) * SECOND)
    log = with_free_tracks(drive()) if name == SLIDE else with_faults(name, begins=begins)
    for m in log.between(drive().start, drive().start + 45 * SECOND).measurements():
        in_time.feed(m)
        if restored is not None:
            restored.feed(m)
        elif m.stamp > save:
            in_time.save(tmp_path / "saved.json")
            restored = PoseEstimator.restore(tmp_path / "saved.json", ALPHA, VARIANT)
            seen = {one.fault for one in in_time.health.findings}
            assert restored.health.findings == in_time.health.findings
        if isinstance(m, PositionFix):
            waiting.append(m)
            continue
        late.feed(m)
        while waiting and m.stamp > waiting[0].stamp + SECOND // 2:
            late.feed(waiting.pop(0))
    for m in waiting:
        late.feed(m)
    assert seen >= FOUND.get(name, set())
    sigmas = np.sqrt(np.diagonal(in_time.covariance))
    assert np.abs((late.state - in_time.state) / np.where(sigmas > 0.0, sigmas, 1.0)).max() < 1e-9
    assert late.health.findings == in_time.health.findings
    assert (restored.state == in_time.state).all()
    assert (restored.covariance == in_time.covariance).all()
    assert restored.health == in_time.health
