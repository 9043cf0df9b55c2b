"""`icreckon replay`: the filter variants over a log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from icreckon.cli.comparing import compare_and_report, exit_if_failed, the_robot
from icreckon.cli.console import messages, progress, results_folder
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant
from icreckon.replay.bags.decoding import read_definitions
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.checking.check import OF_ROBOT_FILE
from icreckon.replay.checking.robot_check import check_robot
from icreckon.replay.comparison.compare import DEFAULT_VARIANTS, ENGINES
from icreckon.replay.comparison.fixes import parse_part
from icreckon.replay.export.formats import parse_formats
from icreckon.replay.reading.gather import source_name
from icreckon.replay.reading.read_log import read_log


def run_replay(
    *,
    paths: list[Path],
    message_files: list[Path],
    robot_name: str | None,
    variants: str | None,
    fixes: str | None,
    smooth: bool,
    engine: str,
    formats: str | None,
    out: Path | None,
    as_json: bool,
    wide: bool,
    overwrite: bool,
    workers: int | None,
) -> None:
    """Run `icreckon replay`; arguments as in its help."""
    robot_name, robot = the_robot(robot_name, paths)
    names = None if variants is None else [name.strip() for name in variants.split(",")]
    for name in names or []:
        find_variant(name)
    if engine not in ENGINES:
        raise ReplayError(f"--engine {engine!r}{nearest_hint(engine, list(ENGINES))}")
    settings = Settings()
    wanted = parse_formats(formats)
    part = None if fixes is None else parse_part(fixes)
    definitions = read_definitions(message_files)
    with results_folder(out, f"icreckon-replay-{paths[0].stem}", overwrite=overwrite) as folder:
        with progress(f"reading {source_name(paths)}") as report_progress:
            log = read_log(paths, robot, definitions=definitions, progress=report_progress)
        messages().print(
            f"read {source_name(paths)}: {log.duration:.0f} s, {len(log.tracks.stamps)} track speeds",
            markup=False,
            soft_wrap=True,
        )
        problems = tuple(one.problem for one in check_robot(log, robot) if one.problem)
        if problems:
            hint = "icreckon check says what each of these costs, and what to set"
            log = replace(
                log, notes=(*log.notes, *(f"{OF_ROBOT_FILE}{one}" for one in problems), hint)
            )
        failed = compare_and_report(
            log,
            robot,
            folder,
            command="replay",
            configuration={
                "log": str(paths[0]) if len(paths) == 1 else [str(path) for path in paths],
                "robot": robot_name,
                "variants": names if names is not None else list(DEFAULT_VARIANTS),
                "fixes": fixes,
                "smooth": smooth,
                "settings": msgspec.to_builtins(settings),
            },
            inputs={str(path): path for path in [*paths, *message_files]},
            variants=names,
            settings=settings,
            fixes=part,
            smooth=smooth,
            engine=engine,
            formats=wanted,
            as_json=as_json,
            wide=wide,
            workers=workers,
        )
    exit_if_failed(failed)
