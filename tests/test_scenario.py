import subprocess
import sys

import msgspec
import numpy as np
import pytest

from estimator.config import convert
from estimator.log import screen
from estimator.robot import load_robot
from simulation.errors import SimulationError
from simulation.scenario import Scenario, grid_rate, random_streams, run_scenario, simulate
from simulation.sensors import EPOCH

ALPHA = load_robot("auriga-alpha")
SHORT = Scenario(trajectory="aggressive", duration=20.0, seed=4, fix_heading_sigma=0.02)


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
    assert log.truth.source == "kinematic"
    assert log.start == EPOCH == 1_700_000_000_000_000_000
    assert log.duration == pytest.approx(20.0)
    assert np.array_equal(log.truth.twists.stamps, log.truth.tracks.stamps)
    assert "auriga-alpha" in log.name
    assert len(list(log.measurements())) == 1001 + 2001 + 2 * 21


def test_the_log_passes_the_screen():
    log = simulate(SHORT, ALPHA)
    assert not screen("tracks", log.tracks.stamps, log.tracks.speeds)[1]
    assert not screen("imu", log.imu.stamps, log.imu.angular_velocity)[1]
    assert not screen("fixes", log.fixes.stamps, log.fixes.poses, positive=log.fixes.variances)[1]


def test_the_same_seed_gives_the_same_bits():
    first = run_scenario(SHORT, ALPHA)
    again = run_scenario(SHORT, ALPHA)
    assert changed(first.log, again.log) == set()
    assert first.true_parameters == again.true_parameters
    assert np.array_equal(first.gyro_bias, again.gyro_bias)


@pytest.mark.parametrize("other", [{"seed": 5}, {"run_index": 1}])
def test_another_seed_or_run_gives_another_run(other):
    scenario = msgspec.structs.replace(SHORT, seed=other.get("seed", SHORT.seed))
    log = simulate(scenario, ALPHA, run_index=other.get("run_index", 0))
    assert changed(simulate(SHORT, ALPHA), log) == set(streams(log))


@pytest.mark.parametrize(
    ("overrides", "stream"),
    [
        ({"tracks_factor": 0.0}, "tracks"),
        ({"gyro_factor": 0.0}, "gyro"),
        ({"gyro_bias_walk": 1.0}, "gyro"),
        ({"accelerometer_noise_density": 0.0}, "accelerometer"),
        ({"fix_factor": 0.0}, "fixes"),
    ],
)
def test_one_sensor_s_noise_changes_no_other_stream(overrides, stream):
    scenario = msgspec.structs.replace(SHORT, noise_overrides=overrides)
    assert changed(simulate(SHORT, ALPHA), simulate(scenario, ALPHA)) == {stream}


def test_noise_presets_leave_the_truth_alone():
    scenario = msgspec.structs.replace(SHORT, noise="perfect")
    perfect = run_scenario(scenario, ALPHA)
    assert changed(simulate(SHORT, ALPHA), perfect.log) == {
        "tracks",
        "gyro",
        "accelerometer",
        "fixes",
    }
    assert not perfect.gyro_bias.any()
    at = np.arange(0, 2001, 2)
    assert np.allclose(
        perfect.log.imu.angular_velocity[at, 2], perfect.log.truth.twists.twists[:, 2], atol=1e-12
    )


def test_streams_are_independent():
    draws = [generator.standard_normal(20_000) for generator in random_streams(1, 0)]
    draws += [generator.standard_normal(20_000) for generator in random_streams(1, 1)]
    correlation = np.corrcoef(draws) - np.eye(len(draws))
    assert np.abs(correlation).max() < 5.0 / np.sqrt(20_000)


def test_rates_choose_the_samples_and_not_the_commands():
    fast = msgspec.structs.replace(SHORT, track_rate=200.0, imu_rate=500.0, truth_rate=10.0)
    log = simulate(fast, ALPHA)
    assert len(log.tracks.stamps) == 4001
    assert len(log.imu.stamps) == 10001
    assert len(log.truth.poses.stamps) == 201
    base = simulate(SHORT, ALPHA).truth.tracks
    assert np.allclose(log.truth.tracks.speeds, base.speeds[::5], atol=1e-9)
    odd = simulate(msgspec.structs.replace(SHORT, track_rate=33.3, imu_rate=130.0), ALPHA)
    assert (np.diff(odd.tracks.stamps) > 0).all()


