"""Rejection of sweeps and variants without effect, before a study runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, product
from typing import Any

import msgspec

from icreckon.estimator.base.errors import IcreckonError
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.study.cells import Cell, Part, Plan, cell_maker, expand, parts_of
from icreckon.simulation.study.inputs import cell_inputs, digest_of, filter_inputs
from icreckon.simulation.study.plan import FilterSpec, Study, flatten, nest
from icreckon.simulation.truth.terrain import NEEDS, Terrain, refuse_idle_keys

# Why a key may change nothing, by its last part.
WHY = {
    "sprocket_radius": "simulated tracks report speeds, which no radius is needed for",
    "mass": "forces of friction and inertia both grow with the mass, which cancels without payloads "
    "and inertia-based variants",
    "indices": "only the kinematic truth and some variants use these indices",
    "constant_icr": "only variants with constant ICRs use them",
    "slip": "only the variant of that name uses it",
    "hold": "no track speeds become that old in this scenario",
    "gap_acceleration": "no track speeds become that old in this scenario",
    "longest_gap": "no stamp is that far ahead in this scenario",
    "max_track_speed": "filters use it for gaps and absurd readings, which this scenario has none of",
    "history": "nothing comes late in a simulation",
    "engine": "both come to the same, to rounding",
    "gyro_axes": "with this mounting all axes but z read nothing",
    "misalignment_sigma": "on a plane a level gyro turns about z alone",
    "outlier_sigma": "there are no outliers: give outlier_share",
    "dropout_duration": "there are no dropouts: give dropouts_per_hour",
    "dropout_reads": "there are no dropouts: give dropouts_per_hour",
    "bias_instability_time": "there is no instability: give bias_instability",
    **{key: needed.text for key, needed in NEEDS.items()},
}

Changes = dict[str, Any]


def refuse_idle(plan: Plan) -> None:
    """Reject swept keys, cases, or keys of variants that change nothing in any cell.

    Raises:
        SimulationError: such a key, or one of the scenario's terrain; the message names it, and the
            reason if known.
    """
    study = plan.study
    terrain, level = study.scenario.terrain, Terrain()
    given = [name for name in NEEDS if getattr(terrain, name) != getattr(level, name)]
    refuse_idle_keys([cell.scenario.terrain for cell in plan.cells], given, "scenario")
    _refuse_idle_variants(study, plan.cells)
    parts = parts_of(study)
    for place, points in enumerate(parts):
        contexts = _Contexts(study, parts, place)
        if points.kind == "latin":
            for key in points.changes[0]:
                values = list(dict.fromkeys(change[key] for change in points.changes))
                alone = [{key: value} for value in values]
                if len(contexts.alike(alone, points.changes)) == 1 and len(values) > 1:
                    raise _idle(key, f"{values[0]!r} and {values[-1]!r}")
            continue
        alike = next((one for one in contexts.alike(points.changes) if len(one) > 1), None)
        if alike is not None:
            first, second = (points.values[index] for index in alike[:2])
            raise _idle(points.name, f"{first!r} and {second!r}", points.changes[alike[1]])
        if points.kind == "cases":
            _refuse_idle_keys_of_cases(points, contexts)


class _Contexts:
    """Contexts of a part of a sweep: the combinations of the other parts' points."""

    def __init__(self, study: Study, parts: Sequence[Part], place: int) -> None:
        self._cell_at = cell_maker(study)
        others = [one.changes for number, one in enumerate(parts) if number != place]
        self._others = [
            {key: value for change in changes for key, value in change.items()}
            for changes in product(*others)
        ]

    def cells(self, changes: Changes) -> Iterator[Cell]:
        """Cells of given changes in each context."""
        return (self._cell_at(other | changes) for other in self._others)

    def alike(
        self, points: Sequence[Changes], besides: Sequence[Changes] = ({},)
    ) -> list[list[int]]:
        """Groups of points that have equal inputs in every context."""
        groups = [list(range(len(points)))]
        for other, besides_it in product(self._others, besides):
            if all(len(group) == 1 for group in groups):
                break
            divided = []
            for group in groups:
                if len(group) == 1:
                    divided.append(group)
                    continue
                by_inputs: dict[str, list[int]] = {}
                for index in group:
                    cell = self._cell_at(other | besides_it | points[index])
                    by_inputs.setdefault(digest_of(cell_inputs(cell)), []).append(index)
                divided += by_inputs.values()
            groups = divided
        return groups


