"""What a release needs agrees: versions, dependencies, workflows, and the recipe for conda."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions

import yaml

import icreckon
from icreckon.cli.main import app
from readme import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ELSEWHERE = {"rclpy", "diagnostic_msgs", "geometry_msgs", "nav_msgs", "rcl_interfaces", "std_srvs"}
ELSEWHERE |= {"visualization_msgs", "sensor_msgs", "tf2_msgs", "builtin_interfaces", "std_msgs"}
"""Packages of ROS 2, which comes with the robot."""
FOLDERS = ("estimator", "simulation", "replay", "icreckon/cli", "icreckon/report", "icreckon/ros2")


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def name_of(requirement: str) -> str:
    return re.split(r"[<>=;\s\[]", requirement)[0].lower().replace("_", "-").replace(".", "-")


def test_a_version_is_the_same_everywhere() -> None:
    version = PROJECT["version"]
    assert icreckon.__version__ == version
    changes = re.findall(r"^## ([\d.]+), (\d{4}-\d{2}-\d{2})$", read("CHANGELOG.md"), re.MULTILINE)
    assert changes[0][0] == version
    cited = yaml.safe_load(read("CITATION.cff"))
    assert cited["version"] == version
    assert f"version = {{{version}}}" in read("docs/explanation/cite.md")
    assert str(cited["date-released"]) == changes[0][1]
    assert f'{{% set version = "{version}" %}}' in read(".github/conda-recipe/meta.yaml")


def test_what_is_imported_is_declared() -> None:
    declared = {name_of(one) for one in PROJECT["dependencies"]}
    homes = packages_distributions()
    missing = set()
    for folder in FOLDERS:
        for file in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    modules = [one.name for one in node.names]
                elif isinstance(node, ast.ImportFrom) and not node.level:
                    modules = [f"{node.module}.{one.name}" for one in node.names]
                else:
                    continue
                for module in modules:
                    top, _, rest = module.partition(".")
                    known = sys.stdlib_module_names | ELSEWHERE | {"icreckon"}
                    if top in known or top == "compression":
                        continue
                    names = {name_of(one) for one in homes.get(top, [top])}
                    names |= {name_of(f"{top}.{rest.partition('.')[0]}")}
                    if not names & declared:
                        missing.add(f"{file.relative_to(ROOT)}: {module}")
    assert not missing, sorted(missing)


def test_the_recipe_for_conda_has_the_same_dependencies() -> None:
    recipe = read(".github/conda-recipe/meta.yaml")
    run = recipe.partition("  run:\n")[2].partition("\n\n")[0]
    listed = set(re.findall(r"^    - (\S.*?)(?: +#.*)?$", run, flags=re.MULTILINE))
    named = {"matplotlib": "matplotlib-base"}
    wanted = {f"python {PROJECT['requires-python']}"}
    for requirement in PROJECT["dependencies"]:
        name, bound = re.fullmatch(r"([\w.-]+)(>=[\w.]+(?:,<\w+)?)(?:;.*)?", requirement).groups()
        wanted.add(f"{named.get(name, name)} {bound}")
    assert listed == wanted


def test_the_workflows_run_what_the_repository_runs() -> None:
    ci = yaml.safe_load(read(".github/workflows/ci.yml"))
    steps = [one.get("run", "") for one in ci["jobs"]["whole"]["steps"]]
    assert "bash .ci/run" in steps
    pythons = {job["python"] for job in ci["jobs"]["fast"]["strategy"]["matrix"]["include"]}
    pythons |= set(ci["jobs"]["fast"]["strategy"]["matrix"]["python"])
    classified = re.findall(r":: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert pythons == set(classified)
    assert "mkdocs build --strict" in read(".github/workflows/docs.yml")


def test_commands_of_forms_and_pages_exist() -> None:
    names = {one.name or one.callback.__name__.replace("_", "-") for one in app.registered_commands}
    pages = [*(ROOT / ".github").rglob("*.yml"), *(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        for command in re.findall(r"`icreckon ([a-z][\w-]*)(?=[ `])", text):
            assert command in names, f"{page.name}: icreckon {command}"
