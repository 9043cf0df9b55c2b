"""Ground under a vehicle, and its path on it, compiled: height field and patches.

The ground is z = h(x, y) in odom; `icreckon.simulation.truth.terrain.Terrain` describes its shape. With
its gradient (p_x, p_y) the normal is n = (-p_x, -p_y, 1) / sqrt(1 + p²). The vehicle's z axis is n. Its x
axis lies in the tangent plane above the heading yaw, e_x = (cos yaw, sin yaw, s) / sqrt(1 + s²), where s
and t are the slopes ahead and to the left:

    s = p_x cos yaw + p_y sin yaw,    t = p_y cos yaw - p_x sin yaw.

From grid point to grid point the vehicle turns about its normal by the integral of its yaw rate w, and
with the normal by the smallest rotation. So w is the rate about the vehicle's own z axis, which a gyro
reads, and not the rate of the heading.

A patch is a row: x from, x to, y from, y to [m], time from, to [s], width of its soft edge [m], length
of its soft beginning and end [s], coefficient of friction across and along [-], rolling resistance [-],
acceleration of gravity along the slope in x and y of odom [m/s²]. NaN leaves a property unchanged.

Import this module inside functions only: numba takes half a second to load.
"""

from typing import NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import WRONG_SIZE
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.tracing.jit_kernel import compiled
from icreckon.simulation.truth.terrain import Surface

Vector = tuple[float, float, float]
X, Y, TIME, EDGE, ONSET, ACROSS, ALONG, ROLLING, SLOPE = 0, 2, 4, 6, 7, 8, 9, 10, 11


class TrackGround(NamedTuple):
    """Ground under the middle of the left and of the right track."""

    friction: Floats  # (2, 2) coefficients of each track, across and along it [-]
    rolling: Floats  # (2,) rolling resistance of each track [-]


@compiled
def look_up(
    patches: Floats,
    time: float,
    pose: tuple[float, float, float],
    half_gauge: float,
    outside: TrackGround,
    under: TrackGround,
    slope: Floats,
) -> None:
    """Look up the ground under each track, and the acceleration by slopes.

    `patches` (k, PATCH_WIDTH): later ones lie on top of earlier ones. The time is since the start of the
    run [s], the pose x, y [m], yaw [rad] in odom, `half_gauge` L / 2 [m]. `outside` is the ground outside
    all patches. Results overwrite `under`, and `slope` (2,), which is taken at x, y [m/s²].
    """
    x, y, yaw = pose
    friction, rolling = under
    slope[:] = 0.0
    for track in range(2):
        rolling[track] = outside.rolling[track]
        for axis in range(2):
            friction[track, axis] = outside.friction[track, axis]
    for patch in patches:
        for track in range(2):
            to_right = half_gauge if track else -half_gauge
            share = _cover(patch, time, x + to_right * np.sin(yaw), y - to_right * np.cos(yaw))
            friction[track, 0] = _blend(friction[track, 0], patch[ACROSS], share)
            friction[track, 1] = _blend(friction[track, 1], patch[ALONG], share)
            rolling[track] = _blend(rolling[track], patch[ROLLING], share)
        share = _cover(patch, time, x, y)
        slope[0] = _blend(slope[0], patch[SLOPE], share)
        slope[1] = _blend(slope[1], patch[SLOPE + 1], share)


@compiled
def gradient(surface: Surface, x: float, y: float) -> tuple[float, float]:
    """Gradient (p_x, p_y) of the height at x, y [m]; u, v are the axes of `Surface`."""
    cos, sin = surface.direction
    u, v = cos * x + sin * y, cos * y - sin * x
    number, (u_phase, v_phase, _) = surface.wave_number, surface.phases
    by_u = surface.plane + surface.waves * np.cos(number * u + u_phase) + _kerb_slope(surface, u)
    by_v = surface.waves * np.cos(number * v + v_phase)
    return cos * by_u - sin * by_v, sin * by_u + cos * by_v


