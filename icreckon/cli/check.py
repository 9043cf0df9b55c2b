"""`icreckon check`: check of a robot file against a log."""

import json
import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

import typer
from rich.text import Text

from icreckon.cli.common import console, options
from icreckon.cli.common.comparing import kernels_of, the_robot
from icreckon.estimator.base.plain_data import json_types
from icreckon.estimator.log.log import Log
from icreckon.replay.bags.decoding import read_definitions
from icreckon.replay.base.errors import OF_STAMPS, ReplayError
from icreckon.replay.checking import robot_check
from icreckon.replay.checking.check import Check
from icreckon.replay.checking.ros_settings import ROS_FIRST_WORDS, ros_settings
from icreckon.replay.checking.worth import LEAST_COST, VARIANT, Worth, judged
from icreckon.replay.reading.gather import source_name
from icreckon.replay.reading.read_log import read_log

LEAST_SHARE = 0.2  # smallest cost that counts, as a share of the drift [-]


def command(
    paths: options.Logs,
    robot_name: options.RobotName = None,
    ros: options.Ros = None,
    message_files: options.MessageFiles = None,
    as_json: options.Json = False,
    overwrite: options.Overwrite = False,
) -> None:
    """Check a robot file against a log: units, signs, latency.

    List contradictions with the log, the costliest first, each with the setting that corrects it. Exit
    with status 1 if there are any, or if the log allows no check.
    """
    _, robot = the_robot(robot_name, paths)
    console.check_writable(ros, ROS_FIRST_WORDS, overwrite=overwrite)
    definitions = read_definitions(message_files or [])
    with console.progress(f"reading {source_name(paths)}") as report:
        log = read_log(paths, robot, definitions=definitions, progress=report)
    log = replace(
        log, notes=(*log.notes, *robot_check.commanded(robot), *robot_check.far_centre(robot))
    )
    checks = robot_check.check_robot(log, robot)
    worth = None
    has_streams = len(log.tracks.stamps) > 0 and log.imu is not None
    is_seen = has_streams and any(check.measured is not None for check in checks)
    if is_seen:
        # If the filter cannot run with all corrections, the checks are shown without costs.
        title, kernels = "filtering, as the file is and corrected", kernels_of([VARIANT])
        with console.progress(title, compiles=kernels) as report, suppress(ReplayError):
            checks, worth, notes = judged(log, robot, checks, report)
            log = replace(log, notes=(*log.notes, *notes))
    if as_json:
        typer.echo(json.dumps(_json_results(checks, worth), indent=1))
    else:
        _show(log, checks, worth, is_seen=is_seen)
    if ros is not None:
        wrong = [check.name for check in checks if check.problem and check.correction is not None]
        source = "by this log" if wrong else "of the robot file"
        log, robot = robot_check.with_corrected(log, robot, checks)
        settings = ros_settings([log], robot, source=source, corrected=wrong)
        console.write_file(
            ros, settings, ROS_FIRST_WORDS, what="settings for ROS", overwrite=overwrite
        )
    if not is_seen or any(check.problem for check in checks):
        raise typer.Exit(console.FAILED)


def _costs(checks: list[Check], worth: Worth | None) -> list[tuple[float, Check]]:
    """Contradictions with costs [% of distance], NaN (unknown) and costliest first."""
    wrong = [check for check in checks if check.problem]
    costs = [*(worth.costs if worth is not None else ())]
    costs += [math.nan] * (len(wrong) - len(costs))  # the filter was not run
    pairs = list(zip(costs, wrong, strict=True))
    return sorted(pairs, key=lambda pair: -math.inf if math.isnan(pair[0]) else -pair[0])


