import msgspec
import numpy as np
import pytest

from icreckon import Patch, Payload, SimulationError, Terrain, TrackSpeedSeries, load_robot
from icreckon.estimator.robot.variants import coulomb_gains
from icreckon.simulation.base.sampling import EPOCH
from icreckon.simulation.scenario import Scenario, change_scenario, load_scenario, lost_options
from icreckon.simulation.sensors.specs import EncoderSpec, FixSpec, InertialSpec
from icreckon.simulation.simulate import run_scenario, simulate

ALPHA = load_robot("auriga-alpha")
KINEMATIC, PATCHES = {"truth": "kinematic"}, (Patch(friction=0.5),)
LOADS = (Payload(time=(0.0, 1.0), mass=1.0),)
SHORT = Scenario(trajectory="aggressive", duration=20.0, seed=4, fixes=FixSpec(heading_sigma=0.02))


def streams(log):
    return {
        "tracks": log.tracks.speeds,
        "gyro": log.imu.angular_velocity,
        "accelerometer": log.imu.linear_acceleration,
        "fixes": log.fixes.poses,
        "poses": log.truth.poses.poses,
        "twists": log.truth.twists.twists,
        "true tracks": log.truth.tracks.speeds,
    }


def changed(log, other):
    return {
        name
        for (name, a), b in zip(streams(log).items(), streams(other).values(), strict=True)
        if not np.array_equal(a, b)
    }


def test_shapes_stamps_and_names():
    log = simulate(SHORT, ALPHA)
    assert log.tracks.speeds.shape == (1001, 2)
    assert log.imu.angular_velocity.shape == (2001, 3)
    assert log.fixes.poses.shape == (21, 3)
    assert log.truth.poses.poses.shape == (1001, 3)
    assert log.truth.source == "friction"
    assert log.start == EPOCH == 1_700_000_000_000_000_000
    assert log.duration == pytest.approx(20.0)
    assert np.array_equal(log.truth.twists.stamps, log.truth.tracks.stamps)
    assert "auriga-alpha" in log.name
    assert len(list(log.measurements())) == 1001 + 2001 + 2 * 21


def test_the_same_seed_gives_the_same_bits():
    first = run_scenario(SHORT, ALPHA)
    again = run_scenario(SHORT, ALPHA)
    assert changed(first.log, again.log) == set()
    assert first.motion.parameters == again.motion.parameters
    assert np.array_equal(first.gyro_bias, again.gyro_bias)


@pytest.mark.parametrize("other", [{"seed": 5}, {"run_index": 1}])
def test_another_seed_or_run_gives_another_run(other):
    scenario = msgspec.structs.replace(SHORT, seed=other.get("seed", SHORT.seed))
    log = simulate(scenario, ALPHA, run_index=other.get("run_index", 0))
    assert changed(simulate(SHORT, ALPHA), log) == set(streams(log))


@pytest.mark.parametrize(
    ("sensor", "spec"),
    [
        ("encoders", EncoderSpec(resolution=1e-3)),
        ("encoders", EncoderSpec(dropouts_per_hour=3600.0, dropout_reads="zero")),
        ("gyro", InertialSpec(bias_walk=1.0)),
        ("accelerometer", InertialSpec(misalignment_sigma=0.1)),
        ("fixes", FixSpec(outlier_share=0.5, heading_sigma=0.02)),
        ("fixes", FixSpec(latency=0.2, heading_sigma=0.02)),
    ],
)
def test_one_sensor_s_figure_changes_no_other_stream(sensor, spec):
    scenario = msgspec.structs.replace(SHORT, **{sensor: spec})
    stream = "tracks" if sensor == "encoders" else sensor
    assert changed(simulate(SHORT, ALPHA), simulate(scenario, ALPHA)) == {stream}


def test_noise_presets_leave_the_truth_alone():
    scenario = msgspec.structs.replace(SHORT, noise="perfect")
    perfect = run_scenario(scenario, ALPHA)
    sensors = {"tracks", "gyro", "accelerometer", "fixes"}
    assert changed(simulate(SHORT, ALPHA), perfect.log) == sensors
    assert not perfect.gyro_bias.any()
    # Rates are means since the sample before: their integral is the yaw.
    yaw = np.cumsum(perfect.log.imu.angular_velocity[1:, 2]) * 0.01
    assert np.allclose(yaw[1::2], perfect.log.truth.poses.poses[1:, 2], atol=1e-9)


