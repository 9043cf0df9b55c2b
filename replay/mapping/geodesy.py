"""Geodesy: latitude and longitude to metres east and north of an origin, and back."""

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats

# Latitude, longitude [deg], altitude [m], on the WGS 84 ellipsoid.
Origin = tuple[float, float, float]


def check_origin(origin: Origin | None) -> None:
    """Raise a ValueError if an origin is not on the globe, or not finite."""
    if origin is None:
        return
    if not (np.isfinite(origin).all() and abs(origin[0]) <= 90.0 and abs(origin[1]) <= 360.0):
        raise ValueError(
            f"origin must be latitude, longitude [deg] and altitude [m], found {list(origin)!r}"
        )


def on_globe(places: Floats) -> NDArray[np.bool_]:
    """Mask (n,) of valid places (n, 3 or more: latitude, longitude [deg], ...).

    Zero for both is invalid: receivers without a fix report it.
    """
    latitude, longitude = places[:, 0], places[:, 1]
    with np.errstate(invalid="ignore"):
        inside = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 360.0)
    return np.asarray(inside & ~((latitude == 0.0) & (longitude == 0.0)))


def east_north(places: Floats, origin: Origin) -> Floats:
    """Convert geodetic places to (n, 2) metres east and north of an origin.

    `places` (n, 3) are latitude, longitude [deg], altitude [m]; for an altitude of NaN that of the origin
    is used, at which the plane is tangent to the ellipsoid.
    """
    from pymap3d import geodetic2enu

    altitude = np.where(np.isfinite(places[:, 2]), places[:, 2], origin[2])
    east, north, _ = geodetic2enu(places[:, 0], places[:, 1], altitude, *origin)
    return np.column_stack([east, north])


def degrees(places: Floats, origin: Origin) -> Floats:
    """Convert metres east and north of an origin to latitude and longitude [deg].

    `places` (n, 2) and the result (n, 2) are at the altitude of the origin, as of `east_north`.
    """
    from pymap3d import enu2geodetic

    up = np.zeros(len(places))
    latitude, longitude, _ = enu2geodetic(places[:, 0], places[:, 1], up, *origin)
    return np.column_stack([latitude, longitude])