def _show(log: Log, checks: list[Check], worth: Worth | None, *, is_seen: bool) -> None:
    out = console.results()
    console.print_banner(log.notes)
    for what, count in log.dropped.items():
        out.print(Text(f"Dropped from the log: {count} x {what}"))
    for note in log.notes:
        if not note.startswith(OF_STAMPS):
            out.print(Text(f"Note: {note}"))
    for check in checks:
        mark = "!" if check.problem else "-"
        file_value = f" (file: {check.in_file})" if check.in_file else ""
        out.print(Text(f"{mark} {check.name}: {check.in_log}{file_value}"))
    contradictions = _costs(checks, worth)
    out.print(Text(f"\n{_verdict(checks, len(contradictions), is_seen=is_seen)}"))
    for number, (cost, check) in enumerate(contradictions, 1):
        text = check.problem[0].upper() + check.problem[1:]
        text += "" if text.endswith("?") else "."
        if worth is not None and not math.isnan(cost):
            share = "nothing here" if cost < LEAST_COST else f"{cost:.1f} % of the distance"
            text += f" Costs {VARIANT} {share} in {worth.horizon:g} s."
        out.print(Text(f"{number}. {text}"))
        verb = "Set" if " = " in check.remedy else "Remedy:"
        out.print(Text(f"   {verb} {check.remedy}"))
    is_wrong, has_truth = bool(contradictions), log.truth is not None
    if worth is not None and (text := _drift(worth, is_wrong=is_wrong, has_truth=has_truth)):
        out.print(Text(f"\n{text}"))
    if worth is not None and worth.missing:
        out.print(Text(f"\nTo learn more in the next log: {'; '.join(worth.missing)}."))


def _verdict(checks: list[Check], contradictions: int, *, is_seen: bool) -> str:
    """Headline: how many things contradict the log, if it shows (`is_seen`) any value."""
    if contradictions:
        many = f"{contradictions} things contradict the log, worst first"
        text = "One thing contradicts the log" if contradictions == 1 else many
        end = ". Is this the file of another robot?" if robot_check.is_of_another(checks) else ":"
        return f"{text}{end}\n"
    if not is_seen:
        return (
            "Nothing could be checked: that takes track speeds and an IMU of a robot that drives."
        )
    unseen = sum(check.measured is None for check in checks)
    of_all = f", but it does not show {unseen} of {len(checks)} values" if unseen else ""
    return f"Nothing in the log contradicts the robot file{of_all}."


def _drift(worth: Worth, *, is_wrong: bool, has_truth: bool) -> str:
    """Text on the drift before and after correction; empty without truth or problem."""
    of_variant = f"of {VARIANT} after {worth.horizon:g} s without fixes"
    unknown = math.isnan(worth.as_it_is)
    as_it_is = "no result" if unknown else f"{worth.as_it_is:.1f} % of the distance"
    if not has_truth:
        if not is_wrong:
            return ""
        if worth.as_it_is < LEAST_COST:
            return f"Once corrected: no effect on the path {of_variant}."
        return f"Path {of_variant}: {as_it_is} from that once corrected."
    if unknown and math.isnan(worth.corrected):
        return "The log is too short, or its truth too rough, to tell what this costs."
    if not is_wrong or math.isnan(worth.corrected):
        return f"Drift {of_variant}: {as_it_is}."
    text = f"Drift {of_variant}: {as_it_is}, {worth.corrected:.1f} % once corrected."
    if worth.corrected >= worth.as_it_is + max(LEAST_COST, LEAST_SHARE * worth.as_it_is):
        text += (
            " That is worse: set only what costs something, and icreckon calibrate for the rest."
        )
    return text


def _json_results(checks: list[Check], worth: Worth | None) -> Any:
    costs = {id(check): cost for cost, check in _costs(checks, worth)}
    return json_types(
        {
            "checks": [
                {
                    "name": check.name,
                    "contradicts": bool(check.problem),
                    "measured": None if check.measured is None else check.measured._asdict(),
                    "set": check.settings,
                    "in_file": check.in_file,
                    "in_log": check.in_log,
                    "problem": check.problem,
                    "remedy": check.remedy,
                    "cost_percent": costs.get(id(check)),
                }
                for check in checks
            ],
            "missing_manoeuvres": [] if worth is None else worth.missing,
            "is_of_another_robot": robot_check.is_of_another(checks),
            "variant": VARIANT,
            "horizon_s": None if worth is None else worth.horizon,
            "drift_percent_as_it_is": None if worth is None else worth.as_it_is,
            "drift_percent_corrected": None if worth is None else worth.corrected,
        }
    )
