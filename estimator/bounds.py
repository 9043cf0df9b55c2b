"""Where ICRs can be: eta0 >= 1 and x_ICRl < 0 < x_ICRr, one number at a time.

Written for plain Python and for numba (`estimator.jit_kernel`).
"""

from __future__ import annotations

# How much of x_ICRl and x_ICRr is kept away from zero [m].
BOUND_MARGIN = 1e-3
BOUNDS = 3
# Moving to one bound may cross another; a few rounds settle it.
BOUND_ROUNDS = 50
ROUNDING = 1e-12


def way_inside(
    bound: int,
    half_gauge: float,
    eta: float,
    epsilon: float,
    variance_of_eta: float,
    covariance: float,
    variance_of_epsilon: float,
) -> tuple[float, float, float]:
    """How to bring the state to a bound that it has crossed, along its covariance P.

    The state moves by P times its derivative of the bound times a share, to the nearest point of the
    bound (Simon, Optimal State Estimation, section 7.5).

    Args:
        bound: which of the three.
        half_gauge: L / 2 [m].
        eta: eta0.
        epsilon: epsilon0 [m].
        variance_of_eta: of eta0.
        covariance: of eta0 and epsilon0 [m].
        variance_of_epsilon: of epsilon0 [m²].

    Returns:
        Derivative of the bound by eta0, by epsilon0, and the share, 0 where the state stays.
    """
    if bound == 0:
        by_eta, by_epsilon, least = 1.0, 0.0, 1.0
    elif bound == 1:
        by_eta, by_epsilon, least = half_gauge, 1.0, BOUND_MARGIN
    else:
        by_eta, by_epsilon, least = half_gauge, -1.0, BOUND_MARGIN
    short = least - (by_eta * eta + by_epsilon * epsilon)
    if short > ROUNDING:
        spread = by_eta * (by_eta * variance_of_eta + by_epsilon * covariance) + by_epsilon * (
            by_eta * covariance + by_epsilon * variance_of_epsilon
        )
        if spread > 0.0:
            return by_eta, by_epsilon, short / spread
    return by_eta, by_epsilon, 0.0
