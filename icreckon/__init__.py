"""Dead reckoning for tracked and skid-steer robots whose ICRs move with inertia.

The public names of the estimator, the simulator and the replay module are imported when first used.
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from icreckon.estimator.base.errors import EstimatorError as EstimatorError
    from icreckon.estimator.base.errors import IcreckonError as IcreckonError
    from icreckon.estimator.base.state import STATE_NAMES as STATE_NAMES
    from icreckon.estimator.batch.feed_arrays import feed_arrays as feed_arrays
    from icreckon.estimator.batch.many import run_many as run_many
    from icreckon.estimator.calibration import Calibration as Calibration
    from icreckon.estimator.calibration import calibrate as calibrate
    from icreckon.estimator.filter.clones import RelativeMotion as RelativeMotion
    from icreckon.estimator.filter.health import Health as Health
    from icreckon.estimator.filter.health import JudgedInnovation as JudgedInnovation
    from icreckon.estimator.filter.health import ParameterHealth as ParameterHealth
    from icreckon.estimator.filter.health import SensorHealth as SensorHealth
    from icreckon.estimator.log.log import Log as Log
    from icreckon.estimator.log.measurements import BodyVelocity as BodyVelocity
    from icreckon.estimator.log.measurements import HeadingFix as HeadingFix
    from icreckon.estimator.log.measurements import ImuSample as ImuSample
    from icreckon.estimator.log.measurements import PoseFix as PoseFix
    from icreckon.estimator.log.measurements import PositionFix as PositionFix
    from icreckon.estimator.log.measurements import TrackSpeeds as TrackSpeeds
    from icreckon.estimator.log.measurements import ZeroVelocity as ZeroVelocity
    from icreckon.estimator.log.scores import drift as drift
    from icreckon.estimator.log.scores import pose_nees as pose_nees
    from icreckon.estimator.log.scores import velocity_errors as velocity_errors
    from icreckon.estimator.log.series import FixSeries as FixSeries
    from icreckon.estimator.log.series import ImuSeries as ImuSeries
    from icreckon.estimator.log.series import PoseSeries as PoseSeries
    from icreckon.estimator.log.series import TrackSpeedSeries as TrackSpeedSeries
    from icreckon.estimator.log.series import Truth as Truth
    from icreckon.estimator.log.series import TwistSeries as TwistSeries
    from icreckon.estimator.log.trajectory import Trajectory as Trajectory
    from icreckon.estimator.motion import icr as kinematics  # noqa: F401
    from icreckon.estimator.motion import index_model as motion  # noqa: F401
    from icreckon.estimator.robot.robot_file import Robot as Robot
    from icreckon.estimator.robot.robot_file import Slip as Slip
    from icreckon.estimator.robot.robot_file import load_robot as load_robot
    from icreckon.estimator.robot.robot_file import robot_names as robot_names
    from icreckon.estimator.robot.settings import GateSettings as GateSettings
    from icreckon.estimator.robot.settings import Settings as Settings
    from icreckon.estimator.robot.settings import StandstillSettings as StandstillSettings
    from icreckon.estimator.robot.variants import VARIANTS as VARIANTS
    from icreckon.estimator.robot.variants import Adaptation as Adaptation
    from icreckon.estimator.robot.variants import default_adaptation as default_adaptation
    from icreckon.estimator.robot.variants import state_names as state_names
    from icreckon.estimator.streaming.pose_estimator import PoseEstimator as PoseEstimator
    from icreckon.estimator.streaming.pose_estimator import Snapshot as Snapshot
    from icreckon.estimator.streaming.recorded_run import Run as Run
    from icreckon.estimator.streaming.run import run as run
    from icreckon.estimator.streaming.smoother import Smoothing as Smoothing
    from icreckon.estimator.streaming.smoother import smooth as smooth
    from icreckon.replay.base.errors import ReplayError as ReplayError
    from icreckon.replay.comparison.compare import compare as compare
    from icreckon.replay.comparison.fixes import parse_part as parse_part
    from icreckon.replay.comparison.results import summarise as summarise
    from icreckon.replay.export.log_bag import write_log as write_log
    from icreckon.replay.inspection.inspect import inspect as inspect
    from icreckon.replay.reading.read_log import read_log as read_log
    from icreckon.report.replay.folder import write_report as write_report
    from icreckon.report.study.folder import run_study as run_study
    from icreckon.simulation.base.errors import SimulationError as SimulationError
    from icreckon.simulation.scenario import Scenario as Scenario
    from icreckon.simulation.scenario import load_scenario as load_scenario
    from icreckon.simulation.sensors.specs import EncoderSpec as EncoderSpec
    from icreckon.simulation.sensors.specs import FixSpec as FixSpec
    from icreckon.simulation.sensors.specs import InertialSpec as InertialSpec
    from icreckon.simulation.simulate import simulate as simulate
    from icreckon.simulation.study.plan import Study as Study
    from icreckon.simulation.study.plan import load_study as load_study
    from icreckon.simulation.study.plan import study_names as study_names
    from icreckon.simulation.truth.terrain import Patch as Patch
    from icreckon.simulation.truth.terrain import Payload as Payload

# Modules that are re-exported as a whole.
_MODULES = {
    "kinematics": "icreckon.estimator.motion.icr",
    "motion": "icreckon.estimator.motion.index_model",
}
_HOMES = {
    "Adaptation": "icreckon.estimator.robot.variants",
    "BodyVelocity": "icreckon.estimator.log.measurements",
    "Calibration": "icreckon.estimator.calibration",
    "EncoderSpec": "icreckon.simulation.sensors.specs",
    "EstimatorError": "icreckon.estimator.base.errors",
    "FixSeries": "icreckon.estimator.log.log",
    "FixSpec": "icreckon.simulation.sensors.specs",
    "GateSettings": "icreckon.estimator.robot.settings",
    "HeadingFix": "icreckon.estimator.log.measurements",
    "Health": "icreckon.estimator.filter.health",
    "IcreckonError": "icreckon.estimator.base.errors",
    "ImuSample": "icreckon.estimator.log.measurements",
    "ImuSeries": "icreckon.estimator.log.log",
    "InertialSpec": "icreckon.simulation.sensors.specs",
    "JudgedInnovation": "icreckon.estimator.filter.health",
    "Log": "icreckon.estimator.log.log",
    "ParameterHealth": "icreckon.estimator.filter.health",
    "Patch": "icreckon.simulation.truth.terrain",
    "Payload": "icreckon.simulation.truth.terrain",
    "PoseEstimator": "icreckon.estimator.streaming.pose_estimator",
    "PoseFix": "icreckon.estimator.log.measurements",
    "PoseSeries": "icreckon.estimator.log.log",
    "PositionFix": "icreckon.estimator.log.measurements",
    "RelativeMotion": "icreckon.estimator.filter.clones",
    "ReplayError": "icreckon.replay.base.errors",
    "Robot": "icreckon.estimator.robot.robot_file",
    "Run": "icreckon.estimator.streaming.run",
    "STATE_NAMES": "icreckon.estimator.base.state",
    "Scenario": "icreckon.simulation.scenario",
    "SensorHealth": "icreckon.estimator.filter.health",
    "Settings": "icreckon.estimator.robot.settings",
    "SimulationError": "icreckon.simulation.base.errors",
    "Slip": "icreckon.estimator.robot.robot_file",
    "Smoothing": "icreckon.estimator.streaming.smoother",
    "Snapshot": "icreckon.estimator.streaming.pose_estimator",
    "StandstillSettings": "icreckon.estimator.robot.settings",
    "Study": "icreckon.simulation.study.plan",
    "TrackSpeedSeries": "icreckon.estimator.log.log",
    "TrackSpeeds": "icreckon.estimator.log.measurements",
    "Trajectory": "icreckon.estimator.log.trajectory",
    "Truth": "icreckon.estimator.log.log",
    "TwistSeries": "icreckon.estimator.log.log",
    "VARIANTS": "icreckon.estimator.robot.variants",
    "ZeroVelocity": "icreckon.estimator.log.measurements",
    "calibrate": "icreckon.estimator.calibration",
    "compare": "icreckon.replay.comparison.compare",
    "default_adaptation": "icreckon.estimator.robot.variants",
    "drift": "icreckon.estimator.log.scores",
    "inspect": "icreckon.replay.inspection.inspect",
    "load_robot": "icreckon.estimator.robot.robot_file",
    "load_scenario": "icreckon.simulation.scenario",
    "load_study": "icreckon.simulation.study.plan",
    "parse_part": "icreckon.replay.comparison.fixes",
    "pose_nees": "icreckon.estimator.log.scores",
    "read_log": "icreckon.replay.reading.read_log",
    "robot_names": "icreckon.estimator.robot.robot_file",
    "run": "icreckon.estimator.streaming.run",
    "feed_arrays": "icreckon.estimator.batch.feed_arrays",
    "run_many": "icreckon.estimator.batch.many",
    "run_study": "icreckon.report.study.folder",
    "simulate": "icreckon.simulation.simulate",
    "smooth": "icreckon.estimator.streaming.smoother",
    "state_names": "icreckon.estimator.robot.variants",
    "study_names": "icreckon.simulation.study.plan",
    "summarise": "icreckon.replay.comparison.results",
    "velocity_errors": "icreckon.estimator.log.scores",
    "write_log": "icreckon.replay.export.log_bag",
    "write_report": "icreckon.report.replay.folder",
}
# Former names, which warn for one version.
_FORMER = {"Identification": "Calibration", "identify": "calibrate"}

__all__ = sorted({*_HOMES, *_MODULES})  # noqa: PLE0605 - the table above is the one list of names
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name in _FORMER:
        new = _FORMER[name]
        warnings.warn(
            f"icreckon.{name} is now icreckon.{new}; the former name goes with the next version",
            DeprecationWarning,
            stacklevel=2,
        )
        return __getattr__(new)
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
