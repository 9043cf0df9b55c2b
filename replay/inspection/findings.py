"""Findings of an inspection, as sentences for people."""

from collections.abc import Collection, Iterator

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND
from icreckon.estimator.log.failed_sensors import unequal_sides, working_imu
from icreckon.estimator.log.lag import Lag, NoLag
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.path_heading import heading_fault
from icreckon.replay.bags.message_types import JOINT_STATE
from icreckon.replay.estimates import imu_mounting, wheels
from icreckon.replay.estimates.fix_wander import FixWanderEstimate
from icreckon.replay.estimates.gyro_bias import LEAST_BY_TRACKS, SURE
from icreckon.replay.estimates.latency import objection
from icreckon.replay.estimates.track_by_rate import TrackByRate, extremes
from icreckon.replay.estimates.wheels import Estimate
from icreckon.replay.inspection.guess_topics import is_special, may_be_a_side
from icreckon.replay.inspection.log_estimates import LogEstimates
from icreckon.replay.inspection.static_frames import contradiction
from icreckon.replay.inspection.topic_survey import Survey
from icreckon.replay.mapping.topics import TopicMap

FAST_SPEED, FAST_RATE = 20.0, 120.0
"""Speed and wheel rate that a ground robot hardly exceeds [m/s, rad/s]."""
OF_THE_FILE = ("out of order", "repeated in", "go back")  # words of notes on what a file holds
MOST_STOPS = 8  # highest number of standstills that are listed


def findings(estimates: LogEstimates) -> Iterator[str]:
    """Findings on clocks, streams, lags, tracks, standstills, biases, units and fixes."""
    mapping, log = estimates.mapping, estimates.log
    for purpose, choice in estimates.clocks.items():
        clock = "header stamps" if choice.clock == "header" else "time of recording"
        if not mapping.columns or getattr(mapping, purpose, None) is not None:
            yield f"{purpose}: {clock}; {choice.reason}"
    if log is None:
        return
    part, failure = working_imu(log)
    yield from _stream_findings(estimates, log)
    yield from _track_findings(estimates, part)
    yield from [f"the IMU {failure}: look at its driver and cable"] if failure else []
    yield from _failed_sensors(estimates, part)
    yield from _standstill_findings(estimates, log)
    yield from (f"suspicious: {text}" for text in unit_suspicions(estimates, log))
    yield from _rate_findings(estimates.track)
    yield from _error_findings(estimates)


def _stream_findings(estimates: LogEstimates, log: Log) -> Iterator[str]:
    """Findings on headings of the truth, the order of samples, clocks and lags."""
    fault = None
    if log.truth is not None:
        fault = heading_fault(log.truth) if log.truth.headings else "are missing"
        if fault is not None:
            yield f"truth: headings {fault}: a replay scores positions alone"
    yield from (note for note in log.notes if any(words in note for words in OF_THE_FILE))
    columns = estimates.mapping.columns
    if columns and (tracks := columns.tracks) and tracks.clock_offset:
        drift = f", and gains {1e3 * tracks.clock_drift:.2f} ms/s" if tracks.clock_drift else ""
        yield f"tracks: their clock is {tracks.clock_offset:+.2f} s off the IMU's{drift}, by yaw rates"
    for purpose, latency in estimates.latencies.items():
        yield _lag_finding(purpose, latency, by_yaw_rate=purpose != "truth" or fault is None)


def _lag_finding(purpose: str, lag: Lag | NoLag, *, by_yaw_rate: bool) -> str:
    """Finding on the lag of a stream behind the gyro, or the tracks."""
    if isinstance(lag, NoLag):
        return f"{purpose}: lag behind the gyro not observable: {lag.reason}"
    lags = "lag" if lag.seconds > 0.0 else "lead"
    against = "the gyro (by yaw rate)" if by_yaw_rate else "the tracks (by speed)"
    reason = objection(lag)
    refusal = f"; {reason}: no latency is proposed" if reason else ""
    size = f"{abs(lag.seconds):.2f} s (± {lag.sigma:.1g})"
    return f"{purpose}: stamps {lags} {against} by {size}{refusal}"


