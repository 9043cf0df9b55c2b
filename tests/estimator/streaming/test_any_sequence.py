"""Any sequence of calls: documented errors only, a positive covariance, and copies that go on alike."""

import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from fed_estimators import feed_all, flaw, known_with_health, result_of, short_log
from icreckon import Latencies, PoseEstimator, load_robot
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    PoseFix,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)
from icreckon.estimator.robot.settings import FixWander, GateSettings, Settings

ALPHA = load_robot("auriga-alpha")
EPOCH = 1_700_000_000_000_000_000
STEP = 10_000_000

NUMBERS = st.one_of(
    st.floats(-2.0, 2.0),
    st.floats(),
    st.sampled_from([0, 10**400, True, "1", None, 1j, np.float32(0.3)]),
)
SPEEDS = st.one_of(st.just(0.0), st.floats(-1.0, 1.0), NUMBERS)
VARIANCES = st.one_of(
    st.floats(-300.0, 300.0).map(lambda power: 10.0**power), st.floats(1e-4, 1.0), NUMBERS
)
# Time from the newest stamp to that of the next measurement [ns].
DELAYS = st.one_of(
    st.integers(0, STEP),
    st.integers(-(10**9), 10**9),
    st.sampled_from([-(10**12), 10**11, 10**15, -(2**62), 2**62, 2**63, 10**400, 0.5, None]),
)
SIGMAS = st.sampled_from([0.0, 1e-3, 10.0, 1e6])


@cache
def made(variant, history, patience, wanders, sigma, watches):
    """A new estimator, of which copies are made."""
    return PoseEstimator(
        ALPHA,
        variant,
        settings=Settings(
            history=history,
            gates=GateSettings(patience),
            wander=FixWander(1.0, 10.0) if wanders else None,
        ),
        start_sigma=(sigma, sigma, min(sigma, 10.0)),
        latencies=Latencies(estimate_tracks=watches, position=0.02),
    )


