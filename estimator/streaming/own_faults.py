"""Faults of users in a filter: watched, with their effects and their memory."""

import math
from copy import deepcopy
from typing import Any

import msgspec

from icreckon.estimator.base import state as s
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.filter.ekf import Ekf
from icreckon.estimator.filter.fault_table import (
    OWN_FAULTS,
    Exclude,
    FilterView,
    Finding,
    Found,
    Inflate,
    OwnFault,
    Replace,
    finding,
)
from icreckon.estimator.log.input_checks import Admission, as_plain
from icreckon.estimator.log.measurements import Measurement

LARGEST_SIGMA = 1e6
"""Largest standard deviation that `Inflate` adds."""


class OwnFaults:
    """Faults that users have added, of one filter.

    Args:
        names: names of its states.
        admission: admission of measurements.
    """

    def __init__(self, names: tuple[str, ...], admission: Admission) -> None:
        self._names, self._admission = names, admission
        self.watched = [kind() for kind in OWN_FAULTS.values()]
        self._failed: dict[str, Finding] = {}

    def watch(
        self, measurement: Measurement, view: FilterView, ekf: Ekf
    ) -> tuple[Measurement, str | None]:
        """Watch a measurement, and inflate the filter.

        Each fault sees the measurement as those before it have replaced it.

        Returns:
            The measurement to use; the name of the fault that excludes it, or None.
        """
        excluded, inflated = None, []
        for fault in self.watched.copy():
            try:
                effect = fault.watch(measurement, view)
                match effect:
                    case Replace():
                        measurement = self._replaced(measurement, effect)
                    case Exclude():
                        excluded = excluded or fault.name
                    case _:
                        inflated += self._variances(effect)
            except Exception as problem:
                self._give_up(fault, problem)
        for state, variance in inflated if excluded is None else ():
            if ekf.P[state, state] > 0.0 or not s.LEARNT.start <= state < s.LEARNT.stop:
                ekf.inflate(state, variance=variance, of_motion=True)
        return measurement, excluded

    def findings(self) -> list[Finding]:
        """Findings that last, and faults that are not watched any more."""
        lasting = []
        for fault in self.watched.copy():
            try:
                found = fault.find()
                if found is not None:
                    lasting.append(finding(fault, Found(*found)))
            except Exception as problem:
                self._give_up(fault, problem)
        return [*lasting, *self._failed.values()]

    def memory(self) -> dict[str, Any]:
        """Copies of the faults by name."""
        return {one.name: deepcopy(one) for one in self.watched}

    def restore(self, memory: dict[str, Any]) -> None:
        """Restore copies, or what a file has of them; faults that these lack start again.

        Raises:
            EstimatorError: the fields of a file are not those of the fault.
        """
        for k, fault in enumerate(self.watched):
            saved = memory.get(fault.name, type(fault)())
            try:
                self.watched[k] = (
                    deepcopy(saved)
                    if isinstance(saved, OwnFault)
                    else msgspec.convert(saved, type(fault))
                )
            except msgspec.ValidationError as problem:
                raise EstimatorError(f"{fault.name!r}: its memory is another: {problem}") from None

    def require_files(self) -> None:
        """Require memories that a file can hold.

        Raises:
            EstimatorError: one holds a number that is not finite, or another kind of value.
        """
        for fault in self.watched:
            try:
                again = msgspec.json.decode(msgspec.json.encode(fault), type=type(fault))
                same = again == fault
            except (TypeError, NotImplementedError, OverflowError, msgspec.MsgspecError) as problem:
                raise EstimatorError(f"{fault.name!r} cannot be saved: {problem}") from None
            if not same:
                raise EstimatorError(f"{fault.name!r} cannot be saved: its memory would change")

    def _replaced(self, before: Measurement, effect: Replace) -> Measurement:
        """Measurement in place of another one, checked."""
        after = as_plain(effect.measurement)
        if type(after) is not type(before) or after.stamp != before.stamp:
            raise ValueError(f"Replace needs the same type and stamp as {before!r}")
        objection = self._admission.objection(after)
        if objection is not None:
            raise ValueError(f"Replace by {after!r}: {objection}")
        return after

    def _variances(self, effect: Inflate | None) -> list[tuple[int, float]]:
        """Index and variance of each state that an effect inflates."""
        if effect is None:
            return []
        if not isinstance(effect, Inflate):
            raise TypeError(f"no effect: {effect!r}")
        for name, sigma in effect.sigmas.items():
            if name not in self._names:
                raise ValueError(f"Inflate: no state {name!r}; see icreckon.state_names")
            if not (math.isfinite(sigma) and 0.0 <= sigma <= LARGEST_SIGMA):
                raise ValueError(f"Inflate: {name} by {sigma!r}, but a sigma is from 0 to 1e6")
        return [(self._names.index(name), sigma**2) for name, sigma in effect.sigmas.items()]

    def _give_up(self, fault: OwnFault, problem: Exception) -> None:
        """Watch for a fault no longer, since it raised an exception; keep a finding."""
        text = f"{type(problem).__name__}: {problem}"
        given_up = Found("robot", f"the fault {fault.name!r} failed: {text}", effect="not watched")
        self._failed[fault.name] = finding(fault, given_up)
        self.watched = [one for one in self.watched if one.name != fault.name]