def _track_findings(estimates: LogEstimates, log: Log) -> Iterator[str]:
    """Findings on the tracks: counts, effective track, turning against the IMU."""
    mounting, yaw_rates = estimates.mounting, estimates.yaw_rates
    if estimates.mapping.lacks_counts_per_turn:
        yield (
            "tracks: counters; fill in counts_per_turn, and inspect again with --overwrite for the "
            "effective track and radius"
        )
    if estimates.wheels.track is not None:
        yield _track_finding(estimates.wheels.track, estimates.mapping)
    if mounting is not None and (mounting.turning_correlation or 0.0) < -wheels.CLEAR_SIGN:
        yield (
            "tracks: they turn the other way than the gyro (correlation "
            f"{mounting.turning_correlation:.2f}): left and right may be swapped, the gyro's signs "
            "wrong, or the IMU upside down"
        )
    if estimates.are_apart and yaw_rates is not None:
        side = imu_mounting.backward_side(log.tracks, yaw_rates)
        backward = f"the {side} side counts backward, a minus before its names?"
        cause = backward if side else "another robot's topic, or another time's?"
        yield f"tracks: they turn, and the gyro turns, but not together: {cause}"
    if mounting is not None and estimates.imu_mount is not None:
        problem = contradiction(mounting, estimates.imu_mount)
        yield from [problem] if problem else []


def _track_finding(track: Estimate, mapping: TopicMap) -> str:
    """Finding on the effective track by the gyro, as settings of a controller have it."""
    ratio, error = track.value, "" if track.sigma is None else f" (± {track.sigma:.1g})"
    if mapping.from_twist:
        return (
            f"tracks: the odometry turns {ratio:.2f}{error} times as far as the gyro: multiply the "
            f"wheel_separation_multiplier of its controller by {ratio:.2f}"
        )
    unit = "times the effective radius" if mapping.in_rates else "m"
    return (
        f"tracks: the effective track is {ratio:.3g}{error} {unit}, by the gyro; divided by the wheel "
        "separation it is a controller's wheel_separation_multiplier"
    )


def _failed_sensors(estimates: LogEstimates, log: Log) -> Iterator[str]:
    """Findings on sensors that fail in the log or a part of it."""
    yield from (f"tracks: {stuck.text}" for stuck in estimates.stuck)
    has_sides = imu_mounting.are_usable(log.tracks) and not estimates.mapping.from_twist
    rates = estimates.yaw_rates if has_sides else None
    if rates and (unequal := unequal_sides(log.tracks, *rates)):
        yield f"tracks: {unequal.text}: look at counts, gears and radius of both sides"


def _standstill_findings(estimates: LogEstimates, log: Log) -> Iterator[str]:
    """Findings on standstills, and on the bias of the gyro at them."""
    mounting = estimates.mounting
    if len(log.tracks.stamps):
        found = wheels.standstills(log)
        ends = [(*((at - log.start) * NANOSECOND for at in stop), turns) for *stop, turns in found]
        named = [(f"{a:.0f} to {b:.0f} s", b - a, turns) for a, b, turns in ends if b - a >= 1.0]
        stops = [(name, length) for name, length, turns in named if not turns]
        total = sum(length for _, length in stops)
        spans = ", ".join(name for name, _ in stops[:MOST_STOPS])
        more = ", ..." if len(stops) > MOST_STOPS else ""
        text = f"{len(stops)}, {total:.0f} s in all ({spans}{more})"
        yield f"standstills: {text if stops else 'none of a second or more'}"
        for name in [name for name, _, turns in named if turns][:MOST_STOPS]:
            yield f"tracks: at rest while the gyro turns, {name}: carried, or no track speeds?"
    if mounting is not None and mounting.gyro_bias is not None:
        bias = ", ".join(f"{value:.5f}" for value in mounting.gyro_bias)
        text = f"gyro bias at standstill: ({bias}) rad/s in the IMU's axes"
        if estimates.bias is not None and estimates.bias.walk:
            text += "; it changes over the log, as with the temperature: gyro_bias_walk is proposed"
        yield text


