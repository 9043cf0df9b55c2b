"""Headings of a truth of positions alone, from the path by tracks and gyro."""

import math
from dataclasses import replace

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.lag import LEAST_SPEEDING, NoLag, find_lag, places_of, plain_path
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault, headings_by_path
from icreckon.estimator.log.series import PoseSeries
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.sensors.sensor_models import SensorModels


def with_headings(log: Log, robot: Robot) -> tuple[Log, tuple[str, ...]]:
    """Log with headings in its truth, and remarks if these are from the path.

    Args:
        log: the log; one without truth, IMU or tracks stays as it is.
        robot: the robot, for its gyro and the size of its sprockets.

    Raises:
        EstimatorError: the truth has no headings, and the robot moves too little to find them.
    """
    truth, imu = log.truth, log.imu
    if truth is None or imu is None or len(imu.stamps) < 2 or len(log.tracks.stamps) < 2:
        return log, ()
    rates = SensorModels(robot).yaw_rates(imu.angular_velocity)
    fault = heading_fault(truth, (imu.stamps, rates)) if truth.headings else "are missing"
    if fault is None:
        return log, ()
    path = plain_path(log.tracks, imu, rates)
    lag = find_lag(places_of(truth.poses), places_of(path), least=LEAST_SPEEDING)
    late = 0 if isinstance(lag, NoLag) else round(lag.seconds / NANOSECOND)
    found = headings_by_path(truth.poses, PoseSeries(path.stamps + late, path.poses))
    if found is None:
        raise EstimatorError(
            f"log {log.name!r}: the headings of the truth {fault}, and the robot moves too little to "
            "find them from its path; drive a longer way, or give a truth with headings"
        )
    remark = (
        f"{log.name}: the headings of the truth {fault}; they were found from the path of tracks and "
        f"gyro, ± {math.degrees(found.sigma):.1f}°. Sideslip looks like a heading then: zeta0, zeta1, "
        "y_ICR and the difference of the radii are less certain than stated. Of the gyro such headings "
        "show nothing: its scale and bias are by the tracks and the positions"
    )
    # Twists of such a truth are not used.
    truth = replace(truth, poses=found.poses, twists=None, headings=True)
    return replace(log, truth=truth), (remark,)
