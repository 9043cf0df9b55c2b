"""The notebook lesson: all of its cells run, one after the other, and do what the text says."""

import contextlib
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from readme import code_blocks

PAGE = "docs/tutorials/notebook.md"


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """All names after the last cell, and the folder that it ran in."""
    pytest.importorskip("pandas", reason="pip install pandas (in the extra test)")
    folder = tmp_path_factory.mktemp("notebook")
    names: dict[str, Any] = {"folder": folder}
    with contextlib.chdir(folder), mpl.rc_context({"backend": "agg"}):
        blocks = code_blocks("python", PAGE)
        assert len(blocks) == 7
        for block in blocks:
            exec(compile(block, PAGE, "exec"), names)  # noqa: S102
    return names


def test_the_table_has_the_scores_of_each_variant_and_the_robot_fits_its_log(cells) -> None:
    checks = cells["icreckon"].check_robot(cells["log"], cells["robot"])
    assert not [one.problem for one in checks if one.problem]
    assert not cells["comparison"].failed
    table = cells["table"]
    assert list(table.index) == ["gyro", "constant-online", "inertia-online"]
    assert np.isfinite(table.to_numpy()).all()
    drifts = table["drift_percent_30s_mean"]
    assert drifts["inertia-online"] < drifts["gyro"] < 5.0


def test_runs_are_frames_over_time_and_plot_and_page_are_written(cells: dict[str, Any]) -> None:
    run = cells["runs"]["inertia-online"]
    assert run.index[-1] == pytest.approx(90.0, abs=0.1)
    assert run.index.is_monotonic_increasing
    assert "gyro_bias_rad_s" in run.columns
    end = cells["comparison"].runs["inertia-online"].trajectory.poses[-1]
    assert (run.x_m.iloc[-1], run.y_m.iloc[-1]) == pytest.approx(tuple(end[:2]))
    assert len(cells["whole"]) == len(cells["comparison"].runs["inertia-online"].stamps)
    assert (cells["folder"] / "drive.png").stat().st_size > 10_000
    assert (cells["folder"] / "report" / "page.html").exists()
