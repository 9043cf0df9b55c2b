"""The page of a comparison: what it says, and that a browser shows it without a word of complaint."""

import copy
import html
import json
import re
import subprocess
from base64 import b64encode
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from markupsafe import escape

from icreckon import Comparison, ReplayError, Scenario, compare, load_robot, simulate, summarise
from icreckon.replay.comparison import plot_series
from icreckon.replay.comparison.results import write_results
from icreckon.report.printable import change
from icreckon.report.replay.figures import write_figure
from icreckon.report.replay.folder import write_views
from icreckon.report.replay.page import replay_page
from icreckon.report.replay.page_charts import constant_parameters, page_data
from icreckon.report.replay.page_text import fault_lines, headline, notes, number, remarks
from icreckon.report.terms import TERMS

VARIANTS = ["differential", "constant-online", "inertia-online"]
HOSTILE = (
    "</script><script>console.error('caught')</script><img src=http://e.example/x onerror=x> & \"'"
)


ROBOT = load_robot("auriga-alpha")


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    drive = {"trajectory": "aggressive", "outages": ((20.0, 90.0),)}
    return compare(simulate(Scenario(duration=90.0, seed=4, **drive), ROBOT), ROBOT, VARIANTS)


def results_of(comparison: Comparison) -> dict[str, Any]:
    return summarise(comparison, ROBOT, command="replay", configuration={"log": "run"})


@pytest.fixture(scope="module")
def results(comparison: Comparison) -> dict[str, Any]:
    return results_of(comparison)


@pytest.fixture
def changed(results: dict[str, Any]) -> dict[str, Any]:
    """Results to be changed."""
    return copy.deepcopy(results)


@pytest.fixture(scope="module")
def blind(comparison: Comparison) -> dict[str, Any]:
    """The same log, without truth and fixes."""
    log = replace(comparison.log, truth=None, fixes=None)
    return results_of(Comparison(log, comparison.runs, None))


@pytest.fixture(scope="module")
def page(results: dict[str, Any]) -> str:
    return replay_page(results)


# --- without a browser ---------------------------------------------------------------------------


def test_without_a_truth_the_streams_that_are_left_out_come_first(blind: dict[str, Any]) -> None:
    note = "the log holds position fixes on /fix, which the file leaves out"
    told = {**blind, "log": {**blind["log"], "notes": ["another", note]}}
    assert remarks(told) == [note]
    assert replay_page(told).index(note) < replay_page(told).index("another")


@pytest.mark.parametrize(("suffix", "begins"), [("pdf", b"%PDF-"), ("svg", b"<?xml")])
def test_the_figure_is_drawn_as_vectors_too(
    suffix: str, begins: bytes, comparison: Comparison, tmp_path: Path
) -> None:
    path = tmp_path / f"figure.{suffix}"
    write_figure(path, summarise(comparison, ROBOT))
    assert path.read_bytes().startswith(begins)


def test_the_page_is_made_of_results_json_and_nothing_else(tmp_path, results, page):
    write_results(tmp_path / "results.json", results)
    text = (tmp_path / "results.json").read_text(encoding="utf-8")
    assert json.loads(text) == results
    assert replay_page(json.loads(text)) == page
    # Lists of numbers stand in one line: some lines for each key, not for each number.
    assert len(text.splitlines()) < 1500
    (tmp_path / "again").mkdir()
    write_views(tmp_path / "again", results)
    assert (tmp_path / "again" / "page.html").read_text(encoding="utf-8") == page
    with pytest.raises(ReplayError, match="--overwrite"):
        write_views(tmp_path / "again", results)


def test_nothing_is_fetched(page: str) -> None:
    assert "http:" not in page
    assert "https:" not in page
    assert not re.search(r"<(link|img|iframe|object|embed|base|form)\b", page)
    assert not re.search(r"\b(src|href|action)\s*=", page)
    assert "@import" not in page
    assert "url(" not in re.sub(r"url\(#(\$\{clip\}|clip-map)\)", "", page)
    assert "default-src 'none'" in page


def test_long_logs_make_no_larger_pages(results: dict[str, Any], page: str) -> None:
    # 1.5 MB for seven variants over half an hour; here they are three.
    assert len(page) < 1_500_000
    assert len(results["series"]["t_s"]) == plot_series.SERIES_POINTS
    for one in results["series"]["variants"].values():
        assert len(one["parameters"]["t_s"]) == plot_series.PARAMETER_POINTS
        for each in one["innovations"].values():
            assert len(each["t_s"]) <= plot_series.INNOVATION_POINTS


