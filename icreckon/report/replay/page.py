"""Self-contained HTML page of a comparison, made from its results only."""

from collections.abc import Sequence
from itertools import chain

from icreckon.estimator.robot.robot_file import Vehicle
from icreckon.replay.base.units import unit
from icreckon.replay.comparison.results import Results
from icreckon.report.pages import Cell, Table, render
from icreckon.report.replay import page_text
from icreckon.report.replay.page_charts import constant_parameters, page_data, switches
from icreckon.report.replay.page_drive import has_wheels
from icreckon.report.replay.page_text import CHECK_HINT, horizon_text, lowest, number
from icreckon.report.replay.tables import (
    DIFFERENCE_COLUMNS,
    END_COLUMNS,
    POSITION_COLUMNS,
    SCORE_COLUMNS,
    SPATIAL_COLUMNS,
    Column,
    scaled,
)

DEFAULT_HALF_LENGTH = Vehicle(mass=1.0, track_gauge=1.0, sprocket_radius=1.0).half_contact_length
Section = tuple[str, str, list[Table]]  # section of the page: its title, a note, tables


def replay_page(results: Results) -> str:
    """Render the page as HTML."""
    dropped, series = results["log"]["dropped"], results["series"]
    vehicle, times = results["robot"]["vehicle"], series["t_s"]
    return render(
        "replay.html",
        title=page_text.page_title(results),
        subtitle=page_text.provenance(results),
        failures=page_text.failures(results),
        doubts=page_text.doubts(results),
        check_hint=CHECK_HINT,
        headline=page_text.headline(results),
        remarks=page_text.calibration_hint(results) + page_text.remarks(results),
        switches=switches(results),
        results=results,
        scored=_scored(results),
        number=number,
        vehicle=vehicle,
        has_wheels=has_wheels(vehicle),
        # A length other than the default was set in the file.
        is_default_length=vehicle["half_contact_length"] == DEFAULT_HALF_LENGTH,
        row_every=(times[-1] - times[0]) / max(1, len(times) - 1),
        # Each variant has the times, under "t_s", also without parameters.
        learns=any(len(variant["parameters"]) > 1 for variant in series["variants"].values()),
        constant=_constant_table(results),
        innovations=_innovation_table(results),
        dropped=[f"{count} × {what}" for what, count in dropped.items()],
        by_filter=_dropped_by_filter(results),
        notes=page_text.notes(results),
        origin={key: results[key] for key in ("versions", "seed", "inputs", "format")},
        data=page_data(results),
    )


def _scored(results: Results) -> list[Section]:
    """Sections of drift and other scores; without a truth, distances of variants."""
    if not results["truth"]:
        labels = _horizons_with(results, "apart_percent_{}_mean")
        apart = [Column(horizon_text(label), f"apart_percent_{label}_mean", 2) for label in labels]
        caption = f"Distance from {results['reference_variant']}, % of the distance driven"
        note = f"{caption}, aligned at each segment's start."
        return [
            ("How far apart per horizon", note, [_score_table(results, apart)]),
            ("Ends", "", [_score_table(results, DIFFERENCE_COLUMNS)]),
        ]
    # The first three columns are drifts, which have tables of their own.
    has_yaw = page_text.has_yaw_errors(results)
    columns = (*SCORE_COLUMNS[3:], *END_COLUMNS) if has_yaw else POSITION_COLUMNS[3:]
    sections: list[Section] = [
        ("Drift per horizon", page_text.scored_text(results), drift_tables(results)),
        ("Other scores", "", [_score_table(results, columns)]),
    ]
    if page_text.is_spatial(results):
        table = _score_table(results, SPATIAL_COLUMNS)
        sections.append(("Height, roll and pitch", page_text.level_text(results), [table]))
    return sections


def drift_tables(results: Results) -> list[Table]:
    """Drift per horizon, and its ratio to the baseline's, with 95 % intervals beneath."""
    variants, baseline = results["variants"], results["baseline_variant"]
    labels = _horizons_with(results, "drift_percent_{}_mean")
    head = ["variant", *map(horizon_text, labels)]
    best = {label: lowest(variants, f"drift_percent_{label}_mean") for label in labels}
    drift_rows, ratio_rows = [], []
    for name, scores in variants.items():
        drifts, ratios = [], []
        for label in labels:
            key = f"drift_percent_{label}"
            is_best = best[label] == name
            drift, interval = scores.get(f"{key}_mean"), scores.get(f"{key}_95")
            drifts.append(interval_cell(drift, interval, is_best=is_best))
            key = f"drift_ratio_{label}"
            interval = None if name == baseline else scores.get(f"{key}_95")
            ratios.append(interval_cell(scores.get(key), interval))
        drift_rows.append((name, drifts))
        ratio_rows.append((name, ratios))
    title = "% of the distance, with 95 % intervals where the log is long enough; bold: lowest"
    ratio_title = f"Ratio to {baseline}, over the same segments"
    return [Table(title, head, drift_rows), Table(ratio_title, head, ratio_rows)]


