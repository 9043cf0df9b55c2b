"""Filter diagnostics (diagnostic_msgs/DiagnosticArray): innovations, uncertainty."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.log.scores import even_grid
from icreckon.estimator.streaming.outputs import Run
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.message_types import DIAGNOSTICS, KEY_VALUE, STATUS
from icreckon.replay.bags.messages import Messages
from icreckon.replay.bags.writer import Outbox
from icreckon.replay.base.diagnostic_status import (
    LARGE_NIS,
    OK,
    STALE,
    WARN,
    DiagnosticStatus,
    estimate_status,
)

DIAGNOSTICS_TOPIC = "/diagnostics"
# Interval of the messages, and the window before each over which innovations are averaged [s].
INTERVAL = 1.0
WINDOW = 10.0
# Fewest innovations in the window from which a large mean NIS is reported as WARN.
ENOUGH = 5


class _Sensor(NamedTuple):
    """One component of a sensor at the times of the messages, (m,) each."""

    name: str  # name of the component
    newest: Floats  # latest normalised innovation, NaN if there is none in the window
    mean_square: Floats  # mean square of the normalised innovations in the window, NaN likewise
    counted: Floats  # number of innovations in the window


def diagnostics(runs: Mapping[str, Run], hardware: str) -> Outbox:
    """Make the diagnostics of filtered runs, one message per second."""
    begin = min(int(one.stamps[0]) for one in runs.values())
    end = max(int(one.stamps[-1]) for one in runs.values())
    known = np.unique(np.concatenate([one.stamps for one in runs.values()]))
    stamps = np.append(even_grid(begin, end, int(INTERVAL * NANOSECONDS), known), end)
    sensors = {name: _sensors(one, stamps) for name, one in runs.items()}
    rows = {
        name: np.maximum(np.searchsorted(one.stamps, stamps, side="right") - 1, 0)
        for name, one in runs.items()
    }

    def make(messages: Messages, i: int) -> Any:
        statuses = []
        for name, one in runs.items():
            row, moved = int(rows[name][i]), one.trajectory
            covariance, twist = moved.pose_covariances[row], moved.twists[row]
            statuses.append(estimate_status(f"{name}: estimate", covariance, twist))
            statuses += [_innovation(name, sensor, i) for sensor in sensors[name]]
            if i == len(stamps) - 1:
                statuses.append(_counts(name, one))
        return messages.new(
            DIAGNOSTICS,
            header=messages.header(stamps[i], ""),
            status=[_message(messages, status, hardware) for status in statuses],
        )

    return Outbox(DIAGNOSTICS_TOPIC, DIAGNOSTICS, stamps, make)


def _sensors(one: Run, stamps: Stamps) -> list[_Sensor]:
    last = np.searchsorted(one.stamps, stamps, side="right")
    first = np.searchsorted(one.stamps, stamps - int(WINDOW * NANOSECONDS), side="right")
    found = []
    for name, column in zip(one.innovation_names, one.innovations.T, strict=True):
        there = np.isfinite(column)
        squares = np.where(there, column, 0.0).astype(float) ** 2
        counts = np.concatenate([[0], np.cumsum(there)])
        sums = np.concatenate([[0.0], np.cumsum(squares)])
        count = counts[last] - counts[first]
        newest = np.concatenate(
            [[-1], np.maximum.accumulate(np.where(there, np.arange(len(there)), -1))]
        )
        some = count > 0
        values = np.where(some, column[newest[last]], np.nan)
        mean = np.where(some, (sums[last] - sums[first]) / np.maximum(count, 1), np.nan)
        found.append(_Sensor(name, values, mean, count))
    return found


def _innovation(variant: str, sensor: _Sensor, i: int) -> DiagnosticStatus:
    name, count = f"{variant}: {sensor.name}", int(sensor.counted[i])
    if not count:
        return DiagnosticStatus(STALE, name, f"none in {WINDOW:.0f} s", {})
    newest, mean = float(sensor.newest[i]), float(sensor.mean_square[i])
    large = count >= ENOUGH and mean > LARGE_NIS
    values = {
        "normalised_innovation": f"{newest:.3f}",
        f"nis_mean_{WINDOW:.0f}s": f"{mean:.3f}",
        f"count_{WINDOW:.0f}s": str(count),
    }
    text = f"NIS {mean:.2f} over {WINDOW:.0f} s (ideal 1)"
    return DiagnosticStatus(WARN if large else OK, name, text, values)


def _counts(variant: str, one: Run) -> DiagnosticStatus:
    """Counts of used and rejected measurements of the whole run, for its last message."""
    values = {f"{name}: used": str(sensor.used) for name, sensor in one.health.sensors.items()}
    values |= {f"{what}, rejected": str(count) for what, count in one.health.rejections().items()}
    values["standstill updates"] = str(one.health.standstill_updates)
    values["gaps in the track speeds"] = str(one.health.track_gaps)
    values |= {f"{fault}: times found": str(count) for fault, count in one.health.times.items()}
    for name, noise in one.health.noise.items():
        if noise.measured is not None:
            values[f"{name}: noise over that of the robot file"] = (
                f"{noise.measured / noise.of_file:.2g}"
            )
    if one.health.wander is not None:
        values["wander of the fixes"] = one.health.wander.text
    seconds = (one.stamps[-1] - one.stamps[0]) * NANOSECOND
    return DiagnosticStatus(OK, f"{variant}: counts", f"of all {seconds:.0f} s", values)


def _message(messages: Messages, status: DiagnosticStatus, hardware: str) -> Any:
    return messages.new(
        STATUS,
        level=status.level,
        name=status.name,
        message=status.message,
        hardware_id=hardware,
        values=[
            messages.new(KEY_VALUE, key=key, value=value) for key, value in status.values.items()
        ],
    )
