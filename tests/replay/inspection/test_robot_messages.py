"""Messages of robots that many people drive: the shape of their definitions, and what is found."""

import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bag_messages import T, header, imu, joints, pose_stamped, vector
from icreckon import inspect, load_robot, read_log

START, STEP = 1_700_000_000_000_000_000, 50_000_000
SECONDS = np.arange(0.0, 60.0, 0.05)
MOVES = SECONDS > 5.0
TURN = np.where(MOVES, 0.6 * np.sin(0.4 * SECONDS), 0.0)
SPEED = np.where(MOVES, 0.5 + 0.2 * np.sin(1.3 * SECONDS), 0.0)
RADIUS, TRACK = 0.2, 0.9
LEFT, RIGHT = ((SPEED + side * 0.5 * TRACK * TURN) / RADIUS for side in (-1.0, 1.0))
TURNED_LEFT, TURNED_RIGHT = np.cumsum(LEFT) * 0.05, np.cumsum(RIGHT) * 0.05
YAW = np.cumsum(TURN) * 0.05
X, Y = (np.cumsum(SPEED * one(YAW)) * 0.05 for one in (np.cos, np.sin))
RPM = 60.0 / (2.0 * np.pi)
RADII_PER_DEGREE = 6_371_000.0 * math.pi / 180.0