def test_hostile_names_stay_text(changed: dict[str, Any]) -> None:
    bad = changed
    bad["log"]["name"] = bad["robot"]["name"] = HOSTILE
    bad["log"]["notes"] = [HOSTILE]
    bad["log"]["dropped"] = {HOSTILE: 3}
    bad["truth"]["source"] = HOSTILE
    bad["configuration"] = {HOSTILE: HOSTILE}
    bad["inputs"] = {HOSTILE: "sha256:0"}
    bad["variants"]["differential"]["rejected"] = {HOSTILE: 1}
    bad["variants"]["differential"]["used"] = {HOSTILE: 1}
    for variants in (bad["series"]["variants"], bad["variants"]):
        variants[HOSTILE] = variants.pop("differential")
    text = replay_page(bad)
    assert text.count("<script") == 2
    assert text.count("</script>") == 2
    assert "<img" not in text
    assert escape(HOSTILE) in text
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    assert HOSTILE in [one["name"] for one in json.loads(data[1])["series"]]


def test_truth_is_silent_in_its_holes(comparison: Comparison) -> None:
    log = comparison.log
    poses = log.truth.poses
    kept = (poses.stamps < log.start + 40 * 10**9) | (poses.stamps > log.start + 50 * 10**9)
    holed = replace(poses, stamps=poses.stamps[kept], poses=poses.poses[kept])
    truth = replace(log.truth, poses=holed)
    found = results_of(Comparison(replace(log, truth=truth), comparison.runs, None))["series"]
    times = np.array(found["t_s"])
    for values in (found["truth"]["x_m"], found["variants"]["differential"]["position_error_m"]):
        unknown = np.array([value is None for value in values])
        assert unknown[(times > 40.6) & (times < 49.4)].all()
        assert not unknown[(times < 39.9) | (times > 50.1)].any()


def test_charts_have_axes_with_units_and_rows_that_match(results: dict[str, Any]) -> None:
    data = page_data(results)
    columns = data["columns"]
    places = {chart["place"] for chart in data["charts"]}
    assert places == {"errors", "motion", "inputs", "icrs", "parameters", "innovations"}
    names = {one["name"] for one in data["series"]}
    assert names == {*VARIANTS, "ground truth", "fixes used"}
    for chart in data["charts"]:
        assert re.search(r"\[.+\]$", chart["y_label"])
        for item in chart.get("lines", []) + chart.get("points", []) + chart.get("bands", []):
            assert item["series"] in names if "series" in item else item["label"]
            used = [item[key] for key in ("y", "sigma", "middle") if item.get(key)]
            assert {len(columns[name]) for name in used} == {len(columns[item["x"]])}
    (position,) = (chart for chart in data["charts"] if chart["title"] == "Position error")
    assert position["spans"] == results["truth"]["scored_s"]
    for band in position["bands"]:
        sigma = results["series"]["variants"][band["series"]]["position_sigma_m"]
        assert (band["times"], band["middle"]) == (3.0, None)
        assert columns[band["sigma"]] is sigma
    learnt = {chart["title"]: chart["y_label"] for chart in data["charts"]}
    assert learnt["Steering efficiency index without force, η₀"] == "eta0 [-]"
    assert learnt["Bias of the gyro"] == "gyro_bias [rad/s]"


@pytest.mark.parametrize("name", ["ground truth", "constant-online", "inertia-online"])
def test_at_its_icr_the_robot_moves_as_the_track_runs(results: dict[str, Any], name: str) -> None:
    columns = page_data(results)["columns"]

    def of(key: str) -> Any:
        return np.array(columns[key], dtype=float)

    v_x, v_y, w = (of(f"{name}/{key}") for key in ("v_x_m_s", "v_y_m_s", "w_rad_s"))
    turning = np.abs(w) > 0.1
    # Noise of the tracks, and the slip that no index stands for; speeds are up to 1 m/s.
    for side in ("left", "right"):
        over_ground = v_x - w * of(f"{name}/{side}_icr_y_m")
        assert np.nanmedian(np.abs(over_ground - of(f"inputs/{side}_m_s"))[turning]) < 0.05
    assert np.nanmedian(np.abs(v_y + w * of(f"{name}/icr_x_m"))[turning]) < 0.02


