from pathlib import Path

import numpy as np
import pytest

from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.series import PoseSeries
from icreckon.replay.base.outputs import written_beside
from icreckon.replay.export.trajectories import write_tum
from tum import read_tum

STAMPS = np.array([-1_500_000_001, 0, 1, 1_700_000_000_123_456_789, 2**62], dtype=np.int64)


def poses(stamps: np.ndarray = STAMPS) -> PoseSeries:
    return PoseSeries(stamps, np.random.default_rng(5).normal(size=(len(stamps), 3)) * [9, 9, 2])


def test_a_trajectory_comes_back(tmp_path: Path) -> None:
    written = poses()
    found = read_tum(write_tum(tmp_path / "t.tum", written))
    np.testing.assert_array_equal(found.stamps, written.stamps)
    np.testing.assert_allclose(found.poses[:, :2], written.poses[:, :2], atol=1e-9)
    assert np.abs(wrap_angle(found.poses[:, 2] - written.poses[:, 2])).max() < 1e-8


def test_the_text(tmp_path: Path) -> None:
    series = PoseSeries(np.array([1_700_000_000_000_000_007]), np.array([[1.5, -2.0, 0.0]]))
    path = write_tum(tmp_path / "t.tum", series)
    assert path.read_text() == (
        "1700000000.000000007 1.500000000 -2.000000000 0.000000000 "
        "0.000000000 0.000000000 0.000000000 1.000000000\n"
    )


def _write_and_fail(path: Path, **options: bool) -> None:
    with written_beside(path, **options) as new:
        new.write_text("half")
        raise KeyboardInterrupt


def test_an_interrupted_write_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "out.txt"
    with pytest.raises(KeyboardInterrupt):
        _write_and_fail(path)
    assert list(path.parent.iterdir()) == []
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        _write_and_fail(path, overwrite=True)
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]
