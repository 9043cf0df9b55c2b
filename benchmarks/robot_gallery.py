"""Pictures of the shipped robots from above, with the ICRs of their robot files.

Each picture has the tracks or wheels to scale, the centre of mass, the IMU, and the ICRs of both sides:
at rest, and in steady bends to both sides up to a lateral acceleration of 1 m/s². A hash of what is
drawn stands in each file; `--check` names the pictures that are not of today's robot files.

    python benchmarks/robot_gallery.py docs/reference/robots
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from PIL import Image

from icreckon.estimator.motion.icr import icrs_from_indices, indices_at_inertia
from icreckon.estimator.robot.robot_file import Robot, load_robot, robot_names

# Largest lateral acceleration of the bends [m/s²], and their number to each side.
FASTEST, BENDS = 1.0, 40
WIDTH, HEIGHT, DPI = 5.6, 3.8, 110
# Width of the axes over their height.
SHAPE = 1.8
LEFT, RIGHT, STILL = "#0072B2", "#D55E00", "#222222"
MASS, IMU = "#CC79A7", "#009E73"
HASH = "robot"


def main() -> None:
    """Draw all shipped robots, or check the pictures that are there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, help="folder of the pictures, NAME.png")
    parser.add_argument(
        "--check", action="store_true", help="draw nothing; exit with 1 if one is old"
    )
    arguments = parser.parse_args()
    old = old_pictures(arguments.folder)
    if arguments.check:
        print(f"to be drawn anew: {', '.join(old) or 'none'}")
        raise SystemExit(1 if old else 0)
    for name in old:
        path = arguments.folder / f"{name}.png"
        arguments.folder.mkdir(parents=True, exist_ok=True)
        write_picture(path, load_robot(name))
        print(f"{path}: {path.stat().st_size / 1000.0:.0f} kB")


def old_pictures(folder: Path) -> list[str]:
    """Names of the shipped robots whose picture is missing or of another robot file."""
    return [
        name for name in robot_names() if _drawn(folder / f"{name}.png") != _hash(load_robot(name))
    ]


def write_picture(path: Path, robot: Robot) -> None:
    """Draw a robot and write it as PNG."""
    with mpl.rc_context({"font.size": 9.0}):
        figure = Figure(figsize=(WIDTH, HEIGHT), dpi=DPI, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure.add_subplot(), robot)
        figure.savefig(path, metadata={HASH: _hash(robot), "Software": None})


def draw(axes: Any, robot: Robot) -> None:
    """Draw a robot in base_link: x forward is up, y left is left."""
    vehicle, eta0 = robot.vehicle, robot.indices.eta0
    high, edge = _body(axes, robot)
    shown = eta0 > 1.0
    if shown:
        still, bends = icrs_at(robot, np.zeros(1)), np.linspace(0.0, FASTEST, BENDS)
        moving = {sign: icrs_at(robot, sign * bends) for sign in (1.0, -1.0)}
        moves = np.ptp(moving[1.0] - still, axis=1).max() > 0.005
        if moves:
            for sign, colour, side in ((1.0, LEFT, "left"), (-1.0, RIGHT, "right")):
                for place, way in enumerate(_ways(moving[sign])):
                    label = f"in bends to the {side}, up to {FASTEST:g} m/s²"
                    axes.plot(*way, color=colour, lw=2.5, label=None if place else label)
                    axes.plot(*way[:, -1], "o", color=colour, ms=5)
        for place, way in enumerate(_ways(still)):
            label = "ICR at slow turning" if moves else "ICR, constant"
            axes.plot(*way, "o", color=STILL, ms=7, mec="white", label=None if place else label)
        reached = np.concatenate([still, *(moving.values() if moves else ())], axis=1)
        edge = max(edge, float(np.abs(reached[:2]).max()))
    at = robot.imu.position
    axes.plot(-at[1], at[0], "s", color=IMU, ms=6, mec="white", label="IMU")
    at = vehicle.centre_of_mass
    axes.plot(-at[1], at[0], "P", color=MASS, ms=9, mec="white", label="centre of mass")
    title = f"{robot.name}: gauge {vehicle.track_gauge:.3g} m"
    title += (
        f", effective track {eta0 * vehicle.track_gauge:.3g} m" if shown else ", ICRs not known"
    )
    axes.figure.suptitle(title, fontsize=10)
    axes.set_aspect("equal")
    size = max(1.2 * edge, 1.2 * high * SHAPE)
    axes.set_xlim(-size, size)
    axes.set_ylim(-size / SHAPE, size / SHAPE)
    axes.set_xlabel("← left   y [m]   right →")
    axes.set_ylabel("x [m], forward")
    axes.xaxis.set_major_formatter(lambda value, _: f"{0.0 - value:g}")
    axes.grid(alpha=0.25)
    axes.figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)


def icrs_at(robot: Robot, lateral: Any) -> Any:
    """ICRs in steady bends on level ground, equations (25) to (30).

    Args:
        robot: the robot.
        lateral: (n,) lateral accelerations v w [m/s²], positive in bends to the left.

    Returns:
        (3, n): how far left and right ICR lie to the right, and how far both lie forward [m].
    """
    plain, gauge = robot.indices, robot.vehicle.track_gauge
    force = -robot.vehicle.mass * lateral
    # Forward driving: x_2 is positive, and x_1 has the sign of the force.
    indices = indices_at_inertia(np.abs(force), force, 1.0, plain.as_array())
    return np.array(icrs_from_indices(indices, gauge))


def _ways(icrs: Any) -> tuple[Any, Any]:
    """Ways (2, n) of the left and the right ICR in the picture."""
    return icrs[[0, 2]], icrs[[1, 2]]


def _body(axes: Any, robot: Robot) -> tuple[float, float]:
    """Draw hull and tracks, or wheels, and return their half length and half width [m]."""
    vehicle = robot.vehicle
    half, reach = 0.5 * vehicle.track_gauge, vehicle.half_contact_length
    broad = 0.22 * vehicle.track_gauge
    axes.add_patch(
        Rectangle((-half, -reach), 2.0 * half, 2.0 * reach, fc="#f0f0f0", ec="#b0b0b0", zorder=0)
    )
    on_wheels, radius = vehicle.contact_points == 2, max(vehicle.sprocket_radius, 0.3 * reach)
    for side in (-half, half):
        spans = [(-reach, 2.0 * reach)]
        if on_wheels:
            spans = [(place - 0.8 * radius, 1.6 * radius) for place in (-reach, reach)]
        for begin, length in spans:
            shape = Rectangle((side - 0.5 * broad, begin), broad, length, fc="#8a9096", ec="white")
            axes.add_patch(shape)
    axes.add_patch(Circle((0.0, 0.0), 0.02 * reach, color="#b0b0b0"))
    high = reach + 0.8 * radius if on_wheels else reach
    axes.annotate("", (0.0, 0.8 * reach), (0.0, 0.35 * reach), arrowprops={"arrowstyle": "-|>"})
    return high, half + 0.5 * broad


def _drawn(path: Path) -> str:
    """Hash in a picture, empty if there is none."""
    if not path.exists():
        return ""
    with Image.open(path) as picture:
        return str(picture.info.get(HASH, ""))


def _hash(robot: Robot) -> str:
    """Hash of all that is drawn."""
    drawn = (robot.name, robot.vehicle, robot.indices, robot.constant_icr, robot.imu.position)
    return hashlib.sha256(msgspec.json.encode(drawn)).hexdigest()[:16]


if __name__ == "__main__":
    main()