@compiled
def tilt(surface: Surface, patches: Floats, time: float, x: float, y: float) -> tuple[float, float]:
    """Gradient at x, y [m] in odom, where slopes of patches replace the surface's.

    Patches are (k, PATCH_WIDTH); the time [s] is since the start of the run.
    """
    p_x, p_y = gradient(surface, x, y)
    for patch in patches:
        along_x, along_y = patch[SLOPE], patch[SLOPE + 1]
        # NaN is no slope.
        share = 0.0 if np.isnan(along_x) else _cover(patch, time, x, y)
        if share > 0.0:
            normal_part = np.sqrt(GRAVITY * GRAVITY - along_x * along_x - along_y * along_y)
            p_x += share * (-along_x / normal_part - p_x)
            p_y += share * (-along_y / normal_part - p_y)
    return p_x, p_y


@compiled
def gravity_on(p_x: float, p_y: float, yaw: float) -> Vector:
    """Acceleration of gravity forward, left and up in base_link's axes [m/s²].

    The ground has the gradient p_x, p_y [-]; the vehicle heads to `yaw` [rad].
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, aside = p_x * cos + p_y * sin, p_y * cos - p_x * sin  # slopes forward and left [-]
    # Squared lengths of the vectors (1, 0, ahead) along x and (-ahead, -aside, 1) along z.
    x_square, z_square = 1.0 + ahead * ahead, 1.0 + ahead * ahead + aside * aside
    return (
        -GRAVITY * ahead / np.sqrt(x_square),
        -GRAVITY * aside / np.sqrt(x_square * z_square),
        -GRAVITY / np.sqrt(z_square),
    )


@compiled
def ride(
    surface: Surface, patches: Floats, time: tuple[float, float], pose: Vector, displacement: Vector
) -> tuple[float, float, float, float]:
    """Move a vehicle on the ground by a small displacement in its own axes.

    `patches` are (k, PATCH_WIDTH), `time` is from, and to, since the start of the run [s], `pose` x, y
    [m], heading [rad] before, `displacement` forward, left [m], turn about the normal [rad].

    Returns:
        x, y [m], heading [rad] after, not wrapped, and the height gained [m].
    """
    x, y, yaw = pose
    before, after = time
    p_x, p_y = tilt(surface, patches, before, x, y)
    normal = _normal(p_x, p_y)
    cos, sin = np.cos(yaw), np.sin(yaw)
    slope = p_x * cos + p_y * sin
    inverse_length = 1.0 / np.sqrt(1.0 + slope * slope)
    ahead = (cos * inverse_length, sin * inverse_length, slope * inverse_length)
    left = _cross(normal, ahead)
    forward, aside, turn = displacement
    step = _sum(forward, ahead, aside, left)
    step_x, step_y, step_z = step
    # The displacement is that of the mean attitude; the attitude after it needs the place after it.
    p_x, p_y = tilt(surface, patches, after, x + step_x, y + step_y)
    later_x, later_y, later_z = _carry(step, normal, _normal(p_x, p_y))
    x += 0.5 * (step_x + later_x)
    y += 0.5 * (step_y + later_y)
    p_x, p_y = tilt(surface, patches, after, x, y)
    facing = _sum(np.cos(turn), ahead, np.sin(turn), left)
    facing_x, facing_y, _ = _carry(facing, normal, _normal(p_x, p_y))
    turned = np.arctan2(cos * facing_y - sin * facing_x, cos * facing_x + sin * facing_y)
    return x, y, yaw + turned, 0.5 * (step_z + later_z)


@compiled
def ride_along(
    surface: Surface,
    patches: Floats,
    step: float,
    displacements: Floats,
    poses: Floats,
    gravity: Floats,
    heights: Floats,
) -> None:
    """Compute poses, gravity and heights on the ground from displacements, in place.

    Displacements (n - 1, 3) of each step [s] are as for `ride`, poses (n, 3) x, y [m], heading [rad], of
    which the first is given, gravity (n, 3) forward, left, up [m/s²], heights (n,) above the first [m].

    Raises:
        ValueError: an array has the wrong size.
    """
    n = len(poses)
    sizes_fit = displacements.shape == (n - 1, 3) and heights.shape == (n,)
    if not sizes_fit or poses.shape != (n, 3) or gravity.shape != (n, 3):
        raise ValueError(WRONG_SIZE)
    heights[0] = 0.0
    for row in range(n):
        x, y, yaw = poses[row, 0], poses[row, 1], poses[row, 2]
        p_x, p_y = tilt(surface, patches, row * step, x, y)
        gravity[row, 0], gravity[row, 1], gravity[row, 2] = gravity_on(p_x, p_y, yaw)
        if row + 1 < n:
            displacement = (displacements[row, 0], displacements[row, 1], displacements[row, 2])
            times = (row * step, (row + 1) * step)
            x, y, yaw, risen = ride(surface, patches, times, (x, y, yaw), displacement)
            poses[row + 1, 0], poses[row + 1, 1], poses[row + 1, 2] = x, y, yaw
            heights[row + 1] = heights[row] + risen


@compiled
def _kerb_slope(surface: Surface, u: float) -> float:
    """Slope of the kerbs at u [-]: cycloids, up and down in turn."""
    if surface.kerb_height == 0.0:
        return 0.0
    place = u / surface.kerb_every + surface.phases[2]
    number = np.floor(place)  # even kerbs go up, odd ones down
    share = min((place - number) * surface.kerb_every / surface.kerb_length, 1.0)
    slope = 1.0 - np.cos(2.0 * np.pi * share)
    if number % 2.0 == 1.0:
        slope = -slope
    return float(surface.kerb_height / surface.kerb_length * slope)


@compiled
def _normal(p_x: float, p_y: float) -> Vector:
    """Unit normal of the ground with a gradient."""
    inverse_length = 1.0 / np.sqrt(1.0 + p_x * p_x + p_y * p_y)
    return -p_x * inverse_length, -p_y * inverse_length, inverse_length


@compiled
def _carry(vector: Vector, normal: Vector, other_normal: Vector) -> Vector:
    """Turn a vector in a tangent plane by the smallest rotation between two normals."""
    share = -_dot(other_normal, vector) / (1.0 + _dot(normal, other_normal))
    (x, y, z), (n_x, n_y, n_z), (other_x, other_y, other_z) = vector, normal, other_normal
    return x + share * (n_x + other_x), y + share * (n_y + other_y), z + share * (n_z + other_z)


@compiled
def _sum(a: float, first: Vector, b: float, other: Vector) -> Vector:
    """Sum of two vectors, multiplied by a and b."""
    (x, y, z), (other_x, other_y, other_z) = first, other
    return a * x + b * other_x, a * y + b * other_y, a * z + b * other_z


@compiled
def _dot(first: Vector, other: Vector) -> float:
    (x, y, z), (other_x, other_y, other_z) = first, other
    return x * other_x + y * other_y + z * other_z


@compiled
def _cross(first: Vector, other: Vector) -> Vector:
    (x, y, z), (other_x, other_y, other_z) = first, other
    return y * other_z - z * other_y, z * other_x - x * other_z, x * other_y - y * other_x


@compiled
def _cover(patch: Floats, time: float, x: float, y: float) -> float:
    """Weight of a patch at a position and time, from 0 to 1 across its soft edges."""
    return (
        _inside(x, patch[X], patch[X + 1], patch[EDGE])
        * _inside(y, patch[Y], patch[Y + 1], patch[EDGE])
        * _inside(time, patch[TIME], patch[TIME + 1], patch[ONSET])
    )


@compiled
def _inside(value: float, low: float, high: float, soft: float) -> float:
    """Weight 1 within [low, high], 0 outside; `soft` is the width of each edge."""
    inner = min(value - low, high - value)
    if soft <= 0.0:
        return 1.0 if inner >= 0.0 else 0.0
    share = min(max(inner / soft + 0.5, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


@compiled
def _blend(value: float, patch: float, share: float) -> float:
    """Mix a value with a patch's value by the patch's weight; NaN keeps the value."""
    return value if np.isnan(patch) else value + share * (patch - value)
