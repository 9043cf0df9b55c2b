"""Command line: options and help; bodies are imported when called."""

from __future__ import annotations

import sys
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated

import typer

from icreckon import __version__
from icreckon.cli.stopping import Stop, stopped_in_one_line, warned_in_one_line

app = typer.Typer(
    help="Dead reckoning for tracked and skid-steer robots whose ICRs move with inertia.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

DEBUG = "--debug"

Out = Annotated[
    Path | None, typer.Option(help="Folder for the results (default: a new one, printed).")
]
Json = Annotated[bool, typer.Option("--json", help="Print results.json instead of the table.")]
RobotName = Annotated[
    str | None,
    typer.Option(help="Name of a robot that ships with icreckon, or a TOML file. Required."),
]
Ros = Annotated[
    Path | None,
    typer.Option(
        help="Write settings for ROS here: diff_drive_controller, covariances, IMU frame."
    ),
]
Wide = Annotated[
    bool, typer.Option("--wide", help="Show all columns, however narrow the terminal is.")
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace what icreckon wrote there before.")
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")]
Duration = Annotated[float, typer.Option(help="Length of the run in seconds.")]
TRAJECTORIES = "straight, spin, circle, arcs, figure-eight, slalom, random, aggressive, stop-and-go"
Trajectory = Annotated[str, typer.Option(help=f"{TRAJECTORIES}.")]
Variants = Annotated[
    str | None,
    typer.Option(
        help="Filter variants, separated by commas (default: all): gyro, differential, constant-fixed, "
        "constant-online, full-linear, inertia-fixed, inertia-online."
    ),
]
Logs = Annotated[
    list[Path],
    typer.Argument(
        help="A ROS 1 .bag, a ROS 2 folder, an .mcap or a .db3, a CSV or Parquet table; several "
        "files are read as one log.",
        metavar="LOG...",
        show_default=False,
    ),
]
Definitions = Annotated[
    list[Path] | None,
    typer.Option(
        "--msg",
        help="Definition of a message type that the bag lacks, as our_msgs/msg/Rate.msg; "
        "repeatable.",
    ),
]


def _limit_unpacking(context: typer.Context, gigabytes: float) -> float:
    """Set the limit of unpacked sizes until the command ends."""
    from icreckon.replay.bags.unpacking import unpacked_limit

    context.with_resource(unpacked_limit(gigabytes))
    return gigabytes


UnpackedLimit = Annotated[
    float,
    typer.Option(
        "--unpacked-limit",
        callback=_limit_unpacking,
        help="Largest unpacked size of a chunk or message of a bag, of a table, or of a bag that is "
        "compressed as a whole, in GB.",
    ),
]
Formats = Annotated[
    str | None,
    typer.Option(
        help="Formats of the trajectories, separated by commas: tum, kitti, csv, parquet, mcap, "
        "ros1, geojson, or none (default: tum,mcap)."
    ),
]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes (default: one for each core).")]
PrepareWorkers = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes (default: as cores, 4 at most).")
]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"icreckon {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
    debug: Annotated[bool, typer.Option(DEBUG, help="Show tracebacks of errors.")] = False,
) -> None:
    pass


