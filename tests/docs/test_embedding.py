"""The guide for embedding: its code runs and does what the text says."""

import contextlib
import io
import re

import numpy as np
import pytest

from icreckon.estimator.base.frames import compose, wrap_angle
from readme import code_blocks

PAGE = "docs/how-to/embedding.md"


def test_what_is_considered_or_kept_stays(guide):
    names, _ = guide
    of_file = names["robot"].indices
    eta0 = names["considering"].parameter_health["eta0"]
    assert names["considering"].parameters["eta0"] == of_file.eta0
    assert (eta0.share, eta0.sigma) == (1.0, 0.4)
    assert names["kept"].parameters["eta0"] == of_file.eta0
    assert names["kept"].parameters["epsilon0"] != of_file.epsilon0


@pytest.fixture(scope="module")
def guide(tmp_path_factory):
    """All names after the blocks of the guide have run, and what each has printed."""
    names, printed = {}, []
    with contextlib.chdir(tmp_path_factory.mktemp("guide")):
        for block in code_blocks("python", PAGE):
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(block, PAGE, "exec"), names)  # noqa: S102
            printed.append(out.getvalue())
    return names, printed


def test_visual_odometry_helps(guide):
    names, _ = guide
    true = names["truth"].poses[-1]
    alone, fused = (names[name] for name in ("alone", "fused"))
    assert fused.health.sensors["body velocity"].late > 150
    assert fused.pose_covariance[0, 0] < alone.pose_covariance[0, 0]
    assert np.hypot(*(fused.pose - true)[:2]) < np.hypot(*(alone.pose - true)[:2])


def test_restored_warm_started_and_docked_are_what_the_guide_says(guide):
    names, _ = guide
    assert (names["same"].pose == names["fused"].pose).all()
    assert (names["later"].pose == 0.0).all()
    assert names["later"].parameters == names["fused"].parameters
    docked = names["docked"]
    assert docked.pose == pytest.approx([0.1, 0.0, 0.2], abs=0.02)
    assert docked.biases["gyro_bias"] == pytest.approx(0.004, abs=1e-3)
    assert docked.health.rejections() == {}


def test_every_example_says_something(guide):
    _, printed = guide
    assert all(printed)
    # What is kept fixed has no share, and the others are learnt.
    text = "".join(printed)
    (learnt,) = re.findall(r"eta0: \S+, share nan\nepsilon0: \S+, share (\S+)\n", text)
    assert float(learnt) < 1.0


def test_a_start_in_a_map_is_found(guide):
    names, _ = guide
    start = [names[name] for name in ("x0", "y0", "yaw0")]
    wrong = names["mapped"].pose - compose(start, names["log"].truth.poses.poses[-1])
    assert np.hypot(*wrong[:2]) < 0.2
    assert abs(wrap_angle(wrong[2])) < 0.05
    assert names["mapped"].health.rejections() == {}
