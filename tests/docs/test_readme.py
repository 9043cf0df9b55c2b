"""The README and the docs do what they say."""

import re
import shlex
import shutil
from pathlib import Path

import msgspec
import pytest
from PIL import Image

from command_line import Done, icreckon
from icreckon import VARIANTS, Imu, load_robot, load_scenario
from icreckon.estimator.robot.variants import used_parameters
from icreckon.replay.mapping.topics import topic_map
from icreckon.simulation.drives.trajectories import trajectory_names, trajectory_options
from readme import RENEWS, ROOT, code_blocks, says

SHELL = code_blocks("sh")


def test_the_first_two_commands_are_the_main_job_and_the_tests() -> None:
    assert SHELL[0].strip().endswith("icreckon demo")
    assert SHELL[1].strip().endswith("-m pytest")
    for block in SHELL[:2]:
        assert len(block.strip().splitlines()) == 1


def test_the_python_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = code_blocks("python")
    names: dict[str, object] = {}
    exec(compile(example, "README.md", "exec"), names)  # noqa: S102
    assert "left ICR" in capsys.readouterr().out
    estimator = names["estimator"]
    x, y, yaw = estimator.pose
    assert 1.5 < x < 2.5
    assert y > 0.5
    assert 1.0 < yaw < 1.6


def test_the_robot_file_in_the_docs_loads_and_shows_every_key(tmp_path: Path) -> None:
    (text,) = code_blocks("toml", "docs/reference/robot-file.md")
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    robot = load_robot(path)
    topic_map(robot)
    for table in (
        robot.vehicle,
        robot.indices,
        robot.constant_icr,
        robot.imu,
        robot.tracks,
        robot.slope,
        robot.undetected_slip,
        robot.soil,
    ):
        for field in msgspec.structs.fields(table):
            assert f"\n{field.name} = " in text, field.name
    for field in msgspec.structs.fields(robot.slip["inertia-online"]):
        assert f"\n{field.name} = " in text, field.name


def test_a_robot_file_with_what_the_docs_require_loads(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(
        'name = "a"\n[vehicle]\nmass = 80.0\ntrack_gauge = 0.6\nsprocket_radius = 0.1\n'
        "[constant_icr]\nx_ICRl = -0.4\nx_ICRr = 0.4\n",
        encoding="utf-8",
    )
    assert load_robot(path).imu == Imu()


def test_the_docs_name_the_unit_of_every_parameter() -> None:
    page = (ROOT / "docs" / "explanation" / "model.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"^\| models \| parameter .*\n((?:\|.*\n)+)", page, flags=re.MULTILINE)
    named = re.findall(r"`(\w+)`", table)
    variants = [VARIANTS[name] for name in ("inertia-online", "full-linear")]
    assert sorted(named) == sorted(name for one in variants for name in used_parameters(one))


def test_the_scenario_file_in_the_docs_loads_and_shows_every_key(tmp_path: Path) -> None:
    (text,) = code_blocks("toml", "docs/reference/scenario-file.md")
    path = tmp_path / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    scenario = load_scenario(path)
    tables = dict(re.findall(r"^\[(\w+)\].*\n((?:(?!\[).*\n)*)", text, flags=re.MULTILINE))
    for field in msgspec.structs.fields(scenario):
        value = getattr(scenario, field.name)
        if isinstance(value, tuple) and value and isinstance(value[0], msgspec.Struct):
            for key in msgspec.structs.fields(value[0]):
                assert re.search(rf"^{key.name} = ", text, re.MULTILINE), key.name
        elif isinstance(value, msgspec.Struct):
            for key in msgspec.structs.fields(value):
                assert re.search(rf"^{key.name} = ", tables[field.name], re.MULTILINE), key.name
        else:
            assert re.search(rf"^(# |\[)?{field.name}( = |\])", text, re.MULTILINE), field.name


def test_the_docs_list_every_trajectory_with_its_options_and_their_defaults() -> None:
    page = (ROOT / "docs" / "reference" / "scenario-file.md").read_text(encoding="utf-8")
    by_hand = page.partition("\n## All keys\n")[0]
    rows = re.findall(r"^\| `([\w-]+)` \| .* \| (.*) \|$", by_hand, flags=re.MULTILINE)
    assert sorted(name for name, _ in rows) == sorted(trajectory_names())
    for name, described in rows:
        said = {
            option: float(number) if number else None
            for option, number in re.findall(r"`(\w+)`(?: ([\d.]+))?", described)
        }
        assert said == trajectory_options(name), name


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub and the site make them."""
    text = re.sub(
        r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    titles = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in titles}


def test_links_between_the_pages_lead_to_headings() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / ".github").rglob("*.md"), *(ROOT / "docs").rglob("*.md")]
    assert len(pages) > 40
    for page in pages:
        links = re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]+))?\)", page.read_text(encoding="utf-8"))
        for file, anchor in links:
            target = page.parent / file if file else page
            assert target.exists(), f"{page.name} links {file}"
            if anchor:
                assert anchor in anchors(target), f"{page.name} links {file}#{anchor}"


@pytest.mark.slow
def test_the_demo_gives_the_picture_of_the_readme(tmp_path: Path) -> None:
    assert "inertia-online" in icreckon("demo", cwd=tmp_path, drawn=True).stdout
    made, shown = tmp_path / "icreckon-demo" / "figure.png", ROOT / "docs" / "demo.png"
    if RENEWS:
        shutil.copy(made, shown)
    titles = [Image.open(figure).text["Title"].splitlines() for figure in (made, shown)]
    assert len(titles[0]) == len(titles[1]) == 2
    assert all(says(*lines) for lines in zip(*titles, strict=True)), titles


@pytest.mark.slow
def test_the_replay_commands_work_on_a_bag(tmp_path: Path) -> None:
    """The block of the README with a simulated bag for LOG; what `inspect` cannot know is filled in."""

    def run(line: str) -> Done:
        return icreckon(*shlex.split(line, comments=True)[1:], cwd=tmp_path)

    assert run("icreckon simulate --out LOG --duration 60 --fix-rate 0").returncode == 0
    first, second, check, third, fourth = SHELL[2].strip().splitlines()
    assert "/joint_states" in run(first).stdout
    assert run(second).returncode == 0
    robot = tmp_path / "robot.toml"
    proposed = robot.read_text(encoding="utf-8")
    assert "mass = nan" in proposed
    # The gauge stands in for the one that only a person can measure.
    assert re.search(r"^track_gauge = 1\.\d+ +# m, the effective track", proposed, re.MULTILINE)
    for name, value in (("mass", 258.0), ("track_gauge", 0.42), ("sprocket_radius", 0.1)):
        proposed = re.sub(f"^{name} = \\S+", f"{name} = {value}", proposed, flags=re.MULTILINE)
    robot.write_text(proposed, encoding="utf-8")
    # The effective track is not filled in yet.
    checked = run(check)
    assert checked.returncode == 1
    assert "Set eta0 = " in checked.stdout
    assert "inertia-online" in run(third).stdout
    assert "The data support" in run(fourth).stdout


def test_the_first_lines_are_those_that_ci_runs() -> None:
    """CI runs the README's lines on a clean clone; running them from within would be a loop."""
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for words, name in ((SHELL[0], "demo_line"), (SHELL[1], "test_line")):
        (shown,) = re.findall(
            rf"^{name}=\$\(grep -m 1 -- '(.*)' README\.md\)$", script, re.MULTILINE
        )
        assert shown in words
        # In two parts, after the first of which kernels are compiled, or files are checked.
        for part in ("% &&", "##* &&"):
            assert f'\nbash -euo pipefail -c "${{{name}{part}' in script
