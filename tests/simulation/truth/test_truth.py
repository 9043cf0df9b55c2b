import msgspec
import numpy as np
import pytest

from icreckon.estimator.base.frames import rep103_to_paper
from icreckon.estimator.motion.icr import PaperTwist, icrs_from_twist, indices_from_icrs
from icreckon.estimator.robot.robot_file import Slip, load_robot, slip_components
from icreckon.estimator.robot.variants import find_variant, initial_parameters
from icreckon.simulation.drives.trajectories import make_trajectory
from icreckon.simulation.truth.kinematic import KinematicTruth, draw_parameters
from icreckon.simulation.truth.true_motion import TRUE_SLIP, gauss_markov

ALPHA = load_robot("auriga-alpha")
NO_SLIP = Slip(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
EXACT = KinematicTruth(spread=0.0, slip_noise=0.0)


def run(truth, command, duration, robot=ALPHA, rate=200.0):
    return truth.run(command, duration, robot, np.random.default_rng(0), rate=rate)


def test_straight_pose_is_the_integral_of_speed():
    command = make_trajectory("straight", 30.0, ALPHA, np.random.default_rng(0))
    # The slip residual vanishes without turning, so it may be on.
    motion = run(KinematicTruth(), command, 30.0)
    ramp = 1.875 * 0.6
    distance = 0.6 * (27.0 - 0.5 * ramp)
    assert motion.poses[-1] == pytest.approx([distance, 0.0, 0.0], abs=1e-9)
    assert motion.distances[-1] == pytest.approx([distance, distance], abs=1e-9)


def test_indices_from_true_twists_and_tracks_show_the_true_parameters():
    command = make_trajectory("circle", 30.0, ALPHA, np.random.default_rng(0))
    motion = run(KinematicTruth(slip_noise=0.0), command, 30.0)
    v_x, v_y, w = motion.twists[-1]
    left, right = motion.track_speeds[-1]
    twist = PaperTwist(*rep103_to_paper(v_x, v_y), w)
    values = indices_from_icrs(icrs_from_twist(left, right, twist), ALPHA.vehicle.track_gauge)
    signed = -ALPHA.vehicle.mass * w * (v_x + ALPHA.centre_of_mass_paper[0] * w)
    true = motion.parameters
    along = np.sign(w) * ALPHA.constants.rolling_resistance
    epsilon = true.epsilon0 + true.epsilon1 * signed + true.epsilon_F * along
    assert values.epsilon == pytest.approx(epsilon)
    assert values.eta == pytest.approx(true.eta0 + true.eta1 * signed + true.eta2 * signed**2)
    assert values.zeta == pytest.approx(true.zeta0 + true.zeta1 * abs(signed))


@pytest.mark.parametrize("step", [0.002, 0.05, 0.7, 25.0])
def test_gauss_markov_is_exact_at_any_step(step):
    count = 200_000
    process = gauss_markov(count, step, 1.0, np.random.default_rng(8))
    # Correlated samples: so many independent ones.
    independent = count * np.tanh(min(step, 10.0))
    band = 5.0 * np.sqrt(2.0 / independent)
    decay = np.exp(-step)
    innovations = (process[1:] - decay * process[:-1]) / np.sqrt(1.0 - decay**2)
    assert np.abs(process.var(axis=0) - 1.0).max() < band
    assert np.abs(innovations.var(axis=0) - 1.0).max() < 5.0 * np.sqrt(2.0 / count)
    lagged = (innovations[1:] * innovations[:-1]).mean(axis=0)
    assert np.abs(lagged).max() < 5.0 / np.sqrt(count)
    assert np.abs(np.corrcoef(innovations.T) - np.eye(3)).max() < 5.0 / np.sqrt(count)


def test_slip_size_is_a_share_of_motion():
    V_l, V_r = np.array([[0.0, 0.5, -0.5], [0.0, 0.5, 0.5]])
    size = np.stack(slip_components(V_l, V_r, TRUE_SLIP, 1.1), axis=-1)
    assert (size[:2] == 0.0).all()
    assert size[2] == pytest.approx([0.01, 0.005, 0.02 / 1.1])
    driving = msgspec.structs.replace(NO_SLIP, driving_x=0.1, driving_w=0.2)
    assert slip_components(0.2, 0.6, driving, 1.1) == pytest.approx((0.04, 0.0, 0.08))


def test_true_parameters_spread_about_those_of_the_robot_file():
    rng = np.random.default_rng(2)
    own = initial_parameters(ALPHA, find_variant("inertia-fixed"))
    drawn = np.array([draw_parameters(ALPHA, 0.1, rng).as_array() for _ in range(300)])
    assert (drawn[:, 0] == own[0]).all()
    factors = np.log(drawn[:, 1:] / own[1:])
    assert (np.abs(factors.std(axis=0) / 0.1 - 1.0) < 0.15).all()
    assert (np.abs(factors.mean(axis=0)) < 0.03).all()
    assert (np.abs(np.corrcoef(factors.T) - np.eye(8)) < 0.25).all()
    assert draw_parameters(ALPHA, 0.0, rng).as_array() == pytest.approx(own)
