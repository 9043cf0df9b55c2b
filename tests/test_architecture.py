"""The walls and floors of the house: imports, what must not be loaded early, words of docstrings."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
# Rooms of each package from the ground up: a room may import those before it. "" holds the files of the
# package itself.
FLOORS = {
    "estimator": [
        "base", "log", "tracing", "motion", "robot", "faults", "sensors", "filter",
        "engine", "reference", "streaming", "batch", "embedded", "calibration", "",
    ],
    "simulation": ["base", "contact", "drives", "truth", "sensors", "", "study", "running", "paper"],
    "replay": [
        "base", "bags", "mapping", "reading", "live", "estimates", "inspection", "comparison", "checking",
        "calibration", "export", "",
    ],
    "icreckon": ["report", "ros2", "", "cli"],
}  # fmt: skip
# Packages that each may import.
MAY_IMPORT = {
    "estimator": {"estimator"},
    "simulation": {"simulation", "estimator"},
    "replay": {"replay", "estimator"},
    "icreckon": {"icreckon", "simulation", "replay", "estimator"},
}
LAYERS = ("estimator", "simulation", "replay")
# Libraries, and the only folders that may import them.
ONLY_IN = {
    "matplotlib": ("icreckon",),
    "rich": ("icreckon",),
    "jinja2": ("icreckon",),
    "typer": ("icreckon/cli",),
    "rosbags": ("replay/bags",),
    "mcap": ("replay/bags",),
    "rclpy": ("icreckon/ros2",),
    "filterpy": ("estimator/reference",),
    "numba": ("estimator/tracing",),
    "llvmlite": ("estimator/tracing",),
}
HEAVY = {"scipy", "matplotlib", "numba", "filterpy", "rosbags", "pyarrow"}
LONGEST_FILE = 600
MOST_LINES = 54_556  # of the four packages together; a change that adds makes room first
# Files that assemble the inputs of a step: of every step, of a prediction ahead, of the textbook.
ASSEMBLE = {
    "estimator/engine/lane_functions.py",
    "estimator/streaming/reckoning.py",
    "estimator/reference/filter.py",
}
MOST_FILES = 13
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
LONGEST_LINE = 80
# A first line begins with a verb or a noun of the field, not with these.
OPENINGS = re.compile(
    r"(What|How|Whether|Of|The same|Those|All that|Everything|Itself|See|Where|When|Which|Who|That)\b"
)
# Code and data do not speak, know, believe or ask.
PERSON_VERBS = re.compile(
    r"\b(told|tells?|says|said|knows?|believes?|believed|foretold|goes by|go by)\b"
)


@cache
def sources(package: str) -> list[Path]:
    """Files of a package, but not those that the links in icreckon/ lead to."""
    found = sorted((ROOT / package).rglob("*.py"))
    return [path for path in found if not any(parent.is_symlink() for parent in path.parents)]


def module_of(source: Path) -> str:
    parts = source.relative_to(ROOT).with_suffix("").parts
    name = ".".join(parts if parts[0] == "icreckon" else ("icreckon", *parts))
    return name.removesuffix(".__init__")


MODULES = {module_of(source): source for package in FLOORS for source in sources(package)}


@cache
def nodes(source: Path) -> tuple[ast.AST, ...]:
    """Imports and docstrings' owners in a file, also those inside functions."""
    kinds = ast.Import | ast.ImportFrom | DOCUMENTED
    found = ast.walk(ast.parse(source.read_text(encoding="utf-8")))
    return tuple(node for node in found if isinstance(node, kinds))


@cache
def imported(source: Path) -> frozenset[str]:
    """Modules of all imports in a file."""
    found: set[str] = set()
    for node in nodes(source):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source}: a relative import hides its direction"
            for alias in node.names:
                inside = f"{node.module}.{alias.name}"
                found.add(inside if inside in MODULES else str(node.module))
    return frozenset(found)


