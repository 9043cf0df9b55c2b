"""Robot file of a calibration: complete, with standard errors as comments."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from icreckon.estimator.calibration import Calibration
from icreckon.estimator.calibration.result import FoundParameter
from icreckon.estimator.robot.robot_toml import robot_toml

FIRST_WORDS = "# Calibrated by icreckon"
LIKE = 0.01
"""Standard errors up to which a written value is the estimate."""
SIGMAS = {
    "gyro_scale_sigma": "standard error, and how much logs differ",
    "gyro_bias_sigma": "of the bias of another log; the previous value counts as one more log",
    "scale_sigma": "standard error, and how much logs and models differ",
    "difference_sigma": "the same",
}


def robot_file_text(
    found: Calibration, sources: Sequence[str], robot_name: str, headline: str = ""
) -> str:
    """Format the text of a robot file, as input of `load_robot`."""
    header = [
        f"from {', '.join(sources)}, starting from {robot_name}.",
        *filter(None, [headline]),
        found.verdict,
        "Comments are standard errors; «held» parameters are not observable in the logs and unchanged.",
        *found.notes,
        *_of_logs(found),
    ]
    # Names of logs may contain line breaks, which would end the comment.
    first, *more = (" ".join(line.split()) for line in header)
    file = msgspec.to_builtins(found.robot)
    comments = {one.name: _comment(one, file) for one in found.parameters}
    of_tables = {
        "vehicle": comments,
        "indices": _under("indices", comments),
        "constant_icr": _under("constant_icr", comments),
        "imu": _imu_comments(found, comments),
        "tracks": _under("tracks", comments) | SIGMAS,
    }
    lines = [f"{FIRST_WORDS} {first}", *(f"# {line}" for line in more)]
    return "\n".join(lines) + "\n" + robot_toml(found.robot, of_tables)


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


def _comment(one: FoundParameter, file: dict[str, Any]) -> str:
    """Standard error of a value, and the estimate where the file has another one."""
    table, _, key = one.name.rpartition(".")
    written = file.get(table or "vehicle", {}).get(key)
    text = "held" if one.sigma is None else f"± {one.sigma:.2g}"
    if (
        one.sigma is not None
        and written is not None
        and abs(written - one.value) > LIKE * one.sigma
    ):
        text = f"estimate {one.value:.4g} {text}"
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


def _imu_comments(found: Calibration, comments: Mapping[str, str]) -> dict[str, str]:
    errors = {one.name: one.sigma for one in found.parameters}
    own = _under("imu", comments) | SIGMAS
    for key, names in (
        ("rotation_rpy_deg", ("roll", "pitch", "yaw")),
        ("position", ("forward", "left")),
    ):
        sigmas = [errors.get(f"imu.{name}") for name in names]
        if any(sigmas):
            texts = ("held" if sigma is None else f"{sigma:.2g}" for sigma in sigmas)
            own[key] = f"± {', '.join(texts)}"
    return own
