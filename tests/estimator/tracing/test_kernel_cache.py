"""Compiled functions on disk: processes that share them, in any order and at once, never mix them up."""

import copy
import os
import pickle
import struct
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

import numpy as np
import pytest

from command_line import fails, icreckon_alone
from conftest import REPOSITORY
from icreckon.estimator.engine.filters import BatchFilter
from icreckon.estimator.engine.work import LaneKernels, run_kernel
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant
from icreckon.estimator.tracing import kernel_cache
from icreckon.estimator.tracing.emit import lanes_of_machine
from icreckon.estimator.tracing.jit_kernel import COMPILED, compiled, entry
from icreckon.estimator.tracing.kernel import Kernel, Store
from icreckon.estimator.tracing.kernel_cache import (
    DIGITS,
    KernelCache,
    cache_folder,
    environment_digest,
)
from icreckon.estimator.tracing.machine_code import address_of, compiled_library
from icreckon.estimator.tracing.trace import lane_input, start

WORKER = REPOSITORY / "tests" / "cache_worker.py"
# Filters of other shapes, with the same functions between their kernels. A process that does one of the
# two has compiled as many functions before as one that does the other.
TASKS = ("replay:differential", "replay:constant-online")
WEAK_OR_GLOBAL, SYMBOL_TABLE = (1, 2), 2


def digests(*processes: tuple[Path, tuple[str, ...]]) -> list[dict[str, str]]:
    """What processes print that do some tasks each, all at once, with the cache of their own."""
    begun = [
        subprocess.Popen(
            [sys.executable, str(WORKER), *tasks],
            env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for cache, tasks in processes
    ]
    ended = [(*process.communicate(timeout=300), process.returncode) for process in begun]
    assert all(code == 0 for _, _, code in ended), ended
    return [dict(line.split() for line in out.splitlines()) for out, _, _ in ended]


@pytest.fixture(scope="module")
def shared_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shared")


@pytest.mark.thorough
def test_processes_that_share_a_cache_compute_what_lonely_ones_do(
    shared_cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    # Each of these compiles all it needs: it begins with an empty cache and does one thing.
    lonely: dict[str, str] = {}
    for found in digests(*((tmp_path_factory.mktemp("lonely"), (task,)) for task in TASKS)):
        lonely |= found
    # Then they share one: at once while it fills, and in both orders when it is full.
    for found in digests(*((shared_cache, (task,)) for task in TASKS)):
        assert found == {task: lonely[task] for task in found}
    for found in digests((shared_cache, TASKS), (shared_cache, TASKS[::-1])):
        assert found == lonely


@pytest.mark.thorough
def test_every_symbol_on_disk_is_named_by_what_its_code_depends_on(shared_cache: Path) -> None:
    """Of two symbols with one name the linker takes the first; the digest is what tells them apart."""
    digest = environment_digest("estimator")
    found: dict[str, Path] = {}
    for path in sorted((shared_cache / "icreckon").rglob("*.kernel")):
        for symbol in symbols_of(path):
            if "estimator" in symbol or "_kernel." in symbol:
                assert digest in symbol, symbol
            if "_kernel." in symbol:
                assert path.name.startswith(f"{symbol}-")
                assert found.setdefault(symbol, path) == path
    # Two shapes of filters have two kernels of each kind, and one loop around them.
    assert sum("step_kernel" in symbol for symbol in found) >= 2 * 4
    assert len(sorted((shared_cache / "icreckon").rglob("*work_through*.kernel"))) == 1


def symbols_of(path: Path) -> Iterator[str]:
    """Names of the weak and global symbols that the object files in a cache file define (64-bit ELF)."""
    content = path.read_bytes()
    place = content.find(b"\x7fELF")
    if place < 0:
        pytest.skip("no ELF object files on this system")
    while place >= 0:
        yield from elf_symbols(content[place:])
        place = content.find(b"\x7fELF", place + 4)


def elf_symbols(data: bytes) -> Iterator[str]:
    (table,) = struct.unpack_from("<Q", data, 0x28)
    size, count = struct.unpack_from("<HH", data, 0x3A)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, table + k * size) for k in range(count)]
    for section in sections:
        if section[1] != SYMBOL_TABLE:
            continue
        names = sections[section[6]][4]
        for place in range(section[4], section[4] + section[5], 24):
            name, info, _, defined_in = struct.unpack_from("<IBBH", data, place)
            if defined_in and info >> 4 in WEAK_OR_GLOBAL:
                begin = names + name
                yield data[begin : data.index(b"\0", begin)].decode()


def test_a_function_with_variables_around_it_is_refused() -> None:
    """They would be missing in the name of its machine code."""
    factor = 2.0
    with pytest.raises(ValueError, match="variables of the function around it"):
        entry(lambda x: factor * x)


def as_of_the_estimator(function: FunctionType) -> FunctionType:
    """Only functions of the package are compiled with their callers."""
    function.__module__ = "icreckon.estimator.made_by_a_test"
    return function


@as_of_the_estimator
def rate(record: np.void) -> float:
    return record.rate + 1.0


@as_of_the_estimator
def countdown(steps: int) -> int:
    return countdown(steps - 1) if steps else 0


def test_a_function_may_be_named_like_an_attribute_it_reads(own_cache: Path) -> None:
    record = np.array([(2.0,)], dtype=[("rate", float)])[0]
    assert entry(rate)(record) == 3.0
    assert len(files_of(own_cache)) == 1


@as_of_the_estimator
def scaled(x: float, times: int) -> float:
    return x * times


@as_of_the_estimator
def six_times(x: float) -> float:
    return scaled(scaled(x, 2), 3)


