"""Robot file: parameters that no log can reveal, as TOML, checked on reading.

Axes are those of REP-103 (x forward, y left, z up, origin at the centre of the tracks' contact area),
except in `[indices]` and `[constant_icr]`, which use the paper's symbols and axes (X right, Y forward).
"""

from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.checks import (
    Bound,
    Bounded,
    Finite,
    NotNegative,
    OnRobot,
    Positive,
    Radius,
    RobotSize,
    Share,
    SmallShare,
)
from icreckon.estimator.base.config import convert, read_toml
from icreckon.estimator.base.errors import EstimatorError, SettingError, nearest_hint
from icreckon.estimator.base.frames import rep103_to_paper, rpy_to_matrix
from icreckon.estimator.motion.motion_model import VehicleConstants
from icreckon.estimator.robot.soil import Soil

ROBOTS_FOLDER = Path(__file__).parent / "robots"
FORMAT = 1
LEAST_UPRIGHT = 0.1  # least share of the vertical along the z axis of a gyro that reads z alone
# Radii that differ by more are an error of units, not of tyres [-].
_Difference = Annotated[float, Bound("relative (0.02 is 2 %), 0.5 at most in size", -0.5, 0.5)]
RATE_NOISE = "in radians, 1 at most (1 deg/s is 0.0175 rad/s, 1 deg/h is 4.85e-6)"
LOAD_LAG = 0.2  # default lag of the load transfer [s]
LARGEST_ETA = 1000.0  # largest distance of constant ICRs, as a multiple of the gauge
MOST_POINTS = 1000  # most contact points of a track
DENSEST = 20_000.0  # largest mass over the cube of the gauge, about that of gold [kg/m³]
FAR = 20.0  # largest distance of a place from base_link, over the track gauge [-]
FASTEST = 100.0  # highest speed of a track [m/s]


class Vehicle(Bounded, frozen=True):
    """Mass and geometry.

    Attributes:
        mass: mass of the vehicle with its load [kg].
        track_gauge: distance L between the track (wheel) centrelines [m].
        sprocket_radius: effective radius that turns sprocket (wheel) rates into track speeds [m].
        centre_of_mass: x forward, y left, z up; 0.3 of the gauge up is usual, and 0 means no load
            transfer [m].
        half_contact_length: half the length of a track's contact with the ground, or half the
            wheelbase [m].
        contact_points: evenly spaced points along each track that press on the ground: 2 for a pair of
            wheels, the number of road wheels of a track.
        yaw_inertia: moment of inertia about the vertical through the centre of mass; by default that
            of a plate as large as the contact's outline [kg m²].
        max_track_speed: highest speed of a track [m/s].
        load_lag: time constant of the load transfer by the force of inertia, as the vehicle rolls and
            pitches on its suspension [s].
    """

    mass: Positive
    track_gauge: RobotSize
    sprocket_radius: Radius
    centre_of_mass: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    half_contact_length: RobotSize = 0.3
    contact_points: Annotated[int, Bound(f"from 2 to {MOST_POINTS}", 2, MOST_POINTS)] = 5
    yaw_inertia: Positive | None = None
    max_track_speed: Positive = 1.0
    load_lag: Positive = LOAD_LAG


class Indices(Bounded, frozen=True):
    """Parameters of the inertia-based kinematics (paper, equations 25 to 27).

    Attributes:
        H: ratio of track speeds of on-spot turning, V_l = -H V_r (13) [-].
        zeta0: sliding index at no inertia [m].
        zeta1: gain of zeta with the force of inertia [m/N].
        epsilon0: eccentricity index at no inertia [m].
        epsilon1: gain of epsilon [m/N].
        eta0: steering efficiency index at no inertia [-].
        eta1: gain of eta [1/N].
        eta2: quadratic gain of eta [1/N²].
        epsilon_F: gain of epsilon with the force along the tracks, as a share of the weight [m]; a ninth
            parameter, not the paper's. If it is left out it is that of Coulomb friction, and so is
            zeta1 if all gains are zero.
    """

    H: Finite = 1.0
    zeta0: Finite = 0.0
    zeta1: Finite = 0.0
    epsilon0: Finite = 0.0
    epsilon1: Finite = 0.0
    eta0: Annotated[float, Bound("at least 1 (1 is the ideal differential drive)", 1.0)] = 1.0
    eta1: Finite = 0.0
    eta2: Finite = 0.0
    epsilon_F: Annotated[float, Bound("a number of metres, 10 at most", -10.0, 10.0)] | None = None

    def as_array(self) -> Floats:
        """Array (9,) of the parameters; epsilon_F is 0 if not given."""
        *eight, epsilon_F = msgspec.structs.astuple(self)
        return np.array([*eight, 0.0 if epsilon_F is None else epsilon_F], dtype=float)


