"""Compiled functions on disk: processes that share them, in any order and at once, never mix them up."""

import pickle
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from command_line import fails, icreckon_alone
from icreckon.estimator.engine.work import run_kernel
from icreckon.estimator.tracing import kernel_cache
from icreckon.estimator.tracing.emit import lanes_of_machine
from icreckon.estimator.tracing.jit_kernel import compiled, entry
from icreckon.estimator.tracing.kernel import Kernel, Store
from icreckon.estimator.tracing.kernel_cache import cache_folder
from icreckon.estimator.tracing.machine_code import address_of, compiled_library
from icreckon.estimator.tracing.trace import lane_input, start


def test_the_cache_is_where_the_user_wants_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/somewhere")
    assert cache_folder() == Path("/somewhere/icreckon")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert cache_folder().parts[-2:] == ("icreckon", "kernels")


def doubled(x: np.ndarray) -> None:
    for k in range(len(x)):
        x[k] *= 2


doubled.__module__ = "icreckon.estimator.made_by_a_test"
# What is loaded from disk looks its module up by name.
sys.modules[doubled.__module__] = sys.modules[__name__]


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return tmp_path


def files_of(folder: Path) -> list[Path]:
    return sorted((folder / "icreckon").rglob("*.kernel"))


def test_each_signature_has_a_file_of_its_own(own_cache: Path) -> None:
    """Two processes that save different signatures at once cannot take each other's place."""
    for kind in (np.float64, np.int64, np.float32):
        function, x = compiled(doubled), np.ones(3, kind)
        function(x)
        assert (x == 2).all()
    assert len(files_of(own_cache)) == 3
    again, x = compiled(doubled), np.ones(3)
    again(x)
    assert (x == 2).all()
    assert sum(again.stats.cache_hits.values()) == 1


@pytest.mark.parametrize("harm", ["cut", "flip", "other", "empty"])
def test_a_damaged_file_is_compiled_again(own_cache: Path, harm: str) -> None:
    compiled(doubled)(np.ones(3))
    (path,) = files_of(own_cache)
    content = bytearray(path.read_bytes())
    match harm:
        case "cut":
            content = content[: len(content) // 2]
        case "flip":
            content[len(content) // 2] ^= 1
        case "empty":
            content = bytearray()
        case "other":
            payload = pickle.dumps((("other", "key", "here"), ()))
            content = bytearray(kernel_cache.CHECKSUM(payload).digest() + payload)
    path.write_bytes(content)
    function, x = compiled(doubled), np.ones(3)
    function(x)
    assert (x == 2).all()
    assert sum(function.stats.cache_misses.values()) == 1
    assert bytes(content) != path.read_bytes(), (
        "what was compiled takes the place of the damaged file"
    )


def test_a_folder_that_cannot_be_written_costs_one_warning(own_cache: Path) -> None:
    (own_cache / "icreckon").write_text("a file in the way")
    kernel_cache._warn_once.cache_clear()
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        for kind in (np.float64, np.int64):
            x = np.ones(3, kind)
            compiled(doubled)(x)
            assert (x == 2).all()
    assert len(found) == 1
    assert "set NUMBA_CACHE_DIR" in str(found[0].message)


def test_preparing_fails_if_nothing_can_be_kept(own_cache: Path) -> None:
    (own_cache / "icreckon").write_text("a file in the way")
    assert "NUMBA_CACHE_DIR" in fails("prepare", cwd=own_cache, run=icreckon_alone)


def doubled_kernel(name: str) -> Kernel:
    """Kernel of this package that doubles one number."""
    start()
    return Kernel(name, (1, 0, 0), [Store("lanes", 0, 2.0 * lane_input("lanes", 0))])


@pytest.mark.parametrize("harm", ["none", "cut", "empty"])
def test_a_kernel_is_loaded_from_its_file_or_compiled_again(own_cache: Path, harm: str) -> None:
    make = address_of.__wrapped__
    make(doubled_kernel, (harm,), 1)
    (path,) = files_of(own_cache)
    content = path.read_bytes()
    path.write_bytes({"none": content, "cut": content[:-9], "empty": b""}[harm])
    lanes = np.ones((1, 1))
    assert entry(run_kernel)(make(doubled_kernel, (harm,), 1), lanes, lanes, lanes) == 0
    assert lanes[0, 0] == 2.0
    assert len(path.read_bytes()) == len(content)


def test_a_step_whose_kernel_is_not_compiled_is_refused() -> None:
    lanes = np.ones((1, 1))
    with pytest.raises(ValueError, match="was not compiled"):
        entry(run_kernel)(0, lanes, lanes, lanes)


def test_a_kernel_cannot_address_rows_that_its_arrays_lack() -> None:
    start()
    stores = [Store("lanes", 1, lane_input("lanes", 0))]
    beyond = Kernel("beyond", (1, 0, 0), stores)
    with pytest.raises(ValueError, match="'beyond' addresses row 1 of 'lanes', which has 1"):
        compiled_library(beyond, "beyond", lanes_of_machine(64))
