"""States that are only considered: they stay as they are, and count in all else."""

import msgspec
import numpy as np
import pytest
from _sampled_model import Fixes, ModelSampler
from scipy.stats import chi2

from agreement_scenes import first
from conftest import thorough
from fed_estimators import feed_all, short_log
from icreckon import EstimatorError, PoseEstimator, Settings, StandstillSettings, load_robot, smooth
from icreckon.estimator.base import state as s
from icreckon.estimator.log.measurements import ImuSample, PositionFix, TrackSpeeds
from icreckon.estimator.robot.robot_file import changed_robot
from icreckon.estimator.robot.variants import (
    VARIANTS,
    default_adaptation,
    find_variant,
    slip_of,
    state_names,
)
from same_runs import apart

ALPHA = load_robot("auriga-alpha")
START = {"start_sigma": (0.1, 0.1, 0.1)}
STEP = 10_000_000


@pytest.fixture(scope="module")
def log():
    return short_log(truth="kinematic")


def fed(log, variant="inertia-online", **options):
    return feed_all(PoseEstimator(ALPHA, variant, settings=Settings(**options), **START), log)


CASES = [
    thorough("inertia-online", ("eta0",)),
    ("inertia-online", ("eta0", "gyro_bias")),
    thorough("constant-online", ("zeta0", "gyro_scale")),
]


@pytest.mark.parametrize(("variant", "names"), CASES)
def test_they_keep_value_and_variance_and_the_others_do_not(log, variant, names):
    estimator = fed(log, variant, considered=names)
    fresh = PoseEstimator(ALPHA, variant)
    free = fed(log, variant)
    for name in s.STATE_NAMES[s.LEARNT]:
        index = state_names(variant).index(name)
        stays = (
            estimator.state[index] == fresh.state[index]
            and estimator.covariance[index, index] == fresh.covariance[index, index]
        )
        was_free = free.covariance[index, index] != fresh.covariance[index, index]
        assert bool(stays) == (name in names or not was_free)
    # They are correlated with what is estimated.
    rows = [state_names(variant).index(name) for name in names]
    uncertain = [row for row in rows if fresh.covariance[row, row] > 0.0]
    assert uncertain
    assert all(np.abs(estimator.covariance[row, s.POSE]).max() > 0.0 for row in uncertain)
    assert np.linalg.eigvalsh(estimator.covariance)[0] > -1e-9


def test_what_has_no_uncertainty_stays_whether_considered_or_not(log):
    """The step is another one for other states, and equal to rounding: plain, as compiling takes long."""
    part = first(log, 1.0)
    one, other = fed(part), fed(part, considered=("H",), engine="plain")
    assert apart(other, one.state, one.covariance) < 1e-9


@pytest.mark.thorough
@pytest.mark.parametrize("considered", [(), ("eta0",)])
def test_the_filter_is_as_sure_as_it_may_be(considered):
    """NEES over runs drawn from the model: of slip and bias, of the pose, and of the twist."""
    variant, runs, totals = find_variant("inertia-online"), 20, np.zeros(3)
    robot, options = ALPHA, {}
    if considered:
        # Little slip, known radii and level ground, or these would explain what eta0 leaves open.
        known = dict.fromkeys(("tracks.difference_sigma", "slope.sigma", "slope.walk"), 0.0)
        robot = changed_robot(ALPHA, known)
        usual = msgspec.structs.asdict(slip_of(ALPHA, variant))
        shares = {name: 0.1 * size for name, size in usual.items() if "time" not in name}
        options["slip"] = msgspec.structs.replace(slip_of(ALPHA, variant), **shares)
        options["adaptation"] = default_adaptation("inertia-online", eta0=0.15)
    standstill = StandstillSettings(track_speed=0.0)
    settings = Settings(considered=considered, standstill=standstill, **options)
    sampler = ModelSampler(robot, variant, settings, Fixes(interval=2.0))
    speeds = 0.5 + 0.2 * np.sin(np.arange(401) * 0.02)[:, None] * [-1.0, 1.0]
    for seed in range(runs):
        run = sampler.run(speeds, 0.02, np.random.default_rng(seed))
        estimator = PoseEstimator(robot, "inertia-online", settings=settings)
        one = feed_all(estimator, run.measurements).snapshot()
        error, P = one.state - run.states[-1], one.covariance
        for k, some in enumerate(([s.SLIP_X, s.SLIP_W, s.GYRO_BIAS], [s.X, s.Y, s.YAW])):
            totals[k] += error[some] @ np.linalg.solve(P[np.ix_(some, some)], error[some])
        error = one.twist - run.twists[-1]
        totals[2] += error @ np.linalg.solve(one.twist_covariance, error)
    low, high = chi2.interval(0.999, 3 * runs)
    assert (low < totals).all()
    assert (totals < high).all()


def test_what_was_learnt_is_taken_over_and_then_stays(log, tmp_path):
    learnt = fed(log)
    learnt.save(tmp_path / "saved.json")
    settings = Settings(considered=("eta0", "gyro_bias"))
    warm = PoseEstimator.warm_start(tmp_path / "saved.json", ALPHA, off=3600.0, settings=settings)
    for index in (s.ETA0, s.GYRO_BIAS):
        assert warm.state[index] == learnt.state[index]
        assert warm.covariance[index, index] == learnt.covariance[index, index]
    # A bias that is estimated has walked meanwhile.
    index = s.ACCELEROMETER_BIAS_Y
    assert warm.covariance[index, index] > learnt.covariance[index, index]
    before = warm.state[s.LEARNT]
    feed_all(warm, log)
    stays = warm.state[s.LEARNT] == before
    assert stays[[s.ETA0 - s.LEARNT.start, s.GYRO_BIAS - s.LEARNT.start]].all()
    assert warm.covariance[s.ETA0, s.ETA0] == learnt.covariance[s.ETA0, s.ETA0]
    assert not stays[s.EPSILON0 - s.LEARNT.start]


def test_smoothing_refuses_them(log):
    with pytest.raises(EstimatorError, match=r"Settings.considered names \(eta0, gyro_bias\)"):
        smooth(log, ALPHA, "inertia-online", settings=Settings(considered=("eta0", "gyro_bias")))


@pytest.mark.parametrize(
    ("name", "said"), [("eta_0", "'eta_0'; did you mean 'eta0'"), ("yaw", "'yaw'")]
)
def test_a_name_that_is_none_is_refused_with_the_nearest(name, said):
    with pytest.raises(EstimatorError, match=f"Settings.considered cannot hold {said}"):
        PoseEstimator(ALPHA, settings=Settings(considered=(name,)))


@pytest.mark.parametrize(
    "variant", ["inertia-online", *map(thorough, sorted(VARIANTS.keys() - {"inertia-online"}))]
)
def test_all_that_is_learnt_may_be_considered(variant):
    names = tuple(filter(None, state_names(variant)[s.LEARNT]))
    # The compiled filter is the plain one: see test_agreement.py.
    settings = Settings(considered=names, engine="plain")
    estimator = PoseEstimator(ALPHA, variant, settings=settings, **START)
    before = estimator.state[s.LEARNT]
    for k in range(20):
        estimator.feed(TrackSpeeds(k * STEP, 0.3, 0.5))
        estimator.feed(ImuSample(k * STEP, (0.0, 0.0, 0.3), (0.0, 0.1, 9.8)))
    estimator.feed(PositionFix(estimator.stamp, 0.2, 0.1, 0.01))
    assert (estimator.state[s.LEARNT] == before).all()