@app.command()
def demo(
    seed: Seed = 1,
    duration: Duration = 300.0,
    trajectory: Trajectory = "random",
    formats: Formats = None,
    out: Out = None,
    json: Json = False,
    wide: Wide = False,
    overwrite: Overwrite = False,
    workers: Workers = None,
) -> None:
    """Simulate a bag, read it back, and compare the variants.

    The robot is Auriga-alpha.
    """
    from icreckon.cli.demo import run_demo

    run_demo(
        seed=seed,
        duration=duration,
        trajectory=trajectory,
        formats=formats,
        out=out,
        as_json=json,
        wide=wide,
        overwrite=overwrite,
        workers=workers,
    )


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(help="The bag: a folder, or a file for ros1.")],
    robot: Annotated[
        str, typer.Option(help="Name of a robot that ships with icreckon, or a TOML file.")
    ] = "auriga-alpha",
    scenario: Annotated[
        Path | None,
        typer.Option(
            help="TOML file of the run (docs/reference/scenario-file.md); the other options change it."
        ),
    ] = None,
    trajectory: Annotated[
        str | None, typer.Option(help=f"{TRAJECTORIES}, or recorded (default: random).")
    ] = None,
    trajectory_file: Annotated[
        str | None,
        typer.Option(
            help="CSV file with columns t, left, right (s, m/s) of the recorded trajectory."
        ),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Length of the run in seconds (default: 300).")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of all random numbers (default: 0).")
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            help="perfect, nominal (the robot file's, the default), or an IMU grade: consumer, "
            "industrial, tactical."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Any key of a scenario file, as gyro.noise_density=0.001 or "
            "trajectory_options.speed=0.4; repeatable. Wins over the other options.",
        ),
    ] = None,
    truth: Annotated[
        str | None, typer.Option(help="Model of the truth: friction (the default) or kinematic.")
    ] = None,
    truth_spread: Annotated[
        float | None,
        typer.Option(
            help="Relative spread of the true parameters about the robot file's (default: 0.15)."
        ),
    ] = None,
    imu_rate: Annotated[
        float | None, typer.Option(help="IMU samples per second (default: 100).")
    ] = None,
    track_rate: Annotated[
        float | None, typer.Option(help="Track-speed samples per second (default: 50).")
    ] = None,
    fix_rate: Annotated[
        float | None, typer.Option(help="Position fixes per second; 0 for none (default: 1).")
    ] = None,
    fix_sigma: Annotated[
        float | None, typer.Option(help="Their standard deviation in metres (default: 0.05).")
    ] = None,
    fix_heading_sigma: Annotated[
        float | None,
        typer.Option(help="Standard deviation of their yaw in radians (default: no heading)."),
    ] = None,
    outage: Annotated[
        list[str] | None, typer.Option(help="Time without fixes, as 100:300 seconds; repeatable.")
    ] = None,
    format: Annotated[  # noqa: A002 - the option's name
        str, typer.Option(help="mcap, sqlite3 (both ROS 2) or ros1.")
    ] = "mcap",
    include_truth: Annotated[
        bool | None,
        typer.Option(
            "--with-truth/--without-truth", help="Whether the bag holds the truth (default: yes)."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a run and write it as a bag of standard messages."""
    from icreckon.cli.simulate import run_simulate

    run_simulate(
        out=out,
        robot=robot,
        scenario_file=scenario,
        settings=settings or [],
        outages=outage or [],
        fixes={"sigma": fix_sigma, "heading_sigma": fix_heading_sigma},
        bag_format=format,
        overwrite=overwrite,
        trajectory=trajectory,
        trajectory_file=trajectory_file,
        duration=duration,
        seed=seed,
        noise=noise,
        truth=truth,
        truth_spread=truth_spread,
        imu_rate=imu_rate,
        track_rate=track_rate,
        fix_rate=fix_rate,
        include_truth=include_truth,
    )


@app.command()
def replay(
    log: Annotated[
        list[Path],
        typer.Argument(
            help="Logs, each by itself: a ROS 1 .bag, a ROS 2 folder, an .mcap or a .db3, a CSV or "
            "Parquet table.",
            metavar="LOG...",
            show_default=False,
        ),
    ],
    robot: Annotated[
        list[str] | None,
        typer.Option(
            help="Name of a robot that ships with icreckon, or a TOML file. Required; repeatable, to "
            "compare robot files.",
        ),
    ] = None,
    one_log: Annotated[
        bool, typer.Option("--one-log", help="The files are parts of one log.")
    ] = False,
    variants: Variants = None,
    fixes: Annotated[
        str | None,
        typer.Option(
            help="Part of the log in which fixes are used, as 0:40% or 0:100 (seconds); taken from the "
            "ground truth if the log has no fixes. Default: all fixes of the log."
        ),
    ] = None,
    msg: Definitions = None,
    _unpacked_limit: UnpackedLimit = 0.5,
    smooth: Annotated[
        bool,
        typer.Option(
            "--smooth",
            help="Smooth each run, too: every pose from all measurements, also later ones; "
            "as variants NAME-smoothed.",
        ),
    ] = False,
    engine: Annotated[
        str,
        typer.Option(
            help="Engine: streaming, one variant after the other; batch, all at once; or auto, batch "
            "for long logs."
        ),
    ] = "auto",
    formats: Formats = None,
    out: Out = None,
    json: Json = False,
    wide: Wide = False,
    overwrite: Overwrite = False,
    workers: Workers = None,
) -> None:
    """Run all filter variants over a log, or several, and score them.

    If a log has a ground truth, they are scored against it, otherwise compared with one another. Several
    logs are scored together, too.
    """
    from icreckon.cli.replay import run_replay

    run_replay(
        paths=log,
        one_log=one_log,
        message_files=msg or [],
        robot_names=robot or [],
        variants=variants,
        fixes=fixes,
        smooth=smooth,
        engine=engine,
        formats=formats,
        out=out,
        as_json=json,
        wide=wide,
        overwrite=overwrite,
        workers=workers,
    )


@app.command()
def inspect(
    log: Logs,
    write: Annotated[Path | None, typer.Option(help="Write the proposed robot file here.")] = None,
    ros: Ros = None,
    msg: Definitions = None,
    _unpacked_limit: UnpackedLimit = 0.5,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
    wide: Wide = False,
    overwrite: Overwrite = False,
) -> None:
    """List what a log holds, and propose a robot file for it."""
    from icreckon.cli.inspect import run_inspect

    run_inspect(
        paths=log,
        message_files=msg or [],
        write=write,
        ros=ros,
        as_json=json,
        wide=wide,
        overwrite=overwrite,
    )


@app.command()
def robots() -> None:
    """List the robots that ship with icreckon, for --robot.

    Their files are in the folder that is printed, to begin a file of your own with.
    """
    from icreckon.cli.comparing import show_robots

    show_robots()


@app.command()
def check(
    log: Logs,
    robot: RobotName = None,
    ros: Ros = None,
    msg: Definitions = None,
    _unpacked_limit: UnpackedLimit = 0.5,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Check a robot file against a log: units, signs, mounting, latency.

    Says what contradicts the log, worst first, its cost, and what to set; exit status 1 if anything does.
    """
    from icreckon.cli.check import run_check

    run_check(
        paths=log,
        message_files=msg or [],
        robot_name=robot,
        ros=ros,
        as_json=json,
        overwrite=overwrite,
    )


@app.command()
def calibrate(
    log: Annotated[
        list[Path],
        typer.Argument(
            help="Logs of one robot with a truth, each by itself: a ROS 1 .bag, a ROS 2 folder, an .mcap "
            "or a .db3, a CSV or Parquet table. A folder of such files is one log.",
            metavar="LOG...",
            show_default=False,
        ),
    ],
    robot: RobotName = None,
    write: Annotated[
        Path | None, typer.Option(help="Write the robot file with what was found here.")
    ] = None,
    ros: Ros = None,
    lever_arm: Annotated[
        str | None,
        typer.Option(
            help="Point that the truth follows, forward and left of the robot's origin in metres, as "
            "0.3,0.0 (default: estimated if observable)."
        ),
    ] = None,
    models: Annotated[
        str | None,
        typer.Option(
            help="Models to compare, separated by commas (default: all): differential, constant, "
            "inertia."
        ),
    ] = None,
    segment: Annotated[
        float, typer.Option(help="Length of the segments that are predicted, in seconds.")
    ] = 3.0,
    msg: Definitions = None,
    _unpacked_limit: UnpackedLimit = 0.5,
    out: Out = None,
    json: Json = False,
    wide: Wide = False,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate a robot from logs with a ground truth.

    Reports which parameters the logs determine, and which model they support.
    """
    from icreckon.cli.calibrate import run_calibrate

    run_calibrate(
        paths=log,
        message_files=msg or [],
        robot_name=robot,
        write=write,
        ros=ros,
        lever_arm=lever_arm,
        models=models,
        segment=segment,
        out=out,
        as_json=json,
        wide=wide,
        overwrite=overwrite,
    )


@app.command()
def paper(
    out: Out = None,
    json: Json = False,
    wide: Wide = False,
    overwrite: Overwrite = False,
) -> None:
    """Reproduce the paper: its numbers, its Table II, its figures."""
    from icreckon.cli.paper import run_paper

    run_paper(out=out, as_json=json, wide=wide, overwrite=overwrite)


@app.command()
def prepare(workers: PrepareWorkers = None) -> None:
    """Compile all filters ahead, for an image or before a robot's first drive.

    What is compiled is kept for all later processes of this version, in $NUMBA_CACHE_DIR/icreckon or
    the user's cache folder.
    """
    from icreckon.cli.prepare import run_prepare

    run_prepare(workers=workers)


@app.command()
def study(
    study: Annotated[
        str | None,
        typer.Argument(help="Name of a study that ships with icreckon, or a TOML file."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for blocks and results (default: icreckon-study/ and the study's name). A study "
            "begun there is continued."
        ),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help="Runs of each cell (default: the study's).")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Threads or processes here (default: one for each core)."),
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option(help="Engine of the runs: auto, or one of docs/reference/study-file.md."),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(help="Address of a dask.distributed scheduler to run on, as tcp://host:8786."),
    ] = None,
    json: Json = False,
    wide: Wide = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace another study that is at --out.")
    ] = False,
    list_studies: Annotated[
        bool, typer.Option("--list", help="List the studies that ship with icreckon.")
    ] = False,
) -> None:
    """Simulate many runs over a sweep of parameters, and summarise them.

    The same command continues an interrupted study.
    """
    from icreckon.cli.study import run_study_command

    run_study_command(
        study=study,
        out=out,
        runs=runs,
        workers=workers,
        engine=engine,
        cluster=cluster,
        as_json=json,
        wide=wide,
        overwrite=overwrite,
        list_studies=list_studies,
    )


@app.command(
    "ros2-node",
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
)
def ros2_node(
    context: typer.Context,
    robot: Annotated[
        str | None,
        typer.Option(
            help="Name of a robot that ships with icreckon, or a TOML file whose [log] names the topics."
        ),
    ] = None,
    variant: Annotated[
        str | None, typer.Option(help="Filter variant (default: inertia-online).")
    ] = None,
) -> None:
    """Run as a ROS 2 node: odometry, tf and diagnostics, live.

    Other arguments go to ROS, as --ros-args -p publish_tf:=false; docs/reference/ros2-node.md lists the
    parameters.
    """
    from icreckon.ros2.node import run_node

    run_node(robot, variant, context.args)


def main() -> None:
    """Entry point; errors are one line and a non-zero exit, tracebacks by --debug."""
    debug = DEBUG in sys.argv
    sys.argv = [word for word in sys.argv if word != DEBUG]
    for stream in (sys.stdout, sys.stderr):
        # Of characters that the terminal lacks question marks are shown.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    with warned_in_one_line(), stopped_in_one_line():
        try:
            app()
        except Exception as problem:
            if debug or Stop.number:
                raise
            from icreckon.cli.console import explain

            sys.exit(explain(problem))
