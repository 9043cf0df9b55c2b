"""The first bag of a stranger: what is missing stands at the top, and tables are one log."""

import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from command_line import fails, icreckon, results_in, succeeds
from icreckon import Scenario, load_robot, robot_toml, simulate
from icreckon.report.replay.page import replay_page
from icreckon.report.replay.page_text import calibration_hint, ends_text, noise_text
from icreckon.report.replay.tables import results_table
from small_robot import COLUMNS

ROBOT = load_robot("auriga-alpha")
REPLAY = ("--robot", "robot.toml", "--variants", "gyro,differential", "--out", "out", "--overwrite")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wheels, IMU and truth of a drive, each in a table; in `early` with stamps from -20 s on."""
    folder = tmp_path_factory.mktemp("tables")
    log = simulate(Scenario(duration=45.0, seed=2, fix_rate=0.0), ROBOT)
    tracks, imu, truth = log.tracks, log.imu, log.truth.poses
    readings = np.hstack([imu.angular_velocity, imu.linear_acceleration])
    tables = {
        "wheels": ("t,left,right", tracks.stamps, tracks.speeds),
        "imu": ("t,gx,gy,gz,ax,ay,az", imu.stamps, readings),
        "truth": ("t,truth_x,truth_y,truth_yaw", truth.stamps, truth.poses),
    }
    for place, offset in ((folder, 0.0), (folder / "early", -20.0)):
        place.mkdir(exist_ok=True)
        for name, (head, stamps, values) in tables.items():
            rows = np.column_stack([(stamps - log.start) * 1e-9 + offset, values])
            how = {"delimiter": ",", "header": head, "comments": "", "fmt": "%.9f"}
            np.savetxt(place / f"{name}.csv", rows, **how)
        (place / "robot.toml").write_text(robot_toml(ROBOT) + COLUMNS, encoding="utf-8")
    return folder


def test_tables_that_are_named_together_are_one_log(folder: Path) -> None:
    names = ("imu.csv", "wheels.csv", "truth.csv")
    done = succeeds("replay", *names, *REPLAY, "--formats", "none", cwd=folder)
    assert "read as one log, of which each file has a part: imu.csv, wheels.csv" in done.stderr
    results = results_in(folder / "out")
    assert results["log"]["imu_samples"] > 4000
    assert results["truth"]["distance_m"] > 10.0
    mapping = json.loads(icreckon("inspect", *names, "--json", cwd=folder).stdout)["mapping"]
    assert mapping["columns"]["truth"]["x"] == "truth_x"


def test_stamps_below_zero_are_refused_before_the_run_where_a_format_has_none(folder: Path) -> None:
    names = ("wheels.csv", "imu.csv", "truth.csv")
    said = fails("replay", *names, *REPLAY, "--formats", "tum,mcap", cwd=folder / "early")
    assert "stamps begin at -20 s, and bags have none below zero: give --formats tum,csv" in said
    succeeds("replay", *names, *REPLAY, "--formats", "tum,csv", cwd=folder / "early")
    first = (folder / "early" / "out" / "gyro.tum").read_text(encoding="utf-8").split()[0]
    assert float(first) == pytest.approx(-20.0, abs=0.1)


def test_an_imu_that_is_missing_stands_above_the_verdict(folder: Path) -> None:
    done = icreckon("replay", "wheels.csv", "truth.csv", *REPLAY, "--formats", "none", cwd=folder)
    lines = done.stdout.splitlines()
    assert lines[0].startswith("The robot file does not fit this log")
    assert "for imu are not all in these tables" in lines[1]
    assert not any(line.startswith("Note: robot file") for line in lines)


@pytest.fixture
def results(folder: Path) -> dict[str, object]:
    made = folder / "out" / "results.json"
    if not made.exists():
        test_tables_that_are_named_together_are_one_log(folder)
    return json.loads(made.read_text(encoding="utf-8"))


def test_an_uncalibrated_file_is_named_beside_a_truth(results: dict) -> None:
    results["configuration"] |= {"log": "drive.bag", "robot": "mine.toml"}
    results["robot"]["indices"] |= dict.fromkeys(("zeta1", "epsilon1", "eta1", "eta2"), 0.0)
    (line,) = calibration_hint(results)
    assert line.endswith("icreckon calibrate drive.bag --robot mine.toml --write calibrated.toml")
    console = Console(width=150, record=True)
    console.print(results_table(results))
    shown = console.export_text()
    ordered = "drifts", "The robot file is not calibrated", "variant"
    assert [*map(shown.index, ordered)] == sorted(map(shown.index, ordered))
    assert line in replay_page(results)
    results["robot"]["indices"]["zeta1"] = 1e-3
    assert calibration_hint(results) == []


def test_ends_that_differ_tenfold_and_noise_of_the_truth_are_named(results: dict) -> None:
    gyro, differential = results["variants"]["gyro"], results["variants"]["differential"]
    results["verdict"]["best"] = "differential"
    gyro["final_position_error_m"], differential["final_position_error_m"] = 72.4, 3.2
    assert ends_text(results).endswith("differential is 3.20 m off, gyro is 72.4 m off.")
    differential["final_position_error_m"] = 10.0
    assert ends_text(results) == ""
    results["verdict"]["best"], gyro["final_position_error_m"] = "gyro", 15.1
    assert "gyro is the farthest off, 15.1 m" in ends_text(results)
    results["verdict"] |= {"horizon": "30s", "drift_percent": 14.4}
    results["truth"]["noise_drift_percent"] = {"30s": 8.0}
    assert "a perfect path drifts 8.00 %." in noise_text(results)
    results["truth"]["noise_drift_percent"] = {"30s": 2.0}
    assert noise_text(results) == ""


@pytest.mark.parametrize("width", [60, 80, 100, 124])
def test_tables_fill_the_width_and_have_the_column_of_the_verdict(results, width):
    """Rejections are one line, however many variants rejected something."""
    results["verdict"]["horizon"] = "30m"
    for one in results["variants"].values():
        one |= {"drift_percent_30m_mean": 7.77, "rejected": {"gyro: gate": 3}}
        one["used"]["gyro"] = 97
    console = Console(width=width, record=True)
    console.print(results_table(results, narrow=width))
    lines = console.export_text().splitlines()
    (head,) = [line for line in lines if line.startswith("┏")][:1]
    assert width - 17 < len(head.rstrip()) <= width
    assert sum("7.77" in line for line in lines) == len(results["variants"])
    assert sum("3 of 100 gyro (gate)" in line for line in lines) == 1
