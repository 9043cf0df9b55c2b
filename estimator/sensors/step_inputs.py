"""Inputs of a filter step from the track speeds; for plain Python and for numba."""

from typing import NamedTuple

from icreckon.estimator.base.records import NEVER
from icreckon.estimator.faults.odd_wheels import wheel_density
from icreckon.estimator.faults.sliding_robot import slide_density
from icreckon.estimator.faults.spinning_tracks import LEFT, RIGHT, spin_density
from icreckon.estimator.sensors.held_tracks import (
    ACCELERATION_AVERAGING,
    TrackRecord,
    coarse_density,
    gap_density,
    late_density,
    mean_decay,
    mean_speeds,
    stuck_density,
)
from icreckon.estimator.sensors.input_settings import InputSettings
from icreckon.estimator.sensors.sensor_models import TrackChange
from icreckon.estimator.sensors.standstill import (
    StandstillRecord,
    carried_density,
    creep_density,
    turn_density,
)


class StepInputs(NamedTuple):
    """Inputs of a step from the track speeds."""

    smooth_left: float  # smoothed speed of the left track [m/s]
    smooth_right: float  # smoothed speed of the right track [m/s]
    left: float  # mean speed of the left track over the step [m/s]
    right: float  # mean speed of the right track over the step [m/s]
    speed_decay: float  # mean factor by which stale speeds have decayed over the step
    missing: float  # speed at which both make up for distance missing before the step [m/s]
    left_density: float  # error density of the left track's speed [m²/s]
    right_density: float  # error density of the right track's speed [m²/s]
    gap_density: float  # error density of stale speeds [m²/s]
    # error density of the forward speed by a slide, by slip that no sensor measures, or if carried [m²/s]
    slide_x_density: float
    slide_y_density: float  # error density of the speed to the left of a carried robot [m²/s]
    turn_density: float  # error density of the yaw of a robot that may turn while it rests [rad²/s]
    creep_density: float  # density of its yaw rate that coarse encoders may hide [rad²/s]
    late_density: float  # error density of the yaw rate by late track speeds [rad²/s]
    acceleration_left: float  # averaged acceleration of the left track [m/s²]
    acceleration_right: float  # averaged acceleration of the right track [m/s²]
    acceleration_variance: float  # variance of each of these, by noise of the speeds [m²/s⁴]
    slow: float  # 1 if both tracks are slow enough for a standstill, else 0
    unknown: float  # 1 if the speed of a track is stale or from a stuck sensor, else 0
    rest_time: float  # time at rest since the robot last stood, at the newest quiet reading [s]
    drive_time: float  # time of driving since then [s]; 0 if it never stood


def step_inputs(
    held: TrackRecord, still: StandstillRecord, start: int, end: int, settings: InputSettings
) -> StepInputs:
    """Inputs of a step between two stamps [ns]; if they are equal, no time passes."""
    left, right, missing = mean_speeds(held, start, end, settings.hold_ns)
    coarse = coarse_density(held, settings)
    track_noise = settings.track_density + coarse
    if held.left == 0.0 and held.right == 0.0:
        # Encoders of tracks at rest have no noise; coarse ones may not have counted yet.
        since = still.stopped_since
        may_creep = since == NEVER or start - since < settings.duration_ns
        track_noise = coarse if may_creep else 0.0
    window = max(ACCELERATION_AVERAGING, held.interval)
    carried = carried_density(still, start, end)
    is_slow = max(abs(held.left), abs(held.right)) < settings.track_speed
    stale = gap_density(held, start, end, settings)
    stuck_left = stuck_density(held.repeating_left, start, end, settings)
    stuck_right = stuck_density(held.repeating_right, start, end, settings)
    odd_left = wheel_density(held.left_wheels, held.stamp, start, end)
    odd_right = wheel_density(held.right_wheels, held.stamp, start, end)
    return StepInputs(
        held.smooth_left,
        held.smooth_right,
        left,
        right,
        mean_decay(held, start, end, settings.hold_ns),
        missing,
        track_noise + stuck_left + odd_left + spin_density(held.spin, LEFT),
        track_noise + stuck_right + odd_right + spin_density(held.spin, RIGHT),
        stale,
        slide_density(held.forward, start, end) + carried + hidden_density(held, settings),
        carried,
        turn_density(still, start, end),
        creep_density(coarse, held.interval, settings),
        late_density(held, start, end, settings),
        held.acceleration_left,
        held.acceleration_right,
        track_noise / (held.interval * window * window),
        1.0 if is_slow else 0.0,
        1.0 if stale + stuck_left + stuck_right > 0.0 else 0.0,
        still.rest_time,
        still.drive_time,
    )


def hidden_density(held: TrackRecord, settings: InputSettings) -> float:
    """Error density of the forward speed by slip that no sensor measures [m²/s]."""
    slip = settings.undetected_share * 0.5 * (abs(held.smooth_left) + abs(held.smooth_right))
    return 2.0 * settings.undetected_time * slip * slip


def track_change(inputs: StepInputs) -> TrackChange:
    """Change of the track speeds at the start of a step."""
    acceleration = inputs.acceleration_left, inputs.acceleration_right
    return TrackChange(acceleration, inputs.acceleration_variance)
