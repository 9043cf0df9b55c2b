"""Stamps of a checkpoint, which follow the clock."""

import numpy as np

from icreckon import FilterCheckpoint, Health, Settings, load_robot
from icreckon.estimator.base import state as s
from icreckon.estimator.base.records import NEVER, shifted
from icreckon.estimator.filter.filter_record import FilterRecord
from icreckon.estimator.filter.gate import GateRecord
from icreckon.estimator.sensors.input_settings import input_settings
from icreckon.estimator.sensors.standstill import QuietMemory

SETTINGS = input_settings(load_robot("auriga-alpha"), Settings())
STEP = 20_000_000
EPOCH = 1_700_000_000_123_456_789


def test_a_checkpoint_is_shifted_with_its_quiet_readings_and_gates():
    record = FilterRecord(settings=SETTINGS, stamp=EPOCH)
    record.still.end, record.gyro.stamp = 2, EPOCH
    found = shifted(
        FilterCheckpoint(
            np.zeros(s.SIZE),
            np.eye(s.SIZE),
            record,
            QuietMemory((EPOCH, EPOCH + STEP), (0.1, 0.2)),
            {"position": GateRecord(stamp=EPOCH), "heading": GateRecord()},
            Health(),
        ),
        STEP,
    )
    assert found.quiet == QuietMemory((EPOCH + STEP, EPOCH + 2 * STEP), (0.1, 0.2))
    assert {name: gate.stamp for name, gate in found.gates.items()} == {
        "position": EPOCH + STEP,
        "heading": NEVER,
    }
    assert found.record.stamp == found.record.gyro.stamp == EPOCH + STEP
    assert found.record.accelerometer_x.stamp == NEVER
