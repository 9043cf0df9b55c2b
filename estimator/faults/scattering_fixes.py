"""Position fixes that scatter more than stated.

Receivers state covariances that are wrong by factors of ten and more. From one fix to the next, dead
reckoning is off by a few per cent of the distance. So each step from fix to fix is compared with that of
the path. The newest fixes scatter if most of their steps are off both along the robot and across it,
whatever turn and stretch the path is given: these are a wrong heading, and slip along the tracks. A jump
of the heading or of the fixes, a burst of wrong ones and a slide of some seconds leave half of the steps
as they are (least median of squares: Rousseeuw, Journal of the American Statistical Association 79,
1984). A robot that slides longer continues in one direction: successive differences of its residuals are
alike. With noise, or an error that walks, they are not. Fixes that scatter far more than stated are used
with the measured variance.

An error that wanders is worse than a white one of the same size, since all fixes of a minute share it.
Then residuals resemble those before them: the sum of squares of their differences is less than twice that
of their own (von Neumann, Distribution of the ratio of the mean square successive difference to the
variance, Annals of Mathematical Statistics 12, 1941). How much less, of white errors and of a random
walk, follows from the path. The residuals of some seconds do not show how long such an error lasts: it is
taken for a minute, as of plain GPS: the fixes of that time count as one. Functions are plain Python, also
for numba.
"""

import math
from typing import Annotated, NamedTuple

import msgspec

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import NANOSECOND, Floats
from icreckon.estimator.base.records import NEVER, Count, Size, Stamp, zeros

SHORTEST_INTERVAL = 1e-9  # least time between fixes that is divided by [s]
MOST_ALIGNED, FEWEST_ALIGNED = 16, 4  # limits of the number of fixes that are aligned with the path
LEAST_INTERVAL = 0.9  # least time between two aligned fixes [s], but at first
SHARE_OF_SPAN = 0.25  # this share of the time since the oldest is enough [-]
FEWEST_IN_ORDER = 8  # number of fixes from which on the order of the residuals counts
LONGEST_GAP = 15.0  # after a longer time without a fix, the path is no measure [s]
# Error of a step of the path, as a share of it; after more than a second, times the number of seconds.
STEP_ERROR = 0.08
# Number of the newest steps, most of which are off if fixes scatter. With 15 an error that wanders is
# found too late, with 3 hardly (`scoreboard.py --parts healthy faults`).
NEWEST_STEPS = 7
FACTOR_FOUND, FACTOR_STILL = 4.0, 2.0  # variance of steps over the expected: scatter begins, ends
FACTOR_OF_FEW = 12.0  # divided by (steps - 1)²: relative increase of both for few steps
MEDIAN_SQUARE = 0.455  # median of the squares of normal errors over their variance
# Sum of squares of second differences of residuals over that of differences, below which the robot
# slides: it is 3 for white errors, 2 for those that walk, and about 1 for slides of some seconds.
SLIDING_RATIO = 1.35
REJECTED_IN_ROW = 3  # rejected fixes in a row that are no outliers
# Likeness of errors to a random walk: 0 if they are white, 1 if they walk.
LIKENESS_WEIGHT, LIKENESS_AT_START = 0.025, 0.4  # weight of a fix in its mean, and first value
WHITE_UP_TO, WALKS_FROM = 0.2, 0.55  # likeness up to which errors are white, from which they walk
MOST_AVERAGED, FEWEST_AVERAGED = 100, 30  # limits of the number of innovations in their correlation
WANDER_TIME = 60.0  # assumed correlation time of an error that wanders [s]
KEPT_SHARE = 0.85  # share of the variance that is kept from fix to fix, if they scatter less [-]
KEPT_TIME = 20.0  # for an error that walks: time until 1/e is left [s], since it is calm at times
LEAST_DISTANCE = 0.1  # least distance on which the path shows a stretch [m]
# Room for the fixes that are aligned with the path, and for those that wait.
ROOM = MOST_ALIGNED + REJECTED_IN_ROW
OfFixes = Annotated[list[float], msgspec.Meta(min_length=ROOM, max_length=ROOM)]
OfStates = Annotated[list[float], msgspec.Meta(min_length=s.SIZE, max_length=s.SIZE)]


