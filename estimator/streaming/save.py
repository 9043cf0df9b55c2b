"""Saved estimators: the whole estimator as one JSON file, which people can read.

    {"format": "icreckon estimator", "version": VERSION, "checksum": "...", "content": {
        "variant", "robot", "settings"      arguments of the estimator
        "now"                               checkpoint of the filter, see `FilterCheckpoint`; the state by
                                            name, the covariance in rows in the order of the state
        "history"                           checkpoint before the history, and the measurements since
        "arrivals", "witnesses", "behind",  counts, and clocks that may have been set
        "latencies", "watch"}}              latencies of the stamps, and the watch over that of the tracks

Numbers are written with all digits: reading returns them to the last bit. The checksum is of the
content. The types of the records have the bounds of single values; `require_sound` checks whole matrices,
and that sizes, bounds and marks fit the filter.
"""

import hashlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.checks import Bounded, Latency, clipped_correlations
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.files import write_whole
from icreckon.estimator.base.plain_data import flatten, json_types
from icreckon.estimator.base.records import Count
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.clones import MOST_MARKS
from icreckon.estimator.filter.ekf import Ekf
from icreckon.estimator.filter.health import Health
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant, state_names
from icreckon.estimator.sensors.track_latency import TrackLatencyMemory
from icreckon.estimator.streaming.late_measurements import HistoryCheckpoint
from icreckon.estimator.streaming.latencies import Latencies

FORMAT = "icreckon estimator"
VERSION = 18
SHORT = 120  # objects of up to this many characters are written on one line of the file
UNUSED = ("log", "note", "format")  # keys of a robot file that an estimator does not depend on
# Keys of a robot file that learnt parameters, scales and biases depend on; the others are noise.
LEARNT_FROM = (
    "name", "vehicle", "indices", "constant_icr", "soil",
    "imu.rotation_rpy_deg", "imu.gyro_axes", "imu.gyro_scale",
)  # fmt: skip
# Largest value of a state, in its unit, and largest variance.
LARGEST_STATE, LARGEST_VARIANCE = 1e15, 1e40
# Least eigenvalue of the correlations, largest asymmetry, and largest covariance of an exact state:
# rounding errors are smaller.
LEAST_EIGENVALUE, ASYMMETRY, LARGEST_OF_EXACT = -1e-6, 1e-9, 1e-90
BEYOND_BOUNDS = 1e-3  # distance by which parameters may be beyond their bounds, in their unit


class SavedEstimator(Bounded, frozen=True):
    """Content of the file."""

    variant: str  # name of the filter variant
    robot: dict[str, Any]  # the robot file's content that the estimator depends on
    settings: Settings  # settings of the estimator
    now: FilterCheckpoint  # checkpoint of the filter
    history: HistoryCheckpoint  # checkpoint of the history, for late measurements
    arrivals: Health  # counts of measurements that did not reach the filter
    witnesses: dict[str, tuple[Count, int]]  # see `icreckon.estimator.log.input_checks.Admission`
    latencies: Latencies = Latencies()  # latencies of the stamps
    estimated_latency: Latency = 0.0  # part of the track speeds' latency that was estimated [s]
    behind: tuple[tuple[Any, ...], ...] = ()  # rows of too old measurements, see `Admission`
    watch: TrackLatencyMemory | None = None  # memory of the watch over the tracks' latency, if any

    def require_fit(
        self, robot: Robot, variant: str | None, source: str, *, to_continue: bool
    ) -> None:
        """Require the robot and the variant (None: any) that the estimator was saved for.

        To continue, all keys must agree; otherwise only those that learnt parameters, scales and biases
        depend on. The `source` is a file name, for messages.

        Raises:
            EstimatorError: robot or variant differ; the message gives the difference.
        """
        if variant is not None and variant != self.variant:
            raise EstimatorError(
                f"{source}: was saved by the variant {self.variant!r}, not {variant!r}; use that, or "
                "start again"
            )
        before, now = flatten(self.robot), flatten(robot_constants(robot))
        # The name first: with another robot all other keys may differ.
        prefixes = tuple(f"{key}." for key in LEARNT_FROM)
        keys = sorted({*before, *now}, key=lambda key: (key != "name", key))
        changed = [key for key in keys if before.get(key) != now.get(key)]
        bar_warm_start = [key for key in changed if f"{key}.".startswith(prefixes)]
        for key in changed if to_continue else bar_warm_start:
            advice = "start again" if bar_warm_start else "make a warm start, or start again"
            raise EstimatorError(
                f"{source}: was saved for a robot with {key} = {before.get(key)!r}, here it is "
                f"{now.get(key)!r}; use the same robot file, or {advice}"
            )


