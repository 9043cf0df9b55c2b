"""A command that is no part of the package: the distance of each track in a log."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from conftest import simulated
from icreckon.cli.common.options import Json, Logs
from icreckon.cli.main import app

# --- the command --------------------------------------------------------------------------------------


def distance(
    log: Logs,
    robot: Annotated[str, typer.Option(help="Name of a robot, or a TOML file.")] = "auriga-alpha",
    as_json: Json = False,
) -> None:
    """Print how far each track has run."""
    # Imports inside: a command that is not called costs no time.
    import numpy as np

    from icreckon.estimator.robot.robot_file import load_robot
    from icreckon.replay.reading.read_log import read_log

    tracks = read_log(log, load_robot(robot)).tracks
    intervals = np.diff(tracks.stamps)[:, None] * 1e-9
    left, right = (np.abs(tracks.speeds[1:]) * intervals).sum(axis=0).tolist()
    if as_json:
        typer.echo(json.dumps({"left_m": left, "right_m": right}))
    else:
        typer.echo(f"left {left:.1f} m, right {right:.1f} m")


# --- its tests ----------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def command() -> Iterator[None]:
    app.command()(distance)
    yield
    app.registered_commands.pop()


def test_it_runs_over_a_bag(tmp_path: Path) -> None:
    bag = simulated(tmp_path / "drive", 20.0, trajectory="straight", fix_rate=0.0)
    shown = CliRunner().invoke(app, ["distance", str(bag)])
    assert shown.exit_code == 0, shown.output
    assert shown.stdout.startswith("left ")
    printed = CliRunner().invoke(app, ["distance", str(bag), "--robot", "auriga-alpha", "--json"])
    found = json.loads(printed.stdout)
    assert shown.stdout == f"left {found['left_m']:.1f} m, right {found['right_m']:.1f} m\n"
    assert found["left_m"] == pytest.approx(found["right_m"], rel=0.05)
    assert found["left_m"] > 5.0


def test_it_is_in_the_help() -> None:
    listed = CliRunner().invoke(app, ["--help"]).stdout
    assert "distance   Print how far each track has run." in listed
    options = CliRunner().invoke(app, ["distance", "--help"]).stdout
    for option in ("LOG...", "--robot", "--json"):
        assert option in options