class ScatterRecord(msgspec.Struct):
    """Record of the scatter of the newest position fixes.

    Fixes are in order, the oldest first: the aligned ones, then those that wait, since the gate rejected
    them; a few of these are outliers.
    """

    begin: Stamp = NEVER  # stamp from which times count [ns]
    newest: Stamp = NEVER  # stamp of the newest fix [ns], or NEVER
    laid: Annotated[int, msgspec.Meta(ge=0, le=MOST_ALIGNED)] = 0  # number of aligned fixes
    waiting: Annotated[int, msgspec.Meta(ge=0, lt=REJECTED_IN_ROW)] = 0  # number of those that wait
    time: OfFixes = zeros(ROOM)  # their times [ns]
    x: OfFixes = zeros(ROOM)  # measured [m]
    y: OfFixes = zeros(ROOM)  # measured [m]
    stated: OfFixes = zeros(ROOM)  # variances that they state [m²]
    path_x: OfFixes = zeros(ROOM)  # place of the antenna on the path by dead reckoning [m]
    path_y: OfFixes = zeros(ROOM)  # see above [m]
    yaw: OfFixes = zeros(ROOM)  # yaw on the path [rad]
    newest_x: float = 0.0  # place of the newest fix on the path [m]
    newest_y: float = 0.0  # see above [m]
    interval: Size = 0.0  # mean time between fixes [s]
    antenna_x: float = 0.0  # estimated place of the antenna after the newest fix [m]
    antenna_y: float = 0.0  # see above [m]
    turn: float = 0.0  # yaw of the estimate less that of the path [rad]
    moved: OfStates = zeros(s.SIZE)  # (SIZE,) corrections of the state with the newest fixes
    likeness: float = LIKENESS_AT_START  # of their errors: 0 if they are white, 1 if they walk
    variance: Size = 0.0  # variance with which a fix is used, 0 if the scatter is as stated [m²]
    used: Count = 0  # number of fixes that were used with it
    judged: Count = 0  # number of fixes whose innovations were counted, at most `MOST_AVERAGED`
    innovation_x: float = 0.0  # normalised innovation of the newest fix [-]
    innovation_y: float = 0.0  # see above [-]
    products: float = 0.0  # averaged product of successive ones
    squares: Size = 0.0  # averaged square of them


def wanders(scatter: ScatterRecord) -> bool:
    """Return True if fixes scatter, and their errors resemble those before them."""
    return scatter.variance > 0.0 and scatter.likeness > 0.5 * (WHITE_UP_TO + WALKS_FROM)


def innovation_correlation(scatter: ScatterRecord) -> float | None:
    """Correlation of successive innovations [-]; None before `FEWEST_AVERAGED` fixes."""
    if scatter.judged < FEWEST_AVERAGED or scatter.squares == 0.0:
        return None
    return scatter.products / scatter.squares


def count_innovation(scatter: ScatterRecord, x: float, y: float) -> None:
    """Add the newest normalised innovation [-] to averaged squares and products."""
    scatter.judged = min(MOST_AVERAGED, scatter.judged + 1)
    product, square = x * scatter.innovation_x + y * scatter.innovation_y, x * x + y * y
    scatter.innovation_x, scatter.innovation_y = x, y
    scatter.products += (product - scatter.products) / scatter.judged
    scatter.squares += (square - scatter.squares) / scatter.judged


class TakenFix(NamedTuple):
    """Position fix, after the update with it."""

    stamp: int  # its stamp [ns]
    x: float  # measured [m]
    y: float  # measured [m]
    variance: float  # variance that it states [m²]
    z: tuple[float, float]  # its innovation, x and y [m]
    S: tuple[float, float, float]  # covariance of the innovation, xx, xy and yy [m²]
    predicted: tuple[float, float, float]  # antenna x, y [m] and yaw [rad] before it
    updated: tuple[float, float, float]  # the same after the update
    used: bool  # True if it has updated the filter


