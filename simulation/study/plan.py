"""Configuration of a study as plain data: scenario, filters, and sweep.

`icreckon.simulation.study.cells` makes its cells, `icreckon.simulation.running.run_study` runs it;
docs/reference/study-file.md lists every key.
"""

import re
from pathlib import Path
from typing import Annotated, Any

import msgspec

from icreckon.estimator.base.checks import Bound, is_finite
from icreckon.estimator.base.config import convert, read_toml
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.base.plain_data import flatten
from icreckon.estimator.log.scores import HORIZONS
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.robot.variants import find_variant
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.base.field_types import settle_types
from icreckon.simulation.base.random_streams import check_whole
from icreckon.simulation.scenario import Scenario

STUDIES_FOLDER = Path(__file__).parent / "studies"
MOST_CELLS = 100_000
MOST_RUNS = 10_000_000  # more runs take a year, and gigabytes for their results
Runs = Annotated[
    int, Bound(f"a whole number from 1 to {MOST_RUNS:,} (for each cell)", 1, MOST_RUNS)
]
Points = Annotated[int, Bound(f"a whole number from 1 to {MOST_CELLS:,}", 1, MOST_CELLS)]
Count = Annotated[int, Bound("a whole number of at least 1", 1)]
Horizon = Annotated[float, Bound("at least 1 s", 1.0)]
DEFAULT_VARIANTS = ("constant-online", "inertia-online")
SCALES = ("linear", "log")
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")  # names become folders and labels columns


