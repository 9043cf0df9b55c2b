"""Saving and restoring: exact continuation, a warm start, and files that do not fit."""

import copy
import json
import pickle
import re

import msgspec
import pytest

from fed_estimators import feed_all, known_with_health, short_log
from icreckon import VARIANTS, Adaptation, EstimatorError, PoseEstimator, changed_robot, load_robot
from icreckon.estimator.base import state as s
from icreckon.estimator.log.measurements import ImuSample, PositionFix, TrackSpeeds
from icreckon.estimator.robot.settings import Settings, StandstillSettings
from icreckon.estimator.streaming.save import VERSION, _checksum

ALPHA = load_robot("auriga-alpha")
STEP = 10_000_000
MEASUREMENTS = list(short_log(duration=8.0, seed=12, truth="kinematic").measurements())
HALF = len(MEASUREMENTS) * 2 // 3
LOADS = PoseEstimator.restore, lambda *args: PoseEstimator.warm_start(*args, off=0.0)


def through_a_file(estimator, folder):
    estimator.save(folder / "saved.json", overwrite=True)
    return PoseEstimator.restore(folder / "saved.json", estimator.robot, estimator.variant.name)


COPIES = {
    "file": through_a_file,
    "pickle": lambda estimator, _: pickle.loads(pickle.dumps(estimator)),  # noqa: S301 - our own
    "deepcopy": lambda estimator, _: copy.deepcopy(estimator),
}


@pytest.fixture
def half_way():
    return feed_all(PoseEstimator(ALPHA), MEASUREMENTS[:HALF])


@pytest.fixture
def saved(half_way, tmp_path):
    path = tmp_path / "saved.json"
    half_way.save(path)
    return path


@pytest.mark.parametrize(
    ("variant", "way"),
    [*((name, "file") for name in VARIANTS), ("gyro", "pickle"), ("inertia-online", "deepcopy")],
)
def test_a_copy_goes_on_as_if_nothing_had_been(variant, way, tmp_path):
    original = feed_all(PoseEstimator(ALPHA, variant), MEASUREMENTS[:HALF])
    copied = COPIES[way](original, tmp_path)
    assert known_with_health(copied) == known_with_health(original)
    assert len(pickle.dumps(original)) < 2_000_000, "it carries a table"
    for m in MEASUREMENTS[HALF:]:
        assert original.feed(m) is copied.feed(m)
    assert known_with_health(copied) == known_with_health(original)


def test_everything_that_was_set_is_there_again(tmp_path):
    settings = Settings(
        use_accelerometer=False,
        adaptation=Adaptation(walk=0.05),
        history=0.25,
        standstill=StandstillSettings(duration=1.0),
    )
    estimator = PoseEstimator(ALPHA, "inertia-fixed", settings=settings, start=(1.0, 2.0, 0.1))
    feed_all(estimator, MEASUREMENTS[:100])
    restored = through_a_file(estimator, tmp_path)
    assert restored.settings == settings
    assert restored.variant == estimator.variant
    assert restored.robot is estimator.robot


def test_the_file_can_be_read_by_people(half_way, saved):
    text = saved.read_text()
    content = json.loads(text)["content"]
    assert content["variant"] == "inertia-online"
    assert content["robot"]["vehicle"]["mass"] == ALPHA.vehicle.mass
    assert content["now"]["state"] == dict(zip(s.STATE_NAMES, half_way.state.tolist(), strict=True))
    assert content["now"]["covariance"] == half_way.covariance.tolist()
    assert len(text.splitlines()) < 1150
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def rewrite(path, change):
    """Change the content of a saved file and sign it anew, as another version of icreckon might."""
    document = json.loads(path.read_text())
    change(document["content"])
    document["checksum"] = _checksum(document["content"])
    path.write_text(json.dumps(document))


def tracks_row(content):
    return next(row for row in content["history"]["measurements"] if row[0] == "tracks")


def now(change):
    """A change of the filter's checkpoint."""
    return lambda content: change(content["now"])


def set_entry(row, column, value):
    def change(checkpoint):
        checkpoint["covariance"][row][column] = checkpoint["covariance"][column][row] = value

    return now(change)


def of_record(*path, value):
    """A value in the record of the filter's checkpoint."""

    def change(checkpoint):
        *parts, last = ("record", *path)
        for part in parts:
            checkpoint = checkpoint[part]
        checkpoint[last] = value

    return now(change)


