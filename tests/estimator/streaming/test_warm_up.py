"""No measurement waits for the compiler: what `feed` calls is compiled when an estimator is made."""

import subprocess
import sys

import pytest

from conftest import REPOSITORY

# The signatures of all compiled functions of a process, before and after a drive with every kind of
# measurement. Those that are loaded from disk count like those that are compiled.
SCRIPT = """
import gc, sys
sys.path.insert(0, {benchmarks!r})
from cold_start import measurements
import icreckon
from numba.core.dispatcher import Dispatcher
from icreckon.estimator.tracing.machine_code import LIBRARIES

def signatures():
    found = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    functions = [(one.py_func.__qualname__, str(sig)) for one in found for sig in one.signatures]
    return sorted(functions) + [("kernels", str(len(LIBRARIES)))]

estimator = icreckon.PoseEstimator(icreckon.load_robot("auriga-alpha"), {variant!r})
before = signatures()
drive = list(measurements(16.0))
for k, measurement in enumerate(drive):
    estimator.feed(measurement)
    # Steps with a mark are made part by part, those before it as a whole.
    if k == len(drive) - 100:
        estimator.mark()
names = " ".join(name for name, _ in before)
assert all(part in names for part in ("take_step", "evaluate_twist"))
print(sorted(set(signatures()) - set(before)))
"""


@pytest.mark.parametrize("variant", ["inertia-online"])
def test_feeding_compiles_nothing(variant: str) -> None:
    script = SCRIPT.format(benchmarks=str(REPOSITORY / "benchmarks"), variant=variant)
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
