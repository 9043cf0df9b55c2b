"""What `colcon test` runs: this package and the installed icreckon fit together."""

from pathlib import Path

import yaml

from icreckon.ros2.parameters import options_from

CONFIG = Path(__file__).parents[1] / "config" / "icreckon.yaml"


def test_parameters_are_of_this_icreckon() -> None:
    """Each parameter of the file is known, and its value is valid."""
    values = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))["/**"]["ros__parameters"]
    assert options_from(values | {"robot": "auriga-alpha"}).robot == "auriga-alpha"
