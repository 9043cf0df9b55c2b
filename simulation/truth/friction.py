"""Friction truth: a planar rigid body on two tracks, integrated in time.

The tracks follow their commands with a first-order lag. Friction and rolling resistance at the contact
points (`icreckon.simulation.contact.contact`) move the body, with the robot's inertia and the scenario's
terrain and payload. At constant track speeds it ends in the stationary motion that
`icreckon.simulation.contact.steady_state` computes.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np
from msgspec import structs
from numpy.random import Generator
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.first_order import first_order
from icreckon.estimator.base.frames import paper_to_rep103, rotate
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.robot.robot_file import LOAD_LAG, Robot
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.contact.contact import Body, Contact, ground
from icreckon.simulation.contact.of_robot import contact_of
from icreckon.simulation.drives.trajectories import Command
from icreckon.simulation.truth.terrain import (
    LEVEL,
    Patch,
    Payload,
    Surface,
    Terrain,
    draw_surface,
    loaded,
    patch_rows,
)
from icreckon.simulation.truth.true_motion import (
    DEFAULT_SPREAD,
    TRUE_SLIP,
    TrueMotion,
    displacements,
    grid_times,
    slip_residual,
    true_motion,
)

TRACK_LAG = 0.1  # first-order lag of a track behind its command [s]
TOLERANCE = 1e-5  # error allowed per step
# Scales of the absolute tolerance: velocities [m/s, rad/s], loads as a share of the weight, yaw [rad].
SMALL_VELOCITY = 0.1
SMALL_LOAD = 0.1
SMALL_YAW = 0.1
# Shares of the spread of the true robot about its file: of the contact's length, of the height of the
# centre of mass, and of its place, as a share of half the length and half the gauge.
LENGTH_SHARE = 0.2
HEIGHT_SHARE = 0.4
CENTRE_SHARE = 0.2


class Drive(NamedTuple):
    """Integrated motion at grid points."""

    twists: Floats  # (n, 3) v_x, v_y [m/s], w [rad/s] of the origin in the paper's axes
    # (n, 2) force at the centre of mass that transfers load, right and forward [N]
    transfer: Floats
    # (n, 2) acceleration of gravity along the slope in x and y of odom [m/s²]; on terrain, in axes that
    # turn with the ground's normal, but not by the yaw rate
    slopes: Floats
    # (n,) True if the force points outside the contact; not set at the end
    tipping: NDArray[np.bool_]


@dataclass(frozen=True)
class FrictionTruth:
    """Transient dynamics of a robot that differs from its file."""

    name: ClassVar[str] = "friction"
    # standard deviation of the logarithm of the factors on friction and rolling resistance; times
    # `LENGTH_SHARE` for the contact's length, `HEIGHT_SHARE` and `CENTRE_SHARE` for the centre of mass
    spread: float = DEFAULT_SPREAD
    track_lag: float = TRACK_LAG  # time constant of the tracks behind their commands [s]
    slip_noise: float = 0.0  # factor on the slip residual `true_motion.TRUE_SLIP` [-]
    terrain: Terrain | None = None  # shape of the ground; None for level ground
    patches: tuple[Patch, ...] = ()  # ground that differs along the path
    payloads: tuple[Payload, ...] = ()  # loads along the path

    def run(
        self, command: Command, duration: float, robot: Robot, rng: Generator, *, rate: float
    ) -> TrueMotion:
        """Simulate the motion over a duration [s], with grid points at a rate [Hz].

        `rng` draws the differences from the robot file, and slip.

        Raises:
            SimulationError: the vehicle cannot stand on its contact (with its payload), tips over,
                or the integration fails.
        """
        true_contact = draw_contact(robot, self.spread, rng)
        step = 1.0 / rate
        speeds, rates = follow(command(grid_times(duration, rate)), step, self.track_lag)
        effective_gauge = robot.vehicle.track_gauge * robot.indices.eta0
        surface = LEVEL
        if self.terrain is not None:
            # A separate stream, so that all other draws are the same as on level ground.
            (phases,) = rng.spawn(1)
            surface = draw_surface(self.terrain, 2.0 * robot.vehicle.half_contact_length, phases)
        slip = self.slip_noise * slip_residual(speeds, TRUE_SLIP, effective_gauge, step, rng)
        driven = drive(
            true_contact,
            robot.yaw_inertia,
            speeds,
            rates,
            step,
            surface=surface,
            patches=self.patches,
            payloads=self.payloads,
            load_lag=robot.vehicle.load_lag,
            slip=slip,
        )
        if driven.tipping.any():
            raise SimulationError(
                f"the vehicle tips over {driven.tipping.argmax() * step:.2f} s after the start, which "
                "this truth cannot follow: lower the slope, the speed, or the centre of mass"
            )
        v_x, v_y = paper_to_rep103(driven.twists[:, 0], driven.twists[:, 1])
        twists = np.stack([v_x, v_y, driven.twists[:, 2]], axis=-1) + slip
        motion = true_motion(rate, twists, speeds, self.name)
        if surface.present:
            return on_surface(motion, surface, self.patches)
        if not driven.slopes.any():
            return motion
        return replace(motion, gravity=gravity_in_body(driven.slopes, motion.poses[:, 2]))


def drive(
    contact: Contact,
    yaw_inertia: float,
    speeds: Floats,
    speed_rates: Floats,
    step: float,
    *,
    surface: Surface = LEVEL,
    patches: tuple[Patch, ...] = (),
    payloads: tuple[Payload, ...] = (),
    load_lag: float = LOAD_LAG,
    tolerance: float = TOLERANCE,
    start: tuple[float, ...] | None = None,
    slip: Floats | None = None,
) -> Drive:
    """Integrate the motion of a vehicle from its track speeds.

    Speeds (n, 2) left, right [m/s], cubic in between, and their derivatives [m/s²] are at grid points
    of an even step [s], at which the ground is looked up and payloads change. The yaw inertia is about
    the vertical through the centre of mass [kg m²], the load lag the time constant of the load transfer
    [s], the tolerance the relative error per step, the start (6,) a state as in
    `icreckon.simulation.truth.friction_ode`, by default at rest. A slip residual (n, 3) of v_x, v_y
    [m/s], w [rad/s] in base_link's axes moves the vehicle on a surface, but is no part of the result.

    Raises:
        SimulationError: the loaded vehicle cannot stand, or the integration fails.
    """
    from icreckon.simulation.truth import friction_ode as ode

    count = len(speeds)
    states, slopes = np.zeros((count, 6)), np.zeros((count, 2))
    tipping = np.zeros(count, dtype=bool)
    residual = np.zeros((count, 3)) if slip is None else np.ascontiguousarray(slip)
    pose = np.zeros(3)
    if start is not None:
        states[0] = start
        pose[2] = start[5]
    rows = patch_rows(patches)
    for first, last in _spans(payloads, count, step):
        # Payloads change at grid points: half a step later it is certain which are carried.
        middle = (first + 0.5) * step
        carried = [load for load in payloads if load.time[0] < middle < load.time[1]]
        loaded_contact, inertia = _loaded_contact(contact, yaw_inertia, carried)
        body = loaded_contact.body
        inverse_mass = np.asarray(np.linalg.inv(mass_matrix(body, inertia)), float)
        vehicle = ode.Vehicle(ground(loaded_contact), inverse_mass, load_lag)
        span = slice(first, last + 1)
        grid = (np.ascontiguousarray(values[span]) for values in (speeds, speed_rates))
        tracks = ode.DrivenTracks(first * step, step, *grid)
        motion = ode.GridMotion(pose, states[span], slopes[span], tipping[span], residual[span])
        scales = np.array([SMALL_VELOCITY] * 3 + [SMALL_LOAD * body.weight] * 2 + [SMALL_YAW])
        reached = ode.integrate(vehicle, surface, rows, tracks, tolerance, scales, motion)
        if first + reached < last:
            raise SimulationError(
                f"the motion cannot be integrated beyond {(first + reached) * step:.3f} s: "
                "the integration step became too small"
            )
    return Drive(states[:, :3], states[:, 3:5], slopes, tipping)


def _loaded_contact(
    contact: Contact, yaw_inertia: float, payloads: list[Payload]
) -> tuple[Contact, float]:
    """Contact and yaw inertia [kg m²] with payloads; an error if it cannot stand."""
    body, inertia = loaded(contact.body, yaw_inertia, payloads)
    try:
        return Contact(contact.soil, contact.geometry, body), inertia
    except ValueError as error:
        raise SimulationError(
            f"the vehicle cannot stand with its payload: the centre of mass, {body.y_CM:.3f} m "
            f"forward and {-body.x_CM:.3f} m left, lies outside the contact"
        ) from error


def mass_matrix(body: Body, yaw_inertia: float) -> Floats:
    """Mass matrix (3, 3) about the origin, for the twist v_x, v_y, w.

    `yaw_inertia` is about the vertical through the centre of mass [kg m²].
    """
    mass, x, y = body.mass, body.x_CM, body.y_CM
    about_origin = yaw_inertia + mass * (x * x + y * y)
    return np.array(
        [[mass, 0.0, -mass * y], [0.0, mass, mass * x], [-mass * y, mass * x, about_origin]]
    )


def follow(commands: Floats, step: float, time_constant: float) -> tuple[Floats, Floats]:
    """Track speeds (n, 2) [m/s] with a first-order lag behind commands, and rates.

    Commands (n, 2) [m/s] have an even step [s] and are linear in between; a lag of 0 is none.
    """
    if time_constant <= 0.0:
        return commands, np.gradient(commands, step, axis=0)
    decay = math.exp(-step / time_constant)
    share = (1.0 - decay) * time_constant / step
    newer_weight, older_weight = 1.0 - share, share - decay
    # The filter begins in the steady state of the first command.
    driving = newer_weight * commands[1:] + older_weight * commands[:-1]
    speeds = first_order(np.concatenate([commands[:1], driving]), decay)
    return speeds, (commands - speeds) / time_constant


def draw_contact(robot: Robot, spread: float, rng: Generator) -> Contact:
    """Draw the true contact of a robot: its file's contact with random changes.

    `spread` is that of `FrictionTruth`.
    """
    contact = contact_of(robot)
    # The last number is not used; without it, later draws of a seed would change.
    friction, rolling, height, length, right, forward, _ = spread * rng.standard_normal(7)
    soil, geometry, body = contact.soil, contact.geometry, contact.body
    true_soil = structs.replace(
        soil,
        friction=float(soil.friction * np.exp(friction)),
        rolling_resistance=float(soil.rolling_resistance * np.exp(rolling)),
    )
    if soil.longitudinal_friction is not None:
        along = float(soil.longitudinal_friction * np.exp(friction))
        true_soil = structs.replace(true_soil, longitudinal_friction=along)
    stretch = float(np.exp(LENGTH_SHARE * length))
    half_length = 0.5 * (geometry.positions[-1] - geometry.positions[0])
    x_CM = body.x_CM + CENTRE_SHARE * 0.5 * geometry.gauge * right
    y_CM = body.y_CM + CENTRE_SHARE * half_length * forward
    true_body = structs.replace(
        body,
        x_CM=_within(x_CM, geometry.gauge),
        y_CM=_within(y_CM, 2.0 * stretch * half_length),
        z_CM=float(body.z_CM * np.exp(HEIGHT_SHARE * height)),
    )
    positions = tuple(stretch * position for position in geometry.positions)
    return Contact(true_soil, structs.replace(geometry, positions=positions), true_body)


def on_surface(motion: TrueMotion, surface: Surface, patches: tuple[Patch, ...]) -> TrueMotion:
    """Repeat a planar motion on a surface: the same twists, other poses, and gravity.

    Slopes of the patches lie over the surface.
    """
    from icreckon.simulation.truth.surface_kernel import ride_along

    step = 1.0 / motion.rate
    poses, gravity = np.zeros_like(motion.poses), np.empty_like(motion.poses)
    heights = np.empty(len(poses))
    moves = displacements(motion.twists, step)
    ride_along(surface, patch_rows(patches), step, moves, poses, gravity, heights)
    return replace(motion, poses=poses, gravity=gravity, turns=motion.poses[:, 2], heights=heights)


def gravity_in_body(slopes: Floats, yaw: Floats) -> Floats:
    """Acceleration of gravity (n, 3) in base_link's axes [m/s²], at yaw (n,) [rad].

    `slopes` (n, 2) are its part along the plane in x and y of odom [m/s²].
    """
    along, left = rotate(slopes, -yaw).T
    down = np.sqrt(np.maximum(GRAVITY**2 - along**2 - left**2, 0.0))
    return np.stack([along, left, -down], axis=-1)


def _within(value: float, width: float) -> float:
    """Clip a coordinate to 40 % of the contact's extent: beyond 50 % it would tip."""
    return float(np.clip(value, -0.4 * width, 0.4 * width))


def _spans(payloads: tuple[Payload, ...], count: int, step: float) -> list[tuple[int, int]]:
    """First and last grid point of each span of constant load; spans share their ends."""
    times = np.array([time for payload in payloads for time in payload.time])
    changes = np.rint(np.clip(times / step, 0.0, count - 1.0)).astype(int).tolist()
    return list(pairwise(sorted({0, count - 1, *changes})))
