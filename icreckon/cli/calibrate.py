"""`icreckon calibrate`: calibration of a robot from logs with a truth."""

from pathlib import Path
from typing import Annotated, Any

from typer import Option

from icreckon.cli.common import options
from icreckon.cli.common.comparing import kernels_of, read, the_robot
from icreckon.cli.common.console import (
    check_writable,
    progress,
    results_folder,
    show,
    working,
    write_file,
)
from icreckon.estimator.base.errors import IcreckonError
from icreckon.estimator.base.plain_data import json_types
from icreckon.estimator.calibration import Calibration, calibrate
from icreckon.estimator.calibration.models import MODELS
from icreckon.replay.bags.decoding import read_definitions
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.base.outputs import write_text
from icreckon.replay.calibration.results import headline, summarise_calibration
from icreckon.replay.calibration.robot_file import FIRST_WORDS, robot_file_text
from icreckon.replay.checking.check import has_track_rates
from icreckon.replay.checking.ros_settings import ROS_FIRST_WORDS, ros_settings
from icreckon.replay.checking.worth import VARIANT
from icreckon.replay.comparison.results import write_results
from icreckon.replay.mapping.topics import topic_map, with_column_keys
from icreckon.replay.reading.gather import log_files, refuse_twice
from icreckon.replay.reading.tables import are_parts
from icreckon.report.calibration.tables import WIDE_FROM, calibration_page, calibration_tables
from icreckon.report.pages import unless_missing
from icreckon.report.replay.folder import FIGURE_FILE, PAGE_FILE, RESULTS_FILE


def command(
    paths: Annotated[
        list[Path],
        options.logs(
            f"Logs of one robot with a truth, each a log: {options.LOG_FILES}. A folder of such "
            "files is one log."
        ),
    ],
    robot_name: options.RobotName = None,
    write: Annotated[
        Path | None, Option(help="Write the robot file with what was found here.")
    ] = None,
    ros: options.Ros = None,
    lever_arm: Annotated[
        str | None,
        Option(
            help="Point that the truth follows, forward and left of the robot's origin in metres, as "
            "0.3,0.0 (default: estimated if observable)."
        ),
    ] = None,
    models: Annotated[
        str | None,
        Option(
            help="Models to compare, constant among them (default: all): differential, constant, "
            "inertia."
        ),
    ] = None,
    segment: Annotated[
        float, Option(help="Length of the segments that are predicted, in seconds.")
    ] = 3.0,
    message_files: options.MessageFiles = None,
    out: options.Out = None,
    as_json: options.Json = False,
    wide: options.Wide = False,
    overwrite: options.Overwrite = False,
) -> None:
    """Calibrate a robot from logs with a ground truth.

    Reports which parameters the logs determine, and which model they support.
    """
    robot_name, robot = the_robot(robot_name, paths[:1])
    refuse_twice(paths, "log")
    check_writable(write, FIRST_WORDS, overwrite=overwrite)
    check_writable(ros, ROS_FIRST_WORDS, overwrite=overwrite)
    names = MODELS if models is None else tuple(name.strip() for name in models.split(","))
    arm = None if lever_arm is None else _pair(lever_arm)
    message_files = message_files or []
    definitions = read_definitions(message_files)
    files_of_logs = [log_files(path) or [path] for path in paths]
    if robot.log and are_parts(files_of_logs, topic_map(robot).columns):
        files_of_logs = [paths]
    with results_folder(out, f"icreckon-calibrate-{paths[0].stem}", overwrite=overwrite) as folder:
        logs = [read(files, robot, definitions) for files in files_of_logs]
        with progress(f"calibrating {robot.name} from {len(logs)} log(s)") as report:
            try:
                calibration = calibrate(
                    logs,
                    robot,
                    segment=segment,
                    lever_arm=arm,
                    models=names,
                    speeds_by_radius=has_track_rates(robot),
                    progress=report,
                )
            except IcreckonError as problem:
                # Errors name the keys of the robot file.
                raise ReplayError(with_column_keys(str(problem), robot)) from None
        calibrated = calibration.robot
        # Track speeds have the radius and latency of the robot by which they are read.
        calibrated_logs = [read(files, calibrated, definitions) for files in files_of_logs]
        kernels = kernels_of([VARIANT])
        with progress("filtering with the file before and after", compiles=kernels) as report:
            gained = headline((logs, robot), (calibrated_logs, calibrated), report)
        configuration = {
            "logs": [str(path) for path in paths],
            "robot": robot_name,
            "segment": segment,
            "lever_arm": lever_arm,
            "models": list(names),
        }
        inputs = {str(path): path for path in [*paths, *message_files]}
        origin: dict[str, Any] = {"configuration": configuration, "inputs": inputs}
        summary = json_types(summarise_calibration(calibration, logs, gained, **origin))
        with working("writing page and figure"), unless_missing():
            write_results(folder / RESULTS_FILE, summary)
            write_text(folder / PAGE_FILE, calibration_page(summary))
            from icreckon.report.calibration.figure import write_calibration_figure

            write_calibration_figure(folder / FIGURE_FILE, summary)
        if write is not None:
            text = robot_file_text(calibration, [log.name for log in logs], robot_name, gained)
            write_file(write, text, FIRST_WORDS, what="robot file", overwrite=overwrite)
        if ros is not None:
            settings = ros_settings(calibrated_logs, calibrated, source=_origin(calibration))
            write_file(ros, settings, ROS_FIRST_WORDS, what="settings for ROS", overwrite=overwrite)
        show(folder, calibration_tables, summary, WIDE_FROM, as_json=as_json, wide=wide)


def _origin(calibration: Calibration) -> str:
    """Origin of the multiplier of the wheel separation, with its standard error."""
    sigmas = {parameter.name: parameter.sigma_other_logs for parameter in calibration.parameters}
    sigma = sigmas.get("effective_track")
    if sigma is None:
        return "of the robot file"
    return f"calibrated ± {sigma / calibration.robot.vehicle.track_gauge:.2g}"


def _pair(text: str) -> tuple[float, float]:
    """Lever arm of the truth [m], forward and left, from the text of the option."""
    try:
        forward, left = (float(part) for part in text.split(","))
    except ValueError:
        raise ReplayError(
            f"--lever-arm takes two numbers in metres, forward and left, as 0.3,0.0; found {text!r}"
        ) from None
    return forward, left