NONSENSE = {
    "a negative variance": (set_entry(0, 0, -1e-9), "variances must be from 0 to 1e.40"),
    "a huge variance": (set_entry(0, 0, 1e300), "variances must be from 0 to 1e.40"),
    "too much correlation": (set_entry(3, 5, 1e3), "is not positive semidefinite"),
    "an exact state that correlates": (set_entry(0, 0, 0.0), "a state without variance"),
    "no symmetry": (
        now(lambda c: c["covariance"][3].__setitem__(4, 1e-3)),
        "the covariance is not symmetric",
    ),
    "a covariance of the history": (
        lambda c: c["history"]["memory"]["covariance"][4].__setitem__(4, -1.0),
        "variances must be from 0",
    ),
    "a state off the map": (now(lambda c: c["state"].update(x=1e200)), "a value of the state"),
    "parameters out of bounds": (now(lambda c: c["state"].update(eta0=0.5)), "out of bounds: 0.5"),
    "another motion model": (now(lambda c: c["model"].append(0.0)), "motion model remembers"),
    "a lost motion model": (now(lambda c: c["model"].__setitem__(0, 1e200)), "of the motion model"),
    "states of another filter": (
        now(
            lambda c: (
                c["state"].update(wander_x=0.0, wander_y=0.0),
                [row.extend([0.0, 0.0]) for row in c["covariance"]],
                c["covariance"].extend([[0.0] * 31, [0.0] * 31]),
            )
        ),
        "the filter has 29 states, found 31",
    ),
    "a wrong setting": (
        lambda c: c["settings"].update(adaptation={"eta0": -1.0}),
        r"Adaptation.eta0 .* at `\$.settings.adaptation`",
    ),
    "a slip factor": (of_record("slip_factor", value=0.5), r"1.0 - at `\$.now.record.slip_factor`"),
    "a size": (of_record("noise", "gyro", "readings", value=[0.0, 0.0, -1.0, 3]), ">= 0.0"),
    "readings of a standstill": (of_record("still", "end", value=10**6), "needs a stamp"),
    "a stamp": (of_record("stamp", value=2**63), "64 bits"),
    "a speed": (lambda c: tracks_row(c).__setitem__(2, 1e9), "absurdly fast"),
    "a witness": (lambda c: c.update(witnesses={"imu": [-1, 0]}), ">= 0"),
    "a latency": (lambda c: c.update(estimated_latency=1e9), "estimated_latency must be"),
    "measurements behind": (
        lambda c: c.update(behind=[["tracks", 0, 0.0, 0.0, [], []]]),
        "tracks: more is too old than was counted",
    ),
    "a mark behind": (lambda c: c.update(behind=[["mark", 0]]), "no measurement"),
    "a watch that goes back": (
        lambda c: c["watch"]["gyro"].update(stamps=[1, 0], rates=[0.0, 0.0]),
        "stamps of a rate must rise",
    ),
    "a watch with a hole": (
        lambda c: c["watch"]["gyro"].update(stamps=[0, 10**18], rates=[0.0, 0.0]),
        "without holes",
    ),
    "a watch of other blocks": (
        lambda c: c["watch"].update(blocks=[[1.0, 2.0]]),
        "blocks of turning need",
    ),
}


@pytest.mark.parametrize("what", NONSENSE)
def test_what_no_estimator_knows_is_refused(saved, what):
    change, message = NONSENSE[what]
    rewrite(saved, change)
    with pytest.raises(EstimatorError, match=r"saved\.json: not as icreckon writes it: ") as found:
        PoseEstimator.restore(saved, ALPHA)
    assert re.search(message, str(found.value)), str(found.value)
    assert "\n" not in str(found.value)


def test_a_warm_start_refuses_nonsense_too(saved):
    rewrite(saved, set_entry(20, 20, -1.0))
    with pytest.raises(EstimatorError, match="variances must be from 0"):
        PoseEstimator.warm_start(saved, ALPHA, off=1.0)


