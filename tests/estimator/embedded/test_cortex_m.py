"""Exported filters on a Cortex-M of QEMU: self-test, size and cost.

`pytest -n 0 -s -m slow tests/estimator/embedded/test_cortex_m.py` prints the figures of the docs. It
needs gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm.
"""

import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

from icreckon import VARIANTS, Scenario, simulate
from icreckon.estimator.embedded.c_filter import filter_in_c
from icreckon.estimator.embedded.vectors import vectors_of
from same_runs import ROBOT

HERE = Path(__file__).parent
PROGRAM = HERE / "cortex_m"
KIB = 1024
OPTIMISED = ("-Os", "-fno-math-errno")


class Board(NamedTuple):
    """Board of QEMU, flags of its compiler, and the limits of the filter on it."""

    machine: str
    cpu: str
    flags: tuple[str, ...]
    bits: int
    clock: float  # [Hz]
    share: float
    struct: int
    stack: int


BOARDS = {
    "Cortex-M4F, float": Board(
        "mps2-an386",
        "cortex-m4",
        ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"),
        32,
        168e6,
        0.05,
        6 * KIB,
        6 * KIB,
    ),
    "Cortex-M7, double": Board(
        "mps2-an500",
        "cortex-m7",
        ("-mcpu=cortex-m7", "-mfpu=fpv5-d16"),
        64,
        400e6,
        0.05,
        12 * KIB,
        12 * KIB,
    ),
}
# Largest code in float, and most instructions of a pair of samples.
LARGEST_CODE = {"inertia-online": 160 * KIB, "gyro": 128 * KIB}
MOST_MEAN = 20_000


def tool(name: str) -> str:
    if shutil.which(name) is None:
        pytest.skip(f"no {name} here: install it to run exported filters on a Cortex-M")
    return name


def compiler_of(board: Board) -> list[str]:
    command = [tool("arm-none-eabi-gcc"), "-std=c99", *OPTIMISED, "-mthumb", "-mfloat-abi=hard"]
    return [*command, *board.flags]


def filter_of(board: Board, folder: Path) -> Path:
    """The filter alone, compiled."""
    target = folder / "filter.o"
    command = [*compiler_of(board), "-c", str(folder / "icreckon_filter.c"), "-o", str(target)]
    subprocess.run(command, check=True, timeout=300)
    return target


def built(board: Board, of: Path, program: Path) -> Path:
    """A program with a compiled filter."""
    target = of.parent / f"{program.stem}.elf"
    script = str(PROGRAM / "mps2.ld")
    command = [*compiler_of(board), "--specs=rdimon.specs", "-T", script, f"-I{of.parent}"]
    command += [*map(str, (PROGRAM / "boot.c", program, of)), "-lm", "-o", str(target)]
    subprocess.run(command, check=True, timeout=300)
    return target


def output_of(board: Board, program: Path) -> str:
    machine = ["-M", board.machine, "-cpu", board.cpu, "-nographic", "-icount", "shift=0"]
    semihosting = ["-semihosting-config", "enable=on,target=native", "-kernel", program.name]
    done = subprocess.run(
        [tool("qemu-system-arm"), *machine, *semihosting],
        cwd=program.parent,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def code_size(of: Path) -> int:
    """Code and constants of the filter alone [bytes]."""
    sizes = subprocess.run(
        ["arm-none-eabi-size", str(of)], check=True, capture_output=True, text=True
    )
    return int(sizes.stdout.splitlines()[1].split()[0])


@pytest.mark.slow
@pytest.mark.parametrize("variant", LARGEST_CODE)
@pytest.mark.parametrize("name", BOARDS)
def test_on_a_cortex_m(name: str, variant: str, tmp_path: Path) -> None:
    board, of = BOARDS[name], VARIANTS[variant]
    exported = filter_in_c(ROBOT, of, bits=board.bits, imu_rate=200.0)
    exported.write(tmp_path)
    log = simulate(Scenario(duration=20.0, fix_rate=1.0), ROBOT)
    vectors = vectors_of(ROBOT, VARIANTS[variant], exported.states, log.measurements())
    (tmp_path / "test_vectors.csv").write_text(vectors, encoding="utf-8")
    of = filter_of(board, tmp_path)
    result = output_of(board, built(board, of, tmp_path / "extras" / "selftest.c"))
    mean, most, struct, stack = map(
        int, output_of(board, built(board, of, PROGRAM / "cost.c")).split()
    )
    code = code_size(of)
    share = 100.0 * mean / board.clock
    of_step = f"{mean} instructions a pair, {most} at most: {share:.2%} of {board.clock:.3g} Hz"
    sizes = f"code {code / KIB:.0f} KiB, filter {struct} B, stack {stack} B"
    print(f"\n{name}, {variant}, {' '.join(OPTIMISED)}: {of_step} at 100 Hz; {sizes}; {result}")  # noqa: T201
    assert share < board.share
    assert struct <= board.struct
    assert stack <= board.stack
    if board.bits == 32:
        assert code <= LARGEST_CODE[variant]
        assert mean <= MOST_MEAN
