"""Speeds of both sides by those of their wheels."""

from __future__ import annotations

from icreckon.estimator.faults.odd_wheels import least_apart, middle_of, take_wheels
from icreckon.estimator.log.measurements import TrackSpeeds
from icreckon.estimator.sensors.held_tracks import TrackRecord


def by_wheels(held: TrackRecord, m: TrackSpeeds, fastest: float) -> TrackSpeeds:
    """Track speeds without the wheels that disagree with the others of their side.

    Args:
        held: record of the track speeds, with that of the wheels, changed in place.
        m: track speeds.
        fastest: highest speed of a track [m/s].
    """
    if not (m.left_wheels or m.right_wheels):
        return m
    limit, wheels = least_apart(fastest), (m.left_wheels, m.right_wheels)
    middles = middle_of(m.left, wheels[0], limit), middle_of(m.right, wheels[1], limit)
    sides = held.left_wheels, held.right_wheels
    return TrackSpeeds(m.stamp, *take_wheels(*sides, held.spin, m.stamp, middles, wheels))
