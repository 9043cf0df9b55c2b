"""`icreckon inspect`: the contents of a log, and a robot file to start from."""

import json
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.table import Table
from rich.text import Text
from typer import Option

from icreckon.cli.common import console, options
from icreckon.replay.bags.decoding import read_definitions
from icreckon.replay.base.errors import OF_STAMPS, ReplayError
from icreckon.replay.base.outputs import check_replaceable, written_beside
from icreckon.replay.checking.ros_settings import ROS_FIRST_WORDS, proposed_ros_settings
from icreckon.replay.inspection.filled_in import filled_in_sizes, with_filled_in
from icreckon.replay.inspection.inspect import Inspection, inspect
from icreckon.replay.inspection.log_estimates import NO_SIZES
from icreckon.replay.inspection.robot_file import FILL_IN, FIRST_WORDS
from icreckon.replay.reading.gather import source_name
from icreckon.report.printable import printable

NAMES = ("topic or column", "type", "frame or file")
NUMBERS = ("messages", "rate\nHz", "gaps", "longest\ngap, s", "header-\nrecorded, s", "repeated")
PNG = b"\x89PNG"  # first bytes of a PNG
LEFT_OUT = (2, 4)  # numbers that a narrow terminal has no room for
WIDE_FROM = 120  # width of a terminal from which on names have columns of their own [characters]


def command(
    paths: options.Logs,
    write: Annotated[Path | None, Option(help="Write the proposed robot file here.")] = None,
    picture: Annotated[
        Path | None, Option(help="Draw the effective track over the yaw rate here (PNG).")
    ] = None,
    ros: options.Ros = None,
    message_files: options.MessageFiles = None,
    as_json: options.Json = False,
    wide: options.Wide = False,
    overwrite: options.Overwrite = False,
) -> None:
    """List what a log holds, and propose a robot file for it."""
    console.check_writable(write, FIRST_WORDS, overwrite=overwrite)
    console.check_writable(ros, ROS_FIRST_WORDS, overwrite=overwrite)
    if picture is not None:
        check_replaceable(picture, overwrite=overwrite, starts=(PNG,))
    sizes = NO_SIZES if write is None else filled_in_sizes(write)
    definitions = read_definitions(message_files or [])
    with console.working(f"reading {source_name(paths)}"):
        inspection = inspect(paths, definitions=definitions, sizes=sizes)
    proposed = inspection.proposed_robot_file
    if as_json:
        typer.echo(json.dumps(_as_plain(inspection), indent=1))
    else:
        _show(inspection, wide=wide, with_file=write is None)
    if write is not None:
        proposed = _write_robot_file(write, proposed, overwrite=overwrite)
        log_and_robot = f"{' '.join(map(str, paths))} --robot {write}"
        next_step = f"then: icreckon replay {log_and_robot}"
        if not sizes.gauge and "eta0 = " in proposed:
            next_step = f"run this again with --overwrite, which computes eta0, {next_step}"
        if not inspection.mapping.track_keys:
            next_step = (
                "and name the track speeds in [log.tracks]: without them nothing can be replayed"
            )
        if FILL_IN in proposed:
            text = f"complete the lines marked «fill in», {next_step}"
        else:
            text = f"all is filled in: icreckon check {log_and_robot}"
        console.say(f"proposed robot file in {write}; {text}")
    if picture is not None:
        _draw(picture, inspection, overwrite=overwrite)
    if ros is not None:
        with console.working("measuring wheels and covariances"):
            settings = proposed_ros_settings(proposed, paths, definitions)
        console.write_file(
            ros, settings, ROS_FIRST_WORDS, what="settings for ROS", overwrite=overwrite
        )


