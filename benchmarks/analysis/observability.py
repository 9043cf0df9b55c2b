"""What a manoeuvre shows: which states the sensors can tell, computed from the filter's own model.

Two questions are answered. What can be told *at all*: the measurements of the whole manoeuvre are
stacked as linear functions of the state at its start,

    O = [ H_k Phi_k / sigma_k ],      G = O' O,

the discrete observability Gramian, weighted by the measurement noise (with that, it is the Fisher
information of a motion without process noise; Maybeck, Stochastic Models, Estimation and Control,
section 5.6). Each state is counted in units of what is not known of it at the start, so that metres and
radians compare. The rank of O is that of G; what spans its null space leaves no trace in any reading.
And what is told *in practice*: the share of the initial standard deviation that is left after the
manoeuvre when slip disturbs it as the filter expects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.linearised import LinearisedModel, Sensors, stepped
from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import compose
from icreckon.estimator.motion.propagation import step_on_se2
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant, state_names

# What is not known where no robot file says it: the pose [m, m, rad], H [-], and the two scales [-].
POSE_SIGMA = (1.0, 1.0, 1.0)
H_SIGMA = 0.1
SCALE_SIGMA = 0.01
# Singular values below this share of the largest are zero: what the arithmetic leaves of nothing.
RANK_TOLERANCE = 1e-9
# A state belongs to the name of a direction if its part of it is at least this.
NAMED_FROM = 0.02


@dataclass(frozen=True)
class Observability:
    """What a manoeuvre shows.

    Attributes:
        states: (n,) names of the states that were asked about.
        sigmas: (n,) their units: what is not known of each at the start.
        singular_values: (n,) of the stacked measurements, falling: by how many standard deviations of
            all noise a deviation by one unit shows.
        directions: (n, n) a row for each of them, in these units.
        left: (n,) share of each unit that is left after the manoeuvre when slip disturbs it [-].
    """

    states: tuple[str, ...]
    sigmas: Floats
    singular_values: Floats
    directions: Floats
    left: Floats

    @property
    def rank(self) -> int:
        """How many directions leave a trace in the readings."""
        values = self.singular_values
        return int(np.count_nonzero(values > RANK_TOLERANCE * max(values[0], 1e-300)))

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of those that are not zero; NaN at rank zero."""
        rank = self.rank
        return float(self.singular_values[0] / self.singular_values[rank - 1]) if rank else np.nan

    @property
    def unobservable(self) -> Floats:
        """(n - rank, n) what leaves no trace: an orthonormal basis, each row as simple as can be."""
        return _simplest(self.directions[self.rank :])

    @property
    def unobservable_names(self) -> list[str]:
        """The directions of `unobservable` in words: states, or what of several cannot be told apart."""
        return [_name(row, self.states) for row in self.unobservable]

    def left_of(self, state: str) -> float:
        """Share of a state's unit that is left after the manoeuvre [-].

        Raises:
            EstimatorError: it was not asked about.
        """
        if state not in self.states:
            raise EstimatorError(f"{state!r} is none of the states {', '.join(self.states)}")
        return float(self.left[self.states.index(state)])


