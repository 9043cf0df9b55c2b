"""How often robots near the published one have more than one steady motion: the model's folds.

    python benchmarks/folds.py [--draws 1000]

Draws the parameters of Auriga-alpha with a relative spread and counts those for which the implicit model
has several solutions at some track speeds.
"""

from __future__ import annotations

import argparse

import msgspec
import numpy as np

from icreckon.estimator.robot.robot_file import load_robot
from icreckon.simulation.truth.kinematic import DRAWN, has_single_motion

SPREADS = (0.05, 0.10, 0.15, 0.20)
SEED = 0


def main() -> None:
    """Print the share for each spread."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--draws", type=int, default=1000)
    draws = parser.parse_args().draws
    robot = load_robot("auriga-alpha")
    published = np.array([getattr(robot.indices, name) for name in DRAWN])
    for spread in SPREADS:
        rng = np.random.default_rng(SEED)
        folded = 0
        for _ in range(draws):
            values = published * np.exp(spread * rng.standard_normal(len(DRAWN)))
            drawn = msgspec.structs.replace(
                robot.indices, **dict(zip(DRAWN, values.tolist(), strict=True))
            )
            folded += not has_single_motion(drawn, robot)
        print(f"spread {100 * spread:.0f} %: {100 * folded / draws:.1f} % of {draws} draws fold")


if __name__ == "__main__":
    main()
