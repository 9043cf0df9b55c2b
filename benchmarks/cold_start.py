"""How long a live node waits for the compiler: the constructor and the longest feed, cold and warm.

    python benchmarks/cold_start.py [--variants inertia-online] [--seconds 20]

Each variant runs in two processes: one begins with an empty compile cache, the next finds it filled. The
drive moves, stands, loses its tracks for a second, and has every kind of measurement, some of them late.
Printed are the time of the constructor, the longest time of a feed, and how many functions were compiled
in a feed (none is right).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

from _study import table

SECOND = 1_000_000_000


def measurements(seconds: float) -> Iterator[object]:
    """A drive: 50 Hz tracks, 100 Hz IMU, fixes of all kinds, a standstill and a gap."""
    import icreckon as i

    covariance = ((0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01))
    for k in range(int(seconds * 100)):
        stamp, t = k * SECOND // 100, k / 100.0
        stands, gap = 5.0 < t < 8.0, 12.0 < t < 13.0
        left, right = (0.0, 0.0) if stands else (0.3, 0.6)
        if k % 2 == 0 and not gap:
            yield i.TrackSpeeds(stamp, left, right)
        turn = 0.0 if stands else 0.2
        yield i.ImuSample(stamp, (0.0, 0.0, turn), (0.0, 0.45 * turn, 9.81))
        if k % 50 == 20:
            yield i.PositionFix(stamp - SECOND // 20, 0.0, 0.0, 4.0)
            yield i.HeadingFix(stamp + 1000, 0.0, 4.0)
        if k % 100 == 40:
            yield i.BodyVelocity(stamp, 0.45 * (not stands), 0.0, 0.1)
            yield i.PoseFix(stamp + 2000, 0.0, 0.0, 0.0, covariance)
        if stands and k % 50 == 0:
            yield i.ZeroVelocity(stamp)


def measured(variant: str, seconds: float) -> dict[str, float]:
    """Times of one process, this one."""
    from numba.core import event

    import icreckon

    robot = icreckon.load_robot("auriga-alpha")
    begin = time.perf_counter()
    estimator = icreckon.PoseEstimator(robot, variant)
    constructor = time.perf_counter() - begin
    times = []
    with event.install_recorder("numba:compile") as recorder:
        for k, measurement in enumerate(measurements(seconds)):
            begin = time.perf_counter()
            estimator.feed(measurement)  # type: ignore[arg-type]
            if k == 700:
                estimator.mark()
            times.append(time.perf_counter() - begin)
    compiled = sum(1 for _, each in recorder.buffer if each.is_start)
    return {
        "constructor": constructor,
        "longest": 1e3 * max(times),
        "compiled": compiled,
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--variants", nargs="+", default=["inertia-online"])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here:
        print(json.dumps(measured(options.variants[0], options.seconds)))
        return
    rows = []
    for variant in options.variants:
        with tempfile.TemporaryDirectory() as cache:
            for cold in (True, False):
                command = [sys.executable, __file__, "--here", "--variants", variant]
                done = subprocess.run(
                    [*command, "--seconds", str(options.seconds)],
                    env={**os.environ, "NUMBA_CACHE_DIR": cache},
                    capture_output=True,
                    text=True,
                    check=True,
                )
                found = json.loads(done.stdout)
                rows.append(
                    [
                        variant,
                        "empty" if cold else "filled",
                        f"{found['constructor']:.1f}",
                        f"{found['longest']:.1f}",
                        f"{found['compiled']:.0f}",
                    ]
                )
    head = ["variant", "cache", "constructor, s", "longest feed, ms", "compiled"]
    table(head, rows)


if __name__ == "__main__":
    main()