PAPER_PARAMETERS = Indices.__struct_fields__[:8]  # the paper's eight parameters: all but epsilon_F


class ConstantIcr(Bounded, frozen=True):
    """Constant ICRs of the tracks in the paper's axes (X right, Y forward).

    Attributes:
        x_ICRl: lateral position of the left track's ICR, negative [m].
        x_ICRr: lateral position of the right track's ICR, positive [m].
        y_ICR: longitudinal position of both [m].
    """

    x_ICRl: OnRobot
    x_ICRr: OnRobot
    y_ICR: OnRobot = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.x_ICRl < 0.0 < self.x_ICRr:
            raise SettingError(
                f"x_ICRl < 0 < x_ICRr must hold, found {self.x_ICRl!r} and {self.x_ICRr!r}"
            )


class Imu(Bounded, frozen=True):
    """Mounting and noise of the IMU.

    Attributes:
        rotation_rpy_deg: orientation of the IMU in base_link, fixed-axis roll, pitch, yaw [deg].
        position: position of the IMU in base_link [m].
        gyro_axes: "xyz", or "z" if only the z gyro was logged (then the rate about the body's z axis
            is that reading over the cosine of the tilt).
        gyro_range: largest rate that it reads [rad/s], such as 4.36 for 250°/s; 0 if unknown. Larger yaw
            rates are clipped, and not used.
        gyro_scale: reading over true rate, 1 for an ideal gyro [-].
        gyro_scale_sigma: standard deviation of the gyro's scale [-]; 0.005 to 0.015 of a cheap gyro.
        gyro_bias: initial bias of the yaw rate in base_link, reading less rate [rad/s].
        gyro_noise_density: white noise of the rate [rad/s/√Hz]; measured noise counts where it differs
            clearly, see `icreckon.estimator.sensors.imu_noise`.
        gyro_bias_sigma: standard deviation of the initial bias [rad/s].
        gyro_bias_walk: random walk of the bias [rad/s/√s].
        accelerometer_noise_density: white noise, vibration and small slopes included [m/s²/√Hz]; clearly
            larger measured noise counts.
        accelerometer_bias_sigma: standard deviation of the initial bias, levelling error included
            [m/s²].
        accelerometer_bias_walk: random walk of the bias [m/s²/√s].
    """

    rotation_rpy_deg: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    position: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    gyro_axes: Literal["xyz", "z"] = "xyz"
    gyro_range: NotNegative = 0.0
    gyro_scale: Annotated[float, Bound("a positive number from 0.1 to 10", 0.1, 10.0)] = 1.0
    gyro_scale_sigma: SmallShare = 0.0
    gyro_bias: Annotated[float, Bound("a number of rad/s, 1 at most", -1.0, 1.0)] = 0.0
    gyro_noise_density: Annotated[float, Bound(RATE_NOISE, 0.0, 1.0, above=True)] = 1e-3
    gyro_bias_sigma: Annotated[float, Bound(RATE_NOISE, 0.0, 1.0)] = 0.01
    gyro_bias_walk: Annotated[float, Bound(RATE_NOISE, 0.0, 1.0)] = 1e-5
    accelerometer_noise_density: Positive = 0.02
    accelerometer_bias_sigma: NotNegative = 0.2
    accelerometer_bias_walk: NotNegative = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        roll, pitch, _ = np.radians(self.rotation_rpy_deg)
        if self.gyro_axes == "z" and abs(np.cos(roll) * np.cos(pitch)) < LEAST_UPRIGHT:
            raise SettingError(
                'gyro_axes = "z" needs a z axis that is not level, '
                f"found rotation_rpy_deg = {list(self.rotation_rpy_deg)!r}"
            )


