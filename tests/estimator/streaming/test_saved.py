"""Saving and restoring: exact continuation, a warm start, and files that do not fit."""

import copy
import json
import pickle
import re

import msgspec
import numpy as np
import pytest

from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.log.measurements import ImuSample, PositionFix, TrackSpeeds
from icreckon.estimator.robot.robot_file import load_robot
from icreckon.estimator.robot.settings import Settings, StandstillSettings
from icreckon.estimator.robot.variants import VARIANTS, Adaptation
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.simulation.scenario import Scenario
from icreckon.simulation.sensors.specs import FixSpec
from icreckon.simulation.simulate import simulate

ALPHA = load_robot("auriga-alpha")
STEP = 10_000_000
SCENARIO = Scenario(
    duration=8.0,
    trajectory="aggressive",
    seed=12,
    truth="kinematic",
    track_rate=25.0,
    imu_rate=50.0,
    fixes=FixSpec(heading_sigma=0.05),
)
MEASUREMENTS = list(simulate(SCENARIO, ALPHA).measurements())
HALF = len(MEASUREMENTS) * 2 // 3


def feed_all(estimator, measurements):
    for measurement in measurements:
        estimator.feed(measurement)
    return estimator


def known(estimator):
    arrays = (estimator.state, estimator.covariance, estimator.twist)
    return estimator.stamp, estimator.stands, estimator.health, *(a.tobytes() for a in arrays)


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


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_copy_goes_on_as_if_nothing_had_been(variant, way, tmp_path):
    original = feed_all(PoseEstimator(ALPHA, variant), MEASUREMENTS[:HALF])
    copied = COPIES[way](original, tmp_path)
    assert known(copied) == known(original)
    for m in MEASUREMENTS[HALF:]:
        assert original.feed(m) is copied.feed(m)
    assert known(copied) == known(original)


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("count", [0, 1, 2, 3, 17, 200])
def test_what_comes_late_after_a_copy_is_taken_in_where_it_belongs(way, count, tmp_path):
    held_back = [m for i, m in enumerate(MEASUREMENTS[:count]) if i % 5 == 2]
    others = [m for i, m in enumerate(MEASUREMENTS[:count]) if i % 5 != 2]
    original = feed_all(PoseEstimator(ALPHA, start_sigma=(0.1, 0.1, 0.1)), others)
    copied = COPIES[way](original, tmp_path)
    for m in held_back + MEASUREMENTS[count : count + 50]:
        assert original.feed(m) is copied.feed(m)
        assert known(copied) == known(original)


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


def test_a_clock_that_is_being_watched_is_watched_on(half_way, tmp_path):
    ahead = MEASUREMENTS[HALF].stamp + 10**12
    for k in range(5):
        assert not half_way.feed(ImuSample(ahead + k * STEP, (0.0, 0.0, 0.0)))
    restored = through_a_file(half_way, tmp_path)
    taken = [restored.feed(ImuSample(ahead + k * STEP, (0.0, 0.0, 0.0))) for k in range(5, 10)]
    assert taken == [False] * 4 + [True]


def test_the_file_can_be_read_by_people(half_way, saved):
    text = saved.read_text()
    content = json.loads(text)["content"]
    assert content["variant"] == "inertia-online"
    assert content["robot"]["vehicle"]["mass"] == ALPHA.vehicle.mass
    assert content["now"]["state"] == dict(zip(s.STATE_NAMES, half_way.state.tolist(), strict=True))
    assert content["now"]["covariance"] == half_way.covariance.tolist()
    assert len(text.splitlines()) < 900
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


# --- what does not fit ------------------------------------------------------------------------------


