"""Do the standard errors of a calibration hold on other logs of the same robot?

    python benchmarks/between_logs.py DATA

DATA is the folder of the sample logs, see accuracy.py. Each of the Warthog's four logs, and each quarter
of Marmotte's and Husky's, is calibrated by itself from the makers' figures. For each parameter the table
has the spread of these values over their standard errors (1 is ideal; the root of the chi-square per
degree of freedom about the weighted mean), with the errors for the given log and with those for other
logs, and the standard deviation between logs that explains the rest (DerSimonian and Laird's estimate,
Controlled Clinical Trials 7, 1986).
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
from _logs import ASPHALT, GRASS
from _study import script_parser, table
from accuracy import HALVED, as_made

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.calibration import Calibration, calibrate
from icreckon.replay.reading.read_log import read_log

LOGS = {
    "Warthog": ("warthog", (*GRASS, ASPHALT), 1),
    **{name: (robot, (log,), 4) for name, (robot, log) in HALVED.items()},
}
"""Robot file, logs, and number of pieces of each log."""
LEFT_OUT = ("imu.gyro_bias",)
"""Parameters of a log, not of a robot."""


def squares(values: Floats, sigmas: Floats) -> float:
    """Chi-square of values about their weighted mean."""
    weights = sigmas**-2.0
    return float((weights * (values - (weights @ values) / weights.sum()) ** 2).sum())


def between(values: Floats, sigmas: Floats) -> float:
    """Standard deviation between logs beyond their standard errors."""
    weights = sigmas**-2.0
    spare = squares(values, sigmas) - (len(values) - 1)
    return math.sqrt(max(spare, 0.0) / (weights.sum() - (weights**2).sum() / weights.sum()))


def calibrations(data: Path) -> dict[str, list[Calibration]]:
    """Calibrations of each robot, one for each piece that shows enough."""
    every: dict[str, list[Calibration]] = {}
    for name, (robot_name, logs, pieces) in LOGS.items():
        robot = as_made(robot_name)
        every[name] = []
        for log in (read_log(data / one, robot) for one in logs):
            edges = [log.start + (log.end - log.start) * at // pieces for at in range(pieces + 1)]
            for start, end in pairwise(edges):
                try:
                    every[name].append(calibrate([log.between(start, end)], robot))
                except EstimatorError as error:
                    print(f"{name}: {error}")
    return every


def main() -> None:
    """Print the table."""
    parser = script_parser(__doc__)
    parser.add_argument("data", type=Path)
    every = calibrations(parser.parse_args().data)
    rows = []
    names = dict.fromkeys(one.name for ones in every.values() for one in ones[0].parameters)
    for name in names:
        if name in LEFT_OUT:
            continue
        totals, freedom, parts = np.zeros(2), 0, []
        for ones in every.values():
            found = [one.parameter(name) for one in ones if _has(one, name)]
            values = np.array([one.value for one in found])
            own = np.array([one.sigma for one in found], dtype=float)
            other = np.array([one.sigma_other_logs for one in found], dtype=float)
            if len(found) < 2:
                parts.append("")
                continue
            totals += squares(values, own), squares(values, other)
            freedom += len(found) - 1
            parts.append(f"{between(values, own):.2g} ({np.mean(values):.3g})")
        if freedom:
            ratios = [f"{one:.2f}" for one in np.sqrt(totals / freedom)]
            rows.append([f"`{name}`", str(freedom), *ratios, *parts])
    head = ["parameter", "degrees of freedom", "spread / error", "spread / error on other logs"]
    table([*head, *(f"{name}: between logs (mean)" for name in every)], rows)


def _has(found: Calibration, name: str) -> bool:
    return any(one.name == name and one.sigma for one in found.parameters)


if __name__ == "__main__":
    main()