def add_fix(scatter: ScatterRecord, fix: TakenFix, correction: Floats) -> bool:
    """Add a position fix and its correction (SIZE,); True if scatter is newly found."""
    variance_before, elapsed = scatter.variance, 0.0
    if scatter.newest != NEVER:
        elapsed = (fix.stamp - scatter.newest) * NANOSECOND
    if scatter.newest == NEVER or not 0.0 <= elapsed <= LONGEST_GAP:
        begin_path(scatter, fix.stamp)
    else:
        # The path is not turned by fixes: the step of the estimate is turned back.
        x, y, _ = fix.predicted
        step = complex(x - scatter.antenna_x, y - scatter.antenna_y)
        step *= unit_number(-scatter.turn)
        scatter.newest_x += step.real
        scatter.newest_y += step.imag
        weight = 0.1 if scatter.interval > 0.0 else 1.0
        scatter.interval += weight * (elapsed - scatter.interval)
    scatter.newest = fix.stamp
    is_aligned = align_newest(scatter, fix)
    kept_share = 1.0 - 1.0 / MOST_ALIGNED if is_aligned else 1.0
    for k in range(len(correction)):
        scatter.moved[k] = kept_share * scatter.moved[k] + correction[k]
    scatter.antenna_x, scatter.antenna_y, yaw = fix.updated
    scatter.turn += yaw - fix.predicted[2]
    scatter.used += fix.used and variance_before > fix.variance
    if is_aligned and scatter.laid >= FEWEST_ALIGNED:
        measure_scatter(scatter)
    return variance_before == 0.0 < scatter.variance


def begin_path(scatter: ScatterRecord, stamp: int) -> None:
    """Begin the path again at a stamp [ns], as after a gap."""
    scatter.begin, scatter.laid, scatter.waiting = stamp, 0, 0
    scatter.newest_x = scatter.newest_y = scatter.turn = scatter.interval = 0.0
    scatter.likeness = LIKENESS_AT_START
    for k in range(len(scatter.moved)):
        scatter.moved[k] = 0.0


def align_newest(scatter: ScatterRecord, fix: TakenFix) -> bool:
    """Add the newest fix to the aligned ones, or let it wait; True if it is aligned.

    A fix too soon after the one before is left out. A used fix drops those that wait. The last of
    `REJECTED_IN_ROW` rejected ones is aligned with them. Beyond `MOST_ALIGNED` the oldest are dropped.
    """
    if fix.used:
        scatter.waiting = 0
    count, time = scatter.laid + scatter.waiting, float(scatter.newest - scatter.begin)
    if count:
        span, gap = time - scatter.time[0], time - scatter.time[count - 1]
        if gap * NANOSECOND < min(LEAST_INTERVAL, SHARE_OF_SPAN * span * NANOSECOND):
            return False
    scatter.time[count], scatter.stated[count] = time, fix.variance
    scatter.x[count], scatter.y[count] = fix.x, fix.y
    scatter.path_x[count], scatter.path_y[count] = scatter.newest_x, scatter.newest_y
    scatter.yaw[count] = fix.predicted[2] - scatter.turn
    scatter.waiting += 1
    if not fix.used and scatter.waiting < REJECTED_IN_ROW:
        return False
    surplus = max(0, count + 1 - MOST_ALIGNED)
    scatter.laid, scatter.waiting = count + 1 - surplus, 0
    if surplus > 0:
        for k in range(scatter.laid):
            scatter.time[k], scatter.yaw[k] = scatter.time[k + surplus], scatter.yaw[k + surplus]
            scatter.x[k], scatter.y[k] = scatter.x[k + surplus], scatter.y[k + surplus]
            scatter.stated[k] = scatter.stated[k + surplus]
            scatter.path_x[k] = scatter.path_x[k + surplus]
            scatter.path_y[k] = scatter.path_y[k + surplus]
    return True


