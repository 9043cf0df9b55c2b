"""Assembly of a log from gathered streams: units, clocks, screening."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.log import series
from icreckon.estimator.log.input_checks import ABSURD_RATE
from icreckon.estimator.log.log import Log, screen
from icreckon.estimator.log.measurements import BodyVelocity, HeadingFix, HeightFix, Measurement
from icreckon.estimator.robot.robot_file import Robot
from icreckon.replay.bags.message_types import JOINT_STATE, NAVSATFIX
from icreckon.replay.base.errors import OF_ROBOT_FILE, OF_STAMPS, ApartError, ReplayError
from icreckon.replay.mapping.columns import TrackColumns
from icreckon.replay.mapping.geodesy import Origin, east_north, on_globe
from icreckon.replay.mapping.topics import TrackTopic
from icreckon.replay.mapping.track_units import ANY_COUNTS, counter_range, differences
from icreckon.replay.reading import conversions, message_rows
from icreckon.replay.reading.clocks import Choice, Evidence, choose_clocks
from icreckon.replay.reading.gather import Gathered
from icreckon.replay.reading.stamps import doubled_times, in_both, largest_part
from icreckon.replay.reading.stream import NAN, Stream
from icreckon.replay.reading.wheels import interpolated, of_sides

FEWEST_APART = 20  # fewest samples of tracks and IMU that show two clocks
OVERLAID = ("tracks", "imu")  # streams that indicate a clock set back if both have twice their rate


def assemble(gathered: Gathered, robot: Robot, name: str) -> Log:
    """Assemble a log from gathered streams.

    Raises:
        ReplayError: no usable track speeds although mapped, or values whose interpretation needs a
            setting that the robot file lacks.
    """
    return _Assembly(gathered, robot, choose_clocks(evidence_of(gathered.streams))).log(name)


def evidence_of(streams: Mapping[str, Stream]) -> dict[str, Evidence]:
    """Evidence about the clocks of streams, by purpose."""
    return {purpose: stream.evidence() for purpose, stream in streams.items()}


# Distance of all samples from tracks and IMU that shows another clock, by purpose [s].
ANOTHER_CLOCK = {"fixes": 60.0, "truth": 0.0}


@dataclass
class _Assembly:
    gathered: Gathered
    robot: Robot
    clocks: dict[str, Choice]
    dropped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    _arrays_of: dict[str, tuple[Stamps, Floats]] = field(default_factory=dict)
    _overlaid: list[tuple[int, int]] = field(default_factory=list)
    _part: tuple[int, int] = (0, 0)
    _span: tuple[int, int] | None = None  # first and last stamp of tracks and IMU [ns]
    _origin: Origin | None = None  # origin of the fixes, if they are geodetic
    _heights: tuple[HeightFix, ...] = ()

    def log(self, name: str) -> Log:
        streams = self.gathered.streams
        self.notes += self.gathered.notes
        for purpose, choice in self.clocks.items():
            if not choice.by_default:
                self.notes.append(f"{purpose} by the time of recording: {choice.reason}")
        stamps = [self._ordered(streams[purpose])[0] for purpose in OVERLAID if purpose in streams]
        ends = [
            (int(times.min()), int(times.max())) for times in stamps if len(times) >= FEWEST_APART
        ]
        if len(ends) == len(OVERLAID) and max(ends)[0] > min(end for _, end in ends):
            (first, last), (begin, end) = (np.array(pair) * NANOSECOND for pair in ends)
            raise ApartError(
                f"{self.gathered.source}: the tracks ({first:.1f} to {last:.1f} s) and the IMU "
                f"({begin:.1f} to {end:.1f} s) do not overlap in time: they have two clocks. In tables, "
                "clock_offset in [log.columns.tracks] brings them together; icreckon inspect finds it "
                "where the robot turns"
            )
        if sum(map(len, stamps)):
            # The rest is by clocks that are not set.
            first, last = self._part = largest_part(np.sort(np.concatenate(stamps)))
            inside = [times[(times >= first) & (times <= last)] for times in stamps]
            inside = [times for times in inside if len(times)]
            self._span = min(int(t[0]) for t in inside), max(int(t[-1]) for t in inside)
        self._find_overlaid(stamps)
        tracks = self._tracks(stream) if (stream := streams.get("tracks")) else None
        if tracks is None:
            self.notes.append("no track speeds: the robot file maps no topic for them")
            tracks = series.TrackSpeedSeries(np.empty(0, np.int64), np.empty((0, 2)))
        imu = self._imu(stream) if (stream := streams.get("imu")) else None
        fixes = self._fixes(stream) if (stream := streams.get("fixes")) else None
        headings = self._headings(stream) if (stream := streams.get("heading")) else ()
        velocities = self._velocities(stream) if (stream := streams.get("velocity")) else ()
        truth = self._truth(stream, streams) if (stream := streams.get("truth")) else None
        for stream in streams.values():
            for reason, count in stream.lost.items():
                self.dropped[f"{stream.purpose}: {reason}"] += count
            self.notes += stream.notes
        others: tuple[Measurement, ...] = (*headings, *velocities, *self._heights)
        # Runs start in the frame of the truth, if there is one.
        is_geodetic = truth is None or streams["truth"].msgtype == NAVSATFIX
        return Log(
            name=name,
            tracks=tracks,
            imu=imu,
            fixes=fixes,
            truth=truth,
            dropped=dict(self.dropped),
            notes=tuple(self.notes),
            others=tuple(sorted(others, key=lambda other: other.stamp)),
            origin=self._origin if is_geodetic else None,
        )

    def _spec(self, stream: Stream) -> Any:
        """Entry of the mapping for a stream: columns of a table, or a topic of a bag."""
        mapping = self.gathered.mapping
        entries = mapping.columns if stream.from_table else mapping
        # True track speeds have the joints, and so the entry, of the measured ones.
        return getattr(entries, stream.purpose.removeprefix("truth "))

    def _arrays(self, stream: Stream, width: int) -> tuple[Stamps, Floats]:
        stamps, rows = self._ordered(stream)
        far = (stamps < self._part[0]) | (stamps > self._part[1])
        if not far.all():
            stream.lose("stamp is days from most others", int(far.sum()))
            stamps, rows = stamps[~far], rows[~far]
        if stream.purpose in ANOTHER_CLOCK and len(stamps) and self._span is not None:
            begin, end = self._span
            apart = max(begin - int(stamps[-1]), int(stamps[0]) - end) * NANOSECOND
            if apart > ANOTHER_CLOCK[stream.purpose]:
                stream.lose("stamp of another clock", len(stamps))
                keys = (
                    f": clock_offset in [log.columns.{stream.purpose}]" if stream.from_table else ""
                )
                self.notes.append(
                    f"{OF_STAMPS}no {'fix' if stream.purpose == 'fixes' else 'pose of the truth'} is "
                    f"within the time of tracks and IMU, they are {apart:.4g} s apart: another clock, "
                    f"or unit of time{keys}; {stream.purpose} left out"
                )
                stamps, rows = stamps[:0], rows[:0]
        for begin, end in self._overlaid:
            inside = (stamps >= begin) & (stamps <= end)
            stream.lose("of a time that occurs twice", int(inside.sum()))
            stamps, rows = stamps[~inside], rows[~inside]
        if not stream.purpose.startswith("truth "):
            corrected = stamps - round(self._spec(stream).latency / NANOSECOND)
            # Bags have no stamps below zero, and clocks of tables begin there.
            below = (corrected < 0) & (stamps >= 0)
            stream.lose("stamp less latency is below zero", int(below.sum()))
            stamps, rows = corrected[~below], rows[~below]
        return stamps, rows.reshape(-1, width)

    def _ordered(self, stream: Stream) -> tuple[Stamps, Floats]:
        if stream.purpose not in self._arrays_of:
            self._arrays_of[stream.purpose] = stream.arrays(self.clocks[stream.purpose].clock)
        return self._arrays_of[stream.purpose]

    def _find_overlaid(self, stamps: list[Stamps]) -> None:
        """Find when the recorder's clock was set back: tracks and IMU at twice their rate."""
        if len(stamps) == len(OVERLAID):
            self._overlaid = in_both(*map(doubled_times, stamps))
        for begin, end in self._overlaid:
            self.notes.append(
                f"for {(end - begin) * NANOSECOND:.1f} s there are twice as many track speeds and IMU "
                "samples as usual, as where the recorder's clock was set back: that time is left out "
                "and bridged"
            )

    def _screened(
        self, stream: Stream, stamps: Stamps, values: Floats, positive: Floats | None = None
    ) -> NDArray[np.bool_]:
        keep, reasons = np.empty(0, dtype=bool), dict[str, int]()
        if len(stamps):
            keep, reasons = screen(stream.purpose, stamps, values, positive=positive)
        self.dropped.update(reasons)
        if not keep.any():
            lost = *reasons.items(), *stream.lost.items()
            losses = "".join(f", {count} x {reason}" for reason, count in lost)
            self.notes.append(
                f"{OF_ROBOT_FILE}no usable message for {stream.purpose} on topic {stream.topic!r}{losses}"
            )
        return keep

    def _tracks(self, stream: Stream) -> series.TrackSpeedSeries:
        """Measured track speeds; a ReplayError if none is usable."""
        vehicle, spec = self.robot.vehicle, self._spec(stream)
        width = 2 if conversions.is_twist(stream.msgtype, spec) else len(spec.names)
        stamps, rows = self._arrays(stream, width)
        wheels = conversions.wheel_values(rows, stream.msgtype, spec, vehicle)
        self.notes += _wrap_notes(rows, spec)
        if stream.msgtype in message_rows.BODY_READERS and spec.names:
            what = f"{stream.msgtype} has one speed and a yaw rate"
            ignored = "speed and yaw_rate" if spec.speed else "left and right"
            self.notes.append(f"{OF_ROBOT_FILE}{ignored} of [log.tracks] are ignored: {what}")
        stamps, values = interpolated(stamps, wheels.values, wheels.wrap)
        keep = self._screened(stream, stamps, values)
        stamps, values = stamps[keep], values[keep]
        if wheels.are_counters and len(stamps):
            has_scale = spec.counts_per_turn != ANY_COUNTS
            most = vehicle.max_track_speed if has_scale else math.inf
            stamps, values, lost = differences(stamps, values, wheels.wrap, most)
            stream.lost.update(lost)
            if not len(stamps):
                self.notes.append(f"no usable difference for tracks on topic {stream.topic!r}")
        if not len(stamps):
            reason = self.notes[-1].removeprefix(OF_ROBOT_FILE)
            raise ReplayError(f"{stream.source}: {reason}{self._joints_hint(stream)}")
        left_count, fastest = wheels.left_count, vehicle.max_track_speed
        tracks, notes = of_sides(stamps, values, left_count, spec.names, fastest)
        self.notes += notes
        return tracks

    def _true_tracks(self, stream: Stream) -> series.TrackSpeedSeries | None:
        """True track speeds, of the joints of the measured ones; None if none is usable."""
        vehicle, spec = self.robot.vehicle, self._spec(stream)
        stamps, rows = self._arrays(stream, len(spec.names))
        speeds = rows * spec.signs * vehicle.sprocket_radius
        stamps, speeds = interpolated(stamps, speeds, wrap=None)
        keep = self._screened(stream, stamps, speeds)
        usable, left_count, fastest = speeds[keep], len(spec.left), vehicle.max_track_speed
        tracks, _ = of_sides(stamps[keep], usable, left_count, spec.names, fastest)
        return tracks if keep.any() else None

    def _joints_hint(self, stream: Stream) -> str:
        """Text on the wanted and the found joints of a stream; "" for other types."""
        reader = stream.readers.get(JOINT_STATE)
        if stream.msgtype != JOINT_STATE or not isinstance(reader, message_rows.JointReader):
            return ""
        wanted = ", ".join(reader.joints)
        found = ", ".join(sorted(reader.seen)) or "no joints"
        field_name = "positions" if reader.positions else "velocities"
        return f"; wanted are the {field_name} of the joints {wanted}, found were {found}"

    def _imu(self, stream: Stream) -> series.ImuSeries | None:
        """IMU samples, without specific forces if no row has any; None if none is usable."""
        stamps, rows = self._arrays(stream, 6)
        measured = np.flatnonzero(~np.isnan(rows).all(axis=0))
        # Accelerations of a table of their own are interpolated at the stamps of the gyros.
        stamps, found = interpolated(stamps, rows[:, measured], None, slowest=0)
        rows = np.full((len(stamps), 6), np.nan)
        rows[:, measured] = found
        rates, forces = rows[:, :3], rows[:, 3:]
        if self.robot.imu.gyro_axes == "z":
            rates[:, :2][~(np.abs(rates[:, :2]) <= ABSURD_RATE)] = 0.0  # of axes that are not used
        absent = np.isnan(forces).any(axis=1, keepdims=True)
        keep = self._screened(stream, stamps, np.hstack([rates, np.where(absent, 0.0, forces)]))
        if not keep.any():
            return None
        return series.ImuSeries(stamps[keep], rates[keep], None if absent.all() else forces[keep])

    def _fixes(self, stream: Stream) -> series.FixSeries | None:
        spec = self._spec(stream)
        if stream.msgtype == NAVSATFIX or spec.latitude:
            stamps, poses, variances, heights = self._geodetic(stream)
        else:
            stamps, rows = self._arrays(stream, message_rows.POSE_WIDTH)
            poses, variances, heights = message_rows.pose_parts(rows)
        no_variance = conversions.fill_variances(variances, spec)
        if len(stamps) and no_variance.all():
            table = "[log.columns.fixes]" if stream.from_table else "[log.fixes]"
            raise ReplayError(
                f"{stream.source}: topic {stream.topic!r}: the fixes carry no covariance; give "
                "position_sigma [m], and heading_sigma [rad] if their heading is to be used, in "
                f"{table}"
            )
        stream.lose("no covariance, and no position_sigma given", int(no_variance.sum()))
        stamps, poses = stamps[~no_variance], poses[~no_variance]
        variances, heights = variances[~no_variance], heights[~no_variance]
        poses = conversions.without_unknown_headings(poses, variances)
        position_variance, yaw_variance = variances.T
        # A fix without heading needs no positive yaw variance.
        yaw_variance = np.where(np.isnan(poses[:, 2]), position_variance, yaw_variance)
        used_variances = np.column_stack([position_variance, yaw_variance])
        keep = self._screened(stream, stamps, poses[:, :2], positive=used_variances)
        if not keep.any():
            return None
        self._heights = conversions.fix_heights(stamps[keep], heights[keep], spec)
        place = (*spec.position, 0.0)[:3]
        antennas = np.tile(place, (int(keep.sum()), 1)) if any(place) else None
        return series.FixSeries(stamps[keep], poses[keep], variances[keep], antennas)

    def _geodetic(self, stream: Stream) -> tuple[Stamps, Floats, Floats, Floats]:
        """Stamps, poses, variances, heights of a geodetic stream; notes the origin.

        A truth without an origin of its own has that of the fixes, so that both share a frame.
        """
        origin: Origin | None = self._spec(stream).origin or self._origin
        stamps, rows = self._arrays(stream, 4)
        possible = on_globe(rows) | ~np.isfinite(rows[:, :2]).all(axis=1)
        stream.lose("not a place on the globe", int((~possible).sum()))
        stamps, rows = stamps[possible], rows[possible]
        places, variances = rows[:, :3], rows[:, 3]
        finite = np.isfinite(places[:, :2]).all(axis=1)
        if origin is None and finite.any():
            latitude, longitude, altitude = places[finite][0].tolist()
            origin = (latitude, longitude, altitude if math.isfinite(altitude) else 0.0)
            self.notes.append(
                f"positions of the {stream.purpose} are in metres east and north of the first one, "
                f"[{origin[0]:.8f}, {origin[1]:.8f}, {origin[2]:.2f}]; "
                f"`origin` in the robot file sets another"
            )
        self._origin = origin
        poses = np.full((len(stamps), 3), NAN)
        if origin is not None:
            poses[finite, :2] = east_north(places[finite], origin)
        heights = places[:, 2] - (0.0 if origin is None else origin[2])
        return stamps, poses, np.column_stack([variances, np.full(len(rows), NAN)]), heights

    def _headings(self, stream: Stream) -> tuple[HeadingFix, ...]:
        mapped = self._spec(stream)
        stamps, rows = self._arrays(stream, 2)
        yaw, variances = conversions.headings(rows, mapped)
        if len(stamps) and mapped.sigma is None and np.isnan(rows[:, 1]).all():
            raise ReplayError(
                f"{stream.source}: topic {stream.topic!r}: the headings carry no covariance; give "
                "sigma [rad] in [log.heading]"
            )
        keep = self._screened(stream, stamps, yaw, positive=variances)
        columns = stamps[keep].tolist(), yaw[keep].tolist(), variances[keep].tolist()
        return tuple(map(HeadingFix, *columns))

    def _velocities(self, stream: Stream) -> tuple[BodyVelocity, ...]:
        stamps, rows = self._arrays(stream, message_rows.POSE_WIDTH)
        is_twist = bool(np.isnan(rows[:, 0]).all())
        columns = message_rows.TWIST if is_twist else [0, 1, 2, 5]
        keep = self._screened(stream, stamps, rows[:, columns])
        return tuple(conversions.velocities(stamps[keep], rows[keep], self._spec(stream)))

    def _truth(self, stream: Stream, streams: dict[str, Stream]) -> series.Truth | None:
        spec = self._spec(stream)
        if stream.msgtype == NAVSATFIX:
            stamps, poses, variances, _ = self._geodetic(stream)
            fits = conversions.fit_for_truth(variances[:, 0])
            stream.lose("stated sigma far above the median", int((~fits).sum()))
            stamps, poses = stamps[fits], poses[fits]
            twists, rows = np.full_like(poses, NAN), np.empty((0, message_rows.POSE_WIDTH))
        else:
            stamps, rows = self._arrays(stream, message_rows.POSE_WIDTH)
            poses, twists = message_rows.planar_poses(rows), rows[:, message_rows.TWIST]
        headings = bool(np.isfinite(poses[:, 2]).any())
        keep = self._screened(stream, stamps, poses if headings else poses[:, :2])
        if not keep.any():
            return None
        spatial = message_rows.spatial_part(rows[keep] if len(rows) else rows)
        if spatial is not None:
            # As that of the filters, the height begins at zero.
            spatial[:, 0] -= spatial[0, 0]
        body, true_tracks = None, streams.get("truth tracks")
        if twist_stream := streams.get("truth twist"):
            twist_stamps, true_twists = self._arrays(twist_stream, 3)
            usable = self._screened(twist_stream, twist_stamps, true_twists)
            if usable.any():
                body = series.TwistSeries(twist_stamps[usable], true_twists[usable])
        elif np.isfinite(twists[keep]).all():
            body = series.TwistSeries(stamps[keep], twists[keep])
        return series.Truth(
            poses=series.PoseSeries(stamps[keep], poses[keep], spatial),
            twists=body,
            tracks=self._true_tracks(true_tracks) if true_tracks else None,
            source=self.gathered.truth_source or spec.source or stream.topic,
            headings=headings,
        )


def _wrap_notes(rows: Floats, mapped: TrackTopic | TrackColumns) -> Iterator[str]:
    """Note a range of counters that their readings contradict."""
    if not mapped.are_counters or not len(rows):
        return
    where, (likely_range, span) = f"{OF_ROBOT_FILE}the counters of the tracks", counter_range(rows)
    if likely_range is not None and mapped.wrap != likely_range:
        yield f"{where} start again after {likely_range:g}: set wrap = {likely_range:.1f}"
    elif mapped.wrap is not None and span > mapped.wrap:
        yield f"{where} span {span:g}, more than wrap = {mapped.wrap:g}: set their range, or none"