def robot_constants(robot: Robot) -> dict[str, Any]:
    """Content of a robot file that an estimator depends on, as JSON has it."""
    return {key: value for key, value in json_types(robot).items() if key not in UNUSED}


def write_saved(path: Path, saved: SavedEstimator, *, overwrite: bool) -> None:
    """Write a saved estimator, in one piece or not at all; `EstimatorError` if not."""
    if path.is_dir():
        raise EstimatorError(f"{path} is a folder; give the path of a file")
    if path.exists() and not (overwrite and path.is_file()):
        raise EstimatorError(f"{path} exists already; give overwrite=True to replace a file")
    content = msgspec.to_builtins(saved, enc_hook=_to_plain)
    names = state_names(find_variant(saved.variant))
    for checkpoint in (content["now"], content["history"]["memory"]):
        numbers = [*checkpoint["state"], *np.ravel(checkpoint["covariance"]), *checkpoint["model"]]
        if not np.isfinite(numbers).all():
            raise EstimatorError(f"{path}: not written, the estimate is not finite")
        # In the file, states are listed by name: those of the variant, then the wander of the fixes if
        # it is estimated. States that the variant lacks have an empty name, and are zero.
        wander = s.WANDER_NAMES[: len(checkpoint["state"]) - len(names)]
        states = zip((*names, *wander), checkpoint["state"], strict=True)
        checkpoint["state"] = {name: value for name, value in states if name}
    document = {"format": FORMAT, "version": VERSION}
    document |= {"checksum": _checksum(content), "content": content}
    try:
        write_whole(path, f"{_readable(document)}\n".encode())
    except OSError as problem:
        raise EstimatorError(f"{path}: cannot be written: {problem.strerror}") from None


