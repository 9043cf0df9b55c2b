"""icreckon: dead reckoning for tracked and skid-steer robots whose ICRs move with inertia.

The public names of the estimator, the simulator and the replay module, imported when first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimator.errors import EstimatorError as EstimatorError
    from estimator.errors import IcreckonError as IcreckonError
    from estimator.log import Log as Log
    from estimator.measurements import BodyVelocity as BodyVelocity
    from estimator.measurements import HeadingFix as HeadingFix
    from estimator.measurements import ImuSample as ImuSample
    from estimator.measurements import PositionFix as PositionFix
    from estimator.measurements import TrackSpeeds as TrackSpeeds
    from estimator.pose_estimator import PoseEstimator as PoseEstimator
    from estimator.robot import Robot as Robot
    from estimator.robot import load_robot as load_robot
    from estimator.robot import robot_names as robot_names
    from estimator.run import Run as Run
    from estimator.run import run as run
    from estimator.settings import Settings as Settings
    from estimator.trajectory import Trajectory as Trajectory
    from estimator.variants import VARIANTS as VARIANTS
    from replay.bag_writer import write_log as write_log
    from replay.bags import read_log as read_log
    from replay.comparison import compare as compare
    from replay.errors import ReplayError as ReplayError
    from replay.inspection import inspect as inspect
    from simulation.errors import SimulationError as SimulationError
    from simulation.scenario import Scenario as Scenario
    from simulation.scenario import simulate as simulate

_HOMES = {
    "BodyVelocity": "estimator.measurements",
    "EstimatorError": "estimator.errors",
    "HeadingFix": "estimator.measurements",
    "IcreckonError": "estimator.errors",
    "ImuSample": "estimator.measurements",
    "Log": "estimator.log",
    "PoseEstimator": "estimator.pose_estimator",
    "PositionFix": "estimator.measurements",
    "ReplayError": "replay.errors",
    "Robot": "estimator.robot",
    "Run": "estimator.run",
    "Scenario": "simulation.scenario",
    "Settings": "estimator.settings",
    "SimulationError": "simulation.errors",
    "TrackSpeeds": "estimator.measurements",
    "Trajectory": "estimator.trajectory",
    "VARIANTS": "estimator.variants",
    "compare": "replay.comparison",
    "inspect": "replay.inspection",
    "load_robot": "estimator.robot",
    "read_log": "replay.bags",
    "robot_names": "estimator.robot",
    "run": "estimator.run",
    "simulate": "simulation.scenario",
    "write_log": "replay.bag_writer",
}

__all__ = sorted(_HOMES)  # noqa: PLE0605 - the table above is the one list of names
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'icreckon' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
