"""`icreckon calibrate` from bag to robot file, and every command of the page about it."""

import io
import math
import re
from pathlib import Path
from unittest import mock

import msgspec
import pytest
from markupsafe import escape
from rich.console import Console

from command_line import results_in, succeeds
from conftest import simulated
from icreckon import IcreckonError, ReplayError, calibrate, compare, drift, read_log, robot_toml
from icreckon.cli.calibrate import command
from icreckon.estimator.robot.robot_file import Robot, Slip, changed_robot, load_robot
from icreckon.replay.calibration import results
from icreckon.replay.calibration.robot_file import robot_file_text
from icreckon.replay.export.log_bag import write_log
from icreckon.replay.mapping.topics import topic_map
from icreckon.report.calibration.tables import calibration_page, calibration_tables, parameter_table
from readme import code_blocks, run_page

PAGE = "docs/tutorials/calibrate.md"
ROBOT = load_robot("auriga-alpha")
RADIUS = ROBOT.vehicle.sprocket_radius


@pytest.mark.parametrize(("before", "warns"), [(2.05, True), (3.0, False), (math.nan, False)])
def test_values_that_drift_further_are_named(
    before: float, warns: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    drifts = iter((before, 2.84, 4.0))
    monkeypatch.setattr(results, "mean_drift", lambda *_: next(drifts))
    said = results.headline(([], ROBOT), ([], ROBOT), lambda _: None)
    assert ("That is more than before" in said) == warns


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a robot that is not quite its file's, and what calibration made of it."""
    folder = tmp_path_factory.mktemp("calibrate")
    simulated(folder / "drive", 90.0, trajectory="aggressive", truth="kinematic", fix_rate=0.0)
    words = ("--robot", "auriga-alpha", "--models", "constant,inertia")
    words = (*words, "--write", "found.toml", "--ros", "ros.yaml", "--out", "results")
    done = succeeds("calibrate", "drive", *words, cwd=folder, drawn=True)
    assert "The data support inertia-based ICRs" in done.stdout
    assert "held, not shown" in done.stdout
    return folder


def test_a_narrow_terminal_gets_the_verdict_first_and_fewer_columns(folder: Path) -> None:
    results = results_in(folder / "results")
    console = Console(width=80, file=io.StringIO())
    console.print(calibration_tables(results, narrow=True))
    shown = console.file.getvalue()
    assert re.match(r"inertia-online drifts \d\.\d\d % of the distance after 30 s", shown)
    assert "The data support inertia-based ICRs." in shown
    assert max(map(len, shown.splitlines())) <= 80
    assert "…" not in shown
    assert "log likelihood" not in shown
    # What a status says stands once, below the table.
    letter = re.search(r"│ indices.H +│.*│ held ([a-z]) +│", shown)[1]
    assert f"\n{letter}: not shown; " in shown
    assert shown.count("acts in the literal form only") == 1


def test_a_radius_is_corrected_also_if_the_reader_leaves_early(folder: Path) -> None:
    """As `... | head -3` does. The bag's own map says that its track speeds are rates.

    Settings for ROS have the radius that the truth shows, not that times the correction again.
    """
    bare = msgspec.structs.replace(ROBOT, log={})
    write_log(read_log(folder / "drive", ROBOT), folder / "bare", "mcap", bare)
    text = robot_toml(changed_robot(bare, {"vehicle.sprocket_radius": 1.1 * RADIUS}))
    (folder / "wide.toml").write_text(text, encoding="utf-8")
    files = {"write": folder / "early.toml", "ros": folder / "wide.yaml", "out": folder / "wide"}
    words = {"paths": ["bare"], "robot_name": str(folder / "wide.toml"), "models": "constant"}
    leaves = mock.patch("icreckon.cli.calibrate.show", side_effect=BrokenPipeError)
    with leaves, pytest.raises(BrokenPipeError):
        calibrated(folder, **words, **files)
    found = load_robot(folder / "early.toml").vehicle.sprocket_radius
    assert found == pytest.approx(RADIUS, rel=0.03)
    settings = (folder / "wide.yaml").read_text(encoding="utf-8")
    radius, shown = re.search(
        r"wheel_radius: (\S+)  # m, effective: by the truth of this log (\S+)", settings
    ).groups()
    assert float(radius) == pytest.approx(0.1, rel=0.03)
    assert float(shown) == pytest.approx(float(radius), rel=0.01)
    multiplier, by_gyro = re.search(
        r"multiplier: (\S+)  # calibrated ± \S+; by the gyro of this log (\S+)", settings
    ).groups()
    assert float(by_gyro) == pytest.approx(float(multiplier), rel=0.03)


def test_it_leaves_results_and_a_picture(folder: Path) -> None:
    results = results_in(folder / "results")
    assert results["command"] == "calibrate"
    assert results["inputs"].keys() == {"drive"}
    assert results["supported_model"] == "inertia"
    assert results["verdict"].startswith("The data support inertia-based ICRs")
    assert list(results["models"]) == ["constant", "inertia"]
    eta0 = results["parameters"]["indices.eta0"]
    low, high = eta0["interval_95"]
    assert eta0["status"] == "shown"
    assert low < eta0["value"] < high
    assert results["parameters"]["indices.H"]["interval_95"] is None
    assert len(results["series"]["t_s"]) == results["logs"][0]["moving_segments"]
    assert (folder / "results" / "figure.png").read_bytes().startswith(b"\x89PNG")
    page = (folder / "results" / "page.html").read_text(encoding="utf-8")
    assert page == calibration_page(results)
    assert page.index(str(escape(results["headline"]))) < page.index("<img") < page.index("<table")
    for name in results["parameters"]:
        assert f'<td class="text">{name}</td>' in page.replace("<wbr>", "")


def test_hostile_names_stay_text_on_the_page(folder: Path) -> None:
    results = results_in(folder / "results")
    bad = "</script><script>alert(1)</script><img src=x onerror=y>"
    results["robot"]["name"] = results["logs"][0]["name"] = bad
    results["notes"], results["configuration"] = [bad], {bad: bad}
    page = calibration_page(results)
    assert "<script" not in page
    assert "<img src" not in page
    assert str(escape(bad)) in page


def test_the_robot_file_loads_and_replays(folder: Path) -> None:
    results = results_in(folder / "results")
    robot = load_robot(folder / "found.toml")
    found = msgspec.convert(results["robot"], Robot)
    for name in ("eta0", "epsilon0", "epsilon1", "zeta1", "eta2"):
        assert getattr(robot.indices, name) == pytest.approx(getattr(found.indices, name), rel=1e-6)
    text = (folder / "found.toml").read_text(encoding="utf-8")
    assert text.startswith("# Calibrated by icreckon from drive, starting from auriga-alpha.\n")
    assert "\nH = 0.67134" in text
    assert "± " in text
    comparison = compare(read_log(folder / "drive", robot), robot, ["gyro", "inertia-fixed"])
    truth = comparison.log.truth.poses
    gyro, inertia = (
        drift(one.trajectory.pose_series, truth, 10.0).percent_mean
        for one in comparison.runs.values()
    )
    assert inertia < gyro


def calibrated(folder: Path, **options: object) -> None:
    """The command's own function, with what is usual where nothing else is asked for."""
    usual: dict[str, object] = dict.fromkeys(("write", "ros", "lever_arm", "models"))
    usual |= {"paths": ["drive"], "robot_name": "auriga-alpha", "out": folder / "none"}
    usual |= dict.fromkeys(("as_json", "wide", "overwrite"), False)
    usual |= {"message_files": [], "segment": 3.0, **options}
    usual["paths"] = [folder / str(name) for name in usual["paths"]]
    command(**usual)


def test_what_is_there_is_not_overwritten_unasked(folder: Path) -> None:
    before = (folder / "found.toml").read_text(encoding="utf-8")
    with pytest.raises(ReplayError, match=r"found\.toml exists already"):
        calibrated(folder, write=folder / "found.toml", out=folder / "other")
    (folder / "mine.toml").write_text("# mine\n", encoding="utf-8")
    with pytest.raises(ReplayError, match="did not write"):
        calibrated(folder, write=folder / "mine.toml", overwrite=True, out=folder / "other")
    assert (folder / "found.toml").read_text(encoding="utf-8") == before
    assert not (folder / "other").exists()


def test_the_robot_file_keeps_all_of_its_tables(folder: Path) -> None:
    """Mapping, slip, notes: what calibration does not touch is written as it was."""
    mapped = ROBOT.log | {
        "tracks": ROBOT.log["tracks"] | {"latency": 0.0},
        "columns": {"time": "t", "tracks": {"left": ["l"], "right": ["r"]}},
    }
    changes = {
        "note": 'with "quotes" and a\nline',
        "slip": {"inertia-online": Slip(turning_x=0.07)},
    }
    full = msgspec.structs.replace(ROBOT, log=mapped, **changes)
    log = read_log(folder / "drive", ROBOT).part(0.0, 60.0)
    found = calibrate([log], full, models=("constant",))
    path = folder / "full.toml"
    path.write_text(robot_file_text(found, ["drive"], "full"), encoding="utf-8")
    again = load_robot(path)
    for table in ("note", "slip", "soil", "indices"):
        assert getattr(again, table) == getattr(full, table)
    assert again.log["columns"] == mapped["columns"]
    assert topic_map(again).tracks.left == ("left_track_joint",)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"robot_name": None}, "what is the robot?"),
        ({"paths": ["drive", "drive"]}, "given twice"),
        ({"lever_arm": "0.3"}, "two numbers in metres"),
        ({"models": "best,constant"}, "no model named 'best'"),
        ({"paths": ["results"]}, "the folder holds no .mcap, .db3 or .bag file"),
    ],
    ids=["robot", "twice", "lever", "model", "folder"],
)
def test_bad_input_is_refused(folder: Path, options: dict[str, object], said: str) -> None:
    before = sorted(folder.iterdir())
    with pytest.raises(IcreckonError, match=re.escape(said)):
        calibrated(folder, **options)
    assert sorted(folder.iterdir()) == before