class AnySequence(RuleBasedStateMachine):
    """Calls of an estimator, and of a copy that was saved and restored on the way."""

    @initialize(
        variant=st.sampled_from(["inertia-online", "constant-online", "differential"]),
        history=st.sampled_from([0.0, 1.0]),
        patience=st.sampled_from([0, 3]),
        wanders=st.booleans(),
        sigma=SIGMAS,
        watches=st.booleans(),
    )
    def make(self, **options):
        self.estimator, self.copied = made(**options).copy(), None
        self.newest = EPOCH

    def both(self, call):
        """Call the estimator, and its copy likewise; the text of an error is a result, too."""
        result = result_of(call, self.estimator)
        if self.copied is not None:
            assert repr(result_of(call, self.copied)) == repr(result)
        return result

    def feed(self, kind, delay, *values):
        stamp = None if delay is None else self.newest + delay
        used = self.both(lambda estimator: estimator.feed(kind(stamp, *values)))
        if used is True:
            self.newest = max(self.newest, stamp)

    @rule(left=SPEEDS, right=SPEEDS, delay=DELAYS)
    def feed_tracks(self, left, right, delay):
        self.feed(TrackSpeeds, delay, left, right)

    @rule(rate=NUMBERS, forward=NUMBERS, has_force=st.booleans(), delay=DELAYS)
    def feed_imu(self, rate, forward, has_force, delay):
        force = (forward, 0.1, 9.8) if has_force else None
        self.feed(ImuSample, delay, (0.0, 0.0, rate), force)

    @rule(
        count=st.integers(1, 40),
        left=st.floats(-1.0, 1.0),
        right=st.floats(-1.0, 1.0),
        back=st.sampled_from([0, 0, 0, 10**13]),
    )
    def drive(self, count, left, right, back):
        """An everyday drive, on a clock that may be set back."""
        start = self.newest - back
        for k in range(1, count + 1):
            stamp = start + k * STEP
            tracks = TrackSpeeds(stamp, left, right)
            rate = 0.8 * (right - left) + 1e-4 * (k % 3)
            imu = ImuSample(stamp + 3, (0.0, 0.0, rate), (0.01 * (k % 5), 0.0, 9.8))
            for m in (tracks, imu):
                self.both(lambda estimator, m=m: estimator.feed(m))
        stamp = self.estimator.stamp
        self.newest = start + count * STEP + 3 if back == 0 or stamp is None else stamp

    @rule(x=NUMBERS, y=NUMBERS, variance=VARIANCES, forward=SPEEDS, delay=DELAYS)
    def feed_position(self, x, y, variance, forward, delay):
        self.feed(PositionFix, delay, x, y, variance, forward, 0.1)

    @rule(yaw=NUMBERS, variance=VARIANCES, delay=DELAYS)
    def feed_heading(self, yaw, variance, delay):
        self.feed(HeadingFix, delay, yaw, variance)

    @rule(v_x=SPEEDS, v_y=SPEEDS, variance=VARIANCES, delay=DELAYS)
    def feed_velocity(self, v_x, v_y, variance, delay):
        self.feed(BodyVelocity, delay, v_x, v_y, variance)

    @rule(x=NUMBERS, yaw=NUMBERS, one=VARIANCES, other=VARIANCES, mixed=NUMBERS, delay=DELAYS)
    def feed_pose(self, x, yaw, one, other, mixed, delay):
        rows = ((one, mixed, 0.0), (mixed, other, 0.0), (0.0, 0.0, one))
        self.feed(PoseFix, delay, x, 0.1, yaw, rows)

    @rule(sigma=VARIANCES, other=VARIANCES, delay=DELAYS)
    def feed_standing(self, sigma, other, delay):
        self.feed(ZeroVelocity, delay, (sigma, other, sigma))

    @rule(what=st.sampled_from([None, 3, "imu", object, (), TrackSpeeds]))
    def feed_what_is_no_measurement(self, what):
        assert "no measurement" in self.both(lambda estimator: estimator.feed(what))

    @rule(delay=DELAYS)
    def mark(self, delay):
        stamp = None if delay is None else self.newest + delay
        self.both(lambda estimator: estimator.mark(stamp))

    @rule(place=st.integers(0, 3), delay=DELAYS)
    def forget(self, place, delay):
        marks = self.estimator.marks
        stamp = marks[place] if place < len(marks) else delay
        self.both(lambda estimator: estimator.forget(stamp))

    @rule(place=st.integers(0, 3), end=st.one_of(st.none(), st.integers(0, 3)), delay=DELAYS)
    def look_back(self, place, end, delay):
        marks = self.estimator.marks
        start = marks[place] if place < len(marks) else delay
        stop = marks[end] if end is not None and end < len(marks) else None
        self.both(lambda estimator: estimator.relative_motion(start, stop))

    @rule()
    def save_and_restore(self):
        path = self.folder / "saved.json"
        self.estimator.save(path, overwrite=True)
        self.copied = PoseEstimator.restore(path, ALPHA)

    @precondition(lambda self: self.copied is not None)
    @rule()
    def go_on_with_the_copy(self):
        self.estimator, self.copied = self.copied, None

    @rule(sigma=SIGMAS)
    def restart(self, sigma):
        self.estimator = self.estimator.restarted((1.0, 2.0, 0.3), (sigma, sigma, 0.1))
        self.copied = None

    @invariant()
    def all_is_finite_and_positive(self):
        if not hasattr(self, "estimator"):
            return
        estimator = self.estimator
        assert flaw(estimator.covariance) is None
        assert np.isfinite(estimator.state).all()
        assert np.isfinite(estimator.twist).all()
        assert np.isfinite(estimator.twist_covariance).all()
        for mark in estimator.marks:
            found = estimator.relative_motion(mark)
            assert np.isfinite(found.pose).all()
            assert flaw(found.covariance) is None

    @invariant()
    def the_copy_is_equal(self):
        if getattr(self, "copied", None) is not None:
            assert known_with_health(self.copied) == known_with_health(self.estimator)


def test_any_sequence_of_calls(tmp_path):
    AnySequence.folder = tmp_path
    limits = settings(
        max_examples=40,
        stateful_step_count=40,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(AnySequence, settings=limits)


def test_estimators_in_several_threads_are_those_of_one():
    jobs = [(variant, seed) for variant in ("gyro", "inertia-online") for seed in range(2)]
    logs = [short_log(duration=4.0, seed=seed) for seed in range(2)]
    begin = threading.Barrier(len(jobs))

    def fed(job):
        return known_with_health(feed_all(PoseEstimator(ALPHA, job[0]), logs[job[1]]))

    def together(job):
        begin.wait()
        return fed(job)

    with ThreadPoolExecutor(len(jobs)) as threads:
        assert list(threads.map(together, jobs)) == list(map(fed, jobs))