def _write_robot_file(path: Path, proposed: str, *, overwrite: bool) -> str:
    """Write a proposal with what a person filled in before; return its text."""
    former = path.read_bytes() if path.exists() else b""
    proposed, taken = with_filled_in(proposed, path)
    if former and former != proposed.encode():
        backup = path.with_name(f"{path.name}~")
        with written_beside(backup, overwrite=True) as old:
            old.write_bytes(former)
        console.say(f"the file before is in {backup}")
    with written_beside(path, overwrite=overwrite, starts=(FIRST_WORDS.encode(),)) as new:
        new.write_text(proposed, encoding="utf-8")
    if taken:
        console.say(f"kept from the file before: {', '.join(taken)}")
    return proposed


def _draw(picture: Path, inspection: Inspection, *, overwrite: bool) -> None:
    """Draw the effective track over the yaw rate, if the log shows it."""
    if inspection.track is None or not inspection.track.bins:
        raise ReplayError(
            f"{picture} is not written: {inspection.path} does not show the effective track over the yaw "
            "rate; that takes a gyro, both tracks, and turns of more than 0.1 rad/s for 4 s"
        )
    from icreckon.report.track_figure import write_track_figure

    with written_beside(picture, overwrite=overwrite, starts=(PNG,)) as new:
        write_track_figure(new, inspection.path.stem, inspection.track)
    console.say(f"effective track over the yaw rate in {picture}")


def _topics(inspection: Inspection, *, narrow: bool) -> Table:
    title = f"{inspection.path}: {inspection.duration:.1f} s"
    table = Table(title=title, title_justify="left", show_lines=narrow)
    for heading in ("topic, type, frame",) if narrow else NAMES:
        table.add_column(heading, overflow="fold")
    numbers = [place for place in range(len(NUMBERS)) if not narrow or place not in LEFT_OUT]
    for place in numbers:
        table.add_column(NUMBERS[place], justify="right", no_wrap=True)
    for topic in inspection.topics:
        names = [topic.topic, topic.msgtype, topic.frame_id]
        names = ["\n".join(filter(None, names))] if narrow else names
        cells = [
            str(topic.count),
            _number(topic.mean_rate, 1),
            "" if topic.gaps is None else str(topic.gaps),
            _number(topic.largest_gap, 2),
            _number(topic.clock_offset, 3),
            "" if topic.repeated_share is None else f"{100.0 * topic.repeated_share:.0f} %",
        ]
        table.add_row(*names, *(cells[place] for place in numbers))
    return table


def _show(inspection: Inspection, *, wide: bool, with_file: bool) -> None:
    console.print_banner(inspection.notes)
    console.print_fitting(_topics, inspection, WIDE_FROM, wide=wide)
    out = console.results()
    for finding in inspection.findings:
        out.print(Text(f"Found: {finding}"))
    for what, count in inspection.dropped.items():
        out.print(Text(f"Would be dropped: {count} x {what}"))
    for note in (note for note in inspection.notes if not note.startswith(OF_STAMPS)):
        out.print(Text(f"Note: {note}"))
    if with_file:
        out.print(Text("\nProposed robot file (--write FILE saves it):\n"))
        typer.echo(printable(inspection.proposed_robot_file))


def _number(value: float | None, digits: int) -> str:
    # Rounded first, without minus zero: clocks that agree to the last digit are equal.
    return "" if value is None else f"{round(value, digits) + 0.0:.{digits}f}"


def _as_plain(inspection: Inspection) -> dict[str, object]:
    track = inspection.track
    bins = [] if track is None else [rate_bin._asdict() for rate_bin in track.bins]
    return {
        "path": str(inspection.path),
        "duration_s": inspection.duration,
        "topics": [msgspec.to_builtins(topic) for topic in inspection.topics],
        "mapping": msgspec.to_builtins(inspection.mapping),
        "findings": list(inspection.findings),
        "dropped": inspection.dropped,
        "notes": list(inspection.notes),
        "proposed_robot_file": inspection.proposed_robot_file,
        "track": None if track is None else track._asdict() | {"bins": bins},
    }
