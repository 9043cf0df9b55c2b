"""Calibrations of the sample logs, one by one and together: two tables in Markdown.

    python benchmarks/calibrated_logs.py DATA

DATA is the folder of the sample logs, see accuracy.py. Each calibration starts from the makers'
figures and an IMU that is mounted square, as there.
"""

from __future__ import annotations

from pathlib import Path

from _logs import ASPHALT, GRASS
from _study import script_parser, table
from accuracy import HALVED, as_made

from icreckon.estimator.calibration import Calibration, calibrate
from icreckon.replay.reading.read_log import read_log

LOGS = {
    "Warthog, grass, 15h56": ("warthog", GRASS[:1]),
    "Warthog, grass, 16h11": ("warthog", GRASS[1:2]),
    "Warthog, grass, July": ("warthog", GRASS[2:]),
    "Warthog, asphalt": ("warthog", (ASPHALT,)),
    "Warthog, three on grass": ("warthog", GRASS),
    "Warthog, all four": ("warthog", (*GRASS, ASPHALT)),
    "Marmotte (tracks)": (HALVED["Marmotte"][0], (HALVED["Marmotte"][1],)),
    "Husky, deflated tyres": (HALVED["Husky"][0], (HALVED["Husky"][1],)),
}


def found_row(name: str, found: Calibration) -> list[str]:
    """Radii, track, lags and the truth's point."""

    def told(parameter: str, digits: int) -> str:
        one = found.parameter(parameter)
        sigma = "" if one.sigma is None else f" ± {one.sigma:.{digits}f}"
        return f"{one.value:.{digits}f}{sigma}"

    lags = [log.lag[0] for log in found.logs if log.lag is not None]
    low, high = min(lags), max(lags)
    return [
        name,
        told("sprocket_radius", 4),
        told("tracks.difference", 4),
        told("effective_track", 3),
        f"{low:.2f}" if high - low < 0.005 else f"{low:.2f} to {high:.2f}",
        f"{told('truth.forward', 3)}, {told('truth.left', 3)}",
        f"{told('indices.zeta1', 5)}",
    ]


def model_row(name: str, found: Calibration) -> list[str]:
    """Held-out drift of each model, and how the others differ from the one that is supported."""
    comparison = found.comparison
    scores = [
        f"{one.drift_percent:.1f} ({one.drift_with_gyro_percent:.2f})" for one in comparison.scores
    ]
    return [name, *scores, found.verdict.split(".")[0].removeprefix("The data support ")]


def main() -> None:
    """Print the tables."""
    parser = script_parser(__doc__)
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    every = {}
    for name, (robot_name, logs) in LOGS.items():
        robot = as_made(robot_name)
        every[name] = calibrate([read_log(data / log, robot) for log in logs], robot)
    head = ["log", "effective radius, m", "right less left", "effective track, m", "truth late, s"]
    rows = [found_row(name, found) for name, found in every.items()]
    table([*head, "its point forward, left, m", "zeta1, m/N"], rows)
    print()
    models = [f"`{one.model}`" for one in next(iter(every.values())).comparison.scores]
    rows = [model_row(name, found) for name, found in every.items()]
    table(["held-out drift, %", *models, "the data support"], rows)


if __name__ == "__main__":
    main()