def test_rates_choose_the_samples_and_not_the_commands():
    fast = msgspec.structs.replace(SHORT, track_rate=200.0, imu_rate=500.0, truth_rate=10.0)
    log = simulate(fast, ALPHA)
    assert len(log.tracks.stamps) == 4001
    assert len(log.imu.stamps) == 10001
    assert len(log.truth.poses.stamps) == 201
    base = simulate(SHORT, ALPHA).truth.tracks
    assert np.allclose(log.truth.tracks.speeds, base.speeds[::5], atol=5e-5)
    odd = simulate(msgspec.structs.replace(SHORT, track_rate=33.3, imu_rate=130.0), ALPHA)
    assert (np.diff(odd.tracks.stamps) > 0).all()


def test_spread_zero_is_the_robot_file():
    drawn = msgspec.structs.replace(SHORT, truth="kinematic")
    exact = msgspec.structs.replace(drawn, truth_spread=0.0)
    # The gain that the file leaves out is that of Coulomb friction.
    expected = msgspec.structs.replace(ALPHA.indices, epsilon_F=coulomb_gains(ALPHA).epsilon_F)
    assert run_scenario(exact, ALPHA).motion.parameters == expected
    assert run_scenario(drawn, ALPHA).motion.parameters != expected


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"trajectory": "slalon"}, "did you mean 'slalom'"),
        ({"seed": 10**23}, "seed must be a whole number"),
        ({"duration": -1.0}, "duration"),
        ({"trajectory_options": {"hodl": 1.0}}, "has no option 'hodl'; did you mean 'hold'"),
        ({"trajectory_file": "drive.csv"}, "set trajectory = 'recorded'"),
        ({"track_rate": 1e4, "duration": 600.0}, "track_rate = 10000.0 Hz over 600.0 s makes 6e"),
        ({"duration": 3e4}, "the true motion at 200 Hz .* makes 6e"),
        ({"outages": ((9.0, 5.0),)}, "an outage must end after it starts, found 9.0 to 5.0 s"),
        ({"outages": ((5.0, 400.0),)}, "an outage must lie within the run of 300.0 s"),
        (
            {"patches": (Patch(time=(300.0, 310.0), friction=0.3),)},
            "time of all patches is outside",
        ),
        (
            {"payloads": (Payload(time=(400.0, 410.0), mass=1.0),)},
            "time of all payloads is outside",
        ),
        (KINEMATIC | {"patches": PATCHES}, "kinematic truth does not support patches"),
        (KINEMATIC | {"patches": PATCHES, "payloads": LOADS}, "support patches or payloads"),
        (KINEMATIC | {"track_lag": 0.1}, "kinematic truth does not support track_lag"),
        (KINEMATIC | {"terrain": Terrain(slope_deg=1.0)}, "truth does not support terrain"),
    ],
)
def test_bad_scenarios_are_refused_in_one_line(values, message):
    with pytest.raises(SimulationError, match=message) as caught:
        Scenario(**values)
    assert "\n" not in str(caught.value)


def test_what_is_no_robot_or_no_run_is_refused():
    with pytest.raises(SimulationError, match=r"load it with load_robot\('auriga-alpha'\)"):
        simulate(SHORT, "auriga-alpha")
    for index in (-1, 0.5, 2**63):
        with pytest.raises(SimulationError, match="run_index must be a whole number from 0"):
            simulate(SHORT, ALPHA, run_index=index)


