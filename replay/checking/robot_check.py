"""Check of a robot file against a log: scale, signs, mounting, latency, units.

Every check compares what the file states with what the log shows, and can correct the difference. Checks
run one after the other, each on the log and file as corrected so far, so that one error (a radius that is
a diameter) does not show up as several.
"""

import math
from collections import ChainMap
from collections.abc import Sequence
from dataclasses import replace

from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot, changed_robot
from icreckon.replay.checking import fix_checks, imu_checks, track_checks
from icreckon.replay.checking.check import (
    FORWARD,
    LATENCY,
    MOUNTING,
    SCALE,
    TRACK,
    Check,
    corrected,
)
from icreckon.replay.mapping.naming import is_command
from icreckon.replay.mapping.topics import topic_map, with_column_keys

SLIGHT = 1.2  # factor of the scale up to which the wheels can be the right ones [-]
# In this order: each needs what those before it have corrected.
CHECKS = (
    imu_checks.check_samples,
    imu_checks.check_gravity,
    imu_checks.check_mounting,
    track_checks.check_sides,
    track_checks.check_ratio,
    track_checks.check_turning,
    imu_checks.check_forward,
    track_checks.check_latency,
    track_checks.check_scale,
    track_checks.check_track,
    imu_checks.check_bias,
    imu_checks.check_noise,
    fix_checks.check_antenna,
    fix_checks.check_heading,
    fix_checks.check_velocity,
)
# These compare both sides with the gyro, which stands in for a side that is stuck or reads too little.
OF_BOTH_SIDES = {
    track_checks.check_turning: "sense of turning",
    track_checks.check_latency: LATENCY,
    track_checks.check_track: TRACK,
}


def check_robot(log: Log, robot: Robot) -> list[Check]:
    """Check a robot against a log: units, signs, mounting, latency, scale.

    The log comes from `read_log` with this robot, or is made of arrays.
    """
    checks: list[Check] = []
    for function in CHECKS:
        if function in OF_BOTH_SIDES and track_checks.FAILED & {check.name for check in checks}:
            checks.append(Check(OF_BOTH_SIDES[function], "", "not checked, since a side fails"))
            continue
        for check in function(log, robot):
            checks.append(replace(check, remedy=with_column_keys(check.remedy, robot)))
            log, robot = corrected(log, robot, [check])
    return checks


def commanded(robot: Robot) -> list[str]:
    """Note on track speeds that are commands by the name of their topic, or nothing."""
    tracks = topic_map(robot).tracks
    if tracks is None or not is_command(tracks.topic):
        return []
    return [
        f"the track speeds are those of {tracks.topic}, commands by its name: a robot that stalls, or is "
        "stopped, counts as driving"
    ]


def far_centre(robot: Robot) -> list[str]:
    """Note on a turning centre that is beyond the contact of the tracks, or nothing."""
    zeta0, half = robot.indices.zeta0, robot.vehicle.half_contact_length
    note = f"zeta0 = {zeta0:.2f} m is beyond half_contact_length = {half:g} m: is [imu] position right?"
    return [note] if abs(zeta0) > half else []


def _correctable(checks: Sequence[Check]) -> list[Check]:
    """Contradictions that have a correction."""
    return [check for check in checks if check.problem and check.correction is not None]


def with_corrected(log: Log, robot: Robot, checks: Sequence[Check]) -> tuple[Log, Robot]:
    """Correct log and robot by all contradictions that have a correction."""
    wrong = _correctable(checks)
    log, robot = corrected(log, robot, wrong)
    return log, changed_robot(robot, dict(ChainMap(*(check.settings for check in reversed(wrong)))))


def is_of_another(checks: Sequence[Check]) -> bool:
    """True if two of IMU mounting, scale and effective track contradict the file."""
    # The log is then rather of another robot than the file is wrong.
    names = set()
    for check in _correctable(checks):
        value = check.measured.value if check.measured is not None else math.nan
        # Worn or sunk wheels explain a slight error of the scale.
        if check.name != SCALE or not 1.0 / SLIGHT < value < SLIGHT:
            names.add(check.name)
    groups = ({MOUNTING, FORWARD}, {SCALE}, {TRACK})
    return sum(bool(names & group) for group in groups) >= 2
