"""`ros2 run icreckon_ros odometry`: `icreckon ros2-node` with the same arguments."""

import sys


def main() -> None:
    """Run the node; errors are one line and a non-zero exit."""
    try:
        from icreckon.cli.main import main as icreckon
    except ImportError as problem:
        sys.exit(
            f"icreckon_ros: icreckon cannot be imported by {sys.executable} ({problem}): activate the "
            "virtual environment into which it was installed, see docs/tutorials/live.md"
        )
    sys.argv = ["icreckon", "ros2-node", *sys.argv[1:]]
    icreckon()
