"""What an identification found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.robot.robot_file import Robot

Status = Literal["shown", "conditional", "held"]
"""Shown by the logs alone; only given what is held; not to be told, so held at the robot file's value."""


@dataclass(frozen=True)
class FoundParameter:
    """A parameter, as far as the logs show it.

    Attributes:
        name: as in the robot file, with its table where that is not plain: "imu.gyro_scale".
        unit: "m", "1/N", ...; "-" for none.
        value: found, or the robot file's where it is held.
        sigma: standard error; None where it is held.
        status: whether it is shown.
        before: what the robot file said, or None where it says nothing of it.
        note: what else there is to say.
    """

    name: str
    unit: str
    value: float
    sigma: float | None
    status: Status
    before: float | None = None
    note: str = ""

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval, or None where it is held."""
        if self.sigma is None:
            return None
        return self.value - 1.96 * self.sigma, self.value + 1.96 * self.sigma


@dataclass(frozen=True)
class OfLog:
    """What belongs to one log.

    Attributes:
        name: of the log.
        gyro_bias: of the rate about the vertical, and its standard error [rad/s].
        lag: how late the truth is stamped, and its standard error [s].
        segments: used of it, moving ones.
        still: used of it, in which it stands.
        distance: way of the moving ones [m].
    """

    name: str
    gyro_bias: tuple[float, float]
    lag: tuple[float, float]
    segments: int
    still: int
    distance: float


@dataclass(frozen=True)
class ModelScore:
    """How well a model predicts what its parameters were not found from.

    Attributes:
        model: its name.
        parameters: how many it has that were found.
        drift_percent: error of windows by track speeds alone, of their way [%].
        drift_low: its 95 % interval, bootstrapped over blocks [%].
        drift_high: upper end.
        drift_with_gyro_percent: with headings from the gyro [%].
        log_likelihood: of a segment, mean.
    """

    model: str
    parameters: int
    drift_percent: float
    drift_low: float
    drift_high: float
    drift_with_gyro_percent: float
    log_likelihood: float


@dataclass(frozen=True)
class Difference:
    """A model's held-out scores less another's, paired, with 95 % intervals over blocks.

    Attributes:
        model: its name.
        than: the other.
        drift: difference of the drifts; negative is better [%].
        drift_low: lower end of its interval.
        drift_high: upper end.
        log_likelihood: difference of the mean log likelihood of a segment; positive is better.
        log_likelihood_low: lower end of its interval.
        log_likelihood_high: upper end.
    """

    model: str
    than: str
    drift: float
    drift_low: float
    drift_high: float
    log_likelihood: float
    log_likelihood_low: float
    log_likelihood_high: float


@dataclass(frozen=True)
class Comparison:
    """Cross-validation of models.

    Attributes:
        scores: of each model.
        differences: of each model to each with fewer parameters.
        blocks: how many blocks of contiguous time there were.
        folds: how many times some of them were left out.
        distance: way of all windows [m].
        window: longest window [s].
        supported: the first model than which no later one is better beyond doubt.
    """

    scores: tuple[ModelScore, ...]
    differences: tuple[Difference, ...]
    blocks: int
    folds: int
    distance: float
    window: float
    supported: str

    def score(self, model: str) -> ModelScore:
        """Of a model by its name."""
        return next(one for one in self.scores if one.model == model)

    def difference(self, model: str, than: str) -> Difference:
        """Of two models, the one with more parameters first."""
        return next(one for one in self.differences if (one.model, one.than) == (model, than))


@dataclass(frozen=True)
class Residuals:
    """Errors of segments for a figure: by the robot file, and by what was found.

    Attributes:
        seconds: (n,) from the first log's start, one log behind the other [s].
        turning: (n,) [rad].
        before: (n, 3) along, across [m], turning [rad].
        after: (n, 3) of the model that is supported.
    """

    seconds: Floats
    turning: Floats
    before: Floats
    after: Floats


@dataclass(frozen=True)
class Identification:
    """What was found of a robot.

    Attributes:
        robot: the robot with everything found put in.
        parameters: all parameters of the robot, what is not shown included.
        correlation_names: of the rows of the next.
        correlations: (c, c) of the estimates of the model with most index parameters.
        logs: what belongs to each log.
        comparison: of the models.
        verdict: one sentence.
        residuals: for a figure.
        notes: what else there is to say.
    """

    robot: Robot
    parameters: tuple[FoundParameter, ...]
    correlation_names: tuple[str, ...]
    correlations: Floats
    logs: tuple[OfLog, ...]
    comparison: Comparison
    verdict: str
    residuals: Residuals
    notes: tuple[str, ...] = ()

    def parameter(self, name: str) -> FoundParameter:
        """A parameter by its name.

        Raises:
            KeyError: there is none of that name.
        """
        for one in self.parameters:
            if one.name == name:
                return one
        raise KeyError(name)
