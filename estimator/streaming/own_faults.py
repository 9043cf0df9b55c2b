"""Faults of users in a filter: watched, with their effects and their memory."""

import logging
import math
from copy import deepcopy
from typing import Any

import msgspec

from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.filter import fault_table
from icreckon.estimator.filter.ekf import Ekf
from icreckon.estimator.filter.fault_table import Finding, Found, Inflate, OwnFault, Replace
from icreckon.estimator.log.input_checks import Admission
from icreckon.estimator.log.measurements import Measurement

LOGGER = logging.getLogger(__name__)
LARGEST_SIGMA = 1e6  # largest standard deviation that `Inflate` adds


class OwnFaults:
    """Faults that users have added, watched by one filter with these states."""

    def __init__(self, state_names: tuple[str, ...], admission: Admission) -> None:
        self._state_names, self._admission = state_names, admission
        self.watched = [fault_type() for fault_type in fault_table.OWN_FAULTS.values()]
        # Findings on faults that raised an exception, by their names.
        self._failed: dict[str, Finding] = {}

    def watch(
        self, measurement: Measurement, view: fault_table.FilterView, ekf: Ekf
    ) -> tuple[Measurement, str | None]:
        """Watch a measurement, and inflate the filter.

        A fault gets the measurement as replaced by the faults before it. Returns the measurement to use,
        and the name of the fault that excludes it, or None.
        """
        excluded_by: str | None = None
        inflations: list[tuple[int, float]] = []
        # A copy, since a fault that raises an exception leaves the list.
        for fault in self.watched.copy():
            try:
                effect = fault.watch(measurement, view)
                match effect:
                    case Replace():
                        measurement = self._replaced(measurement, effect)
                    case fault_table.Exclude():
                        excluded_by = excluded_by or fault.name
                    case _:
                        inflations += self._variances(effect)
            except Exception as problem:
                self._give_up(fault, problem)
        if excluded_by is None:
            for state, variance in inflations:
                # Parameters, biases and scales without variance are not estimated.
                is_learnt = s.LEARNT.start <= state < s.LEARNT.stop
                if ekf.P[state, state] > 0.0 or not is_learnt:
                    ekf.inflate(state, variance=variance, of_motion=True)
        return measurement, excluded_by

    def findings(self) -> list[Finding]:
        """Findings that last, and faults that are not watched any more."""
        lasting = []
        for fault in self.watched.copy():
            try:
                found = fault.find()
                if found is not None:
                    lasting.append(fault_table.finding(fault, Found(*found)))
            except Exception as problem:
                self._give_up(fault, problem)
        return [*lasting, *self._failed.values()]

    def memory(self) -> dict[str, Any]:
        """Copies of the faults by name."""
        return {fault.name: deepcopy(fault) for fault in self.watched}

    def restore(self, memory: dict[str, Any]) -> None:
        """Restore copies or fields of a file; `EstimatorError` if they do not fit."""
        for index, fault in enumerate(self.watched):
            saved = memory.get(fault.name, type(fault)())
            is_copy = isinstance(saved, OwnFault)
            try:
                restored = deepcopy(saved) if is_copy else msgspec.convert(saved, type(fault))
                self.watched[index] = restored
            except msgspec.ValidationError as problem:
                raise EstimatorError(f"{fault.name!r}: its memory is another: {problem}") from None

    def require_files(self) -> None:
        """Require memories that a file can hold; `EstimatorError` otherwise."""
        for fault in self.watched:
            try:
                decoded = msgspec.json.decode(msgspec.json.encode(fault), type=type(fault))
                is_unchanged = decoded == fault
            except (TypeError, NotImplementedError, OverflowError, msgspec.MsgspecError) as problem:
                raise EstimatorError(f"{fault.name!r} cannot be saved: {problem}") from None
            if not is_unchanged:
                raise EstimatorError(f"{fault.name!r} cannot be saved: its memory would change")

    def _replaced(self, before: Measurement, effect: Replace) -> Measurement:
        """Measurement that an effect puts in place of another; `ValueError` if invalid."""
        replacement, objection = self._admission.checked(effect.measurement)
        if type(replacement) is not type(before) or replacement.stamp != before.stamp:
            raise ValueError(f"Replace needs the same type and stamp as {before!r}")
        if objection is not None:
            raise ValueError(f"Replace by {replacement!r}: {objection}")
        return replacement

    def _variances(self, effect: Inflate | None) -> list[tuple[int, float]]:
        """Index and added variance of each state that an effect inflates; none for None."""
        if effect is None:
            return []
        if not isinstance(effect, Inflate):
            raise TypeError(f"no effect: {effect!r}")
        for name, sigma in effect.sigmas.items():
            if name not in self._state_names:
                raise ValueError(f"Inflate: no state {name!r}; see icreckon.STATE_NAMES")
            if not (math.isfinite(sigma) and 0.0 <= sigma <= LARGEST_SIGMA):
                raise ValueError(f"Inflate: {name} by {sigma!r}, but a sigma is from 0 to 1e6")
        index = self._state_names.index
        return [(index(name), sigma**2) for name, sigma in effect.sigmas.items()]

    def _give_up(self, fault: OwnFault, problem: Exception) -> None:
        """Watch for a fault no longer, since it raised an exception; keep a finding."""
        text = f"{type(problem).__name__}: {problem}"
        LOGGER.warning("the fault %r is not watched any more: %s", fault.name, text)
        given_up = Found("robot", f"the fault {fault.name!r} failed: {text}", effect="not watched")
        self._failed[fault.name] = fault_table.finding(fault, given_up)
        self.watched = [other for other in self.watched if other.name != fault.name]