def written(
    path: Path, types: dict[str, str], topics: dict[str, Callable[[Any, int], Any]]
) -> dict[str, Any]:
    """Proposed robot file of a bag with an IMU, the truth, and messages of other types."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, definition in types.items():
        store.register(get_types_from_msg(definition, kind))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connections: dict[str, Any] = {}

        def write(topic: str, stamp: int, message: Any) -> None:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], stamp, store.serialize_cdr(message, kind))

        for k in range(len(SECONDS)):
            stamp = START + k * STEP
            if "/imu" not in topics:
                force = (0.0, SPEED[k] * TURN[k], 9.80665)
                write("/imu", stamp, imu(stamp, (0.0, 0.0, TURN[k]), force))
            q = (0.0, 0.0, math.sin(0.5 * YAW[k]), math.cos(0.5 * YAW[k]))
            write("/truth", stamp, pose_stamped(stamp, x=float(X[k]), y=float(Y[k]), q=q))
            for topic, make in topics.items():
                if (message := make(store.types, k)) is not None:
                    write(topic.removeprefix("/imu") or topic, stamp, message)
    return tomllib.loads(inspect(path).proposed_robot_file)


def of_motors(kind: str, field: str, values, **others) -> Callable[[Any, int], Any]:
    """Messages with a list of motors, of which `field` is the k-th of values."""

    def make(types: Any, k: int) -> Any:
        motor = types[kind.replace("Status", "Motor")]
        rows = [one[k] for one in values]
        named = {name: list(given) for name, given in others.items()}
        motors = [
            motor(**{field: row}, **{name: given[place] for name, given in named.items()})
            for place, row in enumerate(rows)
        ]
        return types[kind](header(START + k * STEP), motors)

    return make


FOUR = np.stack([LEFT, RIGHT, LEFT, RIGHT])
MIRRORED = np.stack([-RIGHT, LEFT, -RIGHT, LEFT]) * RPM
NAMES = ["front_left", "front_right", "rear_left", "rear_right"]
STATUS = "std_msgs/Header header\n{}Motor[] motors\n"


@pytest.mark.parametrize(
    ("motor", "field", "values", "others", "left", "right", "unit", "radius"),
    [
        # Sides by the gyro, right motors in mirror image: AgileX Scout, Hunter, Bunker.
        (
            "uint8 id\nfloat64 rpm",
            "rpm",
            MIRRORED,
            {"id": [0, 1, 2, 3]},
            [1, 3],
            [0, 2],
            "rpm",
            0.2,
        ),
        # Names of the devices beside the values: Clearpath's puma drivers.
        (
            *("string name\nfloat64 travel\nfloat64 speed", "speed", FOUR),
            *({"name": NAMES, "travel": [0.0] * 4}, [0, 2], [1, 3], "rad/s", 0.2),
        ),
        # A speed without a unit: m/s would make a track of 4.5 m (Jackal).
        ("float32 measured_speed", "measured_speed", FOUR[:2], {}, [0], [1], "rad/s", 0.2),
        ("float32 measured_speed", "measured_speed", FOUR[:2] * RPM, {}, [0], [1], "rpm", 0.2),
        ("float32 measured_speed", "measured_speed", FOUR[:2] * RADIUS, {}, [0], [1], "m/s", 0.1),
    ],
    ids=["mirrored", "names", "rates", "turns", "speeds"],
)
def test_motors_in_a_list(
    tmp_path: Path, motor, field, values, others, left, right, unit, radius
) -> None:
    types = {"a_msgs/msg/Motor": motor, "a_msgs/msg/Status": STATUS.format("a_msgs/")}
    make = of_motors("a_msgs/msg/Status", field, values, **others)
    robot = written(tmp_path / "bag", types, {"/status": make})
    minus = "-" if values is MIRRORED else ""
    tracks = robot["log"]["tracks"]
    assert tracks["left"] == [f"motors[{place}].{field}" for place in left]
    assert tracks["right"] == [f"{minus}motors[{place}].{field}" for place in right]
    assert tracks.get("unit", "rad/s") == unit
    assert robot["vehicle"]["sprocket_radius"] == pytest.approx(radius, rel=0.01)


@pytest.mark.parametrize("defined", ["float32 speed", "float32 rate_rpm"])
def test_numbers_of_both_sides_in_one_message(tmp_path: Path, defined: str) -> None:
    """Speeds are proposed by the names of their fields, currents and demanded speeds are not."""
    types = {
        "a_msgs/msg/Side": f"float32 current\nfloat32 target_speed\n{defined}",
        "a_msgs/msg/Drive": "std_msgs/Header header\na_msgs/Side left\na_msgs/Side right",
    }

    def make(types: Any, k: int) -> Any:
        sides = (types["a_msgs/msg/Side"](9.0, 8.0, 60.0 * one[k]) for one in (LEFT, RIGHT))
        return types["a_msgs/msg/Drive"](header(START + k * STEP), *sides)

    tracks = written(tmp_path / "bag", types, {"/motors": make})["log"]["tracks"]
    field = defined.split()[1]
    assert (tracks["left"], tracks["right"]) == ([f"left.{field}"], [f"right.{field}"])
    assert tracks["unit"] == ("rpm" if "rpm" in field else "m/s")


@pytest.mark.parametrize(
    ("fields", "topics", "field", "unit"),
    [
        (
            ("current_motor", "speed", "displacement"),
            ("/vesc_left/core", "/vesc_right/core"),
            "speed",
            "rad/s",
        ),
        (
            ("motor_current", "reference_velocity", "measured_velocity"),
            ("/left/feedback", "/right/feedback"),
            "measured_velocity",
            "rad/s",
        ),
        (
            ("pos_estimate", "vel_estimate", "torque_target"),
            ("/odrive_axis1/controller_status", "/odrive_axis0/controller_status"),
            "vel_estimate",
            "turns/s",
        ),
    ],
    ids=["vesc", "roboteq", "odrive"],
)
def test_a_motor_driver_for_each_side(tmp_path: Path, fields, topics, field, unit) -> None:
    """Of drivers without sides in their names the gyro shows which is left."""
    kind, numbers = "a_msgs/msg/State", "".join(f"\nfloat64 {name}" for name in fields)

    def of_side(values):
        def make(types: Any, k: int) -> Any:
            known = dict.fromkeys(fields, 9.0) | {field: values[k]}
            return types[kind](header(START + k * STEP), **known)

        return make

    makers = dict(zip(topics, map(of_side, (LEFT, RIGHT)), strict=True))
    robot = written(tmp_path / "bag", {kind: f"std_msgs/Header header{numbers}"}, makers)
    tracks = robot["log"]["tracks"]
    assert (tracks["topic"], tracks["right_topic"]) == topics
    assert (tracks["left"], tracks["right"], tracks["unit"]) == ([field], [field], unit)
    is_said = "taken for the left side" in str(inspect(tmp_path / "bag").notes)
    assert is_said == ("axis" in topics[0])


def test_px4_over_ros_2(tmp_path: Path) -> None:
    """Vectors of messages without a header, element 0 the right wheel; places in 1e-7 deg and mm."""
    types = {
        "px4_msgs/msg/SensorCombined": "float32[3] gyro_rad\nfloat32[3] accelerometer_m_s2",
        "px4_msgs/msg/WheelEncoders": "float32[2] wheel_speed\nfloat32[2] wheel_angle",
        "px4_msgs/msg/SensorGps": "int32 lat\nint32 lon\nint32 alt\nfloat32 eph",
    }
    types = {kind: f"uint64 timestamp\n{defined}" for kind, defined in types.items()}
    places = np.column_stack([48.0 + Y / 111_200.0, 11.0 + X / 74_630.0]) * 1e7

    def vectors(k: int, *rows) -> list[Any]:
        return [k, *(np.array(row, np.float32) for row in rows)]

    def imu_sample(types: Any, k: int) -> Any:
        forces = 0.0, -SPEED[k] * TURN[k], -9.80665
        return types["px4_msgs/msg/SensorCombined"](*vectors(k, (0.0, 0.0, -TURN[k]), forces))

    def encoders(types: Any, k: int) -> Any:
        return types["px4_msgs/msg/WheelEncoders"](*vectors(k, (RIGHT[k], LEFT[k]), (9.0, 9.0)))

    def fix(types: Any, k: int) -> Any:
        place = places[k].round().astype(int).tolist()
        return types["px4_msgs/msg/SensorGps"](k, *place, 520_000, 0.05)

    topics = {"/fmu/combined": imu_sample, "/fmu/encoders": encoders, "/fmu/gps": fix}
    written(tmp_path / "bag", types, {"/imu": lambda *_: None, **topics})
    text = inspect(tmp_path / "bag").proposed_robot_file
    (robot := tmp_path / "robot.toml").write_text(text.replace("= nan", "= 1.0"), "utf-8")
    log = read_log(tmp_path / "bag", load_robot(robot))
    radius = load_robot(robot).vehicle.sprocket_radius
    assert radius == pytest.approx(RADIUS, rel=0.01)
    speeds = np.column_stack([LEFT, RIGHT]) * radius
    np.testing.assert_allclose(log.tracks.speeds, speeds, atol=1e-6)
    np.testing.assert_allclose(log.imu.angular_velocity[:, 2], -TURN, atol=1e-6)
    np.testing.assert_allclose(log.imu.linear_acceleration[:, 2], -9.80665, atol=1e-6)
    at = np.column_stack([X, Y]) - [X[0], Y[0]]
    np.testing.assert_allclose(log.fixes.poses[:, :2], at, atol=0.05)


def arrays(**values) -> Callable[[Any, int], Any]:
    def make(types: Any, k: int) -> Any:
        rows = {name: np.array([one[k] for one in table]) for name, table in values.items()}
        return types["a_msgs/msg/State"](**rows)

    return make


def test_wheels_in_an_array(tmp_path: Path) -> None:
    """Of positions, speeds and duty cycles the speeds are taken; sides by the gyro (Leo)."""
    types = {"a_msgs/msg/State": "float64[4] position\nfloat64[4] velocity\nfloat64[4] pwm"}
    sides = np.stack([RIGHT, LEFT, RIGHT, LEFT])
    make = arrays(position=np.cumsum(sides, axis=1), velocity=sides, pwm=sides)
    tracks = written(tmp_path / "bag", types, {"/wheel_states": make})["log"]["tracks"]
    assert (tracks["left"], tracks["right"]) == (
        ["velocity[1]", "velocity[3]"],
        ["velocity[0]", "velocity[2]"],
    )


def test_speed_and_yaw_rate_are_no_sides(tmp_path: Path) -> None:
    """Their difference follows the gyro as that of two tracks does (Robotnik)."""
    types = {"a_msgs/msg/State": "float64[2] real_speed\nfloat64[2] rpm_motors"}
    make = arrays(real_speed=[SPEED, TURN], rpm_motors=[LEFT * RPM, RIGHT * RPM])
    tracks = written(tmp_path / "both", types, {"/state": make})["log"]["tracks"]
    assert tracks["left"] == ["rpm_motors[0]"]


@pytest.mark.parametrize(
    ("speed", "yaw_rate"),
    [
        ("linear_velocity", "angular_velocity"),
        ("longitudinal_velocity", "heading_rate"),
        ("linear_x", "angular_z"),
    ],
)
def test_speed_and_yaw_rate_of_a_controller(tmp_path: Path, speed: str, yaw_rate: str) -> None:
    types = {"a_msgs/msg/Report": f"std_msgs/Header header\nfloat64 {speed}\nfloat64 {yaw_rate}"}

    def make(types: Any, k: int) -> Any:
        return types["a_msgs/msg/Report"](header(START + k * STEP), SPEED[k], TURN[k] * 1.5)

    robot = written(tmp_path / "bag", types, {"/report": make})
    tracks = robot["log"]["tracks"]
    assert (tracks["speed"], tracks["yaw_rate"]) == (speed, yaw_rate)
    assert robot["indices"]["eta0"] == pytest.approx(1.5, abs=0.01)


def test_joints_with_positions_alone(tmp_path: Path) -> None:
    def make(_: Any, k: int) -> Any:
        positions = (TURNED_LEFT[k], TURNED_RIGHT[k])
        return joints(START + k * STEP, (), ("wheel_l", "wheel_r"), positions)

    robot = written(tmp_path / "bag", {}, {"/joint_states": make})
    assert robot["log"]["tracks"]["unit"] == "rad"
    assert robot["vehicle"]["sprocket_radius"] == pytest.approx(RADIUS, rel=0.01)


def wheels(_: Any, k: int) -> Any:
    return joints(START + k * STEP, (LEFT[k], RIGHT[k]), ("wheel_l", "wheel_r"))


def test_gyros_and_accelerometers_as_vectors_on_two_topics(tmp_path: Path) -> None:
    def vectors(x: float, y: float, z: float, k: int) -> Any:
        return T["geometry_msgs/msg/Vector3Stamped"](header(START + k * STEP), vector(x, y, z))

    topics = {
        "/imu": lambda *_: None,
        "/imu/angular_velocity": lambda _, k: vectors(0.0, 0.0, TURN[k], k),
        "/imu/acceleration": lambda _, k: vectors(0.0, SPEED[k] * TURN[k], 9.80665, k),
    }
    topics |= {"/joint_states": wheels}
    robot = written(tmp_path / "bag", {}, topics)
    of_imu = robot["log"]["imu"]
    assert of_imu["topic"] == "/angular_velocity"
    assert of_imu["acceleration_topic"] == "/acceleration"
    assert robot["imu"]["rotation_rpy_deg"] == pytest.approx([0.0, 0.0, 0.0], abs=0.2)


def test_counts_of_an_imu(tmp_path: Path) -> None:
    """Raw 16-bit registers in a table: 16384 counts of a g, 131 of a deg/s."""
    path, rows = tmp_path / "log.csv", ["t,left_m_s,right_m_s,gx,gy,gz,ax,ay,az"]
    for k, second in enumerate(SECONDS):
        counts = round(math.degrees(TURN[k]) * 131), round(SPEED[k] * TURN[k] / 9.80665 * 16384)
        sides = f"{LEFT[k] * RADIUS:.4f},{RIGHT[k] * RADIUS:.4f}"
        rows.append(f"{second:.2f},{sides},0,0,{counts[0]},0,{counts[1]},16384")
    path.write_text("\n".join(rows), encoding="utf-8")
    found = inspect(path)
    assert np.linalg.norm(found.mounting.specific_force) == pytest.approx(9.80665, rel=1e-3)
    robot = tomllib.loads(found.proposed_robot_file)
    assert robot["vehicle"]["track_gauge"] == pytest.approx(TRACK, rel=0.01)
    assert any("131 counts of a deg/s" in note for note in found.notes)


@pytest.mark.parametrize(
    ("numbers", "degrees", "sigma", "accuracy"),
    [("float64", 180.0 / math.pi, "uint16", 2), ("int32", 1e-7, "uint32", 20)],
    ids=["septentrio", "u-blox"],
)
def test_places_in_other_units_than_degrees(
    tmp_path: Path, numbers: str, degrees: float, sigma: str, accuracy: int
) -> None:
    """Radians with centimetres, whole degrees with millimetres: both are 0.02 m."""
    kind = "a_msgs/msg/Fix"
    text = f"std_msgs/Header header\n{numbers} latitude\n{numbers} longitude\n{sigma} h_accuracy"
    as_number = float if numbers == "float64" else round

    def make(types: Any, k: int) -> Any:
        north = 48.1 + Y[k] / RADII_PER_DEGREE
        east = 11.6 + X[k] / RADII_PER_DEGREE / math.cos(math.radians(48.1))
        places = [as_number(place / degrees) for place in (north, east)]
        return types[kind](header(START + k * STEP), *places, accuracy) if k % 4 == 0 else None

    path = tmp_path / "bag"
    written(path, {kind: text}, {"/joint_states": wheels, "/gps": make})
    robot = tmp_path / "robot.toml"
    proposed = inspect(path).proposed_robot_file.replace("mass = nan", "mass = 50.0")
    robot.write_text(proposed, encoding="utf-8")
    fixes = read_log(path, load_robot(robot)).fixes
    assert np.sqrt(fixes.variances[:, 0]) == pytest.approx(0.02)
    moved = fixes.poses[-1, :2] - fixes.poses[0, :2]
    assert moved == pytest.approx([X[-4] - X[0], Y[-4] - Y[0]], abs=0.2)


def test_odometry_in_a_table(tmp_path: Path) -> None:
    """Columns of a controller's twist, as `rostopic echo -p` writes them; its yaw rate is no gyro."""
    path, rows = tmp_path / "odom.csv", ["%time,twist.twist.linear.x,twist.twist.angular.z"]
    twists = zip(SECONDS, SPEED, TURN * 1.5, strict=True)
    rows += [f"{START + round(t * 1e9)},{v:.5f},{w:.5f}" for t, v, w in twists]
    path.write_text("\n".join(rows), encoding="utf-8")
    gyro, rows = tmp_path / "imu.csv", ["%time,angular_velocity.z"]
    rows += [f"{START + round(t * 1e9)},{w:.5f}" for t, w in zip(SECONDS + 0.01, TURN, strict=True)]
    gyro.write_text("\n".join(rows), encoding="utf-8")
    proposed = inspect([path, gyro]).proposed_robot_file
    robot = tmp_path / "robot.toml"
    filled_in = proposed.replace("mass = nan", "mass = 50.0").replace("gauge = nan", "gauge = 0.6")
    robot.write_text(filled_in.replace("# gauge = 0.5", "gauge = 0.6"), encoding="utf-8")
    log = read_log([path, gyro], load_robot(robot))
    assert log.tracks.speeds.mean(axis=1) == pytest.approx(SPEED, abs=1e-4)
    assert log.tracks.difference == pytest.approx(0.9 * TURN, abs=1e-4)
    assert load_robot(robot).constant_indices.eta0 == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize(
    ("names", "values", "unit"),
    [
        (("wL", "wR"), (LEFT, RIGHT), "rad/s"),
        (("VL", "VR"), (LEFT * RADIUS, RIGHT * RADIUS), "m/s"),
        (("axis0.encoder.vel_estimate", "axis1.encoder.vel_estimate"), (LEFT, RIGHT), "turns/s"),
        (("odom_vx", "odom_wz"), (SPEED, TURN), None),
        (("wheel_speed", "wheel_yaw_rate"), (SPEED, TURN), None),
        (("VL [rpm]", "VR [rpm]"), (LEFT * RPM, RIGHT * RPM), "rpm"),
        (("lw_rpm", "rw_rpm"), (LEFT * RPM, RIGHT * RPM), "rpm"),
    ],
)
def test_names_of_columns(tmp_path: Path, names, values, unit) -> None:
    """Tracks by short names, or a twist; the gyro is that of EuRoC's format."""
    path, of_gyro = tmp_path / "log.csv", [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"]
    rows = [",".join(["t", *names, *of_gyro])]
    for second, first, other, w in zip(SECONDS, *values, TURN, strict=True):
        rows.append(f"{second:.2f},{first:.5f},{other:.5f},0.0,0.0,{w:.5f}")
    path.write_text("\n".join(rows), encoding="utf-8")
    columns = inspect(path).mapping.columns
    tracks = columns.tracks
    assert columns.imu.angular_velocity == tuple(of_gyro)
    assert tracks.names == names
    assert (tracks.unit if tracks.left else None) == unit


@pytest.mark.parametrize(
    ("gyro", "time", "place"),
    [("rate_{}_dps", "sec", ("px", "py")), ("imu_rate_{}", "seconds", ("easting", "northing"))],
)
def test_an_imu_and_places_in_tables_of_their_own(tmp_path: Path, gyro, time, place) -> None:
    """Names of rates end like those of places, and are no truth."""
    factor = 180.0 / math.pi if "dps" in gyro else 1.0
    rates = [gyro.format(axis) for axis in "xyz"]
    zeros = np.zeros(len(SECONDS))
    tables = {
        "imu": [time, *rates], "wheels": [time, "left_vel", "right_vel"], "rtk": [time, *place],
    }  # fmt: skip
    values = {"imu": [zeros, zeros, factor * TURN], "wheels": [LEFT, RIGHT], "rtk": [X, Y]}
    for name, columns in values.items():
        rows = np.column_stack([SECONDS, *columns])
        header = ",".join(tables[name])
        np.savetxt(tmp_path / f"{name}.csv", rows, "%.5f", ",", header=header, comments="")
    found = inspect([tmp_path / f"{name}.csv" for name in tables])
    columns = found.mapping.columns
    assert columns.imu.angular_velocity == tuple(rates)
    assert (columns.truth.x, columns.truth.y) == place
    assert not any("not used" in text for text in found.findings)
