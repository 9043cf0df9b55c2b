"""Checks of a saved estimator: its matrices, and that it fits the filter.

The types of the records have the bounds of single values; here are those of whole matrices, and of what
must fit the filter.
"""

from typing import Any

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.checks import clipped_correlations
from icreckon.estimator.filter.checkpoint import FilterCheckpoint
from icreckon.estimator.filter.clones import MOST_MARKS
from icreckon.estimator.filter.ekf import Ekf

# Largest value of a state, in its unit, and largest variance.
LARGEST_STATE, LARGEST_VARIANCE = 1e15, 1e40
# Least eigenvalue of the correlations, largest asymmetry, and largest covariance of an exact state:
# rounding leaves less.
LEAST_EIGENVALUE, ASYMMETRY, LARGEST_OF_EXACT = -1e-6, 1e-9, 1e-90
# Distance by which parameters may be beyond their bounds, in the unit of the bound.
BEYOND_BOUNDS = 1e-3


def require_64_bits(content: Any) -> None:
    """Require that all whole numbers of a file fit into 64 bits.

    Raises:
        ValueError: one does not.
    """
    if isinstance(content, dict | list):
        for item in content.values() if isinstance(content, dict) else content:
            require_64_bits(item)
    elif isinstance(content, int) and not -(2**63) <= content < 2**63:
        raise ValueError("whole numbers must fit into 64 bits")


def require_sound(checkpoint: FilterCheckpoint, ekf: Ekf, *, to_continue: bool = True) -> None:
    """Require a checkpoint that this filter can have.

    Args:
        checkpoint: the checkpoint.
        ekf: filter that is to be restored to it.
        to_continue: it must fit the filter, fixes that wander included.

    Raises:
        ValueError: it has no place in the filter, or holds what no filter estimates.
    """
    state, P, clones = checkpoint.state, checkpoint.covariance, checkpoint.clones
    if to_continue and state.shape != ekf.x.shape:
        raise ValueError(f"the filter has {len(ekf.x)} states, found {len(state)}")
    if to_continue and checkpoint.model.shape != ekf.model.memory.shape:
        size, found = ekf.model.memory.shape, checkpoint.model.shape
        raise ValueError(f"the motion model remembers {size} numbers, found {found}")
    of_model = checkpoint.model, checkpoint.regressors
    for name, values in (
        ("state", state),
        ("motion model", np.hstack([v.ravel() for v in of_model])),
    ):
        if not np.abs(values).max(initial=0.0) <= LARGEST_STATE:
            raise ValueError(f"a value of the {name} is beyond {LARGEST_STATE:g}")
    for bound in ekf.model.bounds:
        value = float(bound[:-1] @ state[s.PARAMETERS])
        if value < bound[-1] - BEYOND_BOUNDS:
            raise ValueError(f"parameters out of bounds: {value:g} is less than {bound[-1]:g}")
    if clones is None:
        require_covariance(P)
        return
    if len(set(clones.stamps)) != len(clones.stamps) or not 1 <= len(clones.stamps) <= MOST_MARKS:
        raise ValueError(f"there must be 1 to {MOST_MARKS} different marks")
    if clones.cross.shape[1] != len(P):
        raise ValueError(
            f"marks need covariances with {len(P)} states, found {clones.cross.shape[1]}"
        )
    if not np.abs(clones.poses).max() <= LARGEST_STATE:
        raise ValueError(f"the motion since a mark is beyond {LARGEST_STATE:g}")
    require_covariance(np.block([[P, clones.cross.T], [clones.cross, clones.covariance]]))


def require_covariance(P: Floats) -> None:
    """Require a covariance matrix: finite, symmetric, positive semidefinite.

    Raises:
        ValueError: it is none.
    """
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
