"""Robot file of a calibration: complete, with standard errors as comments."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from icreckon.estimator.calibration import Calibration
from icreckon.estimator.calibration.result import FoundParameter
from icreckon.estimator.robot.robot_toml import robot_toml

FIRST_WORDS = "# Calibrated by icreckon"
LARGEST_CHANGE = 0.01  # largest rounding of a written estimate, in standard errors [-]
SIGMA_COMMENTS = {
    "gyro_scale_sigma": "standard error, and how much logs differ",
    "gyro_bias_sigma": "of the bias of another log; the previous value counts as one more log",
    "scale_sigma": "standard error, and how much logs and models differ",
    "difference_sigma": "the same",
}


def robot_file_text(
    found: Calibration, sources: Sequence[str], robot_name: str, headline: str = ""
) -> str:
    """Format the text of a robot file, as input of `load_robot`.

    `sources` are names of logs, `robot_name` that of the file before; `headline` is left out if empty.
    """
    logs = []
    for log in found.logs:
        bias, bias_sigma = log.gyro_bias
        lag = "lag not found" if log.lag is None else "{:.3f} ± {:.3f} s late".format(*log.lag)
        gyro = f"gyro bias {bias:.5f} ± {bias_sigma:.5f} rad/s"
        logs.append(f"{log.name}: {log.distance:.0f} m, {gyro}, truth {lag}")
    header = [
        f"from {', '.join(sources)}, starting from {robot_name}.",
        *filter(None, [headline]),
        found.verdict,
        "Comments are standard errors; «held» parameters are not observable in the logs and unchanged.",
        *found.notes,
        *logs,
    ]
    # Names of logs may contain line breaks, which would end the comment.
    first, *more = (" ".join(line.split()) for line in header)
    file = msgspec.to_builtins(found.robot)
    comments = {parameter.name: _comment(parameter, file) for parameter in found.parameters}
    comments_by_table = {
        "vehicle": comments,
        "indices": _under("indices", comments),
        "constant_icr": _under("constant_icr", comments),
        "imu": _imu_comments(found, comments),
        "tracks": _under("tracks", comments) | SIGMA_COMMENTS,
    }
    lines = [f"{FIRST_WORDS} {first}", *(f"# {line}" for line in more)]
    return "\n".join(lines) + "\n" + robot_toml(found.robot, comments_by_table)


def _comment(parameter: FoundParameter, file: dict[str, Any]) -> str:
    """Standard error of a value, and the estimate where the file has another one."""
    table, _, key = parameter.name.rpartition(".")
    written = file.get(table or "vehicle", {}).get(key)
    value, sigma, before = parameter.value, parameter.sigma, parameter.before
    text = "held" if sigma is None else f"± {sigma:.2g}"
    if sigma and (for_others := parameter.sigma_other_logs or 0.0) > sigma:
        text += f" (± {for_others:.2g} for another log)"
    if sigma is not None and written is not None and abs(written - value) > LARGEST_CHANGE * sigma:
        text = f"estimate {value:.4g} {text}"
    if parameter.status == "conditional":
        text += ", given what is held"
    if before is not None and sigma is not None:
        text += f"; was {before:.5g}"
    return f"{text}; {parameter.note}" if parameter.note else text


def _under(table: str, comments: Mapping[str, str]) -> dict[str, str]:
    """Comments on the keys of a table, without its name: "mass" for "vehicle.mass"."""
    prefix = f"{table}."
    own = {name: text for name, text in comments.items() if name.startswith(prefix)}
    return {name.removeprefix(prefix): text for name, text in own.items()}


def _imu_comments(found: Calibration, comments: Mapping[str, str]) -> dict[str, str]:
    """Comments on the table [imu]; its vectors have the errors of all components."""
    sigma_of = {parameter.name: parameter.sigma for parameter in found.parameters}
    imu_comments = _under("imu", comments) | SIGMA_COMMENTS
    for key, names in (
        ("rotation_rpy_deg", ("roll", "pitch", "yaw")),
        ("position", ("forward", "left")),
    ):
        sigmas = [sigma_of.get(f"imu.{name}") for name in names]
        if any(sigmas):
            texts = ("held" if sigma is None else f"{sigma:.2g}" for sigma in sigmas)
            imu_comments[key] = f"± {', '.join(texts)}"
    return imu_comments
