"""`icreckon replay`: the filter variants over a log, or over several."""

import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import msgspec
from typer import Option

from icreckon.cli.common import options
from icreckon.cli.common.comparing import compare_and_write, read, the_robot
from icreckon.cli.common.console import (
    MakeTable,
    exit_if_failed,
    progress,
    results_folder,
    say,
    show,
)
from icreckon.cli.common.stopping import Stop
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import VARIANTS, find_variant
from icreckon.replay.bags.decoding import Definitions, read_definitions
from icreckon.replay.base.errors import OF_ROBOT_FILE, ReplayError
from icreckon.replay.base.outputs import MANIFEST
from icreckon.replay.checking.check import LATENCY
from icreckon.replay.checking.robot_check import check_robot
from icreckon.replay.checking.worth import judged
from icreckon.replay.comparison import many
from icreckon.replay.comparison.compare import DEFAULT_VARIANTS
from icreckon.replay.comparison.fixes import parse_part
from icreckon.replay.export.formats import parse_formats
from icreckon.replay.mapping.topics import topic_map
from icreckon.replay.reading.gather import log_files, refuse_twice, source_name
from icreckon.replay.reading.tables import are_parts
from icreckon.report.replay.folder import PAGE_FILE, RESULTS_FILE, write_many
from icreckon.report.replay.many_tables import many_tables
from icreckon.report.replay.many_text import many_failures
from icreckon.report.replay.page_text import failures
from icreckon.report.replay.tables import WIDE_FROM, results_table


@dataclass(frozen=True)
class _Drive:
    """One log of a command, with the robot that it is replayed with."""

    paths: list[Path]  # files of the log
    robot_name: str  # the option --robot
    robot: Robot  # that robot
    definitions: Definitions  # definitions of message types
    options: dict[str, Any]  # arguments of `compare_and_write`, without log, robot and folder

    def log(self) -> Log:
        """Read the log; its notes include contradictions to the robot file."""
        log = read(self.paths, self.robot, self.definitions)
        count = len(log.tracks.stamps)
        say(f"read {source_name(self.paths)}: {log.duration:.0f} s, {count} track speeds")
        # A stream that is missing has a note by the reader.
        checks = [check for check in check_robot(log, self.robot) if check.name != "IMU"]
        notes: list[str] = []
        has_latency = any(check.problem and check.name == LATENCY for check in checks)
        if log.truth is not None and has_latency:
            with progress("filtering, as the file is and corrected"), suppress(ReplayError):
                checks, _, notes = judged(log, self.robot, checks)
        notes += [f"{OF_ROBOT_FILE}{check.problem}" for check in checks if check.problem]
        return replace(log, notes=(*log.notes, *notes))