def test_a_hole_of_the_log_lifts_the_pen(results, changed):
    times = np.array(changed["series"]["t_s"])
    changed["series"]["t_s"] = np.where(times > 40.0, times + 58.0, times).tolist()
    (row,) = page_data(changed)["breaks"]["t"]
    assert times[row - 1] <= 40.0 < times[row]
    assert page_data(results)["breaks"]["t"] == []


def test_yaws_are_shown_in_the_turn_of_the_truth(results, changed):
    yaw = changed["series"]["variants"]["differential"]["yaw_rad"]
    changed["series"]["truth"]["yaw_rad"][900:] = [None] * (len(yaw) - 900)
    yaw[500:] = [value + 4.0 * np.pi for value in yaw[500:]]
    data = page_data(changed)
    (chart,) = (one for one in data["charts"] if one["title"] == "Yaw, counter-clockwise")
    (line,) = (one for one in chart["lines"] if one["series"] == "differential")
    told = results["series"]["variants"]["differential"]["yaw_rad"]
    np.testing.assert_allclose(data["columns"][line["y"]], told, atol=0.01)


# --- the verdict ---------------------------------------------------------------------------------


def test_the_verdict_stands_first_and_names_horizon_and_interval(results, page):
    found, told = results["verdict"], headline(results)
    assert told.startswith(f"inertia-online drifts least: {number(found['drift_percent'])} %")
    assert f"after {found['horizon'][:-1]} s of dead reckoning (95 % interval" in told
    assert f"That is {change(found['ratio'])} than constant-online (95 %: " in told
    assert page.index(escape(told)) < page.index("<h2>")


def test_a_lead_that_may_be_chance_is_called_so(results: dict[str, Any]) -> None:
    verdict = results["verdict"] | {"ratio": 0.9, "ratio_95": [0.7, 1.1]}
    told = headline(results | {"verdict": verdict})
    assert told.startswith("No variant drifts significantly less than constant-online on this log.")
    assert "10 % less than constant-online (95 %: 30 % less to 10 % more): that may be" in told
    worst = max(verdict["ratios_to_best"], key=verdict["ratios_to_best"].get)
    more = change(verdict["ratios_to_best"][worst])
    assert f"may be chance. {worst} drifts {more}." in headline(
        results | {"verdict": verdict | {"not_shown_worse": []}}
    )
    told = headline(results | {"verdict": verdict | {"ratio_95": None, "drift_percent_95": None}})
    assert "The log is too short to say" in told
    assert "interval" not in told


def test_a_missing_imu_and_errors_less_than_predicted_are_named(changed: dict[str, Any]) -> None:
    changed["log"]["imu_samples"] = 0
    assert "No IMU was read, so gyro is the wheels alone" in headline(changed)
    changed["variants"][changed["verdict"]["best"]]["nees_pose_mean"] = 0.75
    told = "are 50 % less than it predicts (pose NEES 0.75, ideal 3)"
    assert any(told in remark for remark in remarks(changed))


def test_without_truth_none_is_called_best(blind: dict[str, Any]) -> None:
    assert blind["verdict"] is None
    told = headline(blind)
    assert told.startswith("No ground truth, so none can be called best.")
    ends = [(one["end_x_m"], one["end_y_m"]) for one in blind["variants"].values()]
    widest = max(np.hypot(a[0] - b[0], a[1] - b[1]) for a in ends for b in ends)
    assert f"up to {number(widest)} m apart" in told
    assert remarks(blind) == []
    assert "How far apart per horizon" in replay_page(blind)


def test_fixes_throughout_leave_nothing_to_score() -> None:
    log = simulate(Scenario(duration=10.0, seed=4), ROBOT)
    found = results_of(compare(log, ROBOT, ["constant-online"]))
    assert found["verdict"] is None
    assert headline(found).startswith("Nowhere in this log is there a stretch of dead reckoning")
    assert "At its end, constant-online is closest to the truth" in headline(found)
    assert replay_page(found).startswith("<!DOCTYPE html>")


# --- in a browser --------------------------------------------------------------------------------


TELL = """
const tell = (told) => {
  const pre = document.createElement("pre");
  pre.id = "told";
  pre.textContent = JSON.stringify(told);
  document.body.append(pre);
};
"""


