"""Sentences of the pages have the figures of the tables that they quote."""

import json
import re
import statistics
from pathlib import Path

import pytest
from _tables import DOCS, plain, tables

from readme import ROOT

README, PROOF, INDEX = ROOT / "README.md", DOCS / "proof.md", DOCS.parent / "index.md"
LOGS, PEERS, FAULTS, BOARD = (
    DOCS / "proof" / f"{name}.md" for name in ("real-logs", "peers", "faults", "scoreboard")
)
INERTIA = "inertia-online"


def numbers(page: Path, table: str, row: str, column: str) -> list[str]:
    """Numbers of a cell, by the page, the first head of its table, its row and its column."""
    found = [
        line[[plain(one) for one in each.head].index(plain(column))]
        for each in tables(page)
        if plain(each.head[0]) == plain(table) and plain(column) in map(plain, each.head)
        for line in each.rows
        if plain(row) in (plain(line[0]), plain(" ".join(line[:2])))
    ]
    assert len(found) == 1, f"{page.name}: {len(found)} cells «{row}», «{column}» in «{table}»"
    return re.findall(r"\d+(?:\.\d+)?", found[0])


def drift(row: str, column: str) -> list[str]:
    """Drift on real logs after 30 s, and after 10 s."""
    return numbers(LOGS, "% after 30 s (10 s)", row, column)


def known(column: str) -> str:
    """Drift of `inertia-online` on all real logs if less is known, or less used."""
    return numbers(LOGS, "less known, or less used", "all logs", f"{INERTIA}, {column}")[0]


def ratio(row: str) -> list[str]:
    """Drift of `inertia-online` on real logs over that of wheels and gyro, with its interval."""
    return numbers(LOGS, "30 s, ratio to gyro", row, INERTIA)


def less(factor: str) -> str:
    """Whole percent by which a factor decreases."""
    return f"{100.0 * (1.0 - float(factor)):.0f}"


def on_ground(level: str) -> str:
    """Drift of `inertia-online` over that of wheels and gyro on a ground of the scoreboard."""
    return numbers(BOARD, "factor", f"ground {level}", "`inertia-online` over `gyro`")[0]


def steepness() -> list[float]:
    """Drift of `inertia-online` on each ground of 10°, over that on level ground."""
    board = json.loads((ROOT / "benchmarks/scoreboard.json").read_text(encoding="utf-8"))
    drifts: dict[str, list[float]] = {}
    for name, figures in board["healthy"]["rows"].items():
        _, level, *_, variant = name.split(" | ")
        if variant == INERTIA:
            drifts.setdefault(level, []).append(figures[0])
    means = {level: statistics.geometric_mean(values) for level, values in drifts.items()}
    return sorted(mean / means["level"] for level, mean in means.items() if "10°" in level)


def quotations() -> list[tuple[Path, str]]:
    """Each page that quotes a table, and its words."""
    gyro, constant, inertia = (
        drift("all logs", one)[0] for one in ("gyro", "constant-online", INERTIA)
    )
    whole, low, high = ratio("all logs")
    nees = numbers(LOGS, "nees of motions (3)", "all logs", INERTIA)[0]
    husky, asphalt = ratio("Husky"), ratio("Warthog, asphalt")
    others = ("integration", "filterpy", "GTSAM")
    ours = ("gyro", "constant-online", "full-linear", INERTIA)
    after = {
        one: float(numbers(PEERS, "estimator", one, "drift % after 30 s")[0])
        for one in (*others, *ours)
    }
    rivals = [after[one] for one in after if one != INERTIA]
    # The second column of this name is that of the track that spins.
    heads = next(one for one in tables(PEERS) if "survived %" in one.head)
    place = [k for k, head in enumerate(heads.head) if head == "survived %"][1]
    survived = {plain(row[0]): row[place] for row in heads.rows}
    best = sorted((survived[one] for one in ours), key=float)
    (worst,) = {survived[plain(one)] for one in others}
    white, wander = (
        float(numbers(FAULTS, "fixes taken for", one, "NEES, ideal 3")[0])
        for one in ("white, 0.3 m", "wander")
    )
    steep = steepness()
    return [
        (README, f"reduce its drift by {less(whole)} %"),
        (README, f"in place of the calibrated one `{INERTIA}` drifts {known('nominal track')} %"),
        (INDEX, f"with the same calibration: {inertia} instead of {gyro} % of the distance"),
        (PROOF, f"`{INERTIA}` drifts {less(whole)} % less than wheels and gyro"),
        (PROOF, f"(NEES of the motion {nees}, where 3 is ideal)"),
        (
            PROOF,
            f"wheels and gyro are off by {gyro} % of the distance, `constant-online` by {constant} %, "
            f"`{INERTIA}` by {inertia} %: {whole} times wheels and gyro (95 %: {low} to {high})",
        ),
        (PROOF, "gyro: {} times ({} to {}) for".format(*husky)),
        (PROOF, "of one log are too few: {} times, {} to {}.".format(*asphalt)),
        (PROOF, f"the calibrated one `{INERTIA}` drifts {known('nominal track')} %."),
        (PROOF, f"With nothing known, {known('nothing known')} %."),
        (
            PROOF,
            f"{on_ground('soft after fixes')} (soft ground) and "
            f"{on_ground('ice after fixes')} times (ice) the drift of wheels and gyro",
        ),
        (PROOF, f"drifts {steep[0]:.1f} to {steep[-1]:.1f} times as far as on level ground"),
        (PROOF, f"has a NEES of {white:.0f} (3 is ideal)"),
        (PROOF, f"`wander_sigma` and `wander_time` it is {wander:.1f}"),
        (
            LOGS,
            f"`{INERTIA}` drifts {float(inertia):.1f} % of the distance in 30 s: {less(whole)} % less "
            f"than wheels and gyro (95 %: {less(high)} to {less(low)} %)",
        ),
        (PEERS, f"GTSAM drift {min(rivals)} to {max(rivals)} % after 30 s; so do"),
        (PEERS, f"drift a third less ({after[INERTIA]} %)"),
        (PEERS, f"in {best[0]} to {best[-1]} % of the cases, the others in {worst} %"),
    ]


@pytest.mark.parametrize("page", [README, INDEX, PROOF, LOGS, PEERS], ids=lambda page: page.stem)
def test_a_sentence_has_the_figures_of_its_table(page: Path) -> None:
    text = " ".join(page.read_text(encoding="utf-8").split())
    missing = [words for where, words in quotations() if where == page and words not in text]
    assert not missing, f"{page.name} lacks, by the tables: {missing}"
