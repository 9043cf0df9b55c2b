"""Robot file of a calibration: complete, with standard errors as comments."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from icreckon.estimator.calibration import Calibration
from icreckon.estimator.calibration.result import FoundParameter
from icreckon.estimator.robot.robot_file import Robot

FIRST_WORDS = "# Calibrated by icreckon"
# First words of the files of `icreckon identify`, the former name of the command.
FORMER_FIRST_WORDS = "# Identified by icreckon"
# Significant digits of a computed number.
DIGITS = 7
# Column at which the comments of short lines are aligned.
COMMENT_AT = 40
SIGMAS = {
    "gyro_scale_sigma": "standard error, and how much logs differ",
    "gyro_bias_sigma": "of the bias of another log; the previous value counts as one more log",
    "scale_sigma": "standard error, and how much logs and models differ",
    "difference_sigma": "the same",
}


def robot_file_text(found: Calibration, sources: Sequence[str], robot_name: str) -> str:
    """Format the text of a robot file, as input of `load_robot`.

    Args:
        found: the calibration.
        sources: names of the logs.
        robot_name: robot with which the calibration started, a name or a file.
    """
    robot = found.robot
    header = [
        f"from {', '.join(sources)}, starting from {robot_name}.",
        found.verdict,
        "Comments are standard errors; «held» parameters are not observable in the logs and unchanged.",
        *found.notes,
        *_of_logs(found),
    ]
    # Names of logs may contain line breaks, which would end the comment.
    first, *more = (" ".join(line.split()) for line in header)
    lines = [
        f"{FIRST_WORDS} {first}",
        *(f"# {line}" for line in more),
        f"name = {_value(robot.name)}",
        f"format = {robot.format}",
        *([f"note = {_value(robot.note)}"] if robot.note else []),
    ]
    comments = {one.name: _comment(one) for one in found.parameters}
    lines += _table("vehicle", robot.vehicle, _vehicle_comments(robot, comments))
    lines += _table("indices", robot.indices, _under("indices", comments))
    if robot.constant_icr is not None:
        lines += _table("constant_icr", robot.constant_icr, _under("constant_icr", comments))
    lines += _table("imu", robot.imu, _imu_comments(found, comments))
    lines += _table("tracks", robot.tracks, _under("tracks", comments) | SIGMAS)
    lines += _table("slope", robot.slope, {})
    lines += _table("undetected_slip", robot.undetected_slip, {})
    if robot.soil is not None:
        lines += _table("soil", robot.soil, _under("soil", comments))
    for variant, slip in robot.slip.items():
        lines += _table(f"slip.{_key(variant)}", slip, {})
    for name, table in robot.log.items():
        lines += _tree(f"log.{_key(name)}", table)
    return "\n".join(lines) + "\n"


def _of_logs(found: Calibration) -> list[str]:
    lines = []
    for log in found.logs:
        bias, bias_sigma = log.gyro_bias
        lag = "lag not found" if log.lag is None else f"{log.lag[0]:.3f} ± {log.lag[1]:.3f} s late"
        lines.append(
            f"{log.name}: {log.distance:.0f} m, gyro bias {bias:.5f} ± {bias_sigma:.5f} rad/s, "
            f"truth {lag}"
        )
    return lines


def _comment(one: FoundParameter) -> str:
    text = "held" if one.sigma is None else f"± {one.sigma:.2g}"
    if one.status == "conditional":
        text += ", given what is held"
    if one.before is not None and one.sigma is not None:
        text += f"; was {one.before:.5g}"
    return f"{text}; {one.note}" if one.note else text


def _under(table: str, comments: Mapping[str, str]) -> dict[str, str]:
    start = f"{table}."
    return {
        name.removeprefix(start): text for name, text in comments.items() if name.startswith(start)
    }


def _vehicle_comments(robot: Robot, comments: Mapping[str, str]) -> dict[str, str]:
    return {
        name: comments[name]
        for name in ("sprocket_radius", "half_contact_length")
        if name in comments and (name != "half_contact_length" or robot.soil is not None)
    }


def _imu_comments(found: Calibration, comments: Mapping[str, str]) -> dict[str, str]:
    errors = {one.name: one.sigma for one in found.parameters}
    own = _under("imu", comments) | SIGMAS
    turns = [errors.get(f"imu.{name}") for name in ("roll", "pitch", "yaw")]
    if any(turns):
        own["rotation_rpy_deg"] = "± " + ", ".join(
            "held" if sigma is None else f"{sigma:.2g}" for sigma in turns
        )
    places = [errors.get(f"imu.{name}") for name in ("forward", "left")]
    if any(places):
        own["position"] = "± " + ", ".join(
            "held" if sigma is None else f"{sigma:.2g}" for sigma in places
        )
    return own


def _table(name: str, values: msgspec.Struct, comments: Mapping[str, str]) -> list[str]:
    lines = ["", f"[{name}]"]
    for field in msgspec.structs.fields(values):
        value = getattr(values, field.name)
        if value is None:
            continue
        lines.append(_line(field.name, value, comments.get(field.name, "")))
    return lines


def _tree(name: str, table: Any) -> list[str]:
    """Format a table of the mapping, nested tables last."""
    plain = {key: value for key, value in table.items() if not isinstance(value, dict)}
    lines = ["", f"[{name}]", *(_line(_key(key), value, "") for key, value in plain.items())]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += _tree(f"{name}.{_key(key)}", value)
    return lines


def _line(key: str, value: Any, comment: str) -> str:
    line = f"{key} = {_value(value)}"
    return f"{line:{COMMENT_AT}} # {comment}" if comment else line


def _key(name: str) -> str:
    return name if name.replace("-", "").replace("_", "").isalnum() else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        text = f"{value:.{DIGITS}g}"
        return text if any(mark in text for mark in ".en") else f"{text}.0"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    # JSON's escapes are a subset of TOML's.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