def unit_suspicions(estimates: LogEstimates, log: Log) -> Iterator[str]:
    """Findings on values of a log that seem to be in another unit."""
    in_rates, mounting = estimates.mapping.in_rates, estimates.mounting
    if mounting is not None and mounting.specific_force is not None:
        force = float(np.linalg.norm(mounting.specific_force))
        if abs(force - wheels.GRAVITY) > wheels.WRONG_GRAVITY * wheels.GRAVITY:
            guess = wheels.unit_of_gravity(force)
            yield f"mean specific force is {force:.3g}, not {wheels.GRAVITY} m/s²{guess}"
    if log.imu is not None:
        rate_99 = wheels.fast_turning(log.imu)
        if rate_99 > wheels.FAST_TURNING:
            yield f"the gyro reads {rate_99:.3g} and more for 1 % of the time; rad/s, or rather deg/s?"
    yaw_rates = estimates.yaw_rates
    has_turning = estimates.mapping.from_twist and len(log.tracks.stamps) > 1
    if has_turning and yaw_rates and (text := wheels.turning_suspicion(log.tracks, yaw_rates)):
        yield text
    if len(log.tracks.speeds):
        # In rad/s if the tracks are in rates.
        speed_99 = float(np.percentile(np.abs(log.tracks.speeds), 99))
        if in_rates and speed_99 > FAST_RATE and not estimates.mapping.lacks_counts_per_turn:
            yield (
                f"wheel rates of {speed_99:.3g} rad/s: in another unit (rpm, deg/s, counts), or of "
                "motors before a gear (scale in [log.tracks])?"
            )
        if not in_rates and speed_99 > FAST_SPEED:
            yield f"track speeds of {speed_99:.3g}; m/s, or rather mm/s?"
    ratio = estimates.wheels.distance
    if not in_rates and ratio is not None and not 0.5 < ratio.value < 2.0:
        size = f"{ratio.value:.3g} times that of the track speeds"
        yield f"the distance over ground is {size}, by the {ratio.source}"


def _rate_findings(track: TrackByRate | None) -> Iterator[str]:
    """Finding on whether the effective track depends on the yaw rate, if observable."""
    if track is None:
        return
    rates = sorted(abs(rate_bin.rate) for rate_bin in track.bins)
    # Yaw rates that are much alike would not show it.
    if len(rates) < 2 or rates[-1] < 1.5 * rates[0]:
        return
    text = f"tracks: from {rates[0]:.1f} to {rates[-1]:.1f} rad/s the effective track"
    ends = extremes(track.bins)
    if ends is None:
        yield f"{text} does not depend significantly on the yaw rate"
        return
    narrower, wider = (
        f"{width:.3g} (± {sigma:.1g}) {track.unit} at {abs(rate):.2f} rad/s to the "
        f"{'left' if rate > 0.0 else 'right'}"
        for rate, width, sigma, _ in ends
    )
    yield f"{text} depends on the yaw rate: {narrower}, {wider}; --picture FILE draws it"


def _error_findings(estimates: LogEstimates) -> Iterator[str]:
    """Findings on a gyro bias while driving, and on the error of the fixes."""
    bias, wander = estimates.bias, estimates.wander
    if bias is not None and bias.source != "standstill":
        size = f"{bias.value:.4f} ± {bias.sigma:.4f} rad/s about the vertical while driving"
        refusal = "" if bias.differs(0.0) else ": not significant, not written"
        if refusal and abs(bias.value) > SURE * bias.sigma:
            refusal = f": below {LEAST_BY_TRACKS:g} rad/s the tracks may be it, not written"
        yield f"gyro bias: {size}, by the {bias.source}{refusal}"
    if (fit := estimates.fix_fit) is not None and fit.is_late:
        lags = "lag" if fit.lag > 0.0 else "lead"
        yield f"fixes: stamps {lags} the tracks by {abs(fit.lag):.2f} s (± {fit.lag_sigma:.1g})"
    if isinstance(wander, FixWanderEstimate):
        yield f"fixes: {wander.text}"
    elif wander is not None:
        yield f"fixes: whether their error wanders cannot be seen: {wander}"


def missing_tracks(surveys: Collection[Survey]) -> str:
    """Finding that there are no track speeds, with candidates for a person."""
    joints: dict[str, None] = {}  # in the order of the messages
    for survey in surveys:
        if survey.msgtype == JOINT_STATE:
            joints |= dict.fromkeys(name for state in survey.messages for name in state.name)
    numbers = ", ".join(survey.topic for survey in surveys if may_be_a_side(survey))
    text = (
        "no track speeds: nothing here looks like them, and without them nothing can be replayed; name "
        "joints, fields or columns in [log.tracks] or [log.columns.tracks] of the robot file, and "
        "inspect again with --overwrite"
    )
    undefined = ", ".join(
        f"{survey.topic} ({survey.msgtype})"
        for survey in surveys
        if survey.recorded and not survey.messages and is_special(survey)
    )
    if undefined:
        text += f"; the bag holds no definition of {undefined}: give its .msg file with --msg"
    if joints:
        text += f"; joints here are {', '.join(joints)}"
    if numbers:
        text += f"; topics with a number: {numbers} (one of each side: topic, right_topic)"
    return text