class LatinHypercube(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Points spread evenly over ranges of several keys at once.

    Attributes:
        points: number of points.
        ranges: dotted key -> (lowest, highest, "linear" or "log"); the scale is linear by default.
    """

    points: Points
    ranges: dict[str, Any]

    def __post_init__(self) -> None:
        settle_types(self, "{} of a latin hypercube")
        ranges = flatten(self.ranges)
        if not ranges:
            raise SimulationError("a latin hypercube needs ranges; give at least one key")
        for key, bounds in ranges.items():
            _check_range(key, bounds)
        msgspec.structs.force_setattr(self, "ranges", ranges)


class Sweep(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Changes from cell to cell, in all combinations of the parts.

    Attributes:
        grid: dotted key -> its values.
        cases: name of an axis -> name of a case -> dotted key -> value, for keys that change together.
        latin: a Latin hypercube over further keys.
    """

    grid: dict[str, Any] = {}
    cases: dict[str, dict[str, dict[str, Any]]] = {}
    latin: LatinHypercube | None = None

    def __post_init__(self) -> None:
        settle_types(self)
        grid = flatten(self.grid)
        for key, values in grid.items():
            if not isinstance(values, list | tuple) or not values:
                raise SimulationError(f"grid key {key!r} needs a list of values, found {values!r}")
            if len({repr(value) for value in values}) < len(values):
                raise SimulationError(f"grid key {key!r} has a value twice: {list(values)!r}")
        cases = {
            axis: {name: flatten(changes) for name, changes in named.items()}
            for axis, named in self.cases.items()
        }
        for axis, named in cases.items():
            if not named:
                raise SimulationError(f"the axis {axis!r} has no cases")
        if not grid and not cases and self.latin is None:
            raise SimulationError("nothing is swept: give grid, cases or latin, or leave out sweep")
        msgspec.structs.force_setattr(self, "grid", grid)
        msgspec.structs.force_setattr(self, "cases", cases)
        _refuse_shared_keys(self)


class FilterSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Filter of a study.

    Attributes:
        variant: name of the filter variant.
        label: label of the filter; the variant's name by default.
        settings: keys of `icreckon.estimator.robot.settings.Settings`.
        robot: changes of the robot file for this filter alone.
    """

    variant: str
    label: str = ""
    settings: dict[str, Any] = {}
    robot: dict[str, Any] = {}

    def __post_init__(self) -> None:
        if find_variant(self.variant).motion is not None:
            raise SimulationError(
                f"studies take shipped motion models only: {self.variant!r} has one of its own, which "
                "their worker processes cannot import"
            )
        label = self.label or self.variant
        _require_name("label of a variant", label)
        msgspec.structs.force_setattr(self, "label", label)
        msgspec.structs.force_setattr(self, "robot", nest(flatten(self.robot)))
        self.made_settings()

    def made_settings(self) -> Settings:
        """Make the settings, checked.

        Raises:
            SimulationError: a misspelt key, a wrong type or a bad value.
        """
        return convert(self.settings, Settings, f"settings of {self.label}", SimulationError)


class Study(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Configuration of a study.

    Attributes:
        name: name of the study, and of its folder.
        description: purpose of the study, for people.
        robot: name of a robot that ships with icreckon, or the path of a robot file.
        robot_changes: changes of the robot file, for truth and filters alike.
        scenario: scenario of the runs; its seed is the study's.
        variants: the filters, as names of variants or in full.
        sweep: changes from cell to cell; None for a single cell.
        runs: number of runs per cell.
        truths: number of distinct true motions per cell; run r drives true motion r modulo this.
        seed: seed of all random numbers.
        baseline: label of the filter with which the others are compared, run by run; the first by
            default.
        horizons: lengths of the segments over which drift is scored [s]; the page has the longest, and
            30 s by default.
        filters_know_noise: whether the filters have the noise of the simulated IMU and encoders, or that
            of the robot file, whatever is swept.

    Raises:
        SimulationError: a wrong type, an unknown name, or a number out of range.
    """

    name: str
    description: str = ""
    robot: str = "auriga-alpha"
    robot_changes: dict[str, Any] = {}
    scenario: Scenario = Scenario()
    variants: tuple[str | FilterSpec, ...] = DEFAULT_VARIANTS
    sweep: Sweep | None = None
    runs: Runs = 20
    truths: Count = 20  # true motions are the most expensive part of a run
    seed: int = 1
    baseline: str | None = None
    horizons: tuple[Horizon, ...] = HORIZONS
    filters_know_noise: bool = False

    def __post_init__(self) -> None:
        settle_types(self)
        _require_name("name of a study", self.name)
        check_whole("seed", self.seed)
        if self.scenario.seed:
            raise SimulationError("the scenario of a study has no seed of its own; give it above")
        if not self.scenario.include_truth:
            raise SimulationError("a study scores against the truth; leave out include_truth")
        changes = nest(flatten(self.robot_changes))
        msgspec.structs.force_setattr(self, "robot_changes", changes)
        labels = [spec.label for spec in self.filters()]
        if not labels:
            raise SimulationError("a study needs variants; give at least one")
        same = [label for label in labels if labels.count(label) > 1]
        if same:
            raise SimulationError(f"two variants are labelled {same[0]!r}; give each its own label")
        if self.baseline is not None and self.baseline not in labels:
            hint = nearest_hint(self.baseline, labels)
            raise SimulationError(f"no variant labelled {self.baseline!r} to be the baseline{hint}")
        if not self.horizons or len(set(self.horizons)) < len(self.horizons):
            raise SimulationError(f"horizons must be times, each once, found {self.horizons!r}")

    def filters(self) -> tuple[FilterSpec, ...]:
        """Filters in full."""
        return tuple(
            FilterSpec(variant=spec) if isinstance(spec, str) else spec for spec in self.variants
        )

    @property
    def true_motions(self) -> int:
        """Number of distinct true motions per cell."""
        return min(self.runs, self.truths)

    @property
    def compared_with(self) -> str:
        """Label of the baseline."""
        return self.baseline or self.filters()[0].label


def study_names() -> list[str]:
    """Names of the studies that ship with icreckon."""
    return sorted(path.stem for path in STUDIES_FOLDER.glob("*.toml"))


def load_study(name_or_path: str | Path) -> Study:
    """Load a study by the name of a shipped one, or from a TOML file.

    Args:
        name_or_path: a name from `study_names()`, or the path of a `.toml` file. Paths of a robot file
            and of a trajectory_file in it are relative to its folder.

    Raises:
        SimulationError: no such study or file, a misspelt key, a wrong type or a bad value.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml" and not path.is_file():
        path = STUDIES_FOLDER / f"{name_or_path}.toml"
        if not path.exists():
            hint = nearest_hint(str(name_or_path), study_names())
            raise SimulationError(
                f"no study named {str(name_or_path)!r}{hint} (or give the path of a .toml file)"
            )
    data = read_toml(path, SimulationError)
    data.setdefault("name", path.stem)
    study = convert(data, Study, str(path), SimulationError)
    changes: dict[str, Any] = {}
    if study.robot.endswith(".toml"):
        changes["robot"] = str(path.parent / study.robot)
    if study.scenario.trajectory_file is not None:
        file = str(path.parent / study.scenario.trajectory_file)
        changes["scenario"] = msgspec.structs.replace(study.scenario, trajectory_file=file)
    return msgspec.structs.replace(study, **changes)


def nest(flat: dict[str, Any]) -> dict[str, Any]:
    """Nest dotted keys into tables.

    Raises:
        SimulationError: a dotted key is both a value and a table.
    """
    data: dict[str, Any] = {}
    for path, value in flat.items():
        table, (*parents, last) = data, path.split(".")
        for key in parents:
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                raise SimulationError(f"{key!r} of {path!r} is a value, and no table, elsewhere")
        if isinstance(table.get(last), dict):
            raise SimulationError(f"{path!r} is a table, and no value, elsewhere")
        table[last] = value
    return data


def _check_range(key: str, bounds: Any) -> None:
    """Reject a range that is not (lowest, highest) or (lowest, highest, scale)."""
    wanted = f"the range of {key!r} must be [lowest, highest] or [lowest, highest, scale]"
    if not isinstance(bounds, list | tuple) or len(bounds) not in (2, 3):
        raise SimulationError(f"{wanted}, found {bounds!r}")
    low, high, *scales = bounds
    if not (is_finite(low) and is_finite(high) and low < high):
        raise SimulationError(f"{wanted}, numbers of which the second is larger, found {bounds!r}")
    (scale,) = scales or ["linear"]
    if scale not in SCALES:
        hint = nearest_hint(str(scale), [*SCALES])
        raise SimulationError(f"{key!r} has no scale {scale!r}{hint}")
    if scale == "log" and not low > 0.0:
        raise SimulationError(
            f"the range of {key!r} is logarithmic: it must lie above 0, found {low!r}"
        )


def _refuse_shared_keys(sweep: Sweep) -> None:
    """Reject a key or an axis that more than one part of a sweep changes."""
    latin_keys = sweep.latin.ranges if sweep.latin else {}
    axes = [(key, {key}) for key in (*sweep.grid, *latin_keys)]
    axes += [
        (axis, {key for keys in cases.values() for key in keys})
        for axis, cases in sweep.cases.items()
    ]
    names = [axis for axis, _ in axes]
    owners: dict[str, str] = {}
    for axis, keys in axes:
        if names.count(axis) > 1:
            raise SimulationError(f"{axis!r} is swept twice; leave one out")
        for key in sorted(keys):
            if key in owners:
                raise SimulationError(
                    f"{key!r} is swept twice, by {owners[key]!r} and by {axis!r}; leave one out"
                )
            owners[key] = axis


def _require_name(what: str, name: str) -> None:
    """Reject a name that cannot be a folder or column; `what` has it, for the message."""
    if not NAME.fullmatch(name):
        raise SimulationError(
            f"the {what} must be of letters, digits and . _ + -, the first a letter or digit, "
            f"found {name!r}"
        )
