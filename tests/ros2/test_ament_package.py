"""The ament package: what it declares, what it starts, and that colcon builds it."""

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
import tomllib
import venv
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from runpy import run_path
from types import ModuleType
from typing import Any

import msgspec
import pytest

import icreckon
from conftest import REPOSITORY
from icreckon.replay.bags import message_types
from icreckon.ros2.parameters import DESCRIPTIONS, NodeOptions

NAME = "icreckon_ros"
PACKAGE = REPOSITORY / "ros2" / NAME
LAUNCH = PACKAGE / "launch" / "icreckon.launch.py"
CONFIG = PACKAGE / "config" / "icreckon.yaml"
OF_PIP = {"icreckon", "msgspec"}


def manifest(tag: str) -> list[str]:
    text = (PACKAGE / "package.xml").read_text(encoding="utf-8")
    return re.findall(rf"<{tag}\b[^>]*>(.*?)</{tag}>", text)


def ros_packages(source: Path) -> Iterator[str]:
    """ROS packages that a file imports, or whose message types it names."""
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) == "ros":
            modules = [getattr(message_types, node.attr)]
        elif isinstance(node, ast.ImportFrom):
            modules = [str(node.module)]
        elif isinstance(node, ast.Constant) and re.fullmatch(r"\w+/msg/\w+", str(node.value)):
            modules = [node.value]
        else:
            continue
        for module in modules:
            top = re.split(r"[./]", module)[0]
            if top not in sys.stdlib_module_names | OF_PIP:
                yield top


def test_the_manifest_is_that_of_the_library() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert manifest("name") == [NAME]
    assert manifest("version") == [icreckon.__version__]
    assert manifest("license") == [project["license"]]
    setup = (PACKAGE / "setup.py").read_text(encoding="utf-8")
    assert f'version="{icreckon.__version__}"' in setup
    assert (PACKAGE / "resource" / NAME).exists()


def test_the_manifest_names_every_ros_package_that_is_imported() -> None:
    sources = [*(REPOSITORY / "icreckon" / "ros2").glob("*.py"), LAUNCH]
    used = {package for source in sources for package in ros_packages(source)}
    assert {"rclpy", "tf2_msgs", "launch_ros", "rcl_interfaces"} <= used
    # The inputs' types are known only when the robot runs.
    assert set(manifest("exec_depend")) == used | {"sensor_msgs"}


def test_the_config_has_every_parameter_with_its_default() -> None:
    text = CONFIG.read_text(encoding="utf-8")
    _, _, body = text.partition("/**:\n  ros__parameters:\n")
    assert body == "".join(
        f"    # {DESCRIPTIONS[one.name]}\n    {one.name}: {json.dumps(one.default)}\n"
        for one in msgspec.structs.fields(NodeOptions)
    )


def test_the_packages_own_test_passes() -> None:
    """That which `colcon test` runs on the robot."""
    run_path(str(PACKAGE / "test" / "test_parameters.py"))["test_parameters_are_of_this_icreckon"]()


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem.partition(".")[0], path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("words", [[], ["--robot", "a.toml", "--ros-args", "-p", "reorder:=1.0"]])
def test_the_entry_point_is_the_command(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    import icreckon.cli.main

    seen: list[list[str]] = []
    monkeypatch.setattr(icreckon.cli.main, "main", lambda: seen.append(sys.argv))
    monkeypatch.setattr(sys, "argv", ["odometry", *words])
    loaded(PACKAGE / NAME / "node.py").main()
    assert seen == [["icreckon", "ros2-node", *words]]


def test_an_environment_without_icreckon_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "icreckon.cli.main", None)
    with pytest.raises(
        SystemExit, match=r"icreckon_ros: icreckon cannot be imported by .*: activate"
    ):
        loaded(PACKAGE / NAME / "node.py").main()


# --- the launch file ------------------------------------------------------------------------------


class Made:
    """Stand-in for any class of launch and launch_ros: remembers its arguments."""

    def __init__(self, *words: Any, **more: Any) -> None:
        self.words, self.more = words, more

    def perform(self, context: dict[str, str]) -> str:
        return context[self.words[0]]