def test_grid_rate_is_a_multiple_of_the_imu_rate():
    assert [grid_rate(rate) for rate in (50.0, 100.0, 130.0, 200.0, 500.0, 800.0)] == [
        200.0,
        200.0,
        260.0,
        400.0,
        1000.0,
        800.0,
    ]


def test_without_fixes_or_truth():
    scenario = msgspec.structs.replace(SHORT, fix_rate=0.0, include_truth=False)
    result = run_scenario(scenario, ALPHA)
    assert result.log.fixes is None
    assert result.log.truth is None
    assert result.true_parameters is not None


def test_spread_zero_is_the_robot_file():
    scenario = msgspec.structs.replace(SHORT, truth_spread=0.0)
    assert run_scenario(scenario, ALPHA).true_parameters == ALPHA.indices
    assert run_scenario(SHORT, ALPHA).true_parameters != ALPHA.indices


def test_outages_take_fixes_away():
    scenario = msgspec.structs.replace(SHORT, outages=((5.0, 9.5), (15.0, 20.0)))
    seconds = (simulate(scenario, ALPHA).fixes.stamps - EPOCH) / 1e9
    assert seconds.tolist() == [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"trajectory": "slalon"}, "did you mean 'slalom'"),
        ({"truth": "friktion"}, "no truth named 'friktion'"),
        ({"noise": "nominl"}, "did you mean 'nominal'"),
        ({"noise_overrides": {"gyro_bias": 1.0}}, "no noise figure named 'gyro_bias'"),
        ({"noise_overrides": {"gyro_factor": -1.0}}, "gyro_factor must be zero or a positive"),
        ({"duration": 0.0}, "duration must be a positive number, found 0.0"),
        ({"duration": float("nan")}, "duration must be a positive number"),
        ({"imu_rate": -1.0}, "imu_rate must be a positive number"),
        ({"fix_sigma": -0.1}, "fix_sigma must be zero or a positive number"),
        ({"fix_heading_sigma": float("inf")}, "fix_heading_sigma must be"),
        ({"truth_spread": -0.1}, "truth_spread must be"),
        ({"seed": -1}, "seed must be"),
        ({"outages": ((9.0, 5.0),)}, "an outage must end after it starts, found 9.0 to 5.0 s"),
        ({"outages": ((5.0, 400.0),)}, "an outage must lie within the run of 300.0 s"),
        ({"outages": ((-1.0, 4.0),)}, "an outage must lie within the run"),
        ({"outages": ((float("nan"), 4.0),)}, "an outage must end after it starts"),
    ],
)
def test_bad_scenarios_are_refused_in_one_line(values, message):
    with pytest.raises(SimulationError, match=message) as caught:
        Scenario(**values)
    assert "\n" not in str(caught.value)


def test_scenarios_from_plain_data():
    data = {"trajectory": "spin", "duration": 10, "outages": [[4, 5]], "noise_overrides": {}}
    scenario = convert(data, Scenario, "test", SimulationError)
    assert scenario.outages == ((4.0, 5.0),)
    with pytest.raises(SimulationError, match="did you mean 'trajectory'"):
        convert({"trajectroy": "spin"}, Scenario, "test", SimulationError)
    with pytest.raises(SimulationError, match="duration must be a positive number"):
        convert({"duration": -1.0}, Scenario, "test", SimulationError)


def test_a_run_shorter_than_the_standstill_stands_still():
    log = simulate(Scenario(trajectory="stop-and-go", duration=1.0, noise="perfect"), ALPHA)
    assert not log.truth.poses.poses.any()
    assert not log.tracks.speeds.any()


def test_importing_the_simulation_loads_no_heavy_library():
    code = (
        "import sys, simulation.scenario; "
        "print([m for m in ('scipy', 'matplotlib', 'rosbags', 'filterpy', 'replay', 'icreckon') "
        "if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"
