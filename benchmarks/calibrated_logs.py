"""Calibrations of the sample logs, one by one and together, as a table in Markdown.

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
    """Radii, track and gain."""

    def told(parameter: str, digits: int) -> str:
        one = found.parameter(parameter)
        sigma = "" if one.sigma is None else f" ± {one.sigma:.{digits}f}"
        return f"{one.value:.{digits}f}{sigma}"

    return [
        name,
        told("sprocket_radius", 4),
        told("tracks.difference", 4),
        told("effective_track", 3),
        told("indices.zeta1", 5),
    ]


def main() -> None:
    """Print the tables."""
    parser = script_parser(__doc__)
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    every = {}
    for name, (robot_name, logs) in LOGS.items():
        robot = as_made(robot_name)
        every[name] = calibrate([read_log(data / log, robot) for log in logs], robot)
    head = ["log", "effective radius, m", "right less left", "effective track, m", "zeta1, m/N"]
    table(head, [found_row(name, found) for name, found in every.items()])


if __name__ == "__main__":
    main()