def _refuse_idle_keys_of_cases(points: Part, contexts: _Contexts) -> None:
    """Reject keys of cases that change nothing; keys set to defaults are allowed."""
    for name, changes in zip(points.values, points.changes, strict=True):
        for key in changes if len(changes) > 1 else ():
            rest = {other: value for other, value in changes.items() if other != key}
            try:
                pairs = zip(contexts.cells(changes), contexts.cells(rest), strict=True)
                if _differ(pairs):
                    continue
            except IcreckonError:
                # The rest of the case is invalid without it.
                continue
            raise _idle(key, f"case {name!r} of {points.name!r} with it and without it")


def _differ(pairs: Iterable[tuple[Cell, Cell]]) -> bool:
    """Return True if some inputs differ, or if all configurations are equal."""
    configured_alike = True
    for one, other in pairs:
        if digest_of(cell_inputs(one)) != digest_of(cell_inputs(other)):
            return True
        configured_alike &= (one.scenario, one.robot, one.filters) == (
            other.scenario,
            other.robot,
            other.filters,
        )
    return configured_alike


def _refuse_idle_variants(study: Study, cells: Sequence[Cell]) -> None:
    specs = study.filters()
    for place, spec in enumerate(specs):
        for key, rest in _without_each(spec):
            if _acts(study, cells, place, rest):
                continue
            raise SimulationError(
                f"{key} of variant {spec.label!r} changes nothing in this study{_why(key)}; leave it out"
            )
    for first, second in combinations(range(len(specs)), 2):
        same = (
            specs[first].variant == specs[second].variant
            and digest_of(filter_inputs(cell, cell.filters[first]))
            == digest_of(filter_inputs(cell, cell.filters[second]))
            for cell in cells
        )
        if all(same):
            raise SimulationError(
                f"variants {specs[first].label!r} and {specs[second].label!r} are the same filter in "
                "every cell; leave one out"
            )


def _without_each(spec: FilterSpec) -> list[tuple[str, FilterSpec]]:
    """Keys of a variant, each with the variant without it."""
    found = []
    for part in ("settings", "robot"):
        flat = flatten(getattr(spec, part))
        for key in flat:
            rest = nest({other: value for other, value in flat.items() if other != key})
            found.append((f"{part}.{key}", msgspec.structs.replace(spec, **{part: rest})))
    return found


def _acts(study: Study, cells: Sequence[Cell], place: int, rest: FilterSpec) -> bool:
    """Return True if a filter's inputs differ from those of `rest`, or nothing does."""
    variants = list(study.filters())
    variants[place] = rest
    try:
        others = expand(msgspec.structs.replace(study, variants=tuple(variants))).cells
    except IcreckonError:
        # The rest of the variant is invalid without it.
        return True
    configured_alike = True
    for cell, without in zip(cells, others, strict=True):
        one, other = cell.filters[place], without.filters[place]
        if digest_of(filter_inputs(cell, one)) != digest_of(filter_inputs(without, other)):
            return True
        configured_alike &= (one.robot, one.settings) == (other.robot, other.settings)
    return configured_alike


def _idle(key: str, points: str, changes: Changes | None = None) -> SimulationError:
    keys = [key] if changes is None else [*changes] or [key]
    return SimulationError(
        f"sweep: {key!r} changes nothing: {points} come to the same truth, sensors and filters"
        f"{_why(*keys)}; leave it out"
    )


def _why(*keys: str) -> str:
    """Reason why keys change nothing, if known."""
    for key in keys:
        for part in reversed(key.split(".")):
            if part in WHY:
                return f" ({WHY[part]})"
    return ""