def command(
    paths: Annotated[
        list[Path], options.logs(f"Logs, each replayed separately: {options.LOG_FILES}.")
    ],
    robot_names: Annotated[
        list[str] | None, options.robot_option(". Required; repeatable, to compare robot files")
    ] = None,
    one_log: Annotated[bool, Option("--one-log", help="The files are parts of one log.")] = False,
    variants: Annotated[
        str | None,
        Option(
            help=f"Filter variants, separated by commas (default: all): {', '.join(VARIANTS)}.",
            autocompletion=options.VARIANT_NAMES,
        ),
    ] = None,
    fixes: Annotated[
        str | None,
        Option(
            help="Part of the log in which fixes are used, as 0:40% or 0:100 (seconds); taken from the "
            "ground truth if the log has no fixes. Default: all fixes of the log."
        ),
    ] = None,
    message_files: options.MessageFiles = None,
    smooth: Annotated[
        bool,
        Option(
            "--smooth",
            help="Smooth each run, too: later fixes correct each pose; as variants NAME-smoothed.",
        ),
    ] = False,
    formats: options.Formats = None,
    out: options.Out = None,
    as_json: options.Json = False,
    wide: options.Wide = False,
    overwrite: options.Overwrite = False,
    workers: options.Workers = None,
) -> None:
    """Run all filter variants over a log, or several, and score them.

    If a log has a ground truth, they are scored against it, otherwise compared with one another. Several
    logs are scored together, too.
    """
    robot_names, message_files = robot_names or [], message_files or []
    files_of_logs = [paths] if one_log else [[path] for path in paths]
    refuse_twice(paths, "log")
    robots = dict(the_robot(name, files_of_logs[0]) for name in robot_names or (None,))
    refuse_twice(robot_names, "robot file")
    maps = [topic_map(robot) for robot in robots.values() if robot.log]
    table_files = [log_files(path) or [path] for path in paths]
    if any(are_parts(table_files, mapping.columns) for mapping in maps):
        say(f"read as one log, of which each file has a part: {', '.join(map(str, paths))}")
        files_of_logs = [paths]
    names = list(DEFAULT_VARIANTS)
    if variants is not None:
        names = [name.strip() for name in variants.split(",")]
    for name in names:
        find_variant(name)
    shared = {
        "variants": names,
        "fixes": None if fixes is None else parse_part(fixes),
        "smooth": smooth,
        "formats": parse_formats(formats),
        "workers": workers,
    }
    configuration = {
        "variants": names,
        "fixes": fixes,
        "smooth": smooth,
        "settings": msgspec.to_builtins(Settings()),
    }
    definitions = read_definitions(message_files)
    drives = []
    for files, (name, robot) in product(files_of_logs, robots.items()):
        log = str(files[0]) if len(files) == 1 else list(map(str, files))
        inputs = {str(path): path for path in [*files, *message_files]}
        origin = {"command": "replay", "inputs": inputs}
        origin["configuration"] = {"log": log, "robot": name} | configuration
        drives.append(_Drive(files, name, robot, definitions, shared | {"origin": origin}))
    make_tables: MakeTable
    with results_folder(out, f"icreckon-replay-{paths[0].stem}", overwrite=overwrite) as folder:
        if len(drives) == 1:
            (drive,) = drives
            summary, _ = compare_and_write(drive.log(), drive.robot, folder, **drive.options)
            failed, make_tables = failures(summary), results_table
        else:
            # Unique labels, which are also names of folders.
            taken = (PAGE_FILE, RESULTS_FILE, MANIFEST)
            log_labels = many.unique([many.label_of(files[0]) for files in files_of_logs], taken)
            robot_labels = many.unique([many.label_of(Path(name)) for name in robots], taken)
            cases = [many.Case(*labels) for labels in product(log_labels, robot_labels)]
            summary = _many(dict(zip(cases, drives, strict=True)), folder, configuration)
            failed, make_tables = many_failures(summary), many_tables
        show(folder, make_tables, summary, WIDE_FROM, as_json=as_json, wide=wide)
    exit_if_failed(failed)


def _many(
    drives: Mapping[many.Case, _Drive], folder: Path, configuration: dict[str, Any]
) -> dict[str, Any]:
    """Run each log with each robot file, and write the results of all."""
    scored: list[many.CaseScores] = []
    failed: list[dict[str, Any]] = []
    # Subfolder of a case: log, robot or log/robot, whichever of them vary.
    several_logs = len({case.log for case in drives}) > 1
    several_robots = len({case.robot for case in drives}) > 1
    places = {
        case: "/".join([case.log] * several_logs + [case.robot] * several_robots) for case in drives
    }
    for case, drive in drives.items():
        target = folder / places[case]
        target.mkdir(parents=True)
        try:
            log, robot = drive.log(), drive.robot
            _, scores = compare_and_write(log, robot, target, case=case, **drive.options)
        except Exception as problem:
            if Stop.number:
                raise
            failed.append(many.failed_case(case, problem))
            shutil.rmtree(target)
            # A log that failed with all robot files so far has no folder.
            if target.parent != folder and not any(target.parent.iterdir()):
                target.parent.rmdir()
        else:
            scored += [] if scores is None else [scores]
    of_all = {
        "logs": {case.log: list(map(str, drive.paths)) for case, drive in drives.items()},
        "robots": {case.robot: drive.robot_name for case, drive in drives.items()},
    }
    configuration = of_all | configuration
    summary = many.summarise_many(scored, failed, command="replay", configuration=configuration)
    for entry in summary["logs"]:
        entry["folder"] = places[many.Case(entry["label"], entry["robot"])]
    write_many(folder, summary)
    return summary