STAND_INS = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction"),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
    "launch_ros.substitutions": ("FindPackageShare",),
}


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    for name, classes in STAND_INS.items():
        module = ModuleType(name)
        vars(module).update({one: type(one, (Made,), {}) for one in classes})
        monkeypatch.setitem(sys.modules, name, module)
    return loaded(LAUNCH)


def test_the_launch_file_declares_its_arguments(launch_file: ModuleType) -> None:
    *declared, last = launch_file.generate_launch_description().words[0]
    names = [one.words[0] for one in declared]
    assert names == [
        "robot", "variant", "state_file", "params_file", "use_sim_time", "namespace", "respawn"
    ]  # fmt: skip
    assert last.more["function"] is launch_file.make_node
    path = declared[3].more["default_value"].words[0]
    assert (PACKAGE / Path(*path[1:])).samefile(CONFIG)


def test_the_launched_node_has_the_arguments_that_are_given(launch_file: ModuleType) -> None:
    given = {
        "robot": "a.toml",
        "variant": "",
        "state_file": "b.json",
        "use_sim_time": "true",
        "namespace": "",
    }
    (node,) = launch_file.make_node(given)
    setup = (PACKAGE / "setup.py").read_text(encoding="utf-8")
    assert node.more["package"] == NAME
    assert f'"{node.more["executable"]} = {{NAME}}.node:main"' in setup
    file, values = node.more["parameters"]
    assert file.words == ("params_file",)
    assert set(values) == {"robot", "state_file", "use_sim_time"}
    assert node.more["namespace"].words == ("namespace",)
    assert node.more["respawn"].words == ("respawn",)


# --- colcon ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace in which colcon, in an environment of its own, has built the package."""
    folder = tmp_path_factory.mktemp("colcon")
    venv.create(folder / "venv", with_pip=True)
    programs, built = folder / "venv" / "bin", folder / "workspace"
    install = [programs / "pip", "install", "-q", "colcon-common-extensions", "catkin_pkg"]
    done = subprocess.run(install, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"pip cannot install colcon: {done.stderr.strip()[-200:]}")
    built.mkdir()
    command = [programs / "colcon", "build", "--base-paths", REPOSITORY / "ros2"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=built)
    assert done.returncode == 0, done.stdout + done.stderr
    return built


def ros2_run(workspace: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run the installed entry point as `ros2 run` does, with the Python of the tests."""
    program = workspace / "install" / NAME / "lib" / NAME / "odometry"
    script = f'source "{workspace}/install/setup.bash" && exec "{program}" "$@"'
    environment = os.environ | {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    }
    return subprocess.run(
        ["bash", "-c", script, "bash", *map(str, words)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=120,
        check=False,
    )


@pytest.mark.slow
def test_colcon_installs_what_ros2_launch_looks_for(workspace: Path) -> None:
    share = workspace / "install" / NAME / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / NAME).exists()
    for source in (LAUNCH, CONFIG, PACKAGE / "package.xml"):
        installed = share / NAME / source.relative_to(PACKAGE)
        assert installed.read_text(encoding="utf-8") == source.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_installed_entry_point_ends_with_a_line(workspace: Path) -> None:
    done = ros2_run(workspace)
    wanted = (
        "parameter robot: give a robot file" if find_spec("rclpy") else "rclpy cannot be imported"
    )
    assert done.returncode == 1, done.stderr
    assert wanted in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_the_installed_entry_point_reads_the_installed_config(workspace: Path) -> None:
    if find_spec("rclpy") is None:
        pytest.skip("no ROS 2: pip install -e '.[ros2-test]', or source a ROS 2")
    config = workspace / "install" / NAME / "share" / NAME / "config" / "icreckon.yaml"
    done = ros2_run(workspace, "--ros-args", "--params-file", config, "-p", "robot:=no-such-robot")
    assert done.returncode == 1, done.stderr
    assert "no-such-robot" in done.stderr
    assert "Traceback" not in done.stderr