class Tracks(Bounded, frozen=True):
    """Scale and noise of the track-speed sensors.

    Attributes:
        speed_noise_density: white noise of each track's speed [m/s/√Hz]; clearly larger
            measured noise adds to it. Speeds by counts of 2.5 mm or more are averaged over 0.1 s.
        scale_sigma: standard deviation of the relative error of the effective sprocket radius [-].
        difference: effective radius of the right sprocket less that of the left, as a share of
            `sprocket_radius` [-].
        difference_sigma: standard deviation of this difference [-].
    """

    speed_noise_density: NotNegative = 1e-3
    scale_sigma: SmallShare = 0.0
    difference: _Difference = 0.0
    difference_sigma: SmallShare = 0.003


class Slope(Bounded, frozen=True):
    """Slope of the ground: gravity's acceleration along it, in each direction.

    Rates of roll and pitch show how it changes. Without them it is a Gauss-Markov process in the distance
    that the tracks travel; its correlation distance is 2 (sigma / walk)².

    Attributes:
        sigma: standard deviation [m/s²]; 0.17 is a slope of one degree. At 0 the ground is level.
        walk: random walk with the distance [m/s²/√m].
    """

    sigma: Annotated[float, Bound("from 0 to 9.81 m/s²", 0.0, 9.81)] = 0.5
    walk: Annotated[float, Bound("zero or a positive number, 100 at most", 0.0, 100.0)] = 0.05


class Slip(Bounded, frozen=True):
    """Size of the slip residual: body velocity that an index model does not explain.

    The residual is a first-order Gauss-Markov process, in w plus white noise. The standard deviation of
    the process is a share of the difference of the track speeds (turning) plus a share of their mean
    (driving); it vanishes at rest.

    Attributes:
        turning_x: share for v_x, per |V_r - V_l| [-].
        turning_y: share for v_y, per |V_r - V_l| [-].
        turning_w: share for w, per |V_r - V_l| / (L eta0) [-].
        driving_x: share for v_x, per |V_l + V_r| / 2 [-].
        driving_y: share for v_y, per |V_l + V_r| / 2 [-].
        driving_w: share for w, per |V_l + V_r| / 2 [rad/m].
        time_constant: correlation time of the process [s].
        white_time: the white noise of w has the density of a process of the same standard deviation
            and this (short) correlation time [s].
    """

    turning_x: Share = 0.05
    turning_y: Share = 0.02
    turning_w: Share = 0.1
    driving_x: Share = 0.005
    driving_y: Share = 0.003
    driving_w: Share = 0.01
    time_constant: Positive = 1.0
    white_time: NotNegative = 0.1


def slip_components(V_l: Any, V_r: Any, slip: Slip, effective_gauge: float) -> tuple[Any, Any, Any]:
    """Standard deviations of the slip residual of v_x, v_y, w (REP-103), see `Slip`.

    Track speeds V_l and V_r [m/s] are floats or (n,), as are the results [m/s, m/s, rad/s];
    `effective_gauge` is L eta0 [m].
    """
    turning, driving = abs(V_r - V_l), 0.5 * abs(V_l + V_r)
    return (
        slip.turning_x * turning + slip.driving_x * driving,
        slip.turning_y * turning + slip.driving_y * driving,
        slip.turning_w / effective_gauge * turning + slip.driving_w * driving,
    )


class UndetectedSlip(Bounded, frozen=True):
    """Slip of both tracks that no sensor shows, as at a wall or in mud.

    The position grows uncertain along the robot by `share` of the tracks' speed, as of slip that lasts
    for `time`.

    Attributes:
        share: standard deviation, as a share of the mean speed of the tracks; 0 for none [-].
        time: how long it lasts [s].
    """

    share: Share = 0.0
    time: Positive = 5.0