def measure_scatter(scatter: ScatterRecord) -> None:
    """Update `scatter.variance` and `scatter.likeness` by the aligned fixes.

    The variance follows a larger scatter at once and fades if fixes scatter less. It is 0 unless
    it exceeds the variance that the newest fix states.
    """
    factor = FACTOR_STILL if scatter.variance > 0.0 else FACTOR_FOUND
    spread = residual_spread(scatter)
    is_sliding = spread.second_differences <= SLIDING_RATIO * spread.differences
    aligned_interval = max(spread.interval, SHORTEST_INTERVAL)
    white_variance, walk_over_white = 0.0, 1.0
    if not is_sliding and steps_scatter(scatter, factor):
        expected = expected_residuals(scatter)
        if scatter.laid >= FEWEST_IN_ORDER:
            ratio = spread.differences / spread.squares
            likeness = (expected.white_ratio - ratio) / (expected.white_ratio - expected.walk_ratio)
            scatter.likeness += LIKENESS_WEIGHT * (likeness - scatter.likeness)
        # A walk grows with each aligned fix for WANDER_TIME, and all fixes of that time share its error.
        interval = max(scatter.interval, SHORTEST_INTERVAL)
        squared_time = expected.walk_square * aligned_interval * interval
        walk_over_white = max(1.0, WANDER_TIME**2 / squared_time)
        white_variance = 0.5 * spread.squares / spread.freedom
    # 0 if errors are white, 1 if they walk; between them the variance is scaled on a logarithmic axis.
    walk = min(1.0, max(0.0, (scatter.likeness - WHITE_UP_TO) / (WALKS_FROM - WHITE_UP_TO)))
    kept = KEPT_SHARE ** (1.0 - walk) * math.exp(-walk * aligned_interval / KEPT_TIME)
    variance = max(white_variance * walk_over_white**walk, kept * scatter.variance)
    scatter.variance = variance if variance > scatter.stated[scatter.laid - 1] else 0.0


def steps_scatter(scatter: ScatterRecord, ratio: float) -> bool:
    """Return True if most of the newest steps of the fixes differ from the path's.

    The path is left as it is, or turned and stretched so that one of its steps equals that of the fixes.
    See `steps_fit`.
    """
    first = max(1, scatter.laid - NEWEST_STEPS)
    if steps_fit(scatter, first, 1.0 + 0j, ratio):
        return False
    for k in range(first, scatter.laid):
        path, fixes = path_step(scatter, k), fix_step(scatter, k)
        if min(magnitude(path), magnitude(fixes)) > LEAST_DISTANCE:
            # Complex factor that turns and stretches this step of the path to that of the fixes.
            factor = fixes * path.conjugate() * (1.0 / squared_magnitude(path))
            if steps_fit(scatter, first, factor, ratio):
                return False
    return True


def steps_fit(scatter: ScatterRecord, first: int, factor: complex, ratio: float) -> bool:
    """Return True if half of the steps fit the path times a factor.

    They fit along the robot or across it: squared residuals are at most `ratio` times the expected ones.
    """
    turn_back, count = factor.conjugate() * (1.0 / magnitude(factor)), scatter.laid - first
    squares_limit = MEDIAN_SQUARE * ratio * (1.0 + FACTOR_OF_FEW / (count - 1.0) ** 2)
    along = across = 0
    for k in range(first, scatter.laid):
        path = path_step(scatter, k)
        seconds = (scatter.time[k] - scatter.time[k - 1]) * NANOSECOND
        path_error = STEP_ERROR * magnitude(path) * max(1.0, seconds)
        # In the robot's axes: the real part is along it, the imaginary part across.
        residual = fix_step(scatter, k) - factor * path
        residual = residual * unit_number(-scatter.yaw[k]) * turn_back
        limit = squares_limit * (scatter.stated[k - 1] + scatter.stated[k] + path_error**2)
        along += residual.real**2 <= limit
        across += residual.imag**2 <= limit
    return 2 * max(along, across) >= count


class ExpectedResiduals(NamedTuple):
    """Expected residuals of aligned fixes with white errors, and with a random walk."""

    # sum of squared successive differences of the residuals over the sum of their squares [-]
    white_ratio: float
    walk_ratio: float
    walk_square: float  # residual variance of a coordinate over that of one step of the walk [-]


