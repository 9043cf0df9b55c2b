"""`icreckon study`: many simulated runs over a sweep, summarised."""

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import msgspec
from rich.console import Group
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn
from rich.table import Table
from rich.text import Text
from typer import Argument, Option

from icreckon.cli.common.console import BAR, exit_if_failed, messages, results, say, show
from icreckon.cli.common.options import Json, Wide, completed_by
from icreckon.cli.common.stopping import Stop
from icreckon.estimator.tracing.kernel_cache import warn_unless_kept
from icreckon.report.study.folder import PAGE, run_study
from icreckon.report.study.text import failures, headline, notes, same_results, summary_tables
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.running.runner import Progress as Done
from icreckon.simulation.study.cells import expand
from icreckon.simulation.study.plan import load_study, study_names
from icreckon.simulation.study.results import Results

FOLDER = "icreckon-study"
WIDE_FROM = 125  # width of a terminal from which on tables have all columns [characters]
LINE_EVERY = 30.0  # interval of the lines of progress if there is no terminal for a bar [s]


def command(
    study: Annotated[
        str | None,
        Argument(
            help="Name of a study that ships with icreckon, or a TOML file.",
            autocompletion=completed_by(study_names),
        ),
    ] = None,
    out: Annotated[
        Path | None,
        Option(
            help="Folder for blocks and results (default: icreckon-study/ and the study's name). A study "
            "begun there is continued."
        ),
    ] = None,
    runs: Annotated[
        int | None, Option(min=1, help="Runs of each cell (default: the study's).")
    ] = None,
    workers: Annotated[
        int | None, Option(min=1, help="Threads or processes here (default: one for each core).")
    ] = None,
    as_json: Json = False,
    wide: Wide = False,
    overwrite: Annotated[
        bool, Option("--overwrite", help="Replace another study that is at --out.")
    ] = False,
    list_studies: Annotated[
        bool, Option("--list", help="List the studies that ship with icreckon.")
    ] = False,
) -> None:
    """Simulate many runs over a sweep of parameters; summarise them.

    The same command continues an interrupted study.
    """
    if list_studies:
        table = Table(title="studies that ship with icreckon", title_justify="left")
        for heading in ("name", "cells", "variants", "runs of each", "what it shows"):
            table.add_column(heading, no_wrap=heading == "name")
        for name in study_names():
            loaded = load_study(name)
            counts = len(expand(loaded).cells), len(loaded.variants), loaded.runs
            table.add_row(name, *map(str, counts), loaded.description.strip())
        results().print(table)
        return
    if study is None:
        raise SimulationError(
            f"which study? Give a TOML file, or a name: {', '.join(study_names())} (see --list)"
        )
    loaded = load_study(study)
    if runs is not None:
        loaded = msgspec.structs.replace(loaded, runs=runs)
    folder = out if out is not None else Path(FOLDER) / loaded.name
    reporter = _Reporter(loaded.name)
    warn_unless_kept()
    try:
        with reporter.bar:
            study_results = run_study(
                loaded,
                folder,
                workers=workers,
                overwrite=overwrite,
                report=reporter.show,
                remark=reporter.remark,
            )
    except KeyboardInterrupt:
        done = reporter.done
        blocks = "0" if done is None else f"{done.blocks} of {done.all_blocks}"
        again = shlex.join(["icreckon", *sys.argv[1:]])
        Stop.advice = f"{blocks} blocks are in {folder}/. Go on with the same command: {again}"
        raise
    show(folder, _summary, study_results, WIDE_FROM, as_json=as_json, wide=wide)
    say(f"results in {folder}/, the page to read and to send is {folder / PAGE}")
    for line in same_results(study_results):
        say(line, "yellow")
    exit_if_failed(failures(study_results))


class _Reporter:
    """Progress line: blocks, runs a second, time left."""

    def __init__(self, name: str) -> None:
        self.done: Done | None = None
        self._shown_at = 0.0
        shown = TextColumn(name), BarColumn(BAR), TextColumn("{task.fields[text]}")
        self.bar = Progress(SpinnerColumn(), *shown, console=messages(), transient=True)
        self._task = self.bar.add_task(name, total=1.0, text="first block (compiles once)")

    def remark(self, words: str) -> None:
        """Print a line of text."""
        self.bar.console.print(words, soft_wrap=True)

    def show(self, done: Done) -> None:
        """Show the progress."""
        if self.done is None and done.found_blocks:
            self.remark(f"going on: {done.found_blocks} of {done.all_blocks} blocks are there")
        self.done = done
        elapsed = self.bar.tasks[0].elapsed or 0.0
        text = f"{done.blocks} of {done.all_blocks} blocks"
        if done.runs and elapsed > 0.0:
            rate = done.runs / elapsed
            text += f", {rate:.3g} runs/s, {duration(done.runs_left / rate)} left"
        if done.blocks == done.all_blocks:
            text += ", writing tables and page"
        self.bar.update(self._task, completed=done.blocks / max(1, done.all_blocks), text=text)
        if not self.bar.console.is_terminal and elapsed - self._shown_at > LINE_EVERY:
            self._shown_at = elapsed
            self.remark(text)


def duration(seconds: float) -> str:
    """Format a duration in seconds, minutes or hours."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


def _summary(study_results: Results, *, narrow: bool) -> Group:
    parts: list[Table | Text] = [Text(headline(study_results), style="bold")]
    for summary in summary_tables(study_results, narrow=narrow):
        table = Table(title=f"{study_results['name']}: {summary.title}", title_justify="left")
        for number, heading in enumerate(summary.head):
            is_last_text = number == summary.texts - 1
            side: Any = "left" if number < summary.texts else "right"
            table.add_column(Text(heading), justify=side, no_wrap=is_last_text, overflow="fold")
        for row in summary.rows:
            table.add_row(*(Text(cell) for cell in row))
        parts.append(table)
    return Group(*parts, *(Text(line) for line in notes(study_results, narrow=narrow)))
