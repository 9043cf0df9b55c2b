"""The site: it builds strictly, loads nothing from outside, and lists the whole public API."""

import re
import subprocess
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from runpy import run_path

import pytest

from readme import ROOT

DOCS = ROOT / "docs"
PAGES = DOCS / "reference" / "api"
NAMES = run_path(str(DOCS / "hooks" / "names.py"))
TABLES = run_path(str(DOCS / "hooks" / "tables.py"))
FOLDERS = ("estimator", "simulation", "replay", "icreckon")
LOADED = re.compile(
    r"<(?:script|img|iframe|source|link)\b[^>]*?\s(?:src|href)=[\"']?(?:https?:)?//[^>]*>"
    r"|(?:url\(|@import )[\"']?(?:https?:)?//[^)]*",
    re.IGNORECASE,
)


def test_every_public_name_is_on_one_page_of_the_reference() -> None:
    stub = (ROOT / "icreckon" / "__init__.pyi").read_text(encoding="utf-8")
    public = re.findall(r"^from \S+ import \S+ as (\w+)", stub, flags=re.MULTILINE)
    listed: Counter[str] = Counter()
    for page in PAGES.glob("*.md"):
        listed.update(NAMES["ROW"].findall(page.read_text(encoding="utf-8")))
    assert listed == Counter(public)


def test_the_tables_of_names_hold_the_first_lines_of_the_docstrings() -> None:
    for page in PAGES.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        assert NAMES["up_to_date"](text) == text, "run `python docs/hooks/names.py`"


def test_the_tables_of_keys_and_options_are_those_of_the_code() -> None:
    pages = [path for path in DOCS.rglob("*.md") if "<!-- table: " in path.read_text("utf-8")]
    assert len(pages) == 5
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert text.count("<!-- table: ") == len(TABLES["MARK"].findall(text)), page
        assert TABLES["up_to_date"](text) == text, f"{page}: run `python docs/hooks/tables.py`"


def test_the_names_of_the_architecture_are_in_the_code() -> None:
    page = (DOCS / "explanation" / "architecture.md").read_text(encoding="utf-8")
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    page += contributing.split("## Where to begin with a change")[1].split("\n## ")[0]
    files = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
    words = {word for path in files for word in re.findall(r"\w+", path.read_text("utf-8"))}
    names = re.findall(r"`((?:[A-Z]\w*\.)?[A-Za-z_]\w*)`", page)
    assert len(names) > 60
    assert [name for name in names if not {*name.split(".")} <= words] == []


def test_references_to_the_source_that_pages_replace_are_in_docstrings() -> None:
    kinds = (*TABLES["TYPES"].values(), *TABLES["DESCRIBED"].values())
    described = [text for kind in kinds for text in TABLES["descriptions"](kind).values()]
    assert [
        words for words in TABLES["REFERENCES"] if not any(words in one for one in described)
    ] == []


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if find_spec("mkdocstrings") is None:
        pytest.skip("no mkdocs: pip install -e '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_site_loads_nothing_from_outside(site: Path) -> None:
    pages = {page: page.read_text(encoding="utf-8") for page in site.rglob("*.html")}
    assert len(pages) > 40
    for file in (*pages, *site.rglob("*.css")):
        found = LOADED.search(file.read_text(encoding="utf-8"))
        assert found is None, f"{file.relative_to(site)} loads {found[0]}"
    by_name = {
        page.relative_to(site).with_suffix("").as_posix(): text for page, text in pages.items()
    }
    assert not any("<!-- table" in text or "end of table" in text for text in by_name.values())
    # Made from the code: a robot, a key, an option, a docstring.
    assert "<code>warthog</code>" in by_name["reference/robots"]
    assert "<code>gyro_bias_walk</code>" in by_name["reference/robot-file"]
    assert "<code>--smooth</code>" in by_name["reference/commands"]
    assert "relative_motion" in by_name["reference/api/estimator"]


@pytest.mark.slow
def test_a_site_in_a_folder_is_searched(site: Path, chromium: str, tmp_path: Path) -> None:
    command = [
        *(chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run"),
        *(f"--user-data-dir={tmp_path}", "--virtual-time-budget=20000", "--dump-dom"),
        (site / "index.html").as_uri() + "?q=gyro_bias_walk",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    results = done.stdout.split('class="md-search-result"')[1]
    assert "reference/robot-file.html?h=gyro_bias_walk" in results
