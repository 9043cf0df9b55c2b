"""Position fixes that scatter more than stated.

Receivers state covariances that are wrong by factors of ten and more. From one fix to the next, dead
reckoning is off by a few per cent of the way. So the newest fixes are laid over its path by the turn, the
stretch and the shift of least squares, which take out a wrong heading and slip along the tracks. The
residuals are noise of the fixes, if they are large both along the robot and across it: slip leaves more
along, and a gyro's bias more across. A robot that slides down a slope leaves both, but goes on in one
direction: successive differences of the residuals resemble each other, and their differences are small.
Those of noise are not, nor those of an error that walks. Fixes that scatter far more than stated are
used with the variance that they show.

An error that wanders is worse than a white one of the same size, since all fixes of a minute share it.
Then residuals resemble those before them: the sum of squares of their differences is less than twice
that of their own (von Neumann, Distribution of the ratio of the mean square successive difference to the
variance, Annals of Mathematical Statistics 12, 1941). How much less, of white errors and of a random
walk, follows from the path. How long such an error lasts the residuals of some seconds do not show. It is
taken for a minute, as of plain GPS: the fixes of that time count as one.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple, Protocol, TypeVar

import msgspec
import numpy as np

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.base.records import Count, Size, Stamp

# Most and fewest fixes that are laid over the path, and time between two of them [s]: at first less, this
# share of the time since the oldest.
MOST, FEWEST, APART, SHARE_APART = 16, 4, 0.9, 0.25
# Number of fixes from which on the order of the residuals counts.
IN_ORDER = 8
# After a longer time without a fix, the path is no measure [s].
LONGEST = 15.0
# Error of the path from one fix to the next, as a share of it; after more than a second, of so many times
# it as there are seconds.
OF_STEP = 0.08
# Variance by the differences of residuals over what is expected, from which on fixes scatter, and from
# which on they still do; of few fixes it must be larger.
FOUND, STILL, OF_FEW = 4.0, 2.0, 12.0
# Sum of squares of second differences of residuals over that of differences, below which the robot
# slides: it is 3 for white errors, 2 for those that walk, and about 1 for slides of some seconds.
SLIDING = 1.35
# Rejected fixes in a row that are no outliers.
ROW = 3
# Likeness of an error to one that walks, 0 if it is white, 1 if it does: weight of a fix in its mean, its
# value before there is any, that up to which an error is white, and that from which on it walks.
LIKENESS_WEIGHT, LIKENESS_AT_START, WHITE, WALK = 0.025, 0.4, 0.2, 0.55
# Number of fixes over which the correlation of innovations is averaged, and from which on it counts.
AVERAGED, ENOUGH = 100, 30
# Assumed correlation time of an error that wanders [s].
WANDER_TIME = 60.0
# Share of the variance that is kept from one fix to the next, if they scatter less; of an error that
# walks the time until 1/e of it is left [s], since it is calm at times.
KEPT, KEPT_TIME = 0.85, 20.0
# Least way on which the path shows a stretch [m].
LEAST_WAY = 0.1


class PlacedFix(msgspec.Struct, frozen=True, array_like=True):
    """Position fix, and the antenna's place on the path by dead reckoning.

    Attributes:
        stamp: stamp of the fix [ns].
        x: measured [m].
        y: measured [m].
        path_x: on the path [m].
        path_y: on the path [m].
        yaw: yaw on the path [rad].
    """

    stamp: Stamp
    x: float
    y: float
    path_x: float
    path_y: float
    yaw: float


class Scatter(msgspec.Struct, frozen=True):
    """Scatter of the newest position fixes; never changed in place.

    Attributes:
        fixes: the fixes that are laid over the path, oldest first.
        rejected: those that the gate rejected since one was used; outliers, as long as they are few.
        newest: the newest fix.
        interval: mean time between fixes [s].
        antenna: estimated place of the antenna after the newest fix: x, y [m].
        turn: yaw of the estimate less that of the path [rad].
        moved: (SIZE,) corrections of the state with the newest fixes; those of older ones are forgotten.
        likeness: likeness of their errors to those that walk: 0 if they are white, 1 if they do.
        variance: variance with which a fix is used, 0 if the scatter is as stated [m²].
        used: number of fixes that were used with it.
        judged: number of fixes whose innovations were counted, at most `AVERAGED`.
        innovation: normalised innovation of the newest fix, in the axes of odom [-].
        products: averaged product of successive ones.
        squares: averaged square of them.
    """

    fixes: Annotated[tuple[PlacedFix, ...], msgspec.Meta(max_length=MOST)] = ()
    rejected: Annotated[tuple[PlacedFix, ...], msgspec.Meta(max_length=MOST)] = ()
    newest: PlacedFix | None = None
    interval: Size = 0.0
    antenna: tuple[float, float] = (0.0, 0.0)
    turn: float = 0.0
    moved: tuple[float, ...] = ()
    likeness: float = LIKENESS_AT_START
    variance: Size = 0.0
    used: Count = 0
    judged: Count = 0
    innovation: tuple[float, float] = (0.0, 0.0)
    products: float = 0.0
    squares: Size = 0.0

    def of_fix(self, variance: float) -> float:
        """Variance of a fix that states one [m²]."""
        return max(variance, self.variance)

    @property
    def wanders(self) -> bool:
        """True if the residuals resemble those before them."""
        return self.likeness > 0.5 * (WHITE + WALK)

    @property
    def correlation(self) -> float | None:
        """Correlation of successive innovations; None before `ENOUGH`."""
        return self.products / self.squares if self.judged >= ENOUGH and self.squares else None

    def with_innovation(self, x: float, y: float) -> Scatter:
        """Add the normalised innovation of the newest fix [-]."""
        judged, before = min(AVERAGED, self.judged + 1), self.innovation
        return msgspec.structs.replace(
            self,
            judged=judged,
            innovation=(x, y),
            products=self.products + (x * before[0] + y * before[1] - self.products) / judged,
            squares=self.squares + (x * x + y * y - self.squares) / judged,
        )


def scatter_after(
    before: Scatter,
    fix: tuple[int, float, float, float],
    predicted: tuple[float, float, float],
    updated: tuple[float, float, float],
    correction: Floats,
    *,
    admitted: bool,
) -> Scatter:
    """Scatter with another position fix.

    Args:
        before: scatter before it.
        fix: its stamp [ns], x and y [m], and the variance that it states [m²].
        predicted: place of the antenna before the update with it, and yaw [m, m, rad].
        updated: the same after it.
        correction: (SIZE,) change of the state by the update.
        admitted: the fix was used.
    """
    stamp, x, y, variance = fix
    place, interval, newest = 0j, 0.0, before.newest
    if newest is not None:
        interval = (stamp - newest.stamp) * NANOSECOND
        if not 0.0 <= interval <= LONGEST:
            before = msgspec.structs.replace(
                Scatter(variance=before.variance, used=before.used),
                judged=before.judged,
                innovation=before.innovation,
                products=before.products,
                squares=before.squares,
            )
            interval = 0.0
        else:
            step = complex(*predicted[:2]) - complex(*before.antenna)
            place = complex(newest.path_x, newest.path_y) + step * cmath.exp(-1j * before.turn)
            weight = 0.1 if before.interval else 1.0
            interval = before.interval + weight * (interval - before.interval)
    at = PlacedFix(stamp, x, y, place.real, place.imag, predicted[2] - before.turn)
    fixes, rejected = laid_out(before.fixes, before.rejected, at, admitted=admitted)
    is_new = fixes is not before.fixes
    kept = 1.0 - 1.0 / MOST if is_new else 1.0
    after = msgspec.structs.replace(
        before,
        fixes=fixes,
        rejected=rejected,
        newest=at,
        interval=interval,
        antenna=updated[:2],
        turn=before.turn + math.remainder(updated[2] - predicted[2], 2.0 * math.pi),
        moved=tuple((kept * np.array(before.moved or 0.0) + correction).tolist()),
        used=before.used + (admitted and before.variance > variance),
    )
    return _measured_anew(after, variance) if is_new and len(fixes) >= FEWEST else after


class Stamped(Protocol):
    """Fix with a stamp [ns]."""

    @property
    def stamp(self) -> int:
        """Stamp [ns]."""
        ...


OneFix = TypeVar("OneFix", bound=Stamped)


def laid_out(
    fixes: tuple[OneFix, ...], rejected: tuple[OneFix, ...], fix: OneFix, *, admitted: bool
) -> tuple[tuple[OneFix, ...], tuple[OneFix, ...]]:
    """Fixes that are laid over the path, and rejected ones, with another.

    Args:
        fixes: fixes that are laid over the path so far.
        rejected: those that were rejected since one was used.
        fix: the newest.
        admitted: it was used.

    Returns:
        The same two. The first is the same object if it has not changed.
    """
    rejected = () if admitted else rejected
    if not is_apart(fixes + rejected, fix.stamp):
        return fixes, rejected
    rejected = (*rejected, fix)
    if admitted or len(rejected) >= ROW:
        return (*fixes, *rejected)[-MOST:], ()
    return fixes, rejected


def is_apart(fixes: Sequence[Stamped], stamp: int) -> bool:
    """Return True if a fix at a stamp [ns] is far enough from the newest of others."""
    if not fixes:
        return True
    span, gap = ((stamp - fixes[k].stamp) * NANOSECOND for k in (0, -1))
    return gap >= min(APART, SHARE_APART * span)


def _measured_anew(before: Scatter, stated: float) -> Scatter:
    """Scatter by its fixes, the newest of which states a variance [m²]."""
    fixes, least = before.fixes, STILL if before.variance else FOUND
    rows = np.array([(fix.x, fix.y, fix.path_x, fix.path_y, fix.yaw) for fix in fixes])
    measured, path = rows[:, 0] + 1j * rows[:, 1], rows[:, 2] + 1j * rows[:, 3]
    seconds = np.array([fix.stamp - fixes[0].stamp for fix in fixes]) * NANOSECOND
    found = spread_of(measured, path, rows[:, 4], seconds)
    scatters = (
        found.is_beyond(stated, least)
        and found.is_noise
        and parts_scatter(measured, path, rows[:, 4], seconds, stated, least)
    )
    apart, interval = (max(one, NANOSECOND) for one in (float(found.apart), before.interval))
    likeness, white, times = before.likeness, 0.0, 1.0
    if scatters:
        expected, squares = Expected.on(path), float(found.squares.sum())
        if len(fixes) >= IN_ORDER:
            ratio = float(found.successive) / squares
            of_fixes = (expected.ratio_white - ratio) / (expected.ratio_white - expected.ratio_walk)
            likeness += LIKENESS_WEIGHT * (of_fixes - likeness)
        # The variance of a walk over a minute, times the number of fixes in it, over that of white
        # errors.
        times = max(1.0, WANDER_TIME**2 / (expected.of_walk * apart * interval))
        white = 0.5 * squares / found.freedom
    share = min(1.0, max(0.0, (likeness - WHITE) / (WALK - WHITE)))
    kept = KEPT ** (1.0 - share) * math.exp(-share * apart / KEPT_TIME)
    variance = max(white * times**share, kept * before.variance)
    if variance <= stated:
        variance = 0.0
    return msgspec.structs.replace(before, likeness=likeness, variance=variance)


def parts_scatter(
    fixes: Any, path: Any, yaws: Floats, seconds: Floats, stated: float, least: float
) -> bool:
    """Return True if fixes scatter apart from a jump, and apart from a burst.

    A jump of the estimate's heading, or of the fixes, is no scatter: neither those before it show any,
    nor those after it. Nor is a burst of wrong fixes: neither they show any, nor the others.

    Args:
        fixes: (n,) measured places x + iy [m].
        path: (n,) the same places on the path.
        yaws: (n,) yaw on the path [rad].
        seconds: (n,) their times [s].
        stated: variance that the fixes state [m²].
        least: see `Spread.is_beyond`.
    """
    jumps = np.abs(np.abs(np.diff(fixes)) - np.abs(np.diff(path)))
    places, jump = np.arange(len(fixes)), 1 + int(jumps.argmax())
    first, second = sorted((1 + np.argsort(jumps)[-2:]).tolist())
    apart_from = places < jump, (first <= places) & (places < second)

    def scatter(part: Any) -> bool:
        if part.sum() < FEWEST:
            return False
        found = spread_of(fixes[part], path[part], yaws[part], seconds[part])
        return bool(found.is_beyond(stated, least))

    return all(scatter(part) or scatter(~part) for part in apart_from)


class Expected(NamedTuple):
    """Expected sums of squares of residuals of fixes that are laid over a path.

    Attributes:
        ratio_white: sum of squares of successive differences over that of squares, of white errors.
        ratio_walk: the same of errors that walk.
        of_walk: mean square of each coordinate for each degree of freedom, of errors that walk by 1 from
            fix to fix.
    """

    ratio_white: float
    ratio_walk: float
    of_walk: float

    @classmethod
    def on(cls, path: Any) -> Expected:
        """Sums on a path (n,) of places x + iy [m]."""
        n = len(path)
        off = path - path.mean()
        extent = float((off * off.conj()).real.sum())
        rest = np.eye(n) - 1.0 / n
        if extent > n * LEAST_WAY**2:
            rest = rest - np.outer(off, off.conj()) / extent
        walk = rest @ np.tri(n)
        white, walking = (float((np.abs(one) ** 2).sum()) for one in (rest, walk))
        of_white, of_walk = (
            float((np.abs(np.diff(one, axis=0)) ** 2).sum()) for one in (rest, walk)
        )
        return cls(of_white / white, of_walk / walking, walking / (n - 2.0))


class Spread(NamedTuple):
    """Sums of squares of the residuals of fixes laid over the path.

    Each has one value, or one for each window of fixes.

    Attributes:
        differences: (..., 2) sums of the squares of successive differences, along and across [m²].
        squares: (..., 2) sums of their own squares [m²].
        successive: (...) sums of the squares of successive differences, in both axes of odom [m²].
        second: (...) sums of the squares of second differences, likewise [m²].
        freedom: degrees of freedom of each axis.
        apart: time between two fixes [s].
        of_path: variance of the path from one fix to the next [m²].
    """

    differences: Floats
    squares: Floats
    successive: Any
    second: Any
    freedom: float
    apart: Any
    of_path: Any

    @property
    def is_noise(self) -> Any:
        """True if the residuals are no slide of the robot."""
        return self.second > SLIDING * self.successive

    def is_beyond(self, stated: Any, least: float) -> Any:
        """Return True if the differences are larger than expected.

        Args:
            stated: variance that the fixes state [m²].
            least: factor on what is expected, of many fixes.
        """
        least *= 1.0 + OF_FEW / self.freedom**2
        expected = 2.0 * self.freedom * (stated + self.of_path)
        return self.differences.min(axis=-1) > least * expected


def spread_of(fixes: Any, path: Any, yaws: Floats, seconds: Floats) -> Spread:
    """Spread of fixes about the path that is laid over them.

    Args:
        fixes: (..., n) measured places x + iy [m].
        path: (..., n) the same places on the path.
        yaws: (..., n) yaw on the path [rad].
        seconds: (..., n) their times [s].
    """
    n = fixes.shape[-1]
    steps = np.abs(np.diff(path)).mean(axis=-1)
    fixes = fixes - fixes.mean(axis=-1, keepdims=True)
    path = path - path.mean(axis=-1, keepdims=True)
    extent = (path * path.conj()).real.sum(axis=-1, keepdims=True)
    shared = (fixes * path.conj()).sum(axis=-1, keepdims=True)
    is_way = (extent > n * LEAST_WAY**2) & (shared != 0.0)
    stretch = np.where(is_way, shared, 1.0) / np.where(is_way, extent, 1.0)
    off = fixes - stretch * path
    successive, second = ((np.abs(np.diff(off, k)) ** 2).sum(axis=-1) for k in (1, 2))
    off = off * np.exp(-1j * yaws) * np.abs(stretch) / stretch
    axes = np.stack([off.real, off.imag], axis=-2)
    apart = (seconds[..., -1] - seconds[..., 0]) / (n - 1.0)
    of_path = (OF_STEP * steps * np.maximum(1.0, apart)) ** 2
    differences = (np.diff(axes) ** 2).sum(axis=-1)
    squares = (axes**2).sum(axis=-1)
    return Spread(differences, squares, successive, second, n - 2.0, apart, of_path)


class _Numbered(NamedTuple):
    stamp: int
    number: int


def scatters_in_run(before: Scatter, stamps: Stamps, fixes: Floats, at_fixes: Floats) -> bool:
    """Return True if `scatter_after` finds scatter in a run.

    Args:
        before: scatter before the run.
        stamps: (n,) stamps of its position fixes [ns].
        fixes: (n, 3) measured x, y [m], and the variance that they state [m²].
        at_fixes: (n, 7) place of the antenna and yaw before the update with each and after it
            [m, m, rad], and 1 if it was used.
    """
    if before.variance or not len(stamps):
        return before.variance > 0.0
    # The fixes and their path, those before the run first.
    old, newest = (*before.fixes, *before.rejected), before.newest
    places, updated = at_fixes[:, 0] + 1j * at_fixes[:, 1], at_fixes[:, 3] + 1j * at_fixes[:, 4]
    turned = before.turn + np.cumsum([0.0, *wrap_angle(at_fixes[:-1, 5] - at_fixes[:-1, 2])])
    link, start = (
        (places[0], 0j)
        if newest is None
        else (complex(*before.antenna), complex(newest.path_x, newest.path_y))
    )
    steps = (places - np.concatenate([[link], updated[:-1]])) * np.exp(-1j * turned)
    path = np.concatenate([[complex(a.path_x, a.path_y) for a in old], start + steps.cumsum()])
    measured = np.concatenate([[complex(a.x, a.y) for a in old], fixes[:, 0] + 1j * fixes[:, 1]])
    yaws = np.concatenate([[a.yaw for a in old], at_fixes[:, 2] - turned])
    begin = int(stamps[0])
    seconds = np.array([a.stamp - begin for a in old] + (stamps - begin).tolist()) * NANOSECOND

    windows = list[list[int]]()
    numbered = [_Numbered(a.stamp, number) for number, a in enumerate(old)]
    chosen, rejected = (
        tuple(numbered[: len(before.fixes)]),
        tuple(numbered[len(before.fixes) :]),
    )
    last = begin if newest is None else newest.stamp
    for number, (stamp, used) in enumerate(
        zip(stamps.tolist(), at_fixes[:, 6].tolist(), strict=True), len(old)
    ):
        if not 0.0 <= (stamp - last) * NANOSECOND <= LONGEST:
            chosen = rejected = ()
        were, last = chosen, stamp
        one = _Numbered(stamp, number)
        chosen, rejected = laid_out(chosen, rejected, one, admitted=used > 0.0)
        if chosen is not were and len(chosen) >= FEWEST:
            windows.append([each.number for each in chosen])

    stated = np.concatenate([np.zeros(len(old)), fixes[:, 2]])
    for size in sorted({len(one) for one in windows}):
        rows = np.array([one for one in windows if len(one) == size])
        found = spread_of(measured[rows], path[rows], yaws[rows], seconds[rows])
        beyond = found.is_beyond(stated[rows[:, -1]], FOUND) & found.is_noise
        for row in rows[beyond]:
            least = float(stated[row[-1]])
            if parts_scatter(measured[row], path[row], yaws[row], seconds[row], least, FOUND):
                return True
    return False
