"""Poses from a chain of tf transforms, at the stamps of its slowest link."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.replay.bags.decoding import stamp_of
from icreckon.replay.bags.message_types import TF, TF_ROS1, TRANSFORM
from icreckon.replay.bags.records import Record
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.reading.clocks import UsedClock
from icreckon.replay.reading.stream import NAN, RowReader, Rows, Stream

LONGEST_INTERPOLATION = 1.0  # longest interval over which poses are interpolated [s]
ROW_WIDTH = 7  # x, y, z, q_x, q_y, q_z, q_w
IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # transform of a frame to itself

Link = tuple[str, str]


class _Poses(NamedTuple):
    """Poses (n,) of a frame in another; one pose stands for all."""

    translations: Floats  # (n, 3) [m]
    rotations: Any  # n of scipy's rotations


def _unread(_: Any) -> None:
    """Placeholder among the readers: `TransformStream` reads these types itself."""


TRANSFORM_READERS = {TF: _unread, TF_ROS1: _unread, TRANSFORM: _unread}


@dataclass(kw_only=True)
class TransformStream(Stream):
    """Poses of one frame in another, from a tf topic and its `_static` companion."""

    readers: Mapping[str, RowReader] = field(default_factory=TRANSFORM_READERS.copy)
    frames: tuple[str, str] = ("", "")  # the parent frame of the poses, and the child frame
    _links: dict[Link, Rows] = field(default_factory=dict)  # x, y, z, q_x, q_y, q_z, q_w
    _static: dict[Link, Floats] = field(default_factory=dict)

    @property
    def topics(self) -> dict[str, bool]:
        """The topic, and its static companion, which a bag may lack."""
        return {self.topic: True, f"{self.topic}_static": False}

    def extend(self, other: Stream) -> None:
        """Append a stream of the same purpose from another file."""
        super().extend(other)
        if isinstance(other, TransformStream):
            self._static.update(other._static)
            for link, rows in other._links.items():
                self._links.setdefault(link, Rows()).extend(rows)

    def arrays(self, clock: UsedClock) -> tuple[Stamps, Floats]:
        """Stamps (n,) [ns] and rows (n, 12) as of `message_rows.POSE_READERS`.

        Raises:
            ReplayError: no chain of transforms connects the frames, or all of it is static.
        """
        chain = self._chain()
        moving = [link for link, _ in chain if link in self._links]
        if not moving:
            raise ReplayError(
                f"{self.source}: topic {self.topic!r}: all transforms from {self.frames[0]!r} to "
                f"{self.frames[1]!r} are static, so they show no motion"
            )
        series = {}
        for link in moving:
            link_stamps, rows = self._in_order(clock, self._links[link])
            link_stamps, first = np.unique(link_stamps, return_index=True)
            series[link] = link_stamps, rows[first]
        stamps = min((times for times, _ in series.values()), key=len)
        steps, known = {}, np.ones(len(stamps), dtype=bool)
        for link in moving:
            steps[link], is_known = _interpolated(*series[link], stamps)
            known &= is_known
        poses = self._along(chain, steps, len(stamps))
        self.lose("tf: no transforms near in time", int((~known).sum()))
        # Variances and twist are unknown.
        unknown, (xy, z) = np.full((len(stamps), 5), NAN), np.split(poses.translations, [2], axis=1)
        return stamps[known], np.column_stack([xy, poses.rotations.as_quat(), unknown, z])[known]

    @property
    def static_links(self) -> list[Link]:
        """Parent and child frame of each static transform."""
        return [*self._static]

    def static_pose(self) -> tuple[Floats, Floats] | None:
        """Translation (3,) [m] and rotation (3, 3) of the child frame; None unless static."""
        try:
            chain = self._chain()
        except ReplayError:
            return None
        if any(link not in self._static for link, _ in chain):
            return None
        poses = self._along(chain, {}, 1)
        return poses.translations[0], poses.rotations.as_matrix()[0]

    def _take(self, record: Record, message: Any) -> None:
        self.add_transforms(record.channel.topic, record.time, message)

    def forget_transforms(self, age: int | None = None) -> None:
        """Forget transforms that lag the newest by an age [ns], or all but static ones."""
        newest = max((max(rows.stamped) for rows in self._links.values()), default=0)
        for link, rows in list(self._links.items()):
            first = len(rows.stamped)
            if age is not None:
                first = int(np.searchsorted(np.array(rows.stamped), newest - age))
            del rows.recorded[:first], rows.stamped[:first], rows.values[: first * ROW_WIDTH]
            if not rows.stamped:
                del self._links[link]
        self._rows = Rows()

    def add_transforms(self, topic: str, recorded: int, message: Any) -> None:
        """Add the transforms of a TFMessage or TransformStamped, recorded at a time [ns].

        Transforms on any `topic` but the stream's own are static.
        """
        transforms = getattr(message, "transforms", None)
        for stamped in [message] if transforms is None else transforms:
            parent, child = stamped.header.frame_id.strip("/"), stamped.child_frame_id.strip("/")
            at, q = stamped.transform.translation, stamped.transform.rotation
            row = (at.x, at.y, at.z, q.x, q.y, q.z, q.w)
            norm = float(np.linalg.norm(row[3:]))
            if not (np.isfinite(row).all() and norm > 1e-6):
                self.lose("tf: not finite or no rotation")
                continue
            if topic != self.topic:
                self._static[parent, child] = np.array(row)
                continue
            stamp = stamp_of(stamped.header)
            link = self._links.setdefault((parent, child), Rows())
            link.values.extend(row)
            # `_rows` has the stamps of all links, which show the clock of the stream.
            for rows in (link, self._rows):
                rows.recorded.append(recorded)
                rows.stamped.append(stamp)

    def _chain(self) -> list[tuple[Link, bool]]:
        """Links from the first frame to the second, and whether each is traversed forward."""
        start, goal = (frame.strip("/") for frame in self.frames)
        links = [*self._links, *self._static]
        # Breadth-first search; of each frame the one before it, and the link between.
        reached_by: dict[str, tuple[str, Link, bool] | None] = {start: None}
        queue = deque([start])
        while queue and goal not in reached_by:
            frame = queue.popleft()
            for link in links:
                for source, target, forward in ((*link, True), (*link[::-1], False)):
                    if source == frame and target not in reached_by:
                        reached_by[target] = (frame, link, forward)
                        queue.append(target)
        if goal not in reached_by:
            found = ", ".join(f"{parent} -> {child}" for parent, child in sorted(links))
            raise ReplayError(
                f"{self.source}: topic {self.topic!r}: no chain of transforms from {start!r} to "
                f"{goal!r}; there is {found or 'none at all'}"
            )
        chain = []
        while (step := reached_by[goal]) is not None:
            goal, link, forward = step
            chain.append((link, forward))
        return chain[::-1]

    def _along(
        self, chain: list[tuple[Link, bool]], moving: Mapping[Link, _Poses], count: int
    ) -> _Poses:
        """Poses (count,) along a chain by those of moving links; the others are static."""
        poses = _poses(np.tile(IDENTITY, (count, 1)))
        for link, forward in chain:
            places, turns = moving.get(link) or _poses(self._static[link][None])
            if not forward:
                turns = turns.inv()
                places = -turns.apply(places)
            poses = _Poses(
                poses.translations + poses.rotations.apply(places), poses.rotations * turns
            )
        return poses


def _interpolated(stamps: Stamps, rows: Floats, wanted: Stamps) -> tuple[_Poses, Any]:
    """Interpolate the poses of a link at wanted stamps; also the mask of valid ones."""
    from scipy.spatial.transform import Slerp

    is_within = (wanted >= stamps[0]) & (wanted <= stamps[-1])
    after = np.clip(np.searchsorted(stamps, wanted), 0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    gap = (stamps[after] - stamps[before]) * NANOSECOND
    is_known = is_within & ((stamps[after] == wanted) | (gap <= LONGEST_INTERPOLATION))
    times = (stamps - stamps[0]) * NANOSECOND
    wanted_times = np.clip((wanted - stamps[0]) * NANOSECOND, 0.0, times[-1])
    translations, rotations = _poses(rows)
    columns = [np.interp(wanted_times, times, column) for column in translations.T]
    if len(stamps) > 1:
        rotations = Slerp(times, rotations)(wanted_times)
    return _Poses(np.column_stack(columns), rotations), is_known


def _poses(rows: Floats) -> _Poses:
    from scipy.spatial.transform import Rotation

    return _Poses(rows[:, :3], Rotation.from_quat(rows[:, 3:]))