def test_marks_that_no_estimator_has_are_refused(half_way, tmp_path):
    path = tmp_path / "saved.json"
    for count in range(2):
        half_way.mark(half_way.stamp - count * STEP)
    feed_all(half_way, MEASUREMENTS[HALF:])
    for change, message in (
        (lambda m: m["covariance"][0].__setitem__(0, -1.0), "variances must be from 0"),
        (lambda m: m["cross"][3].__setitem__(3, 1e3), "is not positive semidefinite"),
        (lambda m: m["poses"][1].__setitem__(0, 1e300), "the motion since a mark"),
        (lambda m: m["stamps"].__setitem__(1, m["stamps"][0]), "different marks"),
    ):
        half_way.save(path, overwrite=True)
        rewrite(path, now(lambda c, change=change: change(c["marks"])))
        with pytest.raises(EstimatorError, match=message):
            PoseEstimator.restore(path, ALPHA)


@pytest.mark.parametrize("by", [-(10**13), 10**13])
def test_a_clock_that_is_being_set_is_set_after_a_copy(by, half_way, tmp_path):
    def after(k):
        stamp = before + by + k * STEP
        return [TrackSpeeds(stamp, 0.3, 0.3), ImuSample(stamp + 3, (0.0, 0.0, 0.0), None)]

    before = half_way.stamp
    for k in range(5):
        assert [half_way.feed(m) for m in after(k)] == [False, False]
    copied = through_a_file(half_way, tmp_path)
    for k in range(5, 12):
        for m in after(k):
            assert copied.feed(m) is half_way.feed(m)
    assert by < half_way.stamp - before < by + 10**9
    assert known_with_health(copied) == known_with_health(half_way)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(EstimatorError, match="no such file"):
        PoseEstimator.restore(tmp_path / "none.json", ALPHA)
    with pytest.raises(EstimatorError, match="cannot be read"):
        PoseEstimator.restore(tmp_path, ALPHA)
    other = tmp_path / "other.json"
    for text in ("[]", "{}", '{"format": "something else"}', "3"):
        other.write_text(text)
        with pytest.raises(EstimatorError, match=r"no saved estimator; PoseEstimator\.save writes"):
            PoseEstimator.restore(other, ALPHA)


def test_another_version_of_the_format_is_refused(saved):
    document = json.loads(saved.read_text())
    saved.write_text(json.dumps(document | {"version": 1}))
    with pytest.raises(EstimatorError, match=f"version 1 .* this icreckon reads {VERSION}"):
        PoseEstimator.restore(saved, ALPHA)


def test_another_variant_is_refused(saved):
    for load in LOADS:
        with pytest.raises(EstimatorError, match="'inertia-online', not 'inertia-fixed'"):
            load(saved, ALPHA, "inertia-fixed")


def test_windows_of_long_ago_are_not_stepped_through(saved):
    """A file that would take hours at its next measurement goes on like any other."""
    whole = PoseEstimator.restore(saved, ALPHA)
    rewrite(saved, lambda c: c["watch"].update(next_window=-(10**18)))
    odd = PoseEstimator.restore(saved, ALPHA)
    for stamp in range(whole.stamp + 10_000_000, whole.stamp + 500_000_000, 10_000_000):
        for estimator in (whole, odd):
            estimator.feed(TrackSpeeds(stamp, 0.4, 0.5))
            estimator.feed(ImuSample(stamp, (0.0, 0.0, 0.1), (0.0, 0.0, 9.81)))
    assert odd.pose == pytest.approx(whole.pose, abs=1e-12)


def test_another_robot_is_refused_and_the_message_says_what_differs(saved):
    other = changed_robot(ALPHA, {"vehicle.mass": 300.0})
    renamed = msgspec.structs.replace(other, name="beta")
    for load in LOADS:
        with pytest.raises(EstimatorError, match=r"vehicle\.mass = 258\.0, here it is 300\.0"):
            load(saved, other)
        with pytest.raises(EstimatorError, match=r"name = '.*', here it is 'beta'"):
            load(saved, renamed)


