"""Layout of the workspace of a group of lanes: places by name."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from icreckon.estimator.base import state as s
from icreckon.estimator.engine.model import TracedModel
from icreckon.estimator.filter.filter_record import ALIKE_FIXES, DEPARTURE
from icreckon.estimator.robot.robot_file import Slip
from icreckon.estimator.sensors.step_inputs import StepInputs

# Inputs of a step: those of each lane, and those that all lanes share.
STEP_INPUTS = (
    *StepInputs._fields,
    *("gyro_density", "accelerometer_x_density", "accelerometer_y_density"),
    *("quiet_mean", "rate", "roll_rate", "pitch_rate", "tilt_density"),
    *("force_x", "force_y", "now_left", "now_right"),
)
FIX_INPUTS = (
    *("fix_x", "fix_y", "fix_yaw", "fix_variance", "yaw_variance"),
    *("fix_forward", "fix_left", "fix_up", "fix_mode", "fix_interval", "heading_interval"),
)
STEP_CONSTANTS = ("dt", "smoothing")
SLIP_SHARES = ("share_x", "share_y", "share_w")
CONSTANTS = (
    *("gauge", "fastest", "mass", "x_CM", "y_CM", "rolling_resistance", "load_lag", "zeta_F"),
    "slope_forgetting",
    *Slip.__struct_fields__,
    *("imu_x", "imu_y", "threshold", "patience", "imu_patience", "interval"),
    *SLIP_SHARES,
    *("standstill_duration", "position_threshold"),
)
BOUND = range(s.PARAMETER_COUNT + 1)  # columns of a bound
# Counts of each gate, the time of rejections first.
IMU_GATES = ("gyro", "accelerometer_x", "accelerometer_y")
GATES = (*IMU_GATES, "position", "heading")
GATE_COUNTS = ("rejected_for", "used", "rejected", "nis", "admitted")
COUNTS = (*(f"{gate}_{count}" for gate in GATES for count in GATE_COUNTS), "standstill")
# Values from the step before: 1 if the robot stood, the factors on the slip, the departure of fixes from
# the path, those with variances alike, the trend of their innovations, and the place of the antenna and
# the yaw before and after the newest one.
FACTORS = ("slip_factor", "present_factor")
TREND = ("trend_forward", "trend_left", "trend_size")
PLACE = ("x", "y", "yaw")
PLACES = tuple(f"{when}_{axis}" for when in ("predicted", "updated") for axis in PLACE)
BEFORE = ("stood", *FACTORS, *DEPARTURE, *ALIKE_FIXES, *TREND, *PLACES)
TWIST = ("v_x", "v_y", "w", "vv_xx", "vv_xy", "vv_xw", "vv_yy", "vv_yw", "vv_ww")

# Innovation z and innovation covariance S of each gate, if the kernel stores them; S is 0 if the gate had
# no measurement.
INNOVATIONS = (
    *(f"{gate}_{part}" for gate in (*IMU_GATES, "heading") for part in ("z", "S")),
    *(f"position_{part}" for part in ("z_x", "z_y", "S_xx", "S_xy", "S_yy")),
)

REPORTED = 1400  # rows for the changes that a kernel reports, see `filter.changes`

# Motion at some track speeds: indices, force of inertia and its limited value, and the derivatives of the
# twist by the track speeds.
MOTION = (
    *("zeta", "epsilon", "eta", "inertia", "force"),
    *(f"{axis}_by_{side}" for axis in ("v_x", "v_y", "w") for side in ("left", "right")),
)

# Row behind those of the derivatives by the parameters: the yaw rate that tracks and gyro show.
TURN = "turn"


class Names:
    """Places of names in an order."""

    def __init__(self, names: Iterable[str]) -> None:
        self.names = tuple(names)
        self._places = {name: place for place, name in enumerate(self.names)}

    def __getitem__(self, name: str) -> int:
        return self._places[name]

    def __len__(self) -> int:
        return len(self.names)


INPUTS = Names((*STEP_INPUTS, *FIX_INPUTS))


@dataclass(frozen=True)
class Layout:
    """Layout of the workspace of a filter with some of the states."""

    states: tuple[int, ...]  # indices of the uncertain states, ascending, without the fast slip
    model: TracedModel  # the motion model
    reports: bool = False  # kernels report all changes of the filter

    @property
    def parameters(self) -> tuple[int, ...]:
        """Indices of the uncertain parameters."""
        return tuple(i for i in self.states if s.PARAMETERS.start <= i < s.PARAMETERS.stop)

    @property
    def regressors(self) -> int:
        """Row of the first regressor; that of the turn is behind them."""
        return self.rows[TURN] - 3 * len(self.parameters)

    @cached_property
    def rows(self) -> Names:
        """Names of the rows: states, covariances, regressors, counts, twist; outputs last."""
        states, fast = self.states, range(s.FAST_SLIP.start, s.FAST_SLIP.stop)
        all_states = (*states, *fast)
        return Names(
            (
                *(f"x{i}" for i in states),
                *(covariance_name(i, j) for n, i in enumerate(states) for j in states[n:]),
                *(f"r{axis}_{i}" for axis in range(3) for i in self.parameters),
                TURN,
                *COUNTS,
                *TWIST,
                *BEFORE,
                *(f"memory{k}" for k in range(self.model.memory)),
                *(f"x{i}" for i in fast),
                *(
                    covariance_name(i, j)
                    for j in fast
                    for i in all_states
                    if i <= j or i >= fast.stop
                ),
                *INNOVATIONS,
                *MOTION,
                *(f"{axis}_by_{i}" for axis in TWIST[:3] for i in all_states),
                *(f"report{k}" for k in range(REPORTED * self.reports)),
            )
        )

    @cached_property
    def constants(self) -> Names:
        """Names of the constants that all lanes share."""
        return Names(
            (
                *STEP_CONSTANTS,
                *CONSTANTS,
                *(f"fixed{i}" for i in range(s.SIZE)),
                *(f"walk{i}" for i in range(s.SIZE)),
                *(f"bound{row}_{k}" for row in range(len(self.model.bounds)) for k in BOUND),
            )
        )


def covariance_name(a: int, b: int) -> str:
    """Name of the covariance of a pair of states."""
    return f"P{min(a, b)}_{max(a, b)}"