def observe(
    robot: Robot,
    variant: str,
    speeds: Floats,
    dt: float,
    sensors: Sensors,
    *,
    settings: Settings | None = None,
) -> Observability:
    """What a manoeuvre shows of pose, parameters, biases, scales and gravity.

    Biases are asked about where there is the sensor; parameters where the variant estimates them, and
    H in any case.

    Args:
        robot: the robot.
        variant: name of the filter variant.
        speeds: (n, 2) speeds of the left and the right track over each step [m/s].
        dt: length of a step [s].
        sensors: what there is beside the tracks.
        settings: of the pose estimator.

    Returns:
        The singular values of the stacked measurements with their directions, and what is left.

    Raises:
        EstimatorError: no such variant, or speeds that are not (n, 2).
    """
    if speeds.ndim != 2 or speeds.shape[1] != 2 or not len(speeds):
        raise EstimatorError(f"speeds must have shape (n, 2), found {speeds.shape}")
    found = find_variant(variant)
    linearised = LinearisedModel(robot, found, sensors, dt, settings)
    all_names = state_names(found)
    sigmas = _units(linearised.sigmas, sensors)
    if "H" in all_names:
        sigmas[all_names.index("H")] = H_SIGMA
    asked = np.flatnonzero(sigmas)
    unit = sigmas[asked]
    x = linearised.start.copy()
    # The state of a step by that at the start; only the pose changes.
    by_start = np.eye(s.SIZE)
    P = np.diag(sigmas**2)
    rows: list[Floats] = []
    for left, right in speeds.tolist():
        linearised.begin(x, left, right)
        twist = linearised.twist_model(x, left, right).twist
        after = x.copy()
        after[s.POSE] = compose(x[s.POSE], step_on_se2(0.0, twist * dt)[0])
        step = linearised.step(x, left, right, after)
        rows += [one.row @ by_start / np.sqrt(one.variance) for one in step.during]
        by_start = step.transition @ by_start
        rows += [one.row @ by_start / np.sqrt(one.variance) for one in step.after]
        P = stepped(P, step)
        x = after
    stacked = np.array([row[asked] for row in rows]).reshape(len(rows), len(asked)) * unit
    # As many rows as states say the same (R of a QR factorisation), and are never too few.
    square = np.linalg.qr(np.vstack([stacked, np.zeros((len(asked), len(asked)))]), mode="r")
    _, values, directions = np.linalg.svd(square)
    left_over = np.sqrt(np.diagonal(P)[asked].clip(0.0)) / unit
    names = tuple(all_names[index] for index in asked)
    return Observability(names, unit, values, directions, left_over)


def _units(sigmas: Floats, sensors: Sensors) -> Floats:
    """(SIZE,) what is not known at the start of each state that is asked about; zero elsewhere."""
    units = sigmas.copy()
    units[s.POSE] = POSE_SIGMA
    for scale in (s.TRACK_SCALE, s.GYRO_SCALE):
        units[scale] = units[scale] or SCALE_SIGMA
    if not sensors.gyro:
        units[[s.GYRO_BIAS, s.GYRO_SCALE]] = 0.0
    if not sensors.accelerometer:
        units[[s.ACCELEROMETER_BIAS_X, s.ACCELEROMETER_BIAS_Y]] = 0.0
    return units


def _simplest(basis: Floats) -> Floats:
    """The same space (k, n) by the basis whose rows are each about as few states as can be.

    States that lie in the space by themselves come first; the rest is brought to reduced row echelon
    form, each row of length one.
    """
    if not len(basis):
        return basis
    rest, found = basis.copy(), []
    # How much of each state lies in the space: those that do wholly are directions of their own.
    for index in np.flatnonzero((basis**2).sum(axis=0) > 1.0 - 1e-6):
        alone = np.eye(basis.shape[1])[index]
        found.append(alone)
        rest = rest - np.outer(rest @ alone, alone)
    left = len(basis) - len(found)
    if left:
        rest = np.linalg.svd(rest)[2][:left]
        for pivot in range(left):
            place = int(np.argmax(np.abs(rest[pivot:])))
            row, column = pivot + place // basis.shape[1], place % basis.shape[1]
            rest[[pivot, row]] = rest[[row, pivot]]
            rest[pivot] /= rest[pivot, column]
            others = np.arange(left) != pivot
            rest[others] -= np.outer(rest[others, column], rest[pivot])
        found += list(rest / np.linalg.norm(rest, axis=1)[:, None])
    return np.array(found)


def _name(direction: Floats, states: tuple[str, ...]) -> str:
    """A direction in words: its states by size, with the sign they go together with."""
    order = np.argsort(-np.abs(direction), kind="stable").tolist()
    first, *others = (index for index in order if abs(direction[index]) >= NAMED_FROM)
    words = [states[first]]
    for index in others:
        together = direction[index] * direction[first] > 0.0
        words.append(f"{'with' if together else 'against'} {states[index]}")
    return " ".join(words)
