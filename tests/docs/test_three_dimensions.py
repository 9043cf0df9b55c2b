"""The guide to three dimensions: its code runs, and gives what is true."""

import numpy as np

from readme import code_blocks

PAGE = "docs/how-to/three-dimensions.md"


def test_its_pose_is_that_of_the_robot() -> None:
    names: dict = {}
    for block in code_blocks("python", PAGE):
        exec(compile(block, PAGE, "exec"), names)  # noqa: S102
    pose, truth = names["pose"], names["log"].truth.poses
    height, roll, pitch = truth.spatial[-1]
    assert abs(pose.position[2] - height) < 3.0 * np.sqrt(pose.covariance[2, 2])
    assert np.degrees(np.abs(pose.rpy[:2] - [roll, pitch])).max() < 1.5
    assert np.ptp(truth.spatial[:, 0]) > 0.3
