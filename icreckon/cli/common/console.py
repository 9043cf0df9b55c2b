"""Consoles of the commands: messages on stderr, results on stdout."""

import errno
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Column
from rich.text import Text

from icreckon.estimator.base.errors import IcreckonError
from icreckon.replay.base import outputs
from icreckon.replay.base.errors import coarse_stamps
from icreckon.report.printable import printable

TABLE_WIDTH = 150
BAR = 16  # width of a bar [characters]
LONGEST_COMPILATION = 300.0  # longest time for which a kernel is compiled [s]
FAILED = 1  # exit status of a command that has written incomplete results
# Messages of a loader for a library that does not fit in memory.
UNMAPPED = ("failed to map segment", "annot allocate memory", "create shared object descriptor")
LONGEST_LINE = 2000  # most characters of an error; names from a file may be of any length
MakeTable = Callable[..., RenderableType]  # from data and the argument `narrow`


class _PlainConsole(Console):
    """Console that shows names as they are: no markup, no control characters."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **options)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        """Render to segments, as `Console.render`."""
        for text, style, control in super().render(renderable, options):
            yield Segment(text if control else printable(text), style, control)


def messages() -> Console:
    """Console for messages: standard error."""
    return _PlainConsole(stderr=True)


def say(text: str, style: str | None = None) -> None:
    """Print a line to standard error, however long."""
    messages().print(text, style=style, soft_wrap=True)


def exit_if_failed(failed: Sequence[str]) -> None:
    """Print failures and exit with 1 if there are any, after the results are in place."""
    for line in failed:
        say(line, "red")
    if failed:
        raise typer.Exit(FAILED)


def results() -> Console:
    """Console for results: standard output, as wide as the tables if not a terminal.

    The environment variable COLUMNS sets another width.
    """
    console = _PlainConsole()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = TABLE_WIDTH
    return console


def print_banner(notes: Sequence[str]) -> None:
    """Print the notes on coarse stamps; they precede all other output."""
    for note in coarse_stamps(notes):
        results().print(Text(note, style="bold yellow"))


def print_fitting(table: MakeTable, data: Any, wide_from: int, *, wide: bool) -> None:
    """Print the columns of a table that fit the terminal; with `wide`, all columns.

    All columns need `wide_from` characters. On a narrower terminal, `table` is called with its width as
    `narrow`, and omits columns; otherwise `narrow` is 0.
    """
    console = results()
    narrow = console.width if console.width < wide_from and not wide else 0
    console.print(table(data, narrow=narrow))
    if narrow:
        console.print("--wide shows all columns.")


def show(
    folder: Path, table: MakeTable, data: Any, wide_from: int, *, as_json: bool, wide: bool
) -> None:
    """Print the results.json of a folder, or the table of it that fits the terminal."""
    if as_json:
        from icreckon.report.replay.folder import RESULTS_FILE

        typer.echo((folder / RESULTS_FILE).read_text(encoding="utf-8"), nl=False)
    else:
        print_fitting(table, data, wide_from, wide=wide)


class _Title(ProgressColumn):
    """Name of a task; while filters are compiled, how many of their kernels are there.

    A bar that stands still for a second while new kernels appear on disk, or that has begun without any,
    waits for the compiler.
    """

    def __init__(self, compiles: int) -> None:
        super().__init__(table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"))
        self._compiles = compiles
        self._kernels_at_start: int | None = None
        # When the bar moved last: kernels on disk, progress [-], time [s].
        self._kernels, self._completed, self._moved = 0, -1.0, 0.0

    def render(self, task: Task) -> Text:
        """Text of the column."""
        if not self._compiles:
            return Text(task.description)
        from icreckon.estimator.tracing.kernel_cache import environment_digest, kernel_files

        own = environment_digest("estimator")
        count = sum(path.parent.name == own for path in kernel_files())
        now = task.elapsed or 0.0
        if self._kernels_at_start is None:
            self._kernels_at_start = count
        if task.completed != self._completed:
            self._kernels, self._completed, self._moved = count, task.completed, now
        compiles = count > self._kernels or (not self._kernels_at_start and not task.completed)
        if not compiles or now - self._moved > LONGEST_COMPILATION:
            return Text(task.description)
        of_all = f"/{self._compiles}" if count <= self._compiles else ""
        return Text(f"compiling filters (first run only) {count}{of_all}")


@contextmanager
def progress(title: str, *, compiles: int = 0) -> Iterator[Callable[[float], None]]:
    """Show a progress bar; yield a function of the share done, 0 to 1.

    `compiles` is the number of functions that filters compile first, see `comparing.kernels_of`.
    """
    columns = (BarColumn(BAR), TaskProgressColumn(), TimeRemainingColumn(), TextColumn("left"))
    with _bar(_Title(compiles), *columns) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def working(title: str) -> Iterator[None]:
    """Show a spinner with the elapsed time for work of unknown length."""
    with _bar(SpinnerColumn(), _Title(compiles=0), TimeElapsedColumn()) as bar:
        bar.add_task(title, total=None)
        yield


def _bar(*columns: ProgressColumn) -> Progress:
    """Bar on standard error that vanishes at its end; nothing if that is no terminal."""
    console = messages()
    on = console.is_terminal
    return Progress(*columns, console=console, transient=True, disable=not on, expand=True)


@contextmanager
def results_folder(wanted: Path | None, default: str, *, overwrite: bool) -> Iterator[Path]:
    """Yield an empty folder for results, which gets its name on success.

    Without a wanted one it has a default name; or with -2, -3, ..., the first that nobody has or writes.

    Raises:
        ReplayError: the path exists and may not be replaced.
    """
    from icreckon.report.replay.folder import PAGE_FILE, RESULTS_FILE

    folder, number = wanted or Path(default), 1
    while wanted is None and (folder.exists() or outputs.is_being_written(folder)):
        number += 1
        folder = Path(f"{default}-{number}")
    with outputs.written_beside(
        folder, overwrite=overwrite, marker=RESULTS_FILE, starts=(), keeps_foreign=True
    ) as new:
        new.mkdir()
        yield new
    say(f"results in {folder}/, the page to open is {folder / PAGE_FILE}")


def check_writable(path: Path | None, first_words: str, *, overwrite: bool) -> None:
    """Refuse a file that `write_file` would refuse, before long work; None is no file."""
    if path is not None:
        outputs.check_replaceable(path, overwrite=overwrite, starts=(first_words.encode(),))


def write_file(path: Path, text: str, first_words: str, *, what: str, overwrite: bool) -> None:
    """Write a text file in one step, or raise a ReplayError; print where it is."""
    with outputs.written_beside(path, overwrite=overwrite, starts=(first_words.encode(),)) as new:
        new.write_text(text, encoding="utf-8")
    say(f"{what} in {path}")


def worker_count(wanted: int | None) -> int:
    """Number of processes: as requested, or one for each core."""
    return wanted if wanted is not None else os.cpu_count() or 1


def explain(problem: Exception) -> int:
    """Print an error on one line and return the exit status."""
    status = 1
    if isinstance(problem, IcreckonError):
        line = " ".join(str(problem).splitlines())
        if len(line) > LONGEST_LINE:
            line = f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"
    elif is_out_of_memory(problem):
        line = (
            "out of memory: close other programs, take fewer --workers or a shorter log, or raise the "
            "limit of the shell (ulimit -v)"
        )
    elif isinstance(problem, OSError) and problem.errno in outputs.NO_ROOM:
        line = f"{problem.filename or 'output'}: cannot be written: {problem.strerror}"
    else:
        status = 70  # EX_SOFTWARE of sysexits.h
        line = (
            f"internal error: {type(problem).__name__}: {problem} "
            "(please report it, with what the same command prints with --debug)"
        )
    say(f"icreckon: {line}", "red")
    return status


def is_out_of_memory(problem: BaseException) -> bool:
    """Return True if memory ran out, also while a library was loaded."""
    if isinstance(problem, ImportError):
        return any(words in str(problem) for words in UNMAPPED)
    of_system = isinstance(problem, OSError) and problem.errno == errno.ENOMEM
    return of_system or isinstance(problem, MemoryError)