def test_other_noise_is_refused_for_going_on_but_not_for_a_warm_start(saved):
    other = changed_robot(ALPHA, {"imu.gyro_noise_density": 2e-3})
    with pytest.raises(EstimatorError, match=r"imu\.gyro_noise_density .* make a warm start"):
        PoseEstimator.restore(saved, other)
    PoseEstimator.warm_start(saved, other, off=0.0)
    # A scale that was known exactly has the prior of the new file.
    scaled = changed_robot(ALPHA, {"imu.gyro_scale_sigma": 0.005})
    warm = PoseEstimator.warm_start(saved, scaled, off=0.0)
    assert warm.covariance[s.GYRO_SCALE, s.GYRO_SCALE] == pytest.approx(0.005**2)
    turned = changed_robot(ALPHA, {"imu.rotation_rpy_deg": (180.0, 0.0, 0.0)})
    with pytest.raises(EstimatorError, match=r"imu\.rotation_rpy_deg"):
        PoseEstimator.warm_start(saved, turned, off=0.0)
    with pytest.raises(EstimatorError, match=r"use the same robot file, or start again$"):
        PoseEstimator.restore(saved, turned)


def test_notes_and_topics_of_the_robot_file_do_not_matter(saved):
    PoseEstimator.restore(saved, msgspec.structs.replace(ALPHA, note="washed", log={"a": 1}))


def test_nothing_is_replaced_unasked(half_way, saved, tmp_path):
    before = saved.read_bytes()
    with pytest.raises(EstimatorError, match=r"exists already; give overwrite=True"):
        half_way.save(saved)
    assert saved.read_bytes() == before
    feed_all(half_way, MEASUREMENTS[HALF:])
    half_way.save(saved, overwrite=True)
    assert saved.read_bytes() != before
    with pytest.raises(EstimatorError, match="is a folder; give the path of a file"):
        half_way.save(tmp_path, overwrite=True)
    with pytest.raises(EstimatorError, match="cannot be written"):
        half_way.save(tmp_path / "no" / "folder.json")
    assert [path.name for path in tmp_path.iterdir()] == [saved.name]


def test_a_disk_that_fails_leaves_the_old_file_and_nothing_else(half_way, saved, monkeypatch):
    before = saved.read_bytes()

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(EstimatorError, match="cannot be written: No space left"):
        half_way.save(saved, overwrite=True)
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_a_warm_start_takes_over_what_was_learnt_and_nothing_else(half_way, saved):
    off = 3600.0
    start, sigma = (4.0, 5.0, 0.6), (0.1, 0.2, 0.3)
    warm = PoseEstimator.warm_start(saved, ALPHA, off=off, start=start, start_sigma=sigma)
    fresh = PoseEstimator(ALPHA, start=start, start_sigma=sigma)
    learnt = s.LEARNT
    expected = fresh.covariance
    expected[learnt, learnt] = half_way.covariance[learnt, learnt]
    expected[s.GYRO_BIAS, s.GYRO_BIAS] += ALPHA.imu.gyro_bias_walk**2 * off
    for index in (s.GYRO_BIAS_X, s.GYRO_BIAS_Y):
        expected[index, index] += ALPHA.imu.gyro_bias_walk**2 * off
    for index in (s.ACCELEROMETER_BIAS_X, s.ACCELEROMETER_BIAS_Y):
        expected[index, index] += ALPHA.imu.accelerometer_bias_walk**2 * off
    assert warm.covariance == pytest.approx(expected, rel=1e-14, abs=0.0)
    assert warm.parameters == half_way.parameters
    assert warm.biases == half_way.biases
    assert warm.pose.tolist() == list(start)
    others = [i for i in range(s.SIZE) if not learnt.start <= i < learnt.stop]
    assert warm.state[others].tolist() == fresh.state[others].tolist()
    assert warm.stamp is None
    assert warm.health.sensors == {}


def test_after_a_warm_start_the_clock_may_be_another(saved):
    warm = PoseEstimator.warm_start(saved, ALPHA, off=10.0)
    bias = warm.biases["gyro_bias"]
    assert bias != 0.0
    assert warm.feed(ImuSample(5 * STEP, (0.0, 0.0, bias))) is False
    assert warm.feed(TrackSpeeds(4 * STEP, 0.0, 0.0)) is True
    # The sample that came first is worked through again, from what was taken over.
    assert warm.stamp == 5 * STEP
    assert warm.biases["gyro_bias"] == pytest.approx(bias, abs=1e-3)
    assert warm.feed(PositionFix(6 * STEP, 0.0, 0.0, 0.01)) is True


@pytest.mark.parametrize("off", [-1.0, float("nan"), float("inf")])
def test_time_off_must_be_a_time(saved, off):
    with pytest.raises(EstimatorError, match="off must be a time in seconds"):
        PoseEstimator.warm_start(saved, ALPHA, off=off)
