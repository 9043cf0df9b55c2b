"""icreckon: dead reckoning for tracked and skid-steer robots whose ICRs move with inertia.

The public names of the estimator, the simulator and the replay module, imported when first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimator import kinematics as kinematics
    from estimator import motion as motion
    from estimator.batch.many import run_many as run_many
    from estimator.errors import EstimatorError as EstimatorError
    from estimator.errors import IcreckonError as IcreckonError
    from estimator.health import Health as Health
    from estimator.health import JudgedInnovation as JudgedInnovation
    from estimator.health import ParameterHealth as ParameterHealth
    from estimator.health import SensorHealth as SensorHealth
    from estimator.identification import Identification as Identification
    from estimator.identification import identify as identify
    from estimator.log import Log as Log
    from estimator.measurements import BodyVelocity as BodyVelocity
    from estimator.measurements import HeadingFix as HeadingFix
    from estimator.measurements import ImuSample as ImuSample
    from estimator.measurements import PoseFix as PoseFix
    from estimator.measurements import PositionFix as PositionFix
    from estimator.measurements import TrackSpeeds as TrackSpeeds
    from estimator.measurements import ZeroVelocity as ZeroVelocity
    from estimator.pose_estimator import PoseEstimator as PoseEstimator
    from estimator.pose_estimator import Snapshot as Snapshot
    from estimator.recorded_run import Run as Run
    from estimator.relative_motion import RelativeMotion as RelativeMotion
    from estimator.robot import Robot as Robot
    from estimator.robot import Slip as Slip
    from estimator.robot import load_robot as load_robot
    from estimator.robot import robot_names as robot_names
    from estimator.run import run as run
    from estimator.scores import drift as drift
    from estimator.scores import pose_nees as pose_nees
    from estimator.scores import velocity_errors as velocity_errors
    from estimator.series import FixSeries as FixSeries
    from estimator.series import ImuSeries as ImuSeries
    from estimator.series import PoseSeries as PoseSeries
    from estimator.series import TrackSpeedSeries as TrackSpeedSeries
    from estimator.series import Truth as Truth
    from estimator.series import TwistSeries as TwistSeries
    from estimator.settings import GateSettings as GateSettings
    from estimator.settings import Settings as Settings
    from estimator.settings import StandstillSettings as StandstillSettings
    from estimator.smoother import Smoothing as Smoothing
    from estimator.smoother import smooth as smooth
    from estimator.state import STATE_NAMES as STATE_NAMES
    from estimator.trajectory import Trajectory as Trajectory
    from estimator.variants import VARIANTS as VARIANTS
    from estimator.variants import Adaptation as Adaptation
    from estimator.variants import default_adaptation as default_adaptation
    from estimator.variants import state_names as state_names
    from replay.bag_writer import write_log as write_log
    from replay.bags import read_log as read_log
    from replay.comparison import compare as compare
    from replay.errors import ReplayError as ReplayError
    from replay.fixes import parse_part as parse_part
    from replay.inspection import inspect as inspect
    from replay.report import write_report as write_report
    from replay.results import summarise as summarise
    from simulation.errors import SimulationError as SimulationError
    from simulation.noise import EncoderSpec as EncoderSpec
    from simulation.noise import FixSpec as FixSpec
    from simulation.noise import InertialSpec as InertialSpec
    from simulation.scenario import Scenario as Scenario
    from simulation.scenario import load_scenario as load_scenario
    from simulation.simulate import simulate as simulate
    from simulation.study_folder import run_study as run_study
    from simulation.study_plan import Study as Study
    from simulation.study_plan import load_study as load_study
    from simulation.study_plan import study_names as study_names
    from simulation.terrain import Patch as Patch
    from simulation.terrain import Payload as Payload

# Modules that are handed on whole.
_MODULES = {"kinematics": "estimator.kinematics", "motion": "estimator.motion"}
_HOMES = {
    "Adaptation": "estimator.variants",
    "BodyVelocity": "estimator.measurements",
    "EncoderSpec": "simulation.noise",
    "EstimatorError": "estimator.errors",
    "FixSeries": "estimator.log",
    "FixSpec": "simulation.noise",
    "GateSettings": "estimator.settings",
    "HeadingFix": "estimator.measurements",
    "Health": "estimator.health",
    "IcreckonError": "estimator.errors",
    "Identification": "estimator.identification",
    "ImuSample": "estimator.measurements",
    "ImuSeries": "estimator.log",
    "InertialSpec": "simulation.noise",
    "JudgedInnovation": "estimator.health",
    "Log": "estimator.log",
    "ParameterHealth": "estimator.health",
    "Patch": "simulation.terrain",
    "Payload": "simulation.terrain",
    "PoseEstimator": "estimator.pose_estimator",
    "PoseFix": "estimator.measurements",
    "PoseSeries": "estimator.log",
    "PositionFix": "estimator.measurements",
    "RelativeMotion": "estimator.relative_motion",
    "ReplayError": "replay.errors",
    "Robot": "estimator.robot",
    "Run": "estimator.run",
    "STATE_NAMES": "estimator.state",
    "Scenario": "simulation.scenario",
    "SensorHealth": "estimator.health",
    "Settings": "estimator.settings",
    "SimulationError": "simulation.errors",
    "Slip": "estimator.robot",
    "Smoothing": "estimator.smoother",
    "Snapshot": "estimator.pose_estimator",
    "StandstillSettings": "estimator.settings",
    "Study": "simulation.study_plan",
    "TrackSpeedSeries": "estimator.log",
    "TrackSpeeds": "estimator.measurements",
    "Trajectory": "estimator.trajectory",
    "Truth": "estimator.log",
    "TwistSeries": "estimator.log",
    "VARIANTS": "estimator.variants",
    "ZeroVelocity": "estimator.measurements",
    "compare": "replay.comparison",
    "default_adaptation": "estimator.variants",
    "drift": "estimator.scores",
    "identify": "estimator.identification",
    "inspect": "replay.inspection",
    "load_robot": "estimator.robot",
    "load_scenario": "simulation.scenario",
    "load_study": "simulation.study_plan",
    "parse_part": "replay.fixes",
    "pose_nees": "estimator.scores",
    "read_log": "replay.bags",
    "robot_names": "estimator.robot",
    "run": "estimator.run",
    "run_many": "estimator.batch.many",
    "run_study": "simulation.study_folder",
    "simulate": "simulation.simulate",
    "smooth": "estimator.smoother",
    "state_names": "estimator.variants",
    "study_names": "simulation.study_plan",
    "summarise": "replay.results",
    "velocity_errors": "estimator.scores",
    "write_log": "replay.bag_writer",
    "write_report": "replay.report",
}

__all__ = sorted({*_HOMES, *_MODULES})  # noqa: PLE0605 - the table above is the one list of names
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        value: Any = import_module(_MODULES[name])
    elif name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module 'icreckon' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
