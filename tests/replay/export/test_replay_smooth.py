"""`icreckon replay --smooth`, in a process of its own."""

from pathlib import Path

import pytest

from command_line import results_in, succeeds
from tum import read_tum


def test_replay_writes_the_smoothed_paths_beside_the_others(tmp_path: Path) -> None:
    words = ("--duration", 30, "--outage", "8:26", "--trajectory", "slalom", "--seed", 3)
    succeeds("simulate", "--out", "run", *words, cwd=tmp_path)
    words = (
        "--robot",
        "auriga-alpha",
        "--variants",
        "inertia-online",
        "--smooth",
        "--out",
        "found",
    )
    done = succeeds("replay", "run", *words, cwd=tmp_path)
    assert " inertia-online-smoothed " in done.stdout
    assert "Warning" not in done.stderr
    results = results_in(tmp_path / "found")
    assert results["configuration"]["smooth"] is True
    assert list(results["variants"]) == ["inertia-online", "inertia-online-smoothed"]
    filtered, smoothed = (
        read_tum(tmp_path / "found" / f"{name}.tum") for name in results["variants"]
    )
    assert (filtered.stamps == smoothed.stamps).all()
    assert filtered.poses[-1] == pytest.approx(smoothed.poses[-1], abs=0.05)
    before, after = (
        max(error for error in one["position_error_m"])
        for one in (results["series"]["variants"][name] for name in results["variants"])
    )
    # By how much is the business of tests/estimator/streaming/test_smoother.py.
    assert after < before