@pytest.mark.usefixtures("own_cache")
def test_a_callee_is_compiled_once_whatever_constants_it_is_given() -> None:
    assert entry(six_times)(1.5) == 9.0
    assert len(COMPILED[scaled].overloads) == 1


def test_a_function_that_calls_itself_is_refused() -> None:
    with pytest.raises(ValueError, match="countdown calls itself"):
        entry(countdown)


def test_the_cache_is_where_the_user_wants_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/somewhere")
    assert cache_folder() == Path("/somewhere/icreckon")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert cache_folder().parts[-2:] == ("icreckon", "kernels")


def test_a_user_without_a_home_has_no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", none)
    assert cache_folder().parts[-2:] == ("icreckon", "kernels")
    assert not kernel_cache.keeps_kernels()


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


def test_a_cache_can_be_emptied_and_switched_off(own_cache: Path) -> None:
    compiled(doubled)(np.ones(3))
    digest = environment_digest("estimator")
    kept = KernelCache(f"icreckon.estimator.made_by_a_test.doubled.{digest}", "estimator")
    assert kept.cache_path.startswith(str(own_cache))
    kept.flush()
    assert not files_of(own_cache)
    function = compiled(doubled)
    function._cache.disable()
    function(np.ones(3))
    assert not files_of(own_cache)
    function._cache.enable()
    function(np.ones(3, np.int64))
    assert len(files_of(own_cache)) == 1


def test_other_sources_have_another_folder(
    own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled(doubled)(np.ones(3))
    monkeypatch.setattr(kernel_cache, "environment_digest", lambda _: "0" * DIGITS)
    function = compiled(doubled)
    function(np.ones(3))
    assert sum(function.stats.cache_misses.values()) == 1
    assert len({path.parent for path in files_of(own_cache)}) == 2


# --- kernels -------------------------------------------------------------------------------------


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


# --- sizes ---------------------------------------------------------------------------------------


def test_a_kernel_cannot_address_rows_that_its_arrays_lack() -> None:
    start()
    stores = [Store("lanes", 1, lane_input("lanes", 0))]
    beyond = Kernel("beyond", (1, 0, 0), stores)
    with pytest.raises(ValueError, match="'beyond' addresses row 1 of 'lanes', which has 1"):
        compiled_library(beyond, "beyond", lanes_of_machine(64))


@pytest.mark.parametrize(
    "wrong", ["workspace", "constants", "inputs", "type", "table", "estimates", "fixes", "ticks"]
)
def test_filters_side_by_side_refuse_arrays_of_the_wrong_size(wrong: str) -> None:
    from icreckon.estimator.engine.constants import aligned
    from icreckon.estimator.engine.layout import INPUTS, STEP_CONSTANTS
    from icreckon.estimator.engine.schedule import MOVE_AND_UPDATE, TICK, Steps
    from icreckon.estimator.engine.work import ESTIMATE

    robot, variant = load_robot("auriga-alpha"), find_variant("differential")
    filters = BatchFilter(robot, variant, Settings())
    n, width = 2, filters.width
    step = 10_000_000
    zeros = np.zeros(n, dtype=np.int64)
    steps = Steps(
        np.arange(n) * step, np.arange(1, n + 1) * step, zeros + MOVE_AND_UPDATE,
        np.full(n, 0.01), zeros + TICK, zeros + 1, np.arange(n), zeros, np.arange(n), zeros + 1,
    )  # fmt: skip
    table = filters.prepare(steps)
    lanes = filters.begin(np.zeros((width, 2)), np.zeros(3), np.zeros(3))
    inputs = aligned(n * len(INPUTS) * width).reshape(n, -1, width)
    estimates = np.zeros((n, len(ESTIMATE), width))
    before = lanes.workspace.copy()
    match wrong:
        case "workspace":
            lanes = lanes._replace(workspace=aligned(8 * width).reshape(8, width))
        case "constants":
            lanes = lanes._replace(constants=lanes.constants[:-1])
        case "inputs":
            inputs = inputs[:1]
        case "type":
            inputs = inputs.astype(np.float32)
        case "table":
            table = table[:, : len(STEP_CONSTANTS)]
        case "estimates":
            estimates = estimates[:, :3]
        case "fixes":
            lanes = lanes._replace(fixes=lanes.fixes[:1])
        case "ticks":
            estimates = estimates[:1]
    with pytest.raises(ValueError, match="wrong size"):
        filters.work_through(lanes, inputs, steps, np.ascontiguousarray(table), estimates)
    if wrong != "workspace":
        assert np.array_equal(lanes.workspace, before)


def test_filters_for_another_process_have_no_addresses() -> None:
    filters = BatchFilter(load_robot("auriga-alpha"), find_variant("gyro"), Settings(), 32)
    filters._kernels = LaneKernels(usual=1)
    other = copy.deepcopy(filters)
    assert other._kernels == LaneKernels()
    assert (other.number, other.width, other.shape) == (np.float32, filters.width, filters.shape)


def test_an_array_off_the_registers_grid_is_refused() -> None:
    robot, variant = load_robot("auriga-alpha"), find_variant("differential")
    filters = BatchFilter(robot, variant, Settings())
    lanes = filters.begin(np.zeros((filters.width, 2)), np.zeros(3), np.zeros(3))
    rows = len(filters.rows)
    shifted = np.zeros(rows * filters.width + 9)[1:]
    skip = 1 if shifted.ctypes.data % 64 == 0 else 0
    off = shifted[skip : skip + rows * filters.width].reshape(rows, filters.width)
    with pytest.raises(ValueError, match="wrong size"):
        filters.work_through(lanes._replace(workspace=off), off, None, off, off)  # type: ignore[arg-type]
