"""Result of a calibration."""

from dataclasses import dataclass
from typing import Literal

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.robot.robot_file import Robot

Status = Literal["shown", "conditional", "held"]
"""Observable from the logs alone; only given held parameters; unobservable, held at the file's value."""


@dataclass(frozen=True)
class FoundParameter:
    """Calibrated parameter.

    Attributes:
        name: name in the robot file, with its table if ambiguous: "imu.gyro_scale".
        unit: "m", "1/N", ...; "-" for none.
        value: estimate, or the robot file's value if held.
        sigma: standard error; None if held.
        status: observability.
        before: value in the robot file, or None if it has none.
        note: remark for the user.
        is_default: True if `before` is a default, which the robot file need not state.
        sigma_other_logs: standard error for other logs of the robot, on other ground and days: `sigma`
            is for the given logs; None if held.
    """

    name: str
    unit: str
    value: float
    sigma: float | None
    status: Status
    before: float | None = None
    note: str = ""
    is_default: bool = False
    sigma_other_logs: float | None = None

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval for the given logs, or None if held."""
        if self.sigma is None:
            return None
        return self.value - 1.96 * self.sigma, self.value + 1.96 * self.sigma


@dataclass(frozen=True)
class OfLog:
    """Parameters and segments of one log.

    Attributes:
        name: name of the log.
        gyro_bias: bias of the rate about the vertical, and its standard error [rad/s].
        lag: delay of the truth's stamps, and its standard error [s]; None if it was not found.
        segments: number of moving segments used.
        still: number of standing segments used.
        distance: distance of the moving segments [m].
    """

    name: str
    gyro_bias: tuple[float, float]
    lag: tuple[float, float] | None
    segments: int
    still: int
    distance: float


@dataclass(frozen=True)
class ModelScore:
    """Held-out prediction scores of a model.

    Attributes:
        model: name of the model.
        parameters: number of its estimated parameters.
        drift_percent: drift over windows by track speeds alone, as a share of their distance [%].
        drift_low: lower end of its 95 % interval, bootstrapped over blocks [%].
        drift_high: upper end of that interval [%].
        drift_with_gyro_percent: drift with headings from the gyro [%].
        log_likelihood: mean log likelihood of a segment.
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
    """Paired difference of two models' held-out scores; 95 % intervals over blocks.

    Attributes:
        model: name of the model.
        than: name of the other model.
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
class ModelComparison:
    """Cross-validation of models.

    Attributes:
        scores: scores of each model.
        differences: differences of each model to each with fewer parameters.
        blocks: number of blocks of contiguous time.
        folds: number of folds.
        distance: distance of all windows [m].
        window: longest window [s].
        supported: the chosen model: in their order, a model replaces the one chosen so far if its drift
            is significantly lower.
    """

    scores: tuple[ModelScore, ...]
    differences: tuple[Difference, ...]
    blocks: int
    folds: int
    distance: float
    window: float
    supported: str

    def score(self, model: str) -> ModelScore:
        """Score of one of the models that were compared, by its name."""
        return next(score for score in self.scores if score.model == model)

    def difference(self, model: str, than: str) -> Difference:
        """Difference of two models; listed with the one with more parameters first."""
        return next(pair for pair in self.differences if {pair.model, pair.than} == {model, than})


@dataclass(frozen=True)
class Residuals:
    """Errors of segments for a figure: by the robot file, and by the calibrated robot.

    Attributes:
        seconds: (n,) time since the first log's start, logs in sequence [s].
        turning: (n,) rotation of each segment [rad].
        before: (n, 3) errors along, across [m], turning [rad] by the robot file.
        after: (n, 3) the same errors by the supported model.
    """

    seconds: Floats
    turning: Floats
    before: Floats
    after: Floats


@dataclass(frozen=True)
class Calibration:
    """Calibration of a robot.

    Attributes:
        robot: the calibrated robot.
        parameters: all parameters of the robot, unobservable ones included.
        correlation_names: names of the rows of `correlations`.
        correlations: (c, c) of the estimates of the model with most index parameters.
        logs: parameters and segments of each log.
        comparison: comparison of the models.
        verdict: conclusion; its first sentence names the model.
        residuals: residuals for a figure.
        notes: remarks for the user.
    """

    robot: Robot
    parameters: tuple[FoundParameter, ...]
    correlation_names: tuple[str, ...]
    correlations: Floats
    logs: tuple[OfLog, ...]
    comparison: ModelComparison
    verdict: str
    residuals: Residuals
    notes: tuple[str, ...] = ()

    def parameter(self, name: str) -> FoundParameter:
        """Parameter by its name; `KeyError` for an unknown one."""
        return {parameter.name: parameter for parameter in self.parameters}[name]
