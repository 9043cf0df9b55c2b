"""`icreckon check`: a robot file against a log."""

import json
import math
from contextlib import suppress
from dataclasses import replace
from typing import Annotated, Any

import typer
from rich.text import Text

from icreckon.cli.common import console
from icreckon.cli.common.comparing import kernels_of, the_robot
from icreckon.cli.common.options import Logs, MessageFiles, Overwrite, RobotName, Ros, UnpackedLimit
from icreckon.estimator.log.log import Log
from icreckon.replay.bags.decoding import read_definitions
from icreckon.replay.base.errors import OF_STAMPS, ReplayError
from icreckon.replay.checking import robot_check
from icreckon.replay.checking.check import Check
from icreckon.replay.checking.ros_settings import ROS_FIRST_WORDS, ros_settings
from icreckon.replay.checking.worth import LEAST_COST, VARIANT, Worth, judged
from icreckon.replay.comparison.results import json_types
from icreckon.replay.inspection.inspect import guess_mapping
from icreckon.replay.reading.gather import source_name
from icreckon.replay.reading.read_log import read_log

# Smallest cost that counts, as a share of the drift [-].
LEAST_SHARE = 0.2


def command(
    paths: Logs,
    robot_name: RobotName = None,
    ros: Ros = None,
    message_files: MessageFiles = None,
    _unpacked_limit: UnpackedLimit = 0.5,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Check a robot file against a log: units, signs, mounting, latency.

    Says what contradicts the log, worst first, its cost, and what to set; exit status 1 if anything does.
    """
    _, robot = the_robot(robot_name, paths)
    console.check_writable(ros, ROS_FIRST_WORDS, overwrite=overwrite)
    definitions = read_definitions(message_files or [])
    with console.progress(f"reading {source_name(paths)}") as report:
        log = read_log(paths, robot, definitions=definitions, progress=report)
        guessed = guess_mapping(paths, definitions=definitions)
    log = replace(log, notes=(*log.notes, *robot_check.far_centre(robot)))
    checks = robot_check.check_robot(log, robot)
    worth = None
    if len(log.tracks.stamps) and log.imu is not None:
        # Without a result with everything corrected nothing has a price.
        with (
            console.progress(
                "filtering, as the file is and corrected", compiles=kernels_of([VARIANT])
            ) as report,
            suppress(ReplayError),
        ):
            checks, worth, kept = judged(log, robot, checks, report)
            log = replace(log, notes=(*log.notes, *kept))
    hints = [] if guessed is None else robot_check.topics_left_out(guessed, robot)
    left_out = [one for one in hints if one not in log.notes]
    if as_json:
        typer.echo(json.dumps(_as_plain(checks, worth, left_out), indent=1))
    else:
        _show(log, checks, worth, left_out)
    if ros is not None:
        corrected = [one.name for one in checks if one.problem and one.correction is not None]
        of_log, of_robot = robot_check.with_corrected(log, robot, checks)
        source = "by this log" if corrected else "of the robot file"
        settings = ros_settings([of_log], of_robot, source=source, corrected=corrected)
        console.write_file(
            ros, settings, ROS_FIRST_WORDS, what="settings for ROS", overwrite=overwrite
        )
    if any(one.problem for one in checks) or not _any_measured(checks):
        raise typer.Exit(console.FAILED)


def _costs(checks: list[Check], worth: Worth | None) -> list[tuple[float, Check]]:
    """Contradictions with their costs [% of distance], worst first; NaN for none."""
    wrong = [one for one in checks if one.problem]
    costs = [*(worth.costs if worth is not None else ())]
    costs += [math.nan] * (len(wrong) - len(costs))
    pairs = list(zip(costs, wrong, strict=True))
    return sorted(pairs, key=lambda pair: math.inf if math.isnan(pair[0]) else -pair[0])


def _show(log: Log, checks: list[Check], worth: Worth | None, left_out: list[str]) -> None:
    out = console.results()
    console.print_banner(log.notes)
    for what, count in log.dropped.items():
        out.print(Text(f"Dropped from the log: {count} x {what}"))
    for note in (one for one in log.notes if not one.startswith(OF_STAMPS)):
        out.print(Text(f"Note: {note}"))
    for one in checks:
        mark = "!" if one.problem else "-"
        stated = f" (file: {one.in_file})" if one.in_file else ""
        out.print(Text(f"{mark} {one.name}: {one.in_log}{stated}"))
    wrong = _costs(checks, worth)
    if not wrong and not _any_measured(checks):
        out.print(Text("\nNothing could be checked: that takes track speeds and an IMU."))
    elif not wrong:
        unseen = sum(one.measured is None for one in checks)
        of_all = f", but it does not show {unseen} of {len(checks)} values" if unseen else ""
        out.print(Text(f"\nNothing in the log contradicts the robot file{of_all}."))
    else:
        out.print(Text(f"\n{_headline(len(wrong), checks)}\n"))
    for number, (cost, one) in enumerate(wrong, 1):
        costs = "" if worth is None or math.isnan(cost) else f" {_cost(cost, worth)}"
        out.print(Text(f"{number}. {_sentence(one.problem)}{costs}"))
        out.print(
            Text(f"   Set {one.remedy}" if " = " in one.remedy else f"   Remedy: {one.remedy}")
        )
    if worth is not None and (text := _drift(worth, bool(wrong), has_truth=log.truth is not None)):
        out.print(Text(f"\n{text}"))
    if worth is not None and worth.missing:
        out.print(Text(f"\nTo learn more in the next log: {'; '.join(worth.missing)}."))
    for hint in left_out:
        out.print(Text(f"\nHint: {hint}"))


def _any_measured(checks: list[Check]) -> bool:
    return any(one.measured is not None for one in checks)


def _headline(count: int, checks: list[Check]) -> str:
    text = "One thing contradicts" if count == 1 else f"{count} things contradict"
    of_another = robot_check.is_of_another(checks)
    end = ". Is this the file of another robot?" if of_another else ":"
    return f"{text} the log, worst first{end}"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + ("" if text.endswith("?") else ".")


def _cost(cost: float, worth: Worth) -> str:
    if cost < LEAST_COST:
        return f"Costs {VARIANT} nothing here in {worth.horizon:g} s."
    return f"Costs {VARIANT} {cost:.1f} % of the distance in {worth.horizon:g} s."


def _drift(worth: Worth, is_wrong: bool, *, has_truth: bool) -> str:
    of = f"of {VARIANT} after {worth.horizon:g} s without fixes"
    as_it_is = (
        "no result" if math.isnan(worth.as_it_is) else f"{worth.as_it_is:.1f} % of the distance"
    )
    if not has_truth:
        if not is_wrong:
            return ""
        if worth.as_it_is < LEAST_COST:
            return f"Once corrected: no effect on the path {of}."
        return f"Path {of}: {as_it_is} from that once corrected."
    if math.isnan(worth.as_it_is) and math.isnan(worth.corrected):
        return "The log is too short, or its truth too rough, to tell what this costs."
    if not is_wrong or math.isnan(worth.corrected):
        return f"Drift {of}: {as_it_is}."
    text = f"Drift {of}: {as_it_is}, {worth.corrected:.1f} % once corrected."
    if worth.corrected >= worth.as_it_is + max(LEAST_COST, LEAST_SHARE * worth.as_it_is):
        text += (
            " That is worse: set only what costs something, and icreckon calibrate for the rest."
        )
    return text


def _as_plain(checks: list[Check], worth: Worth | None, left_out: list[str]) -> Any:
    costs = {id(one): cost for cost, one in _costs(checks, worth)}
    return json_types(
        {
            "checks": [
                {
                    "name": one.name,
                    "contradicts": bool(one.problem),
                    "measured": None if one.measured is None else one.measured._asdict(),
                    "set": one.settings,
                    "in_file": one.in_file,
                    "in_log": one.in_log,
                    "problem": one.problem,
                    "remedy": one.remedy,
                    "cost_percent": costs.get(id(one)),
                }
                for one in checks
            ],
            "left_out": left_out,
            "missing_manoeuvres": [] if worth is None else worth.missing,
            "is_of_another_robot": robot_check.is_of_another(checks),
            "variant": VARIANT,
            "horizon_s": None if worth is None else worth.horizon,
            "drift_percent_as_it_is": None if worth is None else worth.as_it_is,
            "drift_percent_corrected": None if worth is None else worth.corrected,
        }
    )
