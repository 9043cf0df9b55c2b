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
INTERVAL, WINDOW = 1.0, 10.0
ENOUGH = 5  # fewest innovations in the window from which a large mean NIS is reported as WARN


class _Innovations(NamedTuple):
    """Innovations of a sensor's component in the window before each message, (m,)."""

    name: str  # name of the component
    newest: Floats  # latest normalised innovation, NaN if there is none in the window
    mean_square: Floats  # mean square of the normalised innovations (mean NIS), NaN likewise
    number: Floats  # number of innovations


def diagnostics(runs: Mapping[str, Run], hardware: str) -> Outbox:
    """Make the diagnostics of filtered runs, one message per second."""
    # Each has the estimates' uncertainty and the innovations; the last one also has counts of the whole
    # runs. `runs` are by variant; `hardware` is the id of the robot in the messages.
    begin = min(int(run.stamps[0]) for run in runs.values())
    end = max(int(run.stamps[-1]) for run in runs.values())
    all_stamps = np.unique(np.concatenate([run.stamps for run in runs.values()]))
    stamps = np.append(even_grid(begin, end, int(INTERVAL * NANOSECONDS), all_stamps), end)
    innovations = {name: _innovations_before(run, stamps) for name, run in runs.items()}
    # Newest row of each run at each message, the first one before there is any.
    rows = {
        name: np.maximum(np.searchsorted(run.stamps, stamps, side="right") - 1, 0)
        for name, run in runs.items()
    }

    def make(messages: Messages, stamp: int, i: int) -> Any:
        statuses = []
        for name, run in runs.items():
            row, trajectory = int(rows[name][i]), run.trajectory
            covariance, twist = trajectory.pose_covariances[row], trajectory.twists[row]
            statuses.append(estimate_status(f"{name}: estimate", covariance, twist))
            statuses += [_innovation_status(name, sensor, i) for sensor in innovations[name]]
            if i == len(stamps) - 1:
                statuses.append(_count_status(name, run))
        status_messages = []
        for status in statuses:
            texts = status.values.items()
            values = [messages.new(KEY_VALUE, key=key, value=text) for key, text in texts]
            fields = status._asdict() | {"hardware_id": hardware, "values": values}
            status_messages.append(messages.new(STATUS, **fields))
        header = messages.header(stamp, "")
        return messages.new(DIAGNOSTICS, header=header, status=status_messages)

    numbers = (np.arange(len(stamps)),)
    return Outbox(DIAGNOSTICS_TOPIC, DIAGNOSTICS, stamps, make, numbers, alike=False)


def _innovations_before(run: Run, stamps: Stamps) -> list[_Innovations]:
    """Innovations of each component of the sensors, in the window before each stamp."""
    # A window has the rows from `first` to below `end`.
    end = np.searchsorted(run.stamps, stamps, side="right")
    first = np.searchsorted(run.stamps, stamps - int(WINDOW * NANOSECONDS), side="right")
    components = []
    for name, values in zip(run.innovation_names, run.innovations.T, strict=True):
        is_known = np.isfinite(values)
        squares = np.where(is_known, values, 0.0).astype(float) ** 2
        # Counts and sums of all rows before a row: differences of them are those of a window.
        counts = np.concatenate([[0], np.cumsum(is_known)])
        sums = np.concatenate([[0.0], np.cumsum(squares)])
        # Row of the newest innovation before each row, -1 if there is none.
        newest_rows = np.maximum.accumulate(np.where(is_known, np.arange(len(is_known)), -1))
        newest = values[np.concatenate([[-1], newest_rows])[end]]
        count = counts[end] - counts[first]
        mean = (sums[end] - sums[first]) / np.maximum(count, 1)
        newest, mean = (np.where(count > 0, column, np.nan) for column in (newest, mean))
        components.append(_Innovations(name, newest, mean, count))
    return components


def _innovation_status(variant: str, sensor: _Innovations, i: int) -> DiagnosticStatus:
    """Status of a component of a sensor in the i-th message."""
    name, count = f"{variant}: {sensor.name}", int(sensor.number[i])
    if not count:
        return DiagnosticStatus(STALE, name, f"none in {WINDOW:.0f} s", {})
    newest, mean = float(sensor.newest[i]), float(sensor.mean_square[i])
    is_large = count >= ENOUGH and mean > LARGE_NIS
    values = {
        "normalised_innovation": f"{newest:.3f}",
        f"nis_mean_{WINDOW:.0f}s": f"{mean:.3f}",
        f"count_{WINDOW:.0f}s": str(count),
    }
    text = f"NIS {mean:.2f} over {WINDOW:.0f} s (ideal 1)"
    return DiagnosticStatus(WARN if is_large else OK, name, text, values)


def _count_status(variant: str, run: Run) -> DiagnosticStatus:
    """Counts of measurements, updates and faults, and noise, of the whole run."""
    health = run.health
    values = {f"{name}: used": str(sensor.used) for name, sensor in health.sensors.items()}
    values |= {f"{name}, rejected": str(count) for name, count in health.rejections().items()}
    values["standstill updates"] = str(health.standstill_updates)
    values["gaps in the track speeds"] = str(health.track_gaps)
    values |= {f"{fault}: times found": str(count) for fault, count in health.times.items()}
    for name, noise in health.noise.items():
        if noise.measured is not None:
            ratio = f"{noise.measured / noise.of_file:.2g}"
            values[f"{name}: noise over that of the robot file"] = ratio
    if health.wander is not None:
        values["wander of the fixes"] = health.wander.text
    seconds = (run.stamps[-1] - run.stamps[0]) * NANOSECOND
    return DiagnosticStatus(OK, f"{variant}: counts", f"of all {seconds:.0f} s", values)