class Robot(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """Content of a robot file.

    Attributes:
        name: name of the robot.
        vehicle: mass and geometry.
        indices: the parameters of the inertia-based model.
        constant_icr: the best constant ICRs; by default those of `indices` at no inertia.
        imu: mounting and noise of the IMU.
        tracks: scale and noise of the track speeds.
        slope: slope of the ground.
        soil: friction and rolling resistance of the robot's usual ground.
        undetected_slip: slip of both tracks that no sensor shows.
        slip: overrides of the slip residual, variant name -> Slip; see
            `icreckon.estimator.robot.variants`.
        log: topic mapping of this robot's logs, checked by the readers of logs.
        format: version of the file format.
        note: free text.
    """

    name: str
    vehicle: Vehicle
    indices: Indices = Indices()
    constant_icr: ConstantIcr | None = None
    imu: Imu = Imu()
    tracks: Tracks = Tracks()
    slope: Slope = Slope()
    soil: Soil = Soil()
    undetected_slip: UndetectedSlip = UndetectedSlip()
    slip: dict[str, Slip] = {}
    log: dict[str, Any] = {}
    format: int = FORMAT
    note: str = ""

    def __post_init__(self) -> None:
        if self.format != FORMAT:
            raise SettingError(f"format {self.format!r} is not known; this version reads {FORMAT}")
        icr, gauge = self.constant_icr, self.vehicle.track_gauge
        if icr is not None and not gauge <= icr.x_ICRr - icr.x_ICRl <= LARGEST_ETA * gauge:
            raise SettingError(
                f"the constant ICRs must be at least track_gauge = {gauge!r} m apart, and at most "
                f"{LARGEST_ETA:g} times that, found {icr.x_ICRl!r} and {icr.x_ICRr!r}"
            )

    def __repr__(self) -> str:
        """One line: name and size; `robot_toml` has all."""
        mass, gauge, radius = msgspec.structs.astuple(self.vehicle)[:3]
        return f"<Robot {self.name!r}, {mass:g} kg, track gauge {gauge:g} m, radius {radius:g} m>"

    @cached_property
    def centre_of_mass_paper(self) -> tuple[float, float]:
        """Centre of mass (x_CM, y_CM) in the paper's axes [m]."""
        x_forward, y_left, _ = self.vehicle.centre_of_mass
        x_cm, y_cm = rep103_to_paper(x_forward, y_left)
        return float(x_cm), float(y_cm)

    @cached_property
    def constants(self) -> VehicleConstants:
        """Constants of the motion models: mass and geometry in the paper's axes."""
        vehicle = self.vehicle
        rolling = self.soil.rolling_resistance
        return VehicleConstants(
            vehicle.track_gauge, vehicle.mass, *self.centre_of_mass_paper, rolling, vehicle.load_lag
        )

    @cached_property
    def yaw_inertia(self) -> float:
        """Moment of inertia about the vertical through the centre of mass [kg m²]."""
        vehicle = self.vehicle
        if vehicle.yaw_inertia is not None:
            return vehicle.yaw_inertia
        length, width = 2.0 * vehicle.half_contact_length, vehicle.track_gauge
        return vehicle.mass * (length**2 + width**2) / 12.0

    @property
    def effective_track(self) -> float:
        """Effective track with constant ICRs [m]."""
        return self.constant_indices.eta0 * self.vehicle.track_gauge

    @cached_property
    def constant_indices(self) -> Indices:
        """Constant ICRs as indices: zeta0, epsilon0, eta0 by (17) to (19), others zero."""
        gauge = self.vehicle.track_gauge
        if self.constant_icr is None:
            plain = self.indices
            return Indices(H=plain.H, zeta0=plain.zeta0, epsilon0=plain.epsilon0, eta0=plain.eta0)
        icr = self.constant_icr
        return Indices(
            H=self.indices.H,
            zeta0=icr.y_ICR,
            epsilon0=0.5 * (icr.x_ICRr + icr.x_ICRl),
            eta0=(icr.x_ICRr - icr.x_ICRl) / gauge,
        )

    @cached_property
    def imu_rotation(self) -> Floats:
        """Rotation (3, 3) of vectors from the IMU's axes to base_link."""
        roll, pitch, yaw = np.radians(self.imu.rotation_rpy_deg)
        return rpy_to_matrix(roll, pitch, yaw)


def robot_names() -> list[str]:
    """Names of the robots that ship with icreckon."""
    return sorted(path.stem for path in ROBOTS_FOLDER.glob("*.toml"))


def load_robot(name_or_path: str | Path) -> Robot:
    """Load a robot by the name of a shipped file, or from a TOML file.

    `name_or_path` is a name from `robot_names()`, or the path of a `.toml` file.

    Raises:
        EstimatorError: no such robot or file, a misspelt key, a wrong type or a bad value.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml" and not path.is_file():
        path = ROBOTS_FOLDER / f"{name_or_path}.toml"
        if not path.exists():
            raise EstimatorError(
                f"no robot named {str(name_or_path)!r}{nearest_hint(str(name_or_path), robot_names())}"
                " (or give the path of a .toml file)"
            )
    data = read_toml(path, EstimatorError)
    missing = list(_not_filled_in(data))
    if len(missing) > 1:
        raise EstimatorError(
            f"{path}: {', '.join(missing)} must be numbers, found nan: they are not filled in"
        )
    return _plausible(convert(data, Robot, str(path), EstimatorError))


def _not_filled_in(data: Any, name: str = "") -> Iterator[str]:
    """Keys whose value is NaN, as "vehicle.mass"."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _not_filled_in(value, f"{name}.{key}" if name else key)
    elif isinstance(data, list):
        for value in data:
            yield from _not_filled_in(value, name)
    elif isinstance(data, float) and data != data:
        yield name


def make_robot(name: str, **tables: Mapping[str, Any]) -> Robot:
    """Make a robot without a file; what is left out has its default.

    Tables are those of a robot file, as `vehicle={"mass": 30.0, "track_gauge": 0.42,
    "sprocket_radius": 0.1}`; `vehicle` is required.

    Raises:
        EstimatorError: a misspelt key, a wrong type or a bad value.
    """
    data = {"name": name} | {key: as_plain_table(value) for key, value in tables.items()}
    return _plausible(convert(data, Robot, f"robot {name!r}", EstimatorError))


def _plausible(robot: Robot) -> Robot:
    """Return a robot; EstimatorError for a mass, place or speed in another unit."""
    vehicle, gauge = robot.vehicle, robot.vehicle.track_gauge
    of_gauge = f"does not fit track_gauge = {gauge!r} m"
    for is_wrong, problem in (
        (
            vehicle.mass > DENSEST * gauge**3,
            f"mass = {vehicle.mass!r} kg {of_gauge}: is the mass in grams, or the gauge not in metres?",
        ),
        (
            max(map(abs, vehicle.centre_of_mass)) > FAR * gauge,
            f"centre_of_mass = {vehicle.centre_of_mass!r} m {of_gauge}: is it in millimetres?",
        ),
        (
            max(map(abs, robot.imu.position)) > FAR * gauge,
            f"imu.position = {robot.imu.position!r} m {of_gauge}: is it in millimetres?",
        ),
        (
            vehicle.max_track_speed > FASTEST,
            f"max_track_speed = {vehicle.max_track_speed!r} m/s: is it in mm/s?",
        ),
    ):
        if is_wrong:
            raise EstimatorError(f"robot {robot.name!r}: {problem}")
    return robot


def changed_robot(robot: Robot, changes: Mapping[str, Any], source: str = "") -> Robot:
    """Copy of a robot with other values.

    Values are by their keys in a robot file, as `{"vehicle.track_gauge": 0.45}`; errors name `source`.

    Raises:
        EstimatorError: a misspelt key, a wrong type or a bad value.
    """
    require_robot(robot)
    if not changes:
        return robot
    data = {key: value for key, value in msgspec.to_builtins(robot).items() if value is not None}
    for key, value in changes.items():
        *path, last = str(key).split(".")
        table = data
        for step in path:
            table = table.setdefault(step, {})
            if not isinstance(table, dict):
                raise EstimatorError(f"{key}: {step} is no table of a robot file")
        table[last] = as_plain_table(value)
    return convert(data, Robot, source or f"robot {robot.name!r}", EstimatorError)


def as_plain_table(value: Any) -> Any:
    """Plain data of a value, as TOML has it: dicts, lists, text, numbers."""
    if isinstance(value, Mapping):
        return {str(key): as_plain_table(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [as_plain_table(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return msgspec.to_builtins(value) if isinstance(value, msgspec.Struct) else value


def require_robot(robot: object) -> None:
    """Reject an argument that is not a `Robot`, such as the path of its file.

    Raises:
        EstimatorError: it is not; the message gives the call that loads one.
    """
    if not isinstance(robot, Robot):
        argument = f"{str(robot)!r}" if isinstance(robot, str | Path) else "path"
        raise EstimatorError(
            f"robot must be a Robot, found {type(robot).__name__} {robot!r}; use load_robot({argument})"
        )
