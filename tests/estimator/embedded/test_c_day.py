"""Exported filters in single precision over a day, against the same in double precision."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from c_filters import compiler
from icreckon.estimator.embedded.c_filter import filter_in_c
from icreckon.estimator.robot.variants import VARIANTS
from same_runs import ROBOT

DAY = Path(__file__).parent / "day.c"
HOURS = 24


def rows_of(folder: Path, bits: int) -> np.ndarray:
    """Rows of `day.c`."""
    of = VARIANTS["inertia-online"]
    exported = filter_in_c(ROBOT, of, bits=bits, imu_rate=20.0)
    exported.write(folder)
    program, sources = folder / "day", [str(DAY), str(folder / "icreckon_filter.c")]
    command = [compiler(), "-std=c99", "-O1", f"-I{folder}", *sources, "-lm", "-o", str(program)]
    subprocess.run(command, check=True, timeout=300)
    track = ROBOT.vehicle.track_gauge * ROBOT.indices.eta0
    done = subprocess.run(
        [program, str(HOURS), str(track)], capture_output=True, text=True, check=True, timeout=900
    )
    return np.array([[float(value) for value in row.split(",")] for row in done.stdout.split()])


@pytest.mark.slow
@pytest.mark.thorough
def test_a_day_in_float_is_that_in_double(tmp_path: Path) -> None:
    """Hours without fixes, to 1 km and more of sigma, then fixes of 5 cm: sums and covariance hold."""
    (tmp_path / "32").mkdir()
    (tmp_path / "64").mkdir()
    found, expected = rows_of(tmp_path / "32", 32), rows_of(tmp_path / "64", 64)
    assert len(expected) == HOURS * 6
    assert (found[:, :2] == expected[:, :2]).all()
    sigmas, of_float = np.sqrt(expected[:, 3::2]), np.sqrt(found[:, 3::2])
    assert sigmas[:, 0].max() > 1000.0
    assert sigmas[sigmas[:, 0] < 0.1].shape[0] >= 3
    unit = np.where(sigmas > 1e-9, sigmas, 1.0)
    assert np.abs((found[:, 2::2] - expected[:, 2::2]) / unit).max() < 0.02
    assert np.abs((of_float - sigmas) / unit).max() < 0.02