def test_a_cut_file_is_refused_wherever_it_was_cut(saved):
    whole = saved.read_bytes()
    for length in range(0, len(whole) - 2, len(whole) // 60):
        saved.write_bytes(whole[:length])
        with pytest.raises(EstimatorError, match=r"saved\.json: damaged, or no saved estimator"):
            PoseEstimator.restore(saved, ALPHA)


def test_a_changed_digit_is_noticed_wherever_it_is(saved):
    whole = saved.read_text()
    digits = [i for i, c in enumerate(whole) if c in "123456789" and i > whole.index('"content"')]
    rng = np.random.default_rng(0)
    for place in rng.choice(digits, 60, replace=False).tolist():
        changed = "1" if whole[place] != "1" else "2"
        text = whole[:place] + changed + whole[place + 1 :]
        if json.loads(text) == json.loads(whole):
            continue  # A seventeenth digit may be of no consequence.
        saved.write_text(text)
        with pytest.raises(EstimatorError, match="damaged"):
            PoseEstimator.restore(saved, ALPHA)
    saved.write_text(whole)
    PoseEstimator.restore(saved, ALPHA)


def rewrite(path, change):
    """Change the content of a saved file and sign it anew, as another version of icreckon might."""
    from icreckon.estimator.streaming.save import _checksum

    document = json.loads(path.read_text())
    change(document["content"])
    document["checksum"] = _checksum(document["content"])
    path.write_text(json.dumps(document))


def tracks_row(content):
    return next(row for row in content["history"]["measurements"] if row[0] == "tracks")


CHANGES = {
    "no state": lambda c: c["now"].pop("state"),
    "a state is missing": lambda c: c["now"]["state"].pop("yaw"),
    "a row is missing": lambda c: c["now"]["covariance"].pop(),
    "not finite": lambda c: c["now"]["state"].update(x=None),
    "an unknown key": lambda c: c.update(more=1),
    "an unknown stream": lambda c: c["history"]["measurements"][3].__setitem__(0, "sonar"),
    "a short row": lambda c: tracks_row(c).pop(),
    "a row with a word": lambda c: tracks_row(c).__setitem__(2, "fast"),
    "an empty row": lambda c: c["history"]["measurements"][3].clear(),
    "disorder": lambda c: c["history"]["measurements"].reverse(),
    "no history": lambda c: c.update(history=None),
    "an unknown gate": lambda c: c["now"]["rejected_in_a_row"].update(sonar=1),
    "a wrong setting": lambda c: c["settings"].update(history=-1.0),
    "a wrong gate": lambda c: c["settings"]["gates"].update(patience=-1),
}


def test_a_wrong_setting_in_a_file_is_named_with_its_place(saved):
    rewrite(saved, lambda c: c["settings"].update(adaptation={"eta0": -1.0}))
    said = (
        "saved.json: not as icreckon writes it: Adaptation.eta0 must be zero or a positive number, "
        "found -1.0 - at `$.settings.adaptation`"
    )
    with pytest.raises(EstimatorError, match=re.escape(said)):
        PoseEstimator.restore(saved, ALPHA)


@pytest.mark.parametrize("change", CHANGES)
def test_a_file_that_is_not_as_it_should_be_is_refused(saved, change):
    rewrite(saved, CHANGES[change])
    with pytest.raises(EstimatorError, match=r"saved\.json: not as icreckon writes it"):
        PoseEstimator.restore(saved, ALPHA)


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
    for version in (1, 2, 3, 99):
        document["version"] = version
        saved.write_text(json.dumps(document))
        message = rf"version {version} .* is not known; this icreckon reads 4"
        with pytest.raises(EstimatorError, match=message):
            PoseEstimator.restore(saved, ALPHA)


def test_another_variant_is_refused(saved):
    for load in (PoseEstimator.restore, lambda *args: PoseEstimator.warm_start(*args, off=0.0)):
        with pytest.raises(
            EstimatorError, match="by the variant 'inertia-online', not 'inertia-fi"
        ):
            load(saved, ALPHA, "inertia-fixed")


def changed(table, **values):
    return msgspec.structs.replace(
        ALPHA, **{table: msgspec.structs.replace(getattr(ALPHA, table), **values)}
    )


def test_another_robot_is_refused_and_the_message_says_what_differs(saved):
    other = changed("vehicle", mass=300.0)
    renamed = msgspec.structs.replace(other, name="beta")
    for load in (PoseEstimator.restore, lambda *args: PoseEstimator.warm_start(*args, off=0.0)):
        with pytest.raises(EstimatorError, match=r"vehicle\.mass = 258\.0, here it is 300\.0"):
            load(saved, other)
        with pytest.raises(EstimatorError, match=r"name = '.*', here it is 'beta'"):
            load(saved, renamed)


def test_other_noise_is_refused_for_going_on_but_not_for_a_warm_start(saved):
    other = changed("imu", gyro_noise_density=2e-3)
    with pytest.raises(EstimatorError, match=r"imu\.gyro_noise_density .* make a warm start"):
        PoseEstimator.restore(saved, other)
    PoseEstimator.warm_start(saved, other, off=0.0)
    turned = changed("imu", rotation_rpy_deg=(180.0, 0.0, 0.0))
    with pytest.raises(EstimatorError, match=r"imu\.rotation_rpy_deg"):
        PoseEstimator.warm_start(saved, turned, off=0.0)


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
    with pytest.raises(EstimatorError, match="exists already"):
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


# --- a warm start -----------------------------------------------------------------------------------


def test_a_warm_start_takes_over_what_was_learnt_and_nothing_else(half_way, saved):
    off = 3600.0
    start, sigma = (4.0, 5.0, 0.6), (0.1, 0.2, 0.3)
    warm = PoseEstimator.warm_start(saved, ALPHA, off=off, start=start, start_sigma=sigma)
    fresh = PoseEstimator(ALPHA, start=start, start_sigma=sigma)
    learnt = s.LEARNT
    expected = fresh.covariance
    expected[learnt, learnt] = half_way.covariance[learnt, learnt]
    expected[s.GYRO_BIAS, s.GYRO_BIAS] += ALPHA.imu.gyro_bias_walk**2 * off
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


def test_a_warm_start_may_have_other_settings(saved):
    settings = Settings(history=0.5, use_accelerometer=False)
    assert PoseEstimator.warm_start(saved, ALPHA, off=0.0, settings=settings).settings == settings
    assert PoseEstimator.warm_start(saved, ALPHA, off=0.0).settings == Settings()


@pytest.mark.parametrize("off", [-1.0, float("nan"), float("inf")])
def test_time_off_must_be_a_time(saved, off):
    with pytest.raises(EstimatorError, match="off must be a time in seconds"):
        PoseEstimator.warm_start(saved, ALPHA, off=off)
