"""Tables of the pages that are made from the code: keys of files, commands, robots.

    python docs/hooks/tables.py

brings them up to date. A page has one between a line `<!-- table: NAME -->`, or
`<!-- table: NAME of THING -->`, and a line `<!-- end of table -->`.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgspec

from icreckon.cli.main import COMMANDS, load
from icreckon.estimator.base.checks import Bound
from icreckon.estimator.robot import robot_file, settings, variants
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

ROBOT = "`--robot`"
"""The option that is in the table of each command that has it."""
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
        (topics, "TrackTopic ImuTopic FixTopic HeadingTopic VelocityTopic TruthTopic"),
        (columns, "ColumnMap TrackColumns ImuColumns PoseColumns HeadingColumns"),
        (scenario, "Scenario"),
        (specs, "EncoderSpec InertialSpec FixSpec"),
        (terrain, "Terrain Patch Payload"),
        (plan, "Study Sweep LatinHypercube FilterSpec"),
        (settings, "Settings GateSettings StandstillSettings FixWander"),
        (variants, "Adaptation"),
    )
    for name in names.split()
} | {"Soil": Soil}
TWINS = {
    "ImuTopic": ("TrackTopic", "[log.tracks]"),
    "FixTopic": ("TrackTopic", "[log.tracks]"),
    "HeadingTopic": ("TrackTopic", "[log.tracks]"),
    "VelocityTopic": ("TrackTopic", "[log.tracks]"),
    "TruthTopic": ("TrackTopic", "[log.tracks]"),
    "TrackColumns": ("TrackTopic", "[log.tracks]"),
    "ImuColumns": ("ImuTopic", "[log.imu]"),
    "PoseColumns": ("FixTopic", "[log.fixes]"),
    "HeadingColumns": ("HeadingTopic", "[log.heading]"),
}
"""Types whose rows are not repeated if another type has them, that type and its table of a robot file."""
NESTED = {
    "adaptation": "Adaptation",
    "gates": "GateSettings",
    "standstill": "StandstillSettings",
    "wander": "FixWander",
}
"""Keys of `Settings` that hold structures without a table of their own, and these."""
KEY_HEADS = ("key", "default", "accepted", "meaning")
GRADES = ("consumer", "industrial", "tactical")
WITH_COMMAS = (1e4, 1e8)
"""Numbers of this size are written with commas."""
REFERENCES = {
    "`icreckon.simulation.drives.drives.TRAJECTORIES`": "[Trajectories](#trajectories)",
    "see its docstring": "see [Trajectories](#trajectories)",
    "see `icreckon.simulation.drives.recorded`": "see [Trajectories](#trajectories)",
    "name from `icreckon.simulation.sensors.specs.NOISE_PRESETS`": "one of the [presets](#presets)",
    "name from `icreckon.simulation.scenario.TRUTHS`": " or ".join(
        f'"{name}"' for name in scenario.TRUTHS
    ),
    "dropout, one of `DROPOUT_READINGS`: ": "dropout: ",
    "keys of `icreckon.estimator.robot.settings.Settings`": "keys of [Settings](#settings)",
    "see `icreckon.estimator.sensors.imu_noise`": (
        "see [Noise of the IMU](../explanation/model.md#noise-of-the-imu)"
    ),
    "see `FixWander`": "see [Plain GPS](#defaults)",
    "that of the robot file's fixes, see `FixWander.of`": "that of the robot file's fixes",
    "the slip residual, or None for": "as [`[slip.VARIANT]`](robot-file.md#slipvariant); left out:",
    "the parameters, or None for": "the parameters; left out:",
    " [s], from 1 ms to 60 s": " [s]",
    "the above": "these",
    "(see `state_names`)": "(names of `icreckon.state_names`)",
    ", or None.": ".",
    ", or None for": "; left out:",
    "; None for": "; left out:",
    "; None if": "; left out if",
}
"""References to the source in docstrings, and what pages have in their place."""
OF_TRUTH = "left out: the truth's default"
"""Words for a default that differs between the truths of a scenario."""
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


def bound_of(kind: Any) -> Bound | None:
    """Range of a field; None if it has none."""
    found = [one for one in getattr(kind, "__metadata__", ()) if isinstance(one, Bound)]
    inner = [bound_of(one) for one in get_args(kind) if one is not kind]
    return found[0] if found else next(filter(None, inner), None)


def accepted(kind: Any) -> str:
    """Range of a field, with what its messages add in brackets; empty if it is any finite number."""
    bound = bound_of(kind)
    if bound is None or bound[1:3] == (-math.inf, math.inf):
        return ""
    added = "".join(re.findall(r" \(.*?\)", bound.wanted))
    least, most = _number(bound.least), _number(bound.most)
    if bound.most == math.inf:
        text = f"{'>' if bound.above else '≥'} {least}"
    else:
        text = f"> {least}, ≤ {most}" if bound.above else f"{least} to {most}"
    return ("whole number, " if "whole number" in bound.wanted else "") + text + added


def _number(value: float) -> str:
    if value >= 2.0**64:
        return "2⁶⁴"
    low, high = WITH_COMMAS
    return f"{value:,.0f}" if low <= value < high else f"{value:g}".replace("e+0", "e")


def keys(name: str) -> str:
    """Keys of a table of a TOML file: default, range, meaning; without the columns that are empty."""
    table = rows_of_keys(name)
    twin, where = TWINS.get(name, ("", ""))
    same = [one for one in table if twin and one in rows_of_keys(twin)]
    body = [one for one in table if one not in same]
    filled = [k for k, cells in enumerate(zip(*body, strict=True)) if any(cells)]
    cut = [tuple(row[k] for k in filled) for row in (KEY_HEADS, *body)]
    text = rows(cut[0], cut[1:])
    return f"{text}\n\nAs in `{where}`: {', '.join(one[0] for one in same)}." if same else text


def rows_of_keys(name: str) -> list[tuple[str, ...]]:
    """Rows of such a table."""
    kind = TYPES[name]
    texts = descriptions(DESCRIBED.get(name, kind))
    if name in DESCRIBED:
        texts["factor"] = inspect.cleandoc(kind.__doc__ or "").rpartition("`factor` ")[2]
    hints = get_type_hints(kind, include_extras=True)
    body: list[tuple[str, ...]] = []
    for field in msgspec.structs.fields(kind):
        text = texts[field.name]
        for words, instead in REFERENCES.items():
            text = text.replace(words, instead)
        if OF_TRUTH in text:
            text = text.replace(OF_TRUTH, truth_defaults(field.name))
        range_of = accepted(hints.get(field.name))
        body.append((f"`{field.name}`", default(field), range_of, text))
    return body


def truth_defaults(name: str) -> str:
    """Defaults of a field of the truths that have it."""
    found = {
        truth: one.default
        for truth, kind in scenario.TRUTHS.items()
        for one in dataclasses.fields(kind)
        if one.name == name
    }
    return "by default " + ", ".join(f"{value:g} for {truth}" for truth, value in found.items())


def filter_settings() -> str:
    """Keys of `Settings`, those of its structures included, as dotted keys."""
    body: list[tuple[str, ...]] = []
    for field in msgspec.structs.fields(settings.Settings):
        (row,) = (one for one in rows_of_keys("Settings") if one[0] == f"`{field.name}`")
        inner = NESTED.get(field.name)
        if inner is None or field.default is None:
            body.append(row)
        for key, left_out, *rest, meaning in rows_of_keys(inner) if inner else ():
            others = of_variants(key[1:-1]) if inner == "Adaptation" else ""
            body.append((f"`{field.name}.{key[1:]}", left_out, *rest, meaning + others))
    return rows(KEY_HEADS, body)


def of_variants(key: str) -> str:
    """Values of `Adaptation` that variants have instead of the default."""
    online = [name for name, one in variants.VARIANTS.items() if one.online]
    values = {name: getattr(variants.default_adaptation(name), key) for name in online}
    usual = getattr(variants.Adaptation(), key)
    other = [f"`{name}` {value:g}" for name, value in values.items() if value != usual]
    return f" Without the table: {', '.join(other)}." if other else ""


def presets() -> str:
    """Figures of the grades of IMU."""
    grades = [specs.NOISE_PRESETS[grade] for grade in GRADES]
    of = {"gyro": [one.gyro for one in grades], "acc.": [one.accelerometer for one in grades]}
    heads = [f"{sensor} {grade}" for sensor in of for grade in GRADES]
    found = [one for listed in of.values() for one in listed]
    body = [(f"`{name}`", *(f"{getattr(one, name):g}" for one in found)) for name in specs.GRADED]
    return rows(("key", *heads), body)


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
    shared = [
        row for row in count if count[row] > 1 and row[0].startswith("`--") and row[0] != ROBOT
    ]
    parts = []
    for name, table in described.items():
        command = load(name)
        named = [one for one in command.params if one.param_type_name == "argument"]
        usage = " ".join(
            ["icreckon", name, *(_named(one, as_usage=True) for one in named), "[OPTIONS]"]
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
    names = parameter.opts if parameter.param_type_name == "option" else [_named(parameter)]
    value = parameter.default
    shown = "" if value in (None, False, ()) or callable(value) else f"`{value}`"
    return ", ".join(f"`{one}`" for one in names), shown, " ".join(parameter.help.split())


def _named(argument: Any, *, as_usage: bool = False) -> str:
    """Name of an argument; in a usage, with brackets if it may be left out."""
    text = argument.metavar or str(argument.name).upper()
    return f"[{text}]" if as_usage and not argument.required else text


TABLES = {
    "robots": robots,
    "commands": commands,
    "keys": keys,
    "settings": filter_settings,
    "presets": presets,
}

if __name__ == "__main__":
    for path in PAGES.rglob("*.md"):
        text = path.read_text(encoding="utf-8")
        if (found := up_to_date(text)) != text:
            path.write_text(found, encoding="utf-8")
            print(f"changed: {path}")
