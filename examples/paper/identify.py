"""Find the contact and reading that reproduce the paper's numbers best, and what each choice changes.

    python examples/paper/identify.py [--seed 0] [--out FOLDER]

takes minutes. It writes `contact.toml`, which `contacts.load_paper_contact` reads, and
`identification.json`: all candidates and the ablation. It prints the ablation as a table.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import msgspec
from ablation import Ablation, Count, ablate
from contacts import PaperContact
from search import SAMPLES, STARTS, identify

HERE = Path(__file__).parent
HEAD = (
    "choice made otherwise",
    "as it is: 5 / 10 / 20 %",
    "worst",
    "refitted: 5 / 10 / 20 %",
    "worst",
)


def as_toml(guess: PaperContact, comment: str) -> str:
    """Text of a TOML file that `load_paper_contact` reads.

    Args:
        guess: contact and reading to write.
        comment: first line of the file.
    """
    lines = [f"# {comment}"]
    for table, content in msgspec.to_builtins(guess).items():
        lines += ["", f"[{table}]"]
        # Numbers, strings and booleans are written as in JSON.
        lines += [f"{key} = {json.dumps(one)}" for key, one in content.items() if one is not None]
    return "\n".join(lines) + "\n"


def as_table(rows: list[Ablation]) -> str:
    """Ablation as a table in Markdown."""

    def cells(count: Count) -> tuple[str, str]:
        close = (count.within_5_percent, count.within_10_percent, count.within_20_percent)
        return " / ".join(map(str, close)), f"{count.worst} {count.worst_percent:+.0f} %"

    body = [(row.choice, *cells(row.unchanged), *cells(row.refitted)) for row in rows]
    escaped = [[cell.replace("|", "\\|") for cell in row] for row in body]
    return "\n".join(f"| {' | '.join(row)} |" for row in (HEAD, ("---",) * len(HEAD), *escaped))


def progress(name: str, done: float) -> None:
    """Show the share done on one line."""
    print(f"\r{name}: {done:4.0%}", end="" if done < 1.0 else "\n", file=sys.stderr, flush=True)


def main() -> None:
    """Identify, ablate, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the random contacts")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="random contacts")
    parser.add_argument("--starts", type=int, default=STARTS, help="candidates to refine")
    parser.add_argument(
        "--out", type=Path, default=HERE, help="folder (default: that of the script)"
    )
    given = parser.parse_args()
    found = identify(
        seed=given.seed,
        samples=given.samples,
        starts=given.starts,
        progress=lambda done: progress("identifying contact and soil", done),
    )
    rows = ablate(found.best.guess, progress=lambda done: progress("changing each choice", done))
    given.out.mkdir(parents=True, exist_ok=True)
    comment = f"Found by: python examples/paper/identify.py --seed {given.seed}"
    (given.out / "contact.toml").write_text(as_toml(found.best.guess, comment), encoding="utf-8")
    results: dict[str, Any] = {
        "seed": found.seed,
        "samples": found.samples,
        "failed": found.failed,
        "cost": found.best.cost,
        "candidates": [one._asdict() for one in found.refined],
        "ablation": rows,
    }
    text = json.dumps(msgspec.to_builtins(results), indent=1)
    (given.out / "identification.json").write_text(text + "\n", encoding="utf-8")
    print(as_table(rows))


if __name__ == "__main__":
    main()