def docstrings(source: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each docstring of a file."""
    for node in nodes(source):
        text = ast.get_docstring(node) if isinstance(node, DOCUMENTED) else None
        if text is not None:
            yield getattr(node, "lineno", 1), text


def place_of(module: str) -> tuple[str, str]:
    """Package and room of a module; `__main__` is the command, so part of `cli`."""
    parts = module.replace("__main__", "cli").split(".")[1:]
    package = parts.pop(0) if parts and parts[0] in LAYERS else "icreckon"
    room = parts[0] if parts and parts[0] in FLOORS[package] else ""
    return package, room


@pytest.mark.parametrize("package", FLOORS)
def test_imports_run_downwards_only(package: str) -> None:
    floors = FLOORS[package]
    files = sources(package)
    assert files
    for source in files:
        room = place_of(module_of(source))[1]
        for module in imported(source):
            top = module.split(".")[0]
            assert top not in LAYERS, (
                f"{source.relative_to(ROOT)}: import icreckon.{module} instead"
            )
            if top != "icreckon":
                continue
            other_package, other_room = place_of(module)
            where = f"{source.relative_to(ROOT)} imports {module}"
            assert other_package in MAY_IMPORT[package], where
            if other_package == package and module != "icreckon":
                assert floors.index(other_room) <= floors.index(room), where


def test_no_files_import_each_other_in_a_circle() -> None:
    of = {name: {one for one in imported(path) if one in MODULES} for name, path in MODULES.items()}
    cleared: set[str] = set()

    def walk(name: str, path: list[str]) -> None:
        assert name not in path, f"a circle: {' -> '.join([*path[path.index(name) :], name])}"
        if name not in cleared:
            for other in of[name] - {name, "icreckon"}:
                walk(other, [*path, name])
            cleared.add(name)

    for name in of:
        walk(name, [])


@pytest.mark.parametrize("library", ONLY_IN)
def test_libraries_stay_in_their_rooms(library: str) -> None:
    for package in FLOORS:
        for source in sources(package):
            inside = source.relative_to(ROOT).as_posix().startswith(ONLY_IN[library])
            used = {module.split(".")[0] for module in imported(source)}
            assert inside or library not in used, f"{source.relative_to(ROOT)} imports {library}"


@pytest.mark.parametrize("package", FLOORS)
def test_rooms_are_small_and_say_what_they_are_for(package: str) -> None:
    folders = {source.parent for source in sources(package)}
    for folder in folders:
        files = [source for source in folder.glob("*.py") if source.name != "__init__.py"]
        # Each file of the command line is a command: there may be more of them.
        crowded = folder.name != "cli" and len(files) > MOST_FILES
        assert not crowded, f"{folder.relative_to(ROOT)} has {len(files)} files: merge or split it"
        init = folder / "__init__.py"
        assert init.exists(), folder
        assert next(docstrings(init), None), init


def test_tests_mirror_the_rooms() -> None:
    for test in (ROOT / "tests").rglob("test_*.py"):
        folder = test.parent.relative_to(ROOT / "tests")
        mirrored = folder.parts[1:] if folder.parts[:1] == ("icreckon",) else folder.parts
        assert any((ROOT / top / Path(*mirrored)).is_dir() for top in (".", "icreckon")), test


def test_the_architecture_page_lists_the_rooms_in_their_order() -> None:
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text(encoding="utf-8")
    listed: dict[str, list[str]] = {}
    package = ""
    for indent, name in re.findall(r"^    ( *)(\w+)/ ", page, flags=re.MULTILINE):
        if indent:
            listed[package].append(name)
        else:
            package = name
            listed[package] = []
    assert listed == {
        package: [room for room in rooms if room] for package, rooms in FLOORS.items()
    }
    for file in re.findall(r"`((?:estimator|simulation|replay|icreckon|tests)/[\w/]*\.py)`", page):
        assert (ROOT / file).exists(), file


def test_the_lazy_names_of_the_front_door_are_real() -> None:
    import icreckon

    for name in icreckon.__all__:
        assert getattr(icreckon, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        icreckon.nothing  # noqa: B018


@pytest.mark.parametrize("package", FLOORS)
def test_files_are_rooms_not_halls(package: str) -> None:
    for source in sources(package):
        lines = len(source.read_text(encoding="utf-8").splitlines())
        assert lines <= LONGEST_FILE, f"{source.relative_to(ROOT)} has {lines} lines"


@pytest.mark.parametrize("package", FLOORS)
def test_first_lines_are_plain(package: str) -> None:
    wrong = [
        f"{source.relative_to(ROOT)}:{line}: {first!r}: {why}"
        for source in sources(package)
        for line, text in docstrings(source)
        if (why := why_not_plain(first := text.splitlines()[0]))
    ]
    assert not wrong, "\n".join(wrong)


def why_not_plain(first: str) -> str:
    """Return what is wrong with the first line of a docstring; empty if nothing is."""
    if len(first) > LONGEST_LINE:
        return f"longer than {LONGEST_LINE} characters"
    if OPENINGS.match(first):
        return "begin with a verb or a noun of the field"
    verb = PERSON_VERBS.search(first)
    return f"code does not do this: {verb.group()!r}" if verb else ""


def test_lines_are_a_budget() -> None:
    lines = sum(source.read_text(encoding="utf-8").count("\n") for source in MODULES.values())
    more = lines - MOST_LINES
    assert more <= 0, f"{more} lines too many: delete as many, or see CONTRIBUTING.md"


def test_inputs_of_a_step_are_assembled_in_one_place() -> None:
    calls = re.compile(r"(?<!def )\bstep_inputs\(")
    found = {
        source.relative_to(ROOT).as_posix()
        for source in sources("estimator")
        if calls.search(source.read_text(encoding="utf-8"))
    }
    assert found == ASSEMBLE


def test_records_are_copied_and_shifted_by_generic_functions() -> None:
    for source in sources("estimator"):
        assert "def shifted(self" not in source.read_text(encoding="utf-8"), source


def test_the_distribution_is_typed() -> None:
    assert (ROOT / "icreckon" / "py.typed").exists()


@pytest.mark.parametrize(
    "statement",
    [
        "import icreckon",
        "import icreckon.cli.main, sys; sys.argv = ['icreckon', '--help']\n"
        "try: icreckon.cli.main.main()\nexcept SystemExit: pass",
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


def test_a_compiled_filter_runs_without_what_takes_seconds_to_load() -> None:
    script = (
        "import sys, icreckon, icreckon.cli.replay\n"
        "icreckon.PoseEstimator(icreckon.load_robot('auriga-alpha'), 'inertia-online')\n"
        "print(*{'filterpy', 'scipy.stats', 'scipy.integrate'} & {*sys.modules})"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.split() == []


def test_the_repository_names_no_absolute_path_of_a_machine() -> None:
    tracked = subprocess.run(
        ["git", "ls-files"], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout.split()
    for name in tracked:
        if (ROOT / name).is_symlink():
            continue
        if Path(name).suffix in {".py", ".md", ".toml", ".yml", ""}:
            text = (ROOT / name).read_text(encoding="utf-8")
            for start in ("/" + "home/", "/" + "root/", "/" + "work/"):
                assert start not in text, f"{name} holds {start}"
