from typing import get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from icreckon import SimulationError, TrackSpeedSeries, changed_robot, load_robot
from icreckon.simulation.drives import trajectories
from icreckon.simulation.drives.drives import TRAJECTORIES, arcs, figure_eight, spin
from icreckon.simulation.drives.recorded import read_recording
from icreckon.simulation.drives.smooth_speeds import ACCELERATION, STANDSTILL, blend_duration
from icreckon.simulation.drives.trajectories import RECORDED, make_trajectory, trajectory_options

ALPHA = load_robot("auriga-alpha")


def keeps_its_limits(command, duration, top):
    step = 0.005
    times = np.arange(0.0, duration, step)
    speeds = command(times)
    assert speeds.shape == (len(times), 2)
    assert np.abs(speeds).max() <= top * (1.0 + 1e-9)
    assert (speeds[times <= STANDSTILL] == 0.0).all()
    rates = np.diff(speeds, axis=0) / step
    if len(rates):
        assert np.abs(rates).max() <= ACCELERATION * (1.0 + 1e-9)
    if len(rates) > 1:
        # Acceleration is continuous: a quintic blend has |jerk| <= 5.78 change / length², and no
        # blend is shorter than 0.2 s.
        assert np.abs(np.diff(rates, axis=0)).max() <= 20.0 * step


def option_values(name):
    """Values for some of the options of a trajectory, within what their types allow."""
    hints = get_type_hints(TRAJECTORIES[name], include_extras=True)
    values = {}
    for option in trajectory_options(name):
        text = str(hints[option])
        low = 0.01 if "gt=0" in text else -1.0 if "ge=-1" in text else 0.0
        # Slaloms of more than 5 Hz have more jerk than `keeps_its_limits` allows for.
        high = 1.0 if "le=1" in text else 5.0 if option in {"lowest", "highest"} else 20.0
        values[option] = st.floats(low, high)
    return st.fixed_dictionaries({}, optional=values)


def contradictory(name, options):
    both = trajectory_options(name) | options
    return (
        (name == "arcs" and both["tightest"] > both["widest"])
        or (name == "slalom" and both["lowest"] > both["highest"])
        or (name == "random" and both["reverse"] + both["stop"] > 1.0)
        or (name == "figure-eight" and both["turn"] == 0.0)
    )


@settings(max_examples=300)
@given(st.data())
def test_whatever_the_options_limits_are_kept_or_the_trajectory_is_refused(data):
    name = data.draw(st.sampled_from(sorted(TRAJECTORIES)))
    options = data.draw(option_values(name))
    duration, top = data.draw(st.floats(0.5, 120.0)), data.draw(st.floats(0.2, 4.0))
    robot = changed_robot(ALPHA, {"vehicle.max_track_speed": top})
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    command, refusal = None, ""
    try:
        command = make_trajectory(name, duration, robot, rng, options)
    except SimulationError as error:
        refusal = str(error)
    if contradictory(name, options):
        assert command is None
    elif command is None:
        assert f"more than max_track_speed = {top} m/s of 'auriga-alpha'" in refusal
        assert abs(options.get("speed", 0.6)) + abs(options.get("turn", 0.3)) > 1.0
    else:
        keeps_its_limits(command, duration, top)


@pytest.mark.parametrize("name", sorted(TRAJECTORIES))
def test_every_trajectory_drives_and_does_not_depend_on_sampling(name):
    command = make_trajectory(name, 60.0, ALPHA, np.random.default_rng(3))
    coarse, fine = np.arange(0.0, 60.0, 0.5), np.arange(0.0, 60.0, 0.125)
    assert np.array_equal(command(coarse), command(fine)[::4])
    assert np.abs(command(fine)).max() > 0.3


@pytest.mark.parametrize("name", ["arcs", "random", "aggressive"])
def test_random_trajectories_follow_their_seed(name):
    times = np.arange(0.0, 60.0, 0.1)

    def speeds(seed, duration=60.0):
        return make_trajectory(name, duration, ALPHA, np.random.default_rng(seed))(times)

    assert np.array_equal(speeds(1), speeds(1))
    assert not np.array_equal(speeds(1), speeds(2))
    assert np.array_equal(speeds(1), speeds(1, duration=200.0))


def test_spin_has_the_on_spot_ratio():
    rng = np.random.default_rng(0)
    left, right = spin(20.0, ALPHA, rng)(np.array([15.0]))[0]
    assert left / right == pytest.approx(-ALPHA.indices.H)
    left, right = spin(20.0, ALPHA, rng, ratio=2.0)(np.array([15.0]))[0]
    assert left / right == pytest.approx(-2.0)
    assert left == pytest.approx(-0.6 * ALPHA.vehicle.max_track_speed)


def test_figure_eight_turns_full_circles_for_constant_indices():
    command = figure_eight(200.0, ALPHA, np.random.default_rng(0))
    times = np.arange(0.0, 200.0, 0.001)
    left, right = command(times).T
    effective_gauge = ALPHA.vehicle.track_gauge * ALPHA.indices.eta0
    heading = np.cumsum(right - left) * 0.001 / effective_gauge
    turns = np.flatnonzero(np.diff(np.sign(right - left)[times > 5.0])) + np.sum(times <= 5.0)
    lobes = np.diff(heading[turns])
    assert len(lobes) >= 4
    assert np.abs(lobes) == pytest.approx(2.0 * np.pi, rel=1e-3)
    assert (np.sign(lobes[1:]) == -np.sign(lobes[:-1])).all()


