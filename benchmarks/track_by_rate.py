"""Effective track over the yaw rate of real robots, as `icreckon inspect` finds it.

Means of turns to both sides and of all runs of a ground, weighted by their time. A run that turns
steadily throughout shows none: nothing tells a bias of its gyro from the turning.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from _study import data_parser, table

from icreckon.replay.estimates.track_by_rate import RateBin
from icreckon.replay.inspection.inspect import inspect

ROBOTS = {
    "Marmotte (tracks)": "marmotte_part1",
    "Husky, deflated tyres": "husky_deflated_part1",
    "Warthog, grass": "warthog_grass_*",
    "Husky, asphalt": "borealtc/asphalt_*.parquet",
    "Husky, flooring": "borealtc/flooring_*.parquet",
    "Husky, ice": "borealtc/ice_*.parquet",
}
COLUMNS = (0.1, 0.2, 0.35, 0.7, 1.4, 4.0)
"""Bounds of the yaw rate of the columns [rad/s]."""


def bins_of(files: Iterable[Path]) -> list[RateBin]:
    """Effective track of all logs that show it [m]."""
    tracks = [inspect(file).track for file in sorted(files)]
    return [one for track in tracks if track is not None for one in track.bins]


def cells(bins: Sequence[RateBin]) -> list[str]:
    """Effective track in each column, with its standard error."""
    found = []
    for low, high in pairwise(COLUMNS):
        inside = [one for one in bins if low <= abs(one.rate) < high]
        seconds = sum(one.seconds for one in inside)
        if not inside:
            found.append("-")
            continue
        weights = np.array([one.seconds / seconds for one in inside])
        mean = float(weights @ [one.track for one in inside])
        sigma = float(np.sqrt(weights**2 @ [one.sigma**2 for one in inside]))
        found.append(f"{mean:.3f} ± {sigma:.3f} ({seconds:.0f} s)")
    return found


def main() -> None:
    """Print the table."""
    data = data_parser(__doc__).parse_args().data
    rows = [(name, *cells(bins_of(data.glob(where)))) for name, where in ROBOTS.items()]
    table(("effective track, m", *(f"{a:g} to {b:g} rad/s" for a, b in pairwise(COLUMNS))), rows)


if __name__ == "__main__":
    main()