def interval_cell(
    value: float | None, ends: Sequence[float] | None, *, is_best: bool = False
) -> Cell:
    """Cell of a number with the ends of its interval beneath, if there is one."""
    beneath = "" if ends is None else " to ".join(map(number, ends))
    return Cell(number(value), "best" if is_best else "", beneath)


def _horizons_with(results: Results, key: str) -> list[str]:
    """Labels of horizons with the score `key` ({} is the label); all if none has it."""
    labels, variants = list(results["horizons"]), results["variants"].values()
    known = {name for scores in variants for name, value in scores.items() if value is not None}
    return [label for label in labels if key.format(label) in known] or labels


def _score_table(results: Results, columns: Sequence[Column]) -> Table:
    """Table of scores by variant."""
    rows = []
    for name, scores in results["variants"].items():
        values = [scaled(scores.get(column.key), column.key) for column in columns]
        rows.append((name, [Cell(number(value)) for value in values]))
    headings = [column.heading.replace("\n", ", ") for column in columns]
    return Table("", ["variant", *headings], rows)


def _constant_table(results: Results) -> Table | None:
    """Table of the parameters that no variant moves, instead of charts of level lines."""
    variants_of: dict[tuple[str, str], list[str]] = {}
    for parameter, estimates in constant_parameters(results).items():
        for variant, (value, sigma) in estimates.items():
            text = f"{value:.3g} ± {2.0 * sigma:.3g} ".replace("-", "−") + unit(parameter)
            text = text.removesuffix(" -")  # of a quantity without a unit
            variants_of.setdefault((parameter, text), []).append(variant)
    if not variants_of:
        return None
    title = "Constant, and in no chart: these variants move them by less than a tenth of their σ."
    rows = [
        (parameter, [Cell(text), Cell(", ".join(variants), "wrap")])
        for (parameter, text), variants in variants_of.items()
    ]
    return Table(title, ["parameter", "value ± 2σ", "variants"], rows)


def _innovation_table(results: Results) -> Table | None:
    """Share of large innovations by variant and component; None if there are none."""
    variants = results["series"]["variants"].items()
    # By variant, then by component.
    innovations = {
        name: series["innovations"] for name, series in variants if series["innovations"]
    }
    components = list(dict.fromkeys(chain.from_iterable(innovations.values())))
    if not components:
        return None
    rows = []
    for name, own in innovations.items():
        values = (own.get(component, {}).get("normalised", []) for component in components)
        rows.append((name, list(map(_share_cell, values))))
    title = "Share beyond ±2, and beneath it beyond ±3, of the innovations shown (ideal: 4.6 % and 0.3 %)"
    return Table(title, ["variant", *(key.replace("_", " ") for key in components)], rows)


def _share_cell(normalised: Sequence[float | None]) -> Cell:
    """Share of normalised innovations beyond 2, and beneath it beyond 3 [%]."""
    sizes = [abs(value) for value in normalised if value is not None]
    if not sizes:
        return Cell("–")
    beyond_2, beyond_3 = (sum(size > bound for size in sizes) for bound in (2, 3))
    percent = 100.0 / len(sizes)
    return Cell(f"{percent * beyond_2:.1f} %", beneath=f"{percent * beyond_3:.1f} %")


def _dropped_by_filter(results: Results) -> Table:
    """Measurements used and rejected, NIS and standstill updates of each variant."""
    rows = []
    for name, scores in page_text.filtered(results["variants"]).items():
        used = ", ".join(f"{count} × {sensor}" for sensor, count in scores["used"].items() if count)
        rejected = page_text.rejections_text(scores) or "none"
        nis = ", ".join(f"{name} {number(mean)}" for name, mean in scores["nis"].items() if mean)
        cells = [Cell(text, "wrap") for text in (used, rejected, nis)]
        cells.append(Cell(str(scores["standstill_updates"])))
        rows.append((name, cells))
    nis_heading = "mean NIS per degree of freedom, ideal 1"
    head = ["variant", "used", "rejected", nis_heading, "standstill updates"]
    return Table("By each filter:", head, rows)