def opened(chromium: str, folder: Path, text: str, script: str) -> tuple[str, list[str]]:
    """The page's document as the browser has it in the end, and what it wrote to its console."""
    path = folder / "page.html"
    end = f"<script>{TELL}{script}</script></body>"
    path.write_text(text.replace("</body>", end), encoding="utf-8")
    command = [
        *(chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"),
        *("--no-first-run", "--disable-extensions", f"--user-data-dir={folder / 'profile'}"),
        *("--window-size=1280,900", "--virtual-time-budget=5000", "--dump-dom", path.as_uri()),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def told_by(document: str) -> dict[str, Any]:
    found = re.search(r'<pre id="told">(.*?)</pre>', document, re.S)
    assert found is not None, document[-2000:]
    return json.loads(html.unescape(found[1]))


def test_a_browser_shows_it_without_complaint(acted, results):
    document, complaints = acted
    assert complaints == []
    charts = page_data(results)["charts"]
    assert f'data-drawn="{len(charts)}"' in document
    assert document.count("<figure>") == len(charts)
    assert "ICR left" in document
    for chart in charts:
        assert html.escape(chart["title"], quote=False) in document
        assert html.escape(chart["y_label"], quote=False) in document
    assert html.escape(headline(results), quote=False) in document
    assert "NaN" not in document.split("<script")[0]


ACT = """
async function act() {
const told = {}, map = document.querySelector("svg.map"), box = map.getBoundingClientRect();
const ends = () => [...map.querySelectorAll("text")].map((one) => one.textContent).join(" ");
const lines = () => map.querySelectorAll("path").length;
const fire = (type, name, more) => map.dispatchEvent(new type(name, { bubbles: true, cancelable: true,
  clientX: box.left + box.width / 2, clientY: box.top + box.height / 2, ...more }));
const point = (name, id, dx, dy) => fire(PointerEvent, name, { pointerId: id,
  clientX: box.left + box.width / 2 + dx, clientY: box.top + box.height / 2 + dy });
const frame = () => new Promise((done) => setTimeout(done, 50));
  const first = ends();
  told.passing = fire(WheelEvent, "wheel", { deltaY: -500 });
  told.cancelled = !fire(WheelEvent, "wheel", { deltaY: -500, ctrlKey: true });
  await frame();
  told.wheel = ends() !== first;
  fire(MouseEvent, "dblclick", {});
  await frame();
  told.reset = ends() === first;
  point("pointerdown", 1, 0, 0); point("pointermove", 1, 150, 60); point("pointerup", 1, 150, 60);
  await frame();
  told.drag = ends() !== first;
  document.querySelector("button[aria-label='show all']").click();
  await frame();
  told.button = ends() === first;
  point("pointerdown", 1, -50, 0); point("pointerdown", 2, 50, 0);
  point("pointermove", 1, -200, 0); point("pointermove", 2, 200, 0);
  point("pointerup", 1, -200, 0); point("pointerup", 2, 200, 0);
  await frame();
  told.pinch = ends() !== first;
  fire(MouseEvent, "dblclick", {});
  const time = document.querySelector("svg.over"), scrolls = new WheelEvent("wheel",
    { deltaY: -500, bubbles: true, cancelable: true });
  told.scrolls = time.dispatchEvent(scrolls);
  const before = lines(), toggle = document.querySelector(".toggles input");
  toggle.click();
  await frame();
  told.hidden = before - lines();
  toggle.click();
  await frame();
  told.shown = before - lines();
  told.requests = performance.getEntriesByType("resource").length;
  told.sideways = document.documentElement.scrollWidth > document.documentElement.clientWidth;
  return told;
}
"""


LINKED = """
function linked() {
const told = {}, chart = document.querySelector("#errors svg"), box = chart.getBoundingClientRect();
const at = (name, share) => chart.dispatchEvent(new PointerEvent(name, { pointerId: 1, bubbles: true,
  pointerType: "mouse", clientX: box.left + share * box.width, clientY: box.top + 50 }));
const robot = () => document.querySelector("#map .robot").getAttribute("transform");
const axes = () => [...document.querySelectorAll("#motion svg")].map((one) => one.textContent).join();
const choose = (name, value) => {
  const [select] = [...document.querySelectorAll("label")]
    .filter((one) => one.textContent.startsWith(name))
    .map((one) => one.querySelector("select"));
  select.value = value;
  select.dispatchEvent(new Event("change"));
};
const first = robot();
at("pointermove", 0.3);
told.moved = robot() !== first;
told.values = document.querySelector(".values").textContent.includes("constant-online: ");
told.slider = Math.abs(document.querySelector("#player input").value - State.cursor) < 0.1;
const all = axes();
at("pointerdown", 0.4); at("pointermove", 0.6); at("pointerup", 0.6);
told.zoomed = axes() !== all && !document.getElementById("reset").hidden;
document.getElementById("reset").click();
told.reset = axes() === all && document.getElementById("reset").hidden;
choose("charts over", "distance");
told.distance = axes().includes("distance driven [m]") && !axes().includes("time [s]");
told.coloured = State.page.drive.colourings.map((one, row) => {
  choose("path coloured by", row);
  return document.querySelector("#map .bar").textContent.includes(one.meaning);
});
choose("robot by", "constant-online");
const go = document.getElementById("go"), last = document.querySelectorAll("h2").length - 1;
go.value = last;
go.dispatchEvent(new Event("change"));
told.gone = window.scrollY > 1000 && go.value === "";
told.driver = document.querySelector("#map .bar").textContent.startsWith("constant-online");
return told;
}
act().then((acted) => tell({ acted, linked: linked() }));
"""


@pytest.fixture(scope="module")
def acted(chromium, tmp_path_factory, page):
    # A browser without a screen that is told to dump its document draws no more frames.
    frames = "<script>window.requestAnimationFrame = (draw) => setTimeout(draw, 0);</script></head>"
    return opened(
        chromium, tmp_path_factory.mktemp("acted"), page.replace("</head>", frames), ACT + LINKED
    )


def test_paths_zoom_and_pan_by_wheel_drag_and_pinch_and_variants_hide(acted):
    document, complaints = acted
    assert complaints == []
    done = ("passing", "cancelled", "wheel", "reset", "drag", "button", "pinch", "scrolls")
    counted = {"hidden": 1, "shown": 0, "requests": 0, "sideways": False}
    assert told_by(document)["acted"] == dict.fromkeys(done, True) | counted


def test_charts_map_and_robot_show_one_moment(acted):
    told = told_by(acted[0])["linked"]
    assert told.pop("coloured") == [True] * 5
    assert told == dict.fromkeys(
        ("moved", "values", "slider", "zoomed", "reset", "distance", "driver", "gone"), True
    )


FRAMED = """
<!DOCTYPE html><html><body>
<iframe style="width:390px;height:800px"></iframe><iframe style="width:1280px;height:800px"></iframe>
<script type="text/plain" id="page">PAGE</script></body></html>
"""
LOOK = """
const page = new TextDecoder().decode(Uint8Array.from(atob(
  document.getElementById("page").textContent), (one) => one.charCodeAt(0)));
const look = (frame) => new Promise((done) => {
  frame.addEventListener("load", () => setTimeout(() => {
    const inside = frame.contentDocument, root = inside.documentElement, told = {};
    told.width = root.clientWidth;
    told.sideways = root.scrollWidth > root.clientWidth;
    told.cut = [...inside.querySelectorAll("svg text")].filter((one) => {
      const text = one.getBoundingClientRect(), svg = one.closest("svg").getBoundingClientRect();
      return text.left < svg.left - 2 || text.right > svg.right + 12;
    }).map((one) => one.textContent);
    told.height = root.scrollHeight;
    told.ellipses = inside.querySelectorAll("#map ellipse").length;
    const fold = inside.querySelector("details.section h2").closest("details");
    fold.open = true;
    told.verdict = inside.querySelector(".headline").getBoundingClientRect().bottom;
    setTimeout(() => {
      told.drawn = Math.min(...[...fold.querySelectorAll("svg")].map((one) => one.clientWidth));
      done(told);
    }, 500);
  }, 1000));
  frame.srcdoc = page;
});
Promise.all([...document.querySelectorAll("iframe")].map(look)).then(tell);
"""


@pytest.fixture(scope="module")
def framed(chromium, tmp_path_factory, page):
    """What the page shows at the width of a phone and at that of a desktop."""
    wrapper = FRAMED.replace("PAGE", b64encode(page.encode()).decode())
    document, complaints = opened(chromium, tmp_path_factory.mktemp("framed"), wrapper, LOOK)
    assert complaints == []
    return told_by(document)


def test_at_the_width_of_a_phone_nothing_is_cut_off(framed):
    told = framed[0]
    assert told["width"] == pytest.approx(390, abs=20)
    assert not told["sideways"]
    assert told["cut"] == []
    # At first glance, above the fold.
    assert told["verdict"] < 500


def test_a_desktop_shows_it_on_few_screens_and_sections_unfold(framed):
    told = framed[1]
    assert told["width"] == pytest.approx(1280, abs=20)
    assert told["height"] < 5000
    assert told["ellipses"] > 5
    assert told["drawn"] > 300


@pytest.mark.parametrize(
    ("points", "contacts", "length"),
    [(5, [[0.0, 0.9]], 0.9), (2, [[0.45, 0.56], [-0.45, 0.56]], 1.46)],
)
def test_a_wheeled_robot_is_drawn_on_wheels(changed, points, contacts, length):
    sizes = {"contact_points": points, "half_contact_length": 0.45, "sprocket_radius": 0.28}
    changed["robot"]["vehicle"] |= sizes
    page = replay_page(changed)
    assert ("wheelbase 0.9" if points == 2 else "contact length 0.9") in page
    drive = page_data(changed)["drive"]
    assert drive["contacts"] == contacts
    assert drive["length"] == pytest.approx(length)


def test_each_term_is_explained_without_a_script(page: str) -> None:
    """A popover opens by a tap or a key, a title on hover; neither needs JavaScript."""
    for one in TERMS:
        assert page.count(f'popover id="term-{one.key}"') == 1
    targets = set(re.findall(r'popovertarget="term-([\w-]+)"', page))
    assert targets <= {one.key for one in TERMS}
    assert {"nees", "nis", "sigma", "drift", "innovation", "icr", "rmse"} <= targets
    for button in re.findall(r"<button [^>]*popovertarget[^>]*>", page):
        assert 'type="button"' in button
        assert re.search(r'title="[^"]{20,}"', button)


def with_bias(results: dict[str, Any], value: float) -> dict[str, Any]:
    """Results in which the bias of the gyro stays at a value."""
    for one in results["series"]["variants"].values():
        learnt = one["parameters"]["gyro_bias"]
        learnt["value"] = [value] * len(learnt["value"])
        learnt["sigma"] = [2e-3] * len(learnt["sigma"])
    return results


def test_a_parameter_that_the_log_does_not_move_is_no_chart(changed: dict[str, Any]) -> None:
    flat = with_bias(changed, 1.5e-4)
    assert constant_parameters(flat)["gyro_bias"]["inertia-online"] == (1.5e-4, 2e-3)
    titles = [chart["title"] for chart in page_data(flat)["charts"]]
    assert "Bias of the gyro" not in titles
    row = re.search(r"<td class=\"text\">gyro_<wbr>bias</td>(.*?)</tr>", replay_page(flat), re.S)
    assert "0.00015 ± 0.004 rad/s" in row[1]
    assert ", ".join(VARIANTS) in row[1]


@pytest.mark.parametrize("change", ["value", "sigma"])
def test_a_parameter_that_one_variant_learns_is_a_chart(changed, change):
    moved = with_bias(changed, 0.0)
    moved["series"]["variants"]["inertia-online"]["parameters"]["gyro_bias"][change][-1] = 1e-3
    # The level lines of the others would only lie over it.
    assert list(constant_parameters(moved)["gyro_bias"]) == VARIANTS[:2]
    (chart,) = (one for one in page_data(moved)["charts"] if one["title"] == "Bias of the gyro")
    for part in ("lines", "bands"):
        assert [one["series"] for one in chart[part]] == ["inertia-online"]


def test_faults_are_named_with_their_times(changed) -> None:
    assert not fault_lines(changed)
    best = changed["verdict"]["best"]
    changed["variants"][best]["fault_spans_s"] = {
        "spinning: left track": [[10.0, 11.5], [40.0, 41.0]],
        "silent: IMU": [[50.0, 60.0]],
    }
    found = f"Found by the variant {best}: "
    assert fault_lines(changed) == [
        f"{found}left track spinning, or its sensor failing; 2 times, 2.50 s in all between 10.0 and "
        "41.0 s",
        f"{found}no samples of the IMU; once, 10.0 s in all between 50.0 and 60.0 s",
    ]
    assert set(fault_lines(changed)) <= set(notes(changed))
    speeds = next(one for one in page_data(changed)["charts"] if one["place"] == "inputs")
    assert speeds["spans"] == [[10.0, 11.5], [40.0, 41.0], [50.0, 60.0]]


def test_faults_are_named_without_a_truth_too(blind: dict[str, Any]) -> None:
    """By the last of the filters, since none is the best."""
    assert blind["verdict"] is None
    name = list(blind["variants"])[-1]
    spans = {"fault_spans_s": {"silent: IMU": [[50.0, 60.0]]}}
    variants = blind["variants"] | {name: blind["variants"][name] | spans}
    (line,) = fault_lines(blind | {"variants": variants})
    assert line.startswith(f"Found by the variant {name}: no samples of the IMU; once")
