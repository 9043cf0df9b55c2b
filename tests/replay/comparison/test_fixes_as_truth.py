"""A log without a truth is scored against the fixes that a replay does not use."""

from dataclasses import replace

import numpy as np
import pytest

from icreckon import Log, Scenario, compare, load_robot, simulate, summarise
from icreckon.replay.comparison.fixes import OF_FIXES, parse_part, with_truth_of_fixes

ALPHA = load_robot("auriga-alpha")
VARIANTS = ("gyro", "inertia-online")
PART = parse_part("0:40%")


@pytest.fixture(scope="module")
def log() -> Log:
    """A drive with a fix a second, as a GPS with corrections has them."""
    return simulate(Scenario(duration=120.0, seed=1, fix_rate=1.0, trajectory="aggressive"), ALPHA)


def scored(log: Log, part=PART) -> dict:
    return summarise(compare(log, ALPHA, VARIANTS, fixes=part), ALPHA)


def test_drift_is_about_that_against_the_truth(log: Log):
    by_truth, by_fixes = scored(log), scored(replace(log, truth=None))
    assert (by_truth["truth"]["source"], by_fixes["truth"]["source"]) == ("friction", OF_FIXES)
    noise = by_fixes["truth"]["noise_drift_percent"]["30s"]
    for name in VARIANTS:
        known, found = (one["variants"][name] for one in (by_truth, by_fixes))
        key = "drift_percent_30s_mean"
        # Noise of the fixes adds to the errors, at most as much as to those of a perfect path.
        assert 0.9 * known[key] < found[key] < known[key] + noise
        assert found["drift_segments_30s"] > 30
        # Nothing says how wrong the fixes are, so consistency is not judged.
        assert found["nees_pose_mean"] is None
        assert found["nees_position_mean"] is None
        # The run itself is the same: the fixes that are scored against are not used.
        assert found["used"] == known["used"]
    distances = by_fixes["truth"]["distance_m"], by_truth["truth"]["distance_m"]
    assert distances[0] == pytest.approx(distances[1], rel=0.02)
    gyro, inertia = (by_fixes["variants"][name]["drift_percent_30s_mean"] for name in VARIANTS)
    assert inertia < gyro
    notes = by_fixes["log"]["notes"]
    assert any("the fixes that are not used are scored against" in note for note in notes)


def test_all_fixes_leave_nothing_to_score(log: Log):
    assert scored(replace(log.part(0.0, 20.0), truth=None), None)["truth"] is None


def test_fixes_that_state_a_far_larger_error_are_no_truth() -> None:
    """As of RTK without its integers for a while."""
    log = simulate(Scenario(duration=60.0, seed=3, fix_rate=2.0), load_robot("auriga-alpha"))
    poses, variances = log.fixes.poses.copy(), log.fixes.variances.copy()
    poses[40:60, :2] += 0.5
    variances[40:60, 0] = 100.0 * variances[0, 0]
    floating = replace(log, truth=None, fixes=replace(log.fixes, poses=poses, variances=variances))
    truth = with_truth_of_fixes(floating).truth.poses
    assert truth.stamps.tolist() == np.delete(log.fixes.stamps, np.s_[40:60]).tolist()