def expected_residuals(scatter: ScatterRecord) -> ExpectedResiduals:
    """Compute the residuals that are expected of white errors and of a random walk.

    The fit of `residual_spread` removes the mean, and a turn and stretch of the path. With n > 2 places
    x + iy of the path, and l the places less their mean, an error of 1 at fix j (white) leaves at k

        (1 if k = j else 0) - 1 / n - l_k conj(l_j) / sum |l|²

    and one from fix j on (walk) the sum of this over j and all later fixes. Squares are summed over j, k.
    """
    n, centre, extent = scatter.laid, 0j, 0.0
    for k in range(n):
        centre += path_at(scatter, k) * (1.0 / n)
    for k in range(n):
        extent += squared_magnitude(path_at(scatter, k) - centre)
    # A shorter path shows neither turn nor stretch.
    inverse_extent = 1.0 / extent if extent > n * LEAST_DISTANCE**2 else 0.0
    white_squares = white_differences = walk_squares = walk_differences = 0.0
    walk_stretch = 0j
    for j in range(n - 1, -1, -1):
        white_stretch = (path_at(scatter, j) - centre).conjugate() * inverse_extent
        walk_stretch += white_stretch
        white_before = walk_before = 0j
        for k in range(n):
            lever = path_at(scatter, k) - centre
            white = (1.0 if k == j else 0.0) - 1.0 / n - lever * white_stretch
            walk = (1.0 if k >= j else 0.0) - (n - j) / n - lever * walk_stretch
            white_squares += squared_magnitude(white)
            walk_squares += squared_magnitude(walk)
            if k > 0:
                white_differences += squared_magnitude(white - white_before)
                walk_differences += squared_magnitude(walk - walk_before)
            white_before, walk_before = white, walk
    white_ratio, walk_ratio = white_differences / white_squares, walk_differences / walk_squares
    return ExpectedResiduals(white_ratio, walk_ratio, walk_squares / (n - 2.0))


class Spread(NamedTuple):
    """Sums of squares of the residuals of fixes that are aligned with the path."""

    squares: float  # sum of the squares of the residuals [m²]
    differences: float  # sum of the squares of their successive differences [m²]
    second_differences: float  # sum of the squares of their second differences [m²]
    freedom: float  # degrees of freedom of each axis
    interval: float  # mean time between two fixes [s]


def residual_spread(scatter: ScatterRecord) -> Spread:
    """Spread of the fixes about the path that is aligned with them (least squares)."""
    n, mean_fix, mean_path = scatter.laid, 0j, 0j
    for k in range(n):
        mean_fix += fix_at(scatter, k) * (1.0 / n)
        mean_path += path_at(scatter, k) * (1.0 / n)
    extent, shared = 0.0, 0j
    for k in range(n):
        lever = path_at(scatter, k) - mean_path
        extent += squared_magnitude(lever)
        shared += (fix_at(scatter, k) - mean_fix) * lever.conjugate()
    stretch = shared * (1.0 / extent) if extent > n * LEAST_DISTANCE**2 else 1.0 + 0j
    squares = differences = second_differences = 0.0
    before = difference_before = 0j
    for k in range(n):
        residual = fix_at(scatter, k) - mean_fix - stretch * (path_at(scatter, k) - mean_path)
        squares += squared_magnitude(residual)
        if k > 0:
            differences += squared_magnitude(residual - before)
        if k > 1:
            second_differences += squared_magnitude(residual - before - difference_before)
        before, difference_before = residual, residual - before
    interval = (scatter.time[n - 1] - scatter.time[0]) * NANOSECOND / (n - 1.0)
    return Spread(squares, differences, second_differences, n - 2.0, interval)


def unit_number(angle: float) -> complex:
    """Complex number of length 1, which turns others by an angle [rad] as a factor."""
    return complex(math.cos(angle), math.sin(angle))


def fix_at(scatter: ScatterRecord, k: int) -> complex:
    """Measured place x + iy of aligned fix k [m]."""
    return complex(scatter.x[k], scatter.y[k])


def path_at(scatter: ScatterRecord, k: int) -> complex:
    """Place x + iy of aligned fix k on the path [m]."""
    return complex(scatter.path_x[k], scatter.path_y[k])


def fix_step(scatter: ScatterRecord, k: int) -> complex:
    """Step x + iy from fix k - 1 to fix k, as measured [m]."""
    return fix_at(scatter, k) - fix_at(scatter, k - 1)


def path_step(scatter: ScatterRecord, k: int) -> complex:
    """Step x + iy from fix k - 1 to fix k, on the path [m]."""
    return path_at(scatter, k) - path_at(scatter, k - 1)


def magnitude(number: complex) -> float:
    """Absolute value."""
    return math.sqrt(squared_magnitude(number))


def squared_magnitude(number: complex) -> float:
    """Square of the absolute value."""
    return number.real * number.real + number.imag * number.imag
