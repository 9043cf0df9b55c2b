"""The rows of a run have the faults that `Health.findings` names at their stamps."""

import numpy as np
import pytest

import faulty_drives
from faulty_drives import BEGINS, with_free_track, with_free_wheel, with_rates, with_tracks
from icreckon import Finding, Log, PoseEstimator, Robot, run
from icreckon.estimator.filter.fault_table import FAULT_COLUMNS
from icreckon.estimator.streaming.run import work_through
from same_runs import without

DURATION = 36.0
# Parts of columns whose findings have none, or another.
PARTS = {
    "stuck": "both tracks",
    "spinning": "one track",
    "silent": "IMU",
    "failing": "gyro",
    "sliding": "robot",
    "carried": "robot",
    "departing": "fixes",
}


@pytest.fixture(scope="module")
def drive(robot: Robot) -> Log:
    return faulty_drives.drive(robot, 1, DURATION)


def with_stuck_track(log: Log) -> Log:
    return with_tracks(
        log, 3.0, lambda speeds: np.column_stack([np.full(len(speeds), 0.7), speeds[:, 1]])
    )


def column_of(finding: Finding) -> tuple[str, str]:
    if finding.fault == "wheel off":
        return finding.fault, f"{finding.part.split()[0]} wheels"
    return finding.fault, finding.part or PARTS[finding.fault]


@pytest.mark.parametrize(
    ("fault", "broken"),
    [
        (("spinning", "left track"), with_free_track),
        (("stuck", "left track"), with_stuck_track),
        (
            ("failing", "gyro"),
            lambda log: with_rates(log, 3.0, lambda rates: np.full(len(rates), rates[0])),
        ),
        (("silent", "IMU"), lambda log: without(log, "imu", BEGINS, DURATION + 1.0)),
        (
            ("wheel off", "left wheels"),
            lambda log: with_free_wheel(faulty_drives.with_wheels(log, 3)),
        ),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, tuple) else "",
)
def test_the_rows_have_the_faults_that_findings_name(
    fault, broken, drive: Log, robot: Robot
) -> None:
    log, by_row = broken(drive), []
    estimator = PoseEstimator(robot, "constant-online")

    def at_row() -> None:
        findings = [one for one in estimator.health.findings if one.fault in (*PARTS, "wheel off")]
        assert all(-0.03 < (one.since - log.start) * 1e-9 - BEGINS < 0.5 for one in findings)
        by_row.append({column_of(one) for one in findings})

    streamed = work_through(log, estimator, at_row=at_row)
    for found, row in zip(by_row, streamed.faults, strict=True):
        assert found == {name for name, lasts in zip(FAULT_COLUMNS, row, strict=True) if lasts}
    spans = streamed.fault_spans()
    assert set(spans) == {fault}
    begin, end = (spans[fault][0] - log.start) * 1e-9
    assert BEGINS < begin < BEGINS + 2.0
    assert begin < end <= (DURATION if fault[0] == "silent" else BEGINS + 4.0)
    assert np.array_equal(run(log, robot, "constant-online").faults, streamed.faults)
