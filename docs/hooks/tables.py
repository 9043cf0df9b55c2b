"""Tables of the pages that are made from the code: keys of files, commands, robots.

    python docs/hooks/tables.py

brings them up to date. A page has one between a line `<!-- table: NAME -->`, or
`<!-- table: NAME of THING -->`, and a line `<!-- end of table -->`.
"""

from __future__ import annotations

import inspect
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgspec

from icreckon.cli.main import COMMANDS, load
from icreckon.estimator.base.checks import Bound
from icreckon.estimator.robot import robot_file
from icreckon.estimator.robot.robot_file import ROBOTS_FOLDER, load_robot, robot_names
from icreckon.replay.mapping import columns, topics
from icreckon.simulation import scenario
from icreckon.simulation.contact.contact import Soil
from icreckon.simulation.sensors import specs
from icreckon.simulation.sensors.encoders import EncoderErrors
from icreckon.simulation.sensors.fixes import FixErrors
from icreckon.simulation.sensors.imu import InertialErrors
from icreckon.simulation.study import plan
from icreckon.simulation.truth import terrain

OPTION_HEADS = ("option", "default", "meaning")
END = "<!-- end of table -->"
MARK = re.compile(
    rf"^<!-- table: (\w+)(?: of ([\w.-]+))? -->\n(?:.*?\n)??{re.escape(END)}$",
    re.MULTILINE | re.DOTALL,
)
PAGES = Path(__file__).parents[1]
TYPES = {
    name: getattr(module, name)
    for module, names in (
        (robot_file, "Vehicle Indices ConstantIcr Imu Tracks Slope UndetectedSlip Slip"),
        (topics, "TrackTopic ImuTopic FixTopic HeadingTopic TruthTopic"),
        (columns, "ColumnMap TrackColumns ImuColumns PoseColumns HeadingColumns"),
        (scenario, "Scenario"),
        (specs, "EncoderSpec InertialSpec FixSpec"),
        (terrain, "Terrain Patch Payload"),
        (plan, "Study Sweep LatinHypercube FilterSpec"),
    )
    for name in names.split()
} | {"Soil": Soil}
TWINS = {
    "ImuTopic": ("TrackTopic", "[log.tracks]"),
    "FixTopic": ("TrackTopic", "[log.tracks]"),
    "HeadingTopic": ("TrackTopic", "[log.tracks]"),
    "TruthTopic": ("TrackTopic", "[log.tracks]"),
    "TrackColumns": ("TrackTopic", "[log.tracks]"),
    "ImuColumns": ("ImuTopic", "[log.imu]"),
    "PoseColumns": ("FixTopic", "[log.fixes]"),
    "HeadingColumns": ("HeadingTopic", "[log.heading]"),
}
"""Types whose rows are not repeated if another type has them, that type and its table of a robot file."""
SYMBOLS = {"zero or a positive number": "≥ 0", "a positive number": "> 0"}
DESCRIBED = {"EncoderSpec": EncoderErrors, "InertialSpec": InertialErrors, "FixSpec": FixErrors}
"""Types whose attributes are described at another one; `factor` is in their own text."""


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Leave the marks of the tables out of the site."""
    return MARK.sub(lambda mark: "\n".join(mark[0].split("\n")[1:-1]), markdown)


def up_to_date(markdown: str) -> str:
    """Text of a page with its tables as the code has them."""
    return MARK.sub(_filled, markdown)


def _filled(mark: re.Match[str]) -> str:
    first = mark[0].split("\n", 1)[0]
    return f"{first}\n\n{TABLES[mark[1]](*filter(None, (mark[2],)))}\n\n{END}"


def rows(heads: tuple[str, ...], body: Sequence[tuple[str, ...]]) -> str:
    """Table in Markdown."""
    cells = (heads, tuple("---" for _ in heads), *body)
    return "\n".join(
        f"| {' | '.join(cell.replace('|', '&#124;') for cell in row)} |" for row in cells
    )


def descriptions(kind: type) -> dict[str, str]:
    """Text of each attribute in the docstring of a type."""
    found = {}
    for of in reversed(kind.__mro__):
        _, _, listed = inspect.cleandoc(of.__doc__ or "").partition("Attributes:\n")
        listed = re.split(r"\n\n?(?=\S)", listed)[0]
        found |= dict(re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", listed, flags=re.MULTILINE))
    return {name: " ".join(text.split()) for name, text in found.items()}


def bounds(kind: Any) -> str:
    """Range of a field, as its messages name it."""
    found = [one for one in getattr(kind, "__metadata__", ()) if isinstance(one, Bound)]
    inner = [bounds(one) for one in get_args(kind) if one is not kind]
    return found[0].wanted if found else next(filter(None, inner), "")


def keys(name: str) -> str:
    """Keys of a table of a TOML file: default, range, meaning; without the columns that are empty."""
    table = rows_of_keys(name)
    twin, where = TWINS.get(name, ("", ""))
    same = [one for one in table if twin and one in rows_of_keys(twin)]
    body = [one for one in table if one not in same]
    heads = ("key", "default", "accepted", "meaning")
    filled = [k for k, cells in enumerate(zip(*body, strict=True)) if any(cells)]
    cut = [tuple(row[k] for k in filled) for row in (heads, *body)]
    text = rows(cut[0], cut[1:])
    return f"{text}\n\nAs in `{where}`: {', '.join(one[0] for one in same)}." if same else text


def rows_of_keys(name: str) -> list[tuple[str, ...]]:
    """Rows of such a table."""
    kind = TYPES[name]
    texts = descriptions(DESCRIBED.get(name, kind))
    if name in DESCRIBED:
        texts["factor"] = inspect.cleandoc(kind.__doc__ or "").rpartition("`factor` ")[2]
    hints = get_type_hints(kind, include_extras=True)
    body = []
    for field in msgspec.structs.fields(kind):
        accepted = bounds(hints.get(field.name)).replace("finite", "")
        for words, symbol in SYMBOLS.items():
            accepted = accepted.replace(words, symbol)
        body.append((f"`{field.name}`", default(field), accepted, texts[field.name]))
    return body


def default(field: Any) -> str:
    """Default of a key as it is written in a file; empty if it has none that can be written."""
    if field.required:
        return "required"
    value = field.default
    if value is msgspec.NODEFAULT:
        value = field.default_factory()
    if value is None or isinstance(value, msgspec.Struct) or value in ({}, ()):
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`' if value else '`""`'
    return f"`{list(value) if isinstance(value, tuple) else value}`".replace("'", '"')


def robots() -> str:
    """Gallery of the robots that ship with icreckon, and where their figures are from."""
    body, sources = [], []
    for name in robot_names():
        robot = load_robot(name)
        vehicle, eta0 = robot.vehicle, robot.indices.eta0
        text = (ROBOTS_FOLDER / f"{name}.toml").read_text(encoding="utf-8")
        comment = re.findall(r"^#(.*)$", text.partition("\nname")[0], flags=re.MULTILINE)
        source = " ".join(line.strip() for line in comment)
        body.append(
            (
                f"`{name}`",
                "wheels" if vehicle.contact_points == 2 else "tracks",
                f"{vehicle.mass:g}",
                f"{vehicle.track_gauge:.4g}",
                f"{vehicle.sprocket_radius:g}",
                f"{vehicle.track_gauge * eta0:.3g}" if eta0 != 1.0 else "not known",
                f"{eta0:.3g}" if eta0 != 1.0 else "",
            )
        )
        sources.append(f"- `{name}`: {source}")
    table = rows(
        ("robot", "on", "mass, kg", "gauge, m", "radius, m", "effective track, m", "over gauge"),
        body,
    )
    return table + "\n\nWhere the figures are from, by the files:\n\n" + "\n".join(sources)


def commands() -> str:
    """Arguments and options of all commands; those that several share come last."""
    described = {
        name: [row for one in load(name).params if (row := option(one))] for name in COMMANDS
    }
    count = Counter(row for table in described.values() for row in table)
    shared = [row for row in count if count[row] >= 4]
    parts = []
    for name, table in described.items():
        command = load(name)
        named = [one for one in command.params if one.param_type_name == "argument"]
        usage = " ".join(
            ["icreckon", name, *(one.metavar or str(one.name) for one in named), "[OPTIONS]"]
        )
        parts += [f"## {name}", f"`{usage}`", inspect.cleandoc(command.help or "")]
        if own := [row for row in table if row not in shared]:
            parts.append(rows(OPTION_HEADS, own))
        if also := [row[0] for row in table if row in shared]:
            parts.append(f"[Shared options](#shared-options): {', '.join(also)}.")
    return "\n\n".join([*parts, "## Shared options", rows(OPTION_HEADS, shared)])


def option(parameter: Any) -> tuple[str, str, str] | None:
    """Row of an option or an argument."""
    if getattr(parameter, "hidden", False) or not getattr(parameter, "help", None):
        return None
    names = (
        parameter.opts
        if parameter.param_type_name == "option"
        else [parameter.metavar or str(parameter.name)]
    )
    value = parameter.default
    shown = "" if value in (None, False, ()) or callable(value) else f"`{value}`"
    return ", ".join(f"`{one}`" for one in names), shown, " ".join(parameter.help.split())


TABLES = {"robots": robots, "commands": commands, "keys": keys}

if __name__ == "__main__":
    for path in PAGES.rglob("*.md"):
        text = path.read_text(encoding="utf-8")
        if (found := up_to_date(text)) != text:
            path.write_text(found, encoding="utf-8")