def test_arcs_have_radii_of_their_range_to_both_sides():
    command = arcs(3000.0, ALPHA, np.random.default_rng(1), tightest=0.5, widest=5.0)
    left, right = command.targets.T
    # Of the centre's path for constant indices, left positive.
    radii = 0.5 * (left + right) * ALPHA.vehicle.track_gauge * ALPHA.indices.eta0 / (right - left)
    assert (np.abs(radii) >= 0.5 - 1e-9).all()
    assert (np.abs(radii) <= 5.0 + 1e-9).all()
    # Evenly in the logarithm, and to either side.
    count = len(radii)
    assert abs((radii > 0.0).mean() - 0.5) < 5.0 * np.sqrt(0.25 / count)
    middle = np.sqrt(0.5 * 5.0)
    assert abs((np.abs(radii) < middle).mean() - 0.5) < 5.0 * np.sqrt(0.25 / count)
    # 4 s in the mean, between ramps.
    held = np.diff(command.starts) - command.lengths[:-1]
    assert abs(held.mean() - 4.0) < 5.0 * 4.0 / np.sqrt(count)
    # As fast as asked, or as the outer track can.
    mean, outer = command.targets.mean(axis=1), command.targets.max(axis=1)
    assert ((np.abs(mean - 0.6) < 1e-9) | (np.abs(outer - 1.0) < 1e-9)).all()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("figure-eigth", {}, "no trajectory named 'figure-eigth'; did you mean 'figure-eight'"),
        ("slalom", {"hihgest": 1.0}, "'slalom' has no option 'hihgest'; did you mean 'highest'"),
        ("figure-eight", {"turn": 0.0}, "'figure-eight' cannot be 0.0: no circle"),
        ("arcs", {"tightest": 5.0, "widest": 2.0}, "tightest = 5.0 is more than widest = 2.0"),
        ("random", {"reverse": 0.7, "stop": 0.4}, "together at most 1, found 0.7 and 0.4"),
        ("stop-and-go", {"rest": "long"}, "cannot be 'long': Expected `float`, got `str`"),
    ],
)
def test_bad_options_are_refused_in_one_line(name, options, message):
    with pytest.raises(SimulationError) as caught:
        trajectories.check_trajectory(name, options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_too_fast_is_refused_with_what_to_lower():
    with pytest.raises(
        SimulationError, match=r"reaches 1.2 m/s.*; raise that, or lower speed or turn"
    ):
        make_trajectory("circle", 10.0, ALPHA, None, {"speed": 0.8, "turn": 0.4})


def series(times, speeds):
    stamps = 1_700_000_000_000_000_000 + np.rint(np.asarray(times) * 1e9).astype(np.int64)
    return TrackSpeedSeries(stamps, np.asarray(speeds, dtype=float))


@settings(max_examples=100)
@given(steps=st.lists(st.floats(0.005, 2.0), min_size=1, max_size=30), data=st.data())
def test_a_recording_is_driven_through_its_samples_without_a_jump(steps, data):
    times = np.concatenate([[0.0], np.cumsum(steps)])
    values = st.lists(st.floats(-1.0, 1.0), min_size=2 * len(times), max_size=2 * len(times))
    speeds = np.reshape(data.draw(values), (-1, 2))
    command = make_trajectory(RECORDED, 60.0, ALPHA, None, {}, series(times, speeds))
    start = STANDSTILL + blend_duration(np.abs(speeds[0]).max())
    assert np.allclose(command(start + times), speeds, atol=1e-6)
    fine = np.linspace(0.0, start + times[-1] + 10.0, 4001)
    driven = command(fine)
    assert (driven[fine <= STANDSTILL] == 0.0).all()
    assert (driven[-1] == 0.0).all()
    # Monotone: between two samples no speed leaves their range.
    for before, after, low, high in zip(
        start + times[:-1],
        start + times[1:],
        np.minimum(speeds[:-1], speeds[1:]),
        np.maximum(speeds[:-1], speeds[1:]),
        strict=True,
    ):
        inside = command(np.linspace(before, after, 17))
        assert (inside >= low - 1e-6).all()
        assert (inside <= high + 1e-6).all()


def test_the_factor_of_a_recording_scales_it():
    drive = series([0.0, 1.0, 2.0], [[1.0, 2.0], [1.5, 2.0], [0.0, 0.0]])
    with pytest.raises(SimulationError, match=r"reaches 2 m/s, more than .* lower factor"):
        make_trajectory(RECORDED, 10.0, ALPHA, None, {}, drive)
    command = make_trajectory(RECORDED, 10.0, ALPHA, None, {"factor": 0.5}, drive)
    start = STANDSTILL + blend_duration(1.0)
    assert np.allclose(command(np.array([start, start + 1.0])), [[0.5, 1.0], [0.75, 1.0]])


def test_a_recording_is_read_from_csv(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("\ufefft, note, right,left\n5.0,a,0.2,0.1\n5.5,b,0.4,0.3\n\n7.0,c,0,-0.1\n")
    read = read_recording(path)
    assert read.stamps.tolist() == [0, 500_000_000, 2_000_000_000]
    assert np.array_equal(read.speeds, [[0.1, 0.2], [0.3, 0.4], [-0.1, 0.0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,left,right\n0,0,0\n", "no column 't' in its first line; found 'time', 'left'"),
        ("t;left;right\n0;0;0\n", "has semicolons between its columns; write commas"),
        ("t,left,right\n0,0,0\n", "needs at least 2 samples, found 1"),
        ("t,left,right\n0,0,0\n1,0,fast\n", "row 2: could not convert string to float: 'fast'"),
        ("t,left,right\n1700000000000000000,0,0\n1700000100000000000,0,0\n", "is it in seconds?"),
        ("t,left,right\n0,0,0\n1,0,0\n1,0,0\n", "found 1 s and then 1 s in row 3; sort"),
    ],
)
def test_bad_recordings_are_refused_in_one_line(text, message, tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text(text)
    with pytest.raises(SimulationError) as caught:
        read_recording(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
