"""Animation of README: a robot whose ICRs shift as it takes bends faster.

Auriga-alpha is simulated on level ground, with friction as its truth. It drives bends to the left and to
the right. In the first bends there are fixes, from which the filters learn; what is shown comes after,
without any. Wheel odometry begins there at the true pose, with the constant ICRs that `constant-online`
has learnt by then. With seeds 1 to 3 it ends 1.54, 4.95 and 0.20 m off; `inertia-online` 0.19, 0.20
and 0.09 m.

    python benchmarks/animation.py docs/icrs.gif
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from _study import script_parser
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrow, Polygon, Rectangle
from PIL import Image

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.motion.icr import IndexValues, PaperTwist, direct, icrs_from_twist
from icreckon.estimator.robot.robot_file import Robot, load_robot
from icreckon.replay.comparison.compare import compare
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.simulate import simulate

ROBOT, VARIANT, CONSTANT = "auriga-alpha", "inertia-online", "constant-online"
# Bends with fixes, and those that are shown: speed of the outer track; share of the inner one.
LEARNT, SHOWN, INNER = (
    (0.5, 0.7, 0.9, 0.6, 0.8, 1.0, 0.6, 0.9),
    (0.35, 0.35, 0.65, 0.65, 0.98, 0.98, 0.98),
    0.3,
)
# Angle of a bend by the indices of the robot file [rad]; times of a change of speed, and at rest [s].
ANGLE, BLEND, STANDSTILL = 2.3, 1.0, 3.0
# Slowest turn that has an ICR in reach [rad/s].
LEAST_TURN = 0.05
FRAMES_PER_SECOND, FASTER = 12.5, 4.0
WIDTH, HEIGHT, DPI = 8.2, 4.4, 100
# Time for which the last frame is shown, which says it all [s].
LAST_SHOWN = 4.0
# Frames of the trace behind an ICR.
TRACE = 25
COLOURS = 64
TRUTH, OURS, WHEELS = "#009E73", "#0072B2", "#D55E00"
ICR = "#882255"


class Drive(NamedTuple):
    """Times (n,) [s], poses (n, 3), true ICRs (n, 3) and motion (n, 4) at the frames."""

    times: Any
    true: Any
    ours: Any
    wheels: Any
    icrs: Any
    tracks: Any
    twists: Any


def main() -> None:
    """Simulate, estimate, draw and write the animation."""
    parser = script_parser(__doc__)
    parser.add_argument("out", type=Path, help="GIF to write")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    robot = load_robot(ROBOT)
    drive = driven(robot, arguments.seed)
    frames = [picture(robot, drive, row) for row in range(len(drive.times))]
    palette = frames[-1].quantize(COLOURS)
    shown = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    shown += [shown[-1]] * round(LAST_SHOWN * FRAMES_PER_SECOND)
    period = round(1000.0 / FRAMES_PER_SECOND)
    shown[0].save(
        arguments.out,
        save_all=True,
        append_images=shown[1:],
        duration=period,
        loop=0,
        optimize=True,
    )
    ends = {
        name: np.hypot(*(poses[-1] - drive.true[-1])[:2])
        for name, poses in (("constant ICRs", drive.wheels), (VARIANT, drive.ours))
    }
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1e6:.2f} MB, {len(shown)} frames")
    for name, error in ends.items():
        print(f"position error of {name} at the end: {error:.2f} m")


def driven(robot: Robot, seed: int) -> Drive:
    """Simulate the drive, and estimate it from track speeds and IMU."""
    corners, begin = _bends(robot)
    end = corners[-1][0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "speeds.csv"
        rows = (",".join(f"{value:.5f}" for value in row) for row in corners)
        path.write_text("t,left,right\n" + "\n".join(rows), encoding="utf-8")
        scenario = Scenario(
            trajectory="recorded",
            trajectory_file=str(path),
            duration=end,
            seed=seed,
            outages=((begin, end),),
        )
        log = simulate(scenario, robot)
    runs = compare(log, robot, [CONSTANT, VARIANT]).runs
    run, truth = runs[VARIANT], log.truth
    frames = np.arange(begin, end, FASTER / FRAMES_PER_SECOND)

    def at(stamps: Any, values: Any, times: Any = frames) -> Any:
        known = (stamps - log.start) * NANOSECOND
        return np.column_stack([np.interp(times, known, one) for one in values.T])

    v_x, v_y, w = truth.twists.twists.T
    slow = np.abs(w) < LEAST_TURN
    speeds = at(
        truth.tracks.stamps, truth.tracks.speeds, (truth.twists.stamps - log.start) * NANOSECOND
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        icrs = np.column_stack(icrs_from_twist(*speeds.T, PaperTwist(-v_y, v_x, w)))
    icrs[slow] = np.nan
    constant, first = runs[CONSTANT], log.start + round(begin / NANOSECOND)
    known = constant.indices[np.searchsorted(constant.stamps, first)]
    start = at(truth.poses.stamps, truth.poses.poses, np.array([begin]))[0]
    wheels = _odometry(robot, log.tracks, known, start, first)
    return Drive(
        frames,
        at(truth.poses.stamps, truth.poses.poses),
        at(run.stamps, run.trajectory.poses),
        at(*wheels),
        at(truth.twists.stamps, icrs),
        at(truth.tracks.stamps, truth.tracks.speeds),
        at(truth.twists.stamps, truth.twists.twists),
    )


def _bends(robot: Robot) -> tuple[list[tuple[float, float, float]], float]:
    """Times and track speeds between which the robot ramps, and when those shown begin."""
    corners, now, side, begin = [(0.0, 0.0, 0.0), (STANDSTILL, 0.0, 0.0)], STANDSTILL, 0, 0.0
    width = robot.vehicle.track_gauge * robot.indices.eta0
    for number, outer in enumerate((*LEARNT, *SHOWN)):
        if number == len(LEARNT):
            begin = now
        speeds = (INNER * outer, outer) if side == 0 else (outer, INNER * outer)
        length = ANGLE * width / ((1.0 - INNER) * outer)
        corners += [(now + BLEND, *speeds), (now + BLEND + length, *speeds)]
        now, side = now + BLEND + length, 1 - side
    return corners, begin


def _odometry(robot: Robot, tracks: Any, indices: Any, start: Any, begin: int) -> tuple[Any, Any]:
    """Integrate the measured track speeds with constant indices from a pose on."""
    later = tracks.stamps >= begin
    stamps, speeds = tracks.stamps[later], tracks.speeds[later]
    twist = direct(*speeds.T, IndexValues(*indices), robot.vehicle.track_gauge)
    steps = np.diff(stamps) * NANOSECOND
    v_x, v_y, w = twist.v_y[:-1], -twist.v_x[:-1], twist.w[:-1]
    yaw = start[2] + np.concatenate([[0.0], np.cumsum(w * steps)])
    middle = yaw[:-1] + 0.5 * w * steps
    x = start[0] + np.append(0.0, np.cumsum((v_x * np.cos(middle) - v_y * np.sin(middle)) * steps))
    y = start[1] + np.append(0.0, np.cumsum((v_x * np.sin(middle) + v_y * np.cos(middle)) * steps))
    return stamps, np.column_stack([x, y, yaw])


def picture(robot: Robot, drive: Drive, row: int) -> Image.Image:
    """Draw one frame: the map above, the robot and the errors below."""
    with mpl.rc_context({"font.size": 10}):
        figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI)
        axes = figure.add_axes((0.06, 0.56, 0.92, 0.42))
        paths = (
            (drive.true, TRUTH, "truth"),
            (drive.wheels, WHEELS, "wheel odometry, constant ICRs"),
            (drive.ours, OURS, f"icreckon, {VARIANT}"),
        )
        turned = [(_along(drive, poses), colour) for poses, colour, _ in paths]
        for place, (way, colour) in enumerate(turned):
            look = {"lw": 2.0} if place else {"lw": 6.0, "alpha": 0.45}
            axes.plot(*way[: row + 1].T, color=colour, **look)
            axes.plot(
                *way[row], "o", color=colour, ms=7 if place else 12, alpha=look.get("alpha", 1.0)
            )
        every = np.concatenate([way for way, _ in turned])
        low, high = every.min(axis=0) - 0.4, every.max(axis=0) + 0.4
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal", adjustable="box")
        axes.grid(alpha=0.3)
        axes.set_xlabel("x [m]", labelpad=1)
        axes.set_ylabel("y [m]", labelpad=1)
        _above(figure.add_axes((0.0, 0.0, 0.56, 0.5)), robot, drive, row)
        side = figure.add_axes((0.57, 0.0, 0.43, 0.5))
        side.axis("off")
        side.text(0.0, 0.86, "The ICRs shift with the force in a bend", weight="bold")
        v_x, _, w = drive.twists[row]
        side.text(0.0, 0.72, f"speed {v_x:.2f} m/s, lateral acceleration {v_x * w:+.2f} m/s²")
        steps = np.diff(drive.true[: row + 1, :2], axis=0)
        driven_so_far = float(np.hypot(*steps.T).sum())
        side.text(0.0, 0.5, f"off the truth (broad) after {driven_so_far:.0f} m without fixes:")
        for place, (poses, colour, label) in enumerate(paths[1:]):
            off = np.hypot(*(poses[row] - drive.true[row])[:2])
            side.text(
                0.0, 0.36 - 0.14 * place, f"{off:.2f} m  {label}", color=colour, weight="bold"
            )
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        size = canvas.get_width_height()
        return Image.frombuffer("RGBA", size, canvas.buffer_rgba()).convert("RGB")


def _along(drive: Drive, poses: Any) -> Any:
    """Positions (n, 2) from where the drive begins, x towards its end."""
    way = poses[:, :2] - drive.true[0, :2]
    x, y = drive.true[-1, :2] - drive.true[0, :2]
    length = np.hypot(x, y)
    return way @ np.array([[x, -y], [y, x]]) / length


def _above(axes: Any, robot: Robot, drive: Drive, row: int) -> None:
    """Draw the robot from above, forward up, with the true ICRs of its tracks."""
    half, length = 0.5 * robot.vehicle.track_gauge, 2.0 * robot.vehicle.half_contact_length
    axes.set_xlim(-1.1, 1.1)
    axes.set_ylim(-0.55, 0.6)
    axes.set_aspect("equal")
    axes.axis("off")
    hull = (-half, -0.45 * length), 2 * half, 0.9 * length
    axes.add_patch(Rectangle(*hull, fc="#eeeeee", ec="#888888"))
    axes.add_patch(Polygon([(-0.07, 0.2), (0.07, 0.2), (0.0, 0.32)], color=OURS))
    for side, speed in zip((-1, 1), drive.tracks[row], strict=True):
        track = (side * half - 0.06, -0.5 * length), 0.12, length
        axes.add_patch(Rectangle(*track, fc="#4a4f55", ec="white"))
        if speed > 0.02:
            arrow = FancyArrow(
                side * half, 0.0, 0.0, 0.36 * speed, width=0.025, color="white", lw=0
            )
            axes.add_patch(arrow)
    forward, trace = drive.icrs[:, 2], slice(max(0, row - TRACE), row + 1)
    for place, name in ((0, "ICR left"), (1, "ICR right")):
        way = drive.icrs[:, place]
        axes.plot(way[trace], forward[trace], "-", color=ICR, alpha=0.35, lw=4)
        if np.isfinite(way[row]):
            at = way[row], forward[row]
            axes.plot(*at, "o", color=ICR, ms=11, mec="white")
            words = f"{name}\n{abs(way[row]):.2f} m"
            where = (at[0], at[1] - 0.12)
            axes.text(*where, words, color=ICR, ha="center", va="top", weight="bold")


if __name__ == "__main__":
    main()