def read_saved(path: Path) -> SavedEstimator:
    """Read and check a saved estimator; `EstimatorError` if that fails."""
    try:
        document = msgspec.json.decode(path.read_bytes())
    except FileNotFoundError:
        raise EstimatorError(f"{path}: no such file") from None
    except OSError as problem:
        raise EstimatorError(f"{path}: cannot be read: {problem.strerror}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as problem:
        raise EstimatorError(f"{path}: damaged, or no saved estimator: {problem}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise EstimatorError(f"{path}: no saved estimator; PoseEstimator.save writes one")
    if document.get("version") != VERSION:
        raise EstimatorError(
            f"{path}: version {document.get('version')!r} of the format is not known; this icreckon "
            f"reads {VERSION}"
        )
    content: Any = document.get("content")
    if document.get("checksum") != _checksum(content):
        raise EstimatorError(f"{path}: damaged, or changed by hand: the checksum does not fit")
    try:
        require_64_bits(content)
        names = state_names(find_variant(content["variant"]))
        for checkpoint in (content["now"], content["history"]["memory"]):
            state = checkpoint["state"]
            wander = [name for name in s.WANDER_NAMES if name in state]
            checkpoint["state"] = [state[name] if name else 0.0 for name in (*names, *wander)]
        return msgspec.convert(content, SavedEstimator, dec_hook=_from_plain)
    except (KeyError, TypeError, ValueError, EstimatorError) as problem:
        raise EstimatorError(f"{path}: not as icreckon writes it: {problem}") from None


def _to_plain(value: Any) -> Any:
    """Convert arrays and numbers of numpy, which JSON does not have."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise NotImplementedError(f"no JSON for {type(value).__name__}")


def _from_plain(_kind: type, value: Any) -> Any:
    """Convert lists of numbers to arrays, the only type that JSON does not have."""
    array = np.array(value, dtype=float)
    if not np.isfinite(array).all():
        raise ValueError("all numbers must be finite")
    return array


def _checksum(content: Any) -> str:
    """Checksum of the content as compact JSON, which is without line breaks."""
    return hashlib.sha256(msgspec.json.encode(content)).hexdigest()


def _readable(value: Any, indent: str = "") -> str:
    """JSON text with a line for each entry of a long object and each row of a table."""
    inner, text = indent + "  ", msgspec.json.encode(value).decode()
    if isinstance(value, dict) and len(text) > SHORT:
        entries = [
            f"{inner}{msgspec.json.encode(key).decode()}: {_readable(item, inner)}"
            for key, item in value.items()
        ]
        return "{\n" + ",\n".join(entries) + f"\n{indent}}}"
    if isinstance(value, list | tuple) and any(isinstance(item, list | tuple) for item in value):
        rows = [f"{inner}{msgspec.json.encode(item).decode()}" for item in value]
        return "[\n" + ",\n".join(rows) + f"\n{indent}]"
    return text


def require_64_bits(content: Any) -> None:
    """Require that whole numbers of a file fit into 64 bits; `ValueError` otherwise."""
    if isinstance(content, dict | list):
        for item in content.values() if isinstance(content, dict) else content:
            require_64_bits(item)
    elif isinstance(content, int) and not -(2**63) <= content < 2**63:
        raise ValueError("whole numbers must fit into 64 bits")


def require_sound(checkpoint: FilterCheckpoint, ekf: Ekf, *, to_continue: bool = True) -> None:
    """Require a checkpoint that this filter can have; `ValueError` otherwise.

    Sizes of state and memory must be the filter's only to continue, not for a warm start.
    """
    state, memory, P = checkpoint.state, checkpoint.model, checkpoint.covariance
    if to_continue and state.shape != ekf.x.shape:
        raise ValueError(f"the filter has {len(ekf.x)} states, found {len(state)}")
    if to_continue and memory.shape != ekf.model.memory.shape:
        size = ekf.model.memory.shape
        raise ValueError(f"the motion model remembers {size} numbers, found {memory.shape}")
    _require_size(state, "a value of the state")
    for values in (memory, checkpoint.regressors):
        _require_size(values, "a value of the motion model")
    # Each bound is a row (a, b) of the condition a . parameters >= b.
    for bound in ekf.model.bounds:
        value, least = float(bound[:-1] @ state[s.PARAMETERS]), bound[-1]
        if value < least - BEYOND_BOUNDS:
            raise ValueError(f"parameters out of bounds: {value:g} is less than {least:g}")
    clones = checkpoint.clones
    if clones is None:
        require_covariance(P)
        return
    if len(set(clones.stamps)) != len(clones.stamps) or not 1 <= len(clones.stamps) <= MOST_MARKS:
        raise ValueError(f"there must be 1 to {MOST_MARKS} different marks")
    width = clones.cross.shape[1]
    if width != len(P):
        raise ValueError(f"marks need covariances with {len(P)} states, found {width}")
    _require_size(clones.poses, "the motion since a mark")
    require_covariance(np.block([[P, clones.cross.T], [clones.cross, clones.covariance]]))


def _require_size(values: Floats, name: str) -> None:
    """Require sizes of at most `LARGEST_STATE`, and no NaN; `ValueError` otherwise."""
    if not np.abs(values).max(initial=0.0) <= LARGEST_STATE:
        raise ValueError(f"{name} is beyond {LARGEST_STATE:g}")


def require_covariance(P: Floats) -> None:
    """Require a finite, symmetric, positive semidefinite matrix, else `ValueError`."""
    variances = P.diagonal()
    if not (variances.min() >= 0.0 and np.abs(P).max() <= LARGEST_VARIANCE):
        raise ValueError(f"variances must be from 0 to {LARGEST_VARIANCE:g}")
    exact = variances == 0.0
    if np.abs(P[exact]).max(initial=0.0) > LARGEST_OF_EXACT:
        raise ValueError("a state without variance has a covariance with others")
    correlations = clipped_correlations(P[np.ix_(~exact, ~exact)])
    if np.abs(correlations - correlations.T).max(initial=0.0) > ASYMMETRY:
        raise ValueError("the covariance is not symmetric")
    if len(correlations) and np.linalg.eigvalsh(correlations)[0] < LEAST_EIGENVALUE:
        raise ValueError("the covariance is not positive semidefinite")
