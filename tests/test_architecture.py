"""The walls of the house: who may import whom, and what must not be loaded early."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
# Each package and the packages of this repository that it may import.
MAY_IMPORT = {
    "estimator": {"estimator"},
    "simulation": {"simulation", "estimator"},
    "replay": {"replay", "estimator"},
    "icreckon": {"icreckon", "simulation", "replay", "estimator"},
}
HEAVY = {"scipy", "matplotlib", "numba", "filterpy", "rosbags", "pyarrow", "distributed"}
LONGEST_FILE = 600


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported_packages(source: Path) -> set[str]:
    """Top-level names of all imports in a file, also those inside functions."""
    names = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source}: a relative import hides its direction"
            names.add(str(node.module).split(".")[0])
    return names


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_run_downwards_only(package: str) -> None:
    files = sources(package)
    assert files
    for source in files:
        wrong = imported_packages(source) & set(MAY_IMPORT) - MAY_IMPORT[package]
        assert not wrong, f"{source.relative_to(ROOT)} imports {wrong}"


def test_the_lazy_names_of_the_front_door_are_real() -> None:
    import icreckon

    for name in icreckon.__all__:
        assert getattr(icreckon, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        icreckon.nothing  # noqa: B018


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_files_are_rooms_not_halls(package: str) -> None:
    for source in sources(package):
        lines = len(source.read_text(encoding="utf-8").splitlines())
        assert lines <= LONGEST_FILE, f"{source.relative_to(ROOT)} has {lines} lines"


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_packages_are_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").exists()
    assert (ROOT / package / "__init__.py").exists()


@pytest.mark.parametrize(
    "statement",
    [
        "import icreckon",
        "import icreckon.cli, sys; sys.argv = ['icreckon', '--help']\n"
        "try: icreckon.cli.main()\nexcept SystemExit: pass",
    ],
    ids=["import", "help"],
)
def test_nothing_heavy_is_loaded_early(statement: str) -> None:
    script = f"{statement}\nimport sys\nprint('|'.join(sorted(sys.modules)), file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    loaded = {name.split(".")[0] for name in done.stderr.strip().splitlines()[-1].split("|")}
    assert "icreckon" in loaded
    assert not loaded & HEAVY


def test_the_repository_names_no_absolute_path_of_a_machine() -> None:
    tracked = subprocess.run(
        ["git", "ls-files"], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout.split()
    for name in tracked:
        if Path(name).suffix in {".py", ".md", ".toml", ".yml", ""}:
            text = (ROOT / name).read_text(encoding="utf-8")
            for start in ("/" + "home/", "/" + "root/", "/" + "work/"):
                assert start not in text, f"{name} holds {start}"