@pytest.mark.slow
def test_every_command_of_the_page_works(tmp_path: Path) -> None:
    run_page(PAGE, tmp_path)
    assert load_robot(tmp_path / "calibrated.toml").name == "auriga-alpha"


@pytest.mark.slow
def test_the_python_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = code_blocks("python", PAGE)
    exec(compile(example, PAGE, "exec"), {})  # noqa: S102
    assert "The data support" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("value", "sigma", "texts"),
    [
        (10.3784, 0.12, ("10.38", "0.12")),
        (-0.00097797, 0.0043, ("-0.001", "0.0043")),
        (-1.1766e-06, 5.4e-06, ("-1.2e-06", "5.4e-06")),
        (-0.31202, 0.01, ("-0.312", "0.010")),
        (300.0, 2000.0, ("300", "2.0e+03")),
        (0.0, 0.17, ("0", "0.17")),
        (1.073456, None, ("1.0735", "")),
    ],
)
def test_values_end_at_the_second_digit_of_their_error(value, sigma, texts):
    one = {
        "value": value, "sigma": sigma, "status": "shown", "note": "", "unit": "m", "before": None,
        "before_is_default": False, "sigma_other_logs": sigma,
    }  # fmt: skip
    table = parameter_table({"parameters": {"a": one}, "robot": {"name": "r"}})
    (_, cells) = table.rows[0]
    assert tuple(cell.text for cell in cells[:2]) == texts
