"""Data of the drive on a comparison's page: robot, ICRs, coloured path.

`drive.js` draws it. Columns are those of the page's data; `colourings` are choices of what colours the
path, each with one column for each variant that has it.
"""

import math
from typing import Any

import numpy as np

from icreckon.replay.comparison.plot_series import rounded
from icreckon.replay.comparison.results import Results

LEAST_SPEED = 0.1  # least speed at which a slip angle is computed [m/s]
WHEELS = 2  # number of contact points on a side that are wheels; more of them are a track
LARGEST_WHEEL = 0.9  # largest diameter of a drawn wheel, over the wheelbase [-]
# Columns of a variant's motion, by their names in the script.
MOTION = {
    "x": "x_m",
    "y": "y_m",
    "yaw": "yaw_rad",
    "v_x": "v_x_m_s",
    "v_y": "v_y_m_s",
    "w": "w_rad_s",
    "icr_x": "icr_x_m",
    "left_y": "left_icr_y_m",
    "right_y": "right_icr_y_m",
}
Numbers = list[float | None]


def drive_data(results: Results, columns: dict[str, Numbers]) -> Results:
    """Input of `drive.js`; adds the columns that it needs to `columns`."""
    series, vehicle = results["series"], results["robot"]["vehicle"]
    length = 2.0 * vehicle["half_contact_length"]
    # Centre and length [m] of what a side runs on: one track, or two wheels.
    contacts = [[0.0, length]]
    if has_wheels(vehicle):
        diameter = min(2.0 * vehicle["sprocket_radius"], LARGEST_WHEEL * length)
        contacts = [[0.5 * length, diameter], [-0.5 * length, diameter]]
    verdict, names = results["verdict"], list(results["variants"])
    # The variant that is animated first is the best one if its ICRs move.
    first = "inertia-online" if "inertia-online" in names else str(names[-1])
    if verdict and verdict["best"].startswith("inertia"):
        first = str(verdict["best"])
    by_tracks, ellipses = floats(columns["inputs/tracks_rad_s"]), {}
    for name, motion in series["variants"].items():
        ellipses[name] = motion.get("ellipses", [])
        v_x, v_y, w = (floats(motion[key]) for key in ("v_x_m_s", "v_y_m_s", "w_rad_s"))
        columns[f"{name}/lost_rad_s"] = rounded((by_tracks - w) * np.sign(by_tracks))
        # Angle from the robot's axis to its travel, to the left.
        angles = np.degrees(np.arctan2(v_y, np.abs(v_x)))
        is_moving = np.hypot(v_x, v_y) >= LEAST_SPEED
        columns[f"{name}/slip_angle_deg"] = rounded(np.where(is_moving, angles, math.nan))
    return {
        "gauge": vehicle["track_gauge"],
        "length": max(2.0 * centre + extent for centre, extent in contacts),
        "base": length,
        "contacts": contacts,
        "variants": {
            name: {key: f"{name}/{column}" for key, column in MOTION.items()}
            for name in series["variants"]
        },
        "ellipses": ellipses,
        "first": first,
        "truth": "truth" in series,
        "fixes": bool(series.get("fixes", {}).get("x_m")),
        "gyro": "gyro_rad_s" in series["inputs"],
        "colourings": _colourings(results, columns),
    }


def has_wheels(vehicle: Results) -> bool:
    """True for a robot on two wheels a side."""
    return bool(vehicle["contact_points"] == WHEELS)


def _colourings(results: Results, columns: dict[str, Numbers]) -> list[Results]:
    """Choices of what colours the path, and columns of the variants with values."""
    choices = []
    lost = "yaw rate by the tracks less the estimated one, in the direction of the turn"
    nis = "mean NIS of all sensors per degree of freedom, ideal 1"
    for title, meaning, key, unit, is_signed in (
        ("slip in turning", lost, "lost_rad_s", "rad/s", True),
        ("slip angle", "angle from heading to travel, to the left", "slip_angle_deg", "deg", True),
        ("position error", "distance from the truth", "position_error_m", "m", False),
        ("NIS", nis, "nis_per_dof", "-", False),
        ("speed", "forward speed", "v_x_m_s", "m/s", True),
    ):
        names = results["series"]["variants"]
        drawn = {name: f"{name}/{key}" for name in names if known(columns.get(f"{name}/{key}", []))}
        if drawn:
            words = {"title": title, "meaning": meaning, "unit": unit}
            choices.append(words | {"signed": is_signed, "columns": drawn})
    return choices


def known(values: Numbers) -> bool:
    """Return True if any value is known."""
    return any(value is not None for value in values)


def floats(values: Numbers | list[Numbers]) -> Any:
    """Array of numbers, NaN for None."""
    return np.array(values, dtype=float)
