"""Constants that all lanes of a filter share."""

from typing import Any

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.engine.lane import FilterShape
from icreckon.estimator.engine.layout import SLIP_SHARES, STEP_CONSTANTS
from icreckon.estimator.filter.gate import CHI_SQUARE_1E4, imu_patience
from icreckon.estimator.filter.process_noise import Disturbances
from icreckon.estimator.motion.motion_model import MotionModel
from icreckon.estimator.robot.robot_file import Robot, Slip
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.held_tracks import smoothing_share

PRECISIONS: dict[int, Any] = {64: np.float64, 32: np.float32}  # numPy types by number of bits
# Time constant of the derivatives by the parameters [s]. A longer one leaves less noise, but delays them
# so far that they are those of another motion (`scoreboard.py --parts healthy` with 0.1).
REGRESSOR_SMOOTHING = 0.03
PER_STEP = len(STEP_CONSTANTS)
LINE = 64  # alignment of arrays: length of the widest registers, and of a line of the cache [bytes]


def step_constants(dt: float) -> Any:
    """Compute the values of `STEP_CONSTANTS` for a step of `dt` seconds."""
    return dt, smoothing_share(dt, REGRESSOR_SMOOTHING)


def shared_constants(
    shape: FilterShape,
    model: MotionModel,
    disturbances: Disturbances,
    robot: Robot,
    settings: Settings,
    state: Floats,
) -> Floats:
    """Constants that all lanes of a filter share, with room for those of a step.

    `state` (SIZE,) has the values of the states that are not uncertain.
    """
    names = shape.layout.constants
    values: Floats = aligned(len(names), PRECISIONS[shape.bits])
    slip, (imu_x, imu_y, _) = disturbances.slip, robot.imu.position
    walks = all_walks(disturbances)
    named = {
        **model.vehicle._asdict(),
        "slope_forgetting": disturbances.slope_forgetting,
        "fastest": robot.vehicle.max_track_speed,
        **{name: getattr(slip, name) for name in Slip.__struct_fields__},
        "imu_x": imu_x,
        "imu_y": imu_y,
        "threshold": CHI_SQUARE_1E4[1],
        "position_threshold": CHI_SQUARE_1E4[2],
        **dict.fromkeys(SLIP_SHARES, 1.0),
        "patience": settings.gates.patience,
        "imu_patience": imu_patience(settings.gates),
        "standstill_duration": settings.standstill.duration,
        **{f"fixed{i}": value for i, value in enumerate(state)},
        **{f"walk{i}": value for i, value in enumerate(walks)},
    }
    for row, bound in enumerate(model.bounds):
        named |= {f"bound{row}_{k}": value for k, value in enumerate(bound)}
    for name, value in named.items():
        values[names[name]] = value
    return values


def all_walks(disturbances: Disturbances) -> Floats:
    """Random walks (SIZE,) of all states, see `Disturbances`."""
    return disturbances.bias_walk + disturbances.parameter_walk + disturbances.slope_walk


def aligned(count: int, number: Any = np.float64) -> Any:
    """Zeros (count,) of a type, aligned with the machine's registers."""
    size = np.dtype(number).itemsize
    padded = np.zeros(count + LINE // size, dtype=number)
    first = (-padded.ctypes.data % LINE) // size  # the first that is at a multiple of LINE
    return padded[first : first + count]