def written(tmp_path, text):
    path = tmp_path / "run.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_scenario_is_read_from_a_file(tmp_path):
    text = """
    trajectory = "spin"
    duration = 10
    noise = "industrial"
    outages = [[4, 5]]
    [trajectory_options]
    speed = 0.3
    [encoders]
    resolution = 0.001
    dropout_reads = "last"
    [gyro]
    range = 1
    [fixes]
    latency = 0.2
    """
    assert load_scenario(written(tmp_path, text)) == Scenario(
        trajectory="spin",
        duration=10.0,
        noise="industrial",
        outages=((4.0, 5.0),),
        trajectory_options={"speed": 0.3},
        encoders=EncoderSpec(resolution=0.001, dropout_reads="last"),
        gyro=InertialSpec(range=1.0),
        fixes=FixSpec(latency=0.2),
    )
    assert load_scenario(written(tmp_path, "")) == Scenario()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("trajectroy = 'spin'", "unknown key 'trajectroy'; did you mean 'trajectory'?"),
        ("[gyro]\nbias_walk = 'x'", "[gyro] bias_walk: expected a number, found text"),
        ("trajectory = 'spin'\n[trajectory_options]\nsped = 1", "did you mean 'speed'?"),
        ("[terrain]\nwavelength = 5", "[terrain] wavelength has no effect"),
        ("[[patches]]\nuphill_deg = 90", "has uphill_deg = 90.0 but no slope_deg"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_that_names_it(text, message, tmp_path):
    path = written(tmp_path, text)
    with pytest.raises(SimulationError) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_changes_go_over_a_scenario_key_by_key():
    base = Scenario(
        trajectory="circle", trajectory_options={"turn": 0.1}, gyro=InertialSpec(range=3)
    )
    changes = {"duration": 5, "gyro": {"bias_walk": 1e-3}, "trajectory_options": {"speed": 0.2}}
    assert change_scenario(base, changes, "test") == Scenario(
        trajectory="circle",
        trajectory_options={"turn": 0.1, "speed": 0.2},
        duration=5.0,
        gyro=InertialSpec(range=3.0, bias_walk=1e-3),
    )
    assert change_scenario(base, {}, "test") == base
    other = change_scenario(base, {"trajectory": "random"}, "test")
    assert other == Scenario(gyro=InertialSpec(range=3.0))
    # Options that the other trajectory has, too, stay.
    change = {"trajectory": "slalom", "trajectory_options": {"highest": 0.2}}
    assert lost_options(base, change) == []
    assert change_scenario(base, change, "test").trajectory_options == {"turn": 0.1, "highest": 0.2}
    assert lost_options(base, {"trajectory": "random"}) == ["turn"]
    recorded = {"trajectory": "recorded", "trajectory_file": "a.csv"}
    drive = Scenario(**recorded, trajectory_options={"factor": 0.5})
    assert lost_options(drive, {"trajectory": "random"}) == ["factor", "trajectory_file"]
    assert change_scenario(drive, {"trajectory": "random"}, "test") == Scenario()
    with pytest.raises(SimulationError, match=r"test: unknown key 'bias' in \[gyro\]"):
        change_scenario(base, {"gyro": {"bias": 1.0}}, "test")


def test_options_reach_the_trajectory():
    slow = Scenario(trajectory="straight", trajectory_options={"speed": 0.2}, duration=10.0)
    assert simulate(slow, ALPHA).truth.tracks.speeds[-1] == pytest.approx([0.2, 0.2])
    fast = Scenario(trajectory="circle", trajectory_options={"speed": 0.9}, duration=10.0)
    with pytest.raises(SimulationError, match="more than max_track_speed"):
        simulate(fast, ALPHA)


def test_a_recorded_drive_from_a_file_beside_the_scenario_and_from_memory(tmp_path, monkeypatch):
    (tmp_path / "drives").mkdir()
    (tmp_path / "drives" / "one.csv").write_text("t,left,right\n0,0.2,0.4\n5,0.4,0.4\n")
    text = "trajectory = 'recorded'\ntrajectory_file = 'drives/one.csv'\nduration = 12\ntrack_lag = 0\n"
    text += "[fixes]\nheading_sigma = 0.02"
    scenario = load_scenario(written(tmp_path, text))
    monkeypatch.chdir("/")
    log = simulate(scenario, ALPHA)
    # 3 s of standstill and 0.75 s of ramp to 0.4 m/s, then the first sample.
    at = round(3.75 * scenario.truth_rate)
    assert log.truth.tracks.speeds[at] == pytest.approx([0.2, 0.4], abs=0.01)
    assert not log.truth.tracks.speeds[-1].any()
    recording = TrackSpeedSeries(
        np.array([7, 5_000_000_007], dtype=np.int64), np.array([[0.2, 0.4], [0.4, 0.4]])
    )
    bare = msgspec.structs.replace(scenario, trajectory_file=None)
    assert changed(log, simulate(bare, ALPHA, recording=recording)) == set()
    with pytest.warns(UserWarning, match="the recording ends after 8.0 s, the run after 7 s"):
        simulate(msgspec.structs.replace(scenario, duration=7.0), ALPHA)
    with pytest.warns(UserWarning, match="after 70 s: then the robot stands"):
        simulate(msgspec.structs.replace(scenario, duration=70.0), ALPHA)
    with pytest.raises(SimulationError, match="two recordings to drive"):
        simulate(scenario, ALPHA, recording=recording)
    with pytest.raises(SimulationError, match="set trajectory = 'recorded'"):
        simulate(SHORT, ALPHA, recording=recording)
    with pytest.raises(SimulationError, match="'recorded' needs trajectory_file"):
        simulate(bare, ALPHA)


def test_a_run_of_a_study_drives_the_motion_of_another() -> None:
    again = simulate(SHORT, ALPHA, run_index=4, motion_index=1)
    first, own = (simulate(SHORT, ALPHA, run_index=index) for index in (1, 4))
    assert (again.truth.poses.poses == first.truth.poses.poses).all()
    assert (again.truth.poses.poses != own.truth.poses.poses).any()
    assert (again.imu.angular_velocity != first.imu.angular_velocity).any()
