"""Self-contained HTML page of a comparison, made from its results only."""

from collections.abc import Sequence

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
    THOUSANDTHS,
    Column,
)

DEFAULT_HALF_LENGTH = Vehicle(mass=1.0, track_gauge=1.0, sprocket_radius=1.0).half_contact_length


# Section of the page: its title, a note, tables.
Section = tuple[str, str, list[Table]]


def replay_page(results: Results) -> str:
    """Render the page as HTML."""
    dropped = results["log"]["dropped"]
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
        truth=results["truth"],
        scored=_scored(results),
        drive_note=_drive_note(results),
        inputs_note=_inputs_note(results),
        icrs_note=_icrs_note(results),
        parameters_note=_parameters_note(results),
        constant=_constant_table(results),
        innovations_note=_innovations_note(results),
        innovations=_innovation_table(results),
        dropped=[f"{count} × {what}" for what, count in dropped.items()],
        by_filter=_dropped_by_filter(results),
        notes=page_text.notes(results),
        configuration=results["configuration"],
        robot=results["robot"],
        origin={key: results[key] for key in ("versions", "seed", "inputs", "format")},
        data=page_data(results),
    )


def _scored(results: Results) -> list[Section]:
    """Drift or differences, and other scores."""
    variants = results["variants"]
    if not results["truth"]:
        labels = _filled(results, "apart_percent_{}_mean")
        head = ["variant", *(horizon_text(label) for label in labels)]
        keys = [f"apart_percent_{label}_mean" for label in labels]
        rows = [
            (name, [Cell(number(one.get(key))) for key in keys]) for name, one in variants.items()
        ]
        caption = f"Distance from {results['reference_variant']}, % of the distance driven"
        note = f"{caption}, aligned at each segment's start."
        return [
            ("How far apart per horizon", note, [Table("", head, rows)]),
            ("Ends", "", [_score_table(results, DIFFERENCE_COLUMNS)]),
        ]
    has_yaw = page_text.has_yaw_errors(results)
    of_truth = (*SCORE_COLUMNS[3:], *END_COLUMNS) if has_yaw else POSITION_COLUMNS[3:]
    sections: list[Section] = [
        ("Drift per horizon", page_text.scored_text(results), drift_tables(results)),
        ("Other scores", "", [_score_table(results, of_truth)]),
    ]
    if page_text.is_spatial(results):
        table = _score_table(results, SPATIAL_COLUMNS)
        sections.append(("Height, roll and pitch", page_text.level_text(results), [table]))
    return sections


def drift_tables(results: Results) -> list[Table]:
    """Drift per horizon and ratio to the baseline, with intervals."""
    labels = _filled(results, "drift_percent_{}_mean")
    head = ["variant", *(horizon_text(label) for label in labels)]
    baseline = results["baseline_variant"]
    variants, tables = results["variants"], []
    for title, key in (
        (
            "% of the distance, with 95 % intervals; bold: the lowest of the filters",
            "drift_percent_{}_mean",
        ),
        (f"Ratio to {baseline}, over the same segments", "drift_ratio_{}"),
    ):
        rows = []
        best = {place: lowest(variants, place) for place in (key.format(label) for label in labels)}
        for name, one in variants.items():
            cells = []
            for label in labels:
                place = key.format(label)
                interval = one.get(f"{place.removesuffix('_mean')}_95")
                if name == baseline and "ratio" in key:
                    interval = None
                is_best = best.get(place) == name and "ratio" not in key
                cells.append(interval_cell(one.get(place), interval, is_best=is_best))
            rows.append((name, cells))
        tables.append(Table(title, head, rows))
    return tables


def interval_cell(
    value: float | None, interval: Sequence[float] | None, *, is_best: bool = False
) -> Cell:
    """Cell of a number with its interval beneath, if there is one."""
    beneath = "" if interval is None else " to ".join(map(number, interval))
    return Cell(number(value), "best" if is_best else "", beneath)


def _filled(results: Results, key: str) -> list[str]:
    """Horizons that have figures, or all if none has."""
    filled = [
        label
        for label in results["horizons"]
        if any(one.get(key.format(label)) is not None for one in results["variants"].values())
    ]
    return filled or list(results["horizons"])


def _score_table(results: Results, columns: Sequence[Column]) -> Table:
    def text(value: float | None, key: str) -> str:
        return number(1e3 * value if value is not None and key.startswith(THOUSANDTHS) else value)

    rows = [
        (name, [Cell(text(one.get(key), key)) for _, key, _ in columns])
        for name, one in results["variants"].items()
    ]
    return Table("", ["variant", *(head.replace("\n", ", ") for head, _, _ in columns)], rows)


def _drive_note(results: Results) -> str:
    vehicle = results["robot"]["vehicle"]
    half = vehicle["half_contact_length"]
    # Only a file that gives another length has it from somewhere.
    assumed = " (assumed: the default)" if half == DEFAULT_HALF_LENGTH else " (not measured here)"
    rings = ""
    if "icr_distance_m" in results["series"].get("truth", {}):
        rings = " Rings: where the ICRs truly are, while the robot turns."
    times = results["series"]["t_s"]
    step = (times[-1] - times[0]) / max(1, len(times) - 1)
    size = f"{number(2.0 * half)} m{assumed}"
    along = f"wheelbase {size}" if has_wheels(vehicle) else f"contact length {size}"
    return (
        f"Drawn to scale, by the robot file: track gauge {number(vehicle['track_gauge'])} m, {along}; "
        f"the width of the {'wheels' if has_wheels(vehicle) else 'tracks'} is not. The ICR of a track is "
        "the point where its tread would not slide over the ground. Without slip it lies on the "
        "track; the farther out both lie, the more turning is lost. Dots: their last 6 s. Line: the last "
        f"8 s of the path.{rings} Lateral acceleration is speed times yaw rate. The page has a row of "
        f"the log every {number(step)} s."
    )


def _inputs_note(results: Results) -> str:
    note = "As measured; thinned out."
    if "gyro_rad_s" in results["series"]["inputs"]:
        note += " The gyro's rate is about base_link's z axis, its bias included."
    return f"{note} Where the tracks turn faster than the gyro, they slip."


def _icrs_note(results: Results) -> str:
    sentences = ["In base_link: x forward, y to the left."]
    if "icr_distance_m" in results["series"].get("truth", {}):
        sentences.append("Dots: the truth, while the robot turns.")
    if "differential" in results["variants"]:
        half = 0.5 * results["robot"]["vehicle"]["track_gauge"]
        sentences.append(
            f"Not drawn: differential, whose ICRs are its tracks, at y = ±{number(half)} m."
        )
    return " ".join(sentences)


def _parameters_note(results: Results) -> str:
    if not any(len(one["parameters"]) > 1 for one in results["series"]["variants"].values()):
        return "No variant that was run learns any."
    return (
        "Those that a variant learns, with bands of ±2σ. Lengths and indices are in the paper's axes "
        "(X right, Y forward). gravity_x and gravity_y are gravity along the ground in base_link, "
        "forward and left: uphill, gravity_x is negative; 0.17 m/s² is a slope of one degree."
    )


def _constant_table(results: Results) -> Table | None:
    """Table of the parameters that no variant moves, instead of charts of level lines."""
    rows: dict[tuple[str, str], list[str]] = {}
    for parameter, of in constant_parameters(results).items():
        for name, (value, sigma) in of.items():
            text = f"{_digits(value)} ± {_digits(2.0 * sigma)} {unit(parameter)}".removesuffix(" -")
            rows.setdefault((parameter, text), []).append(name)
    if not rows:
        return None
    title = "Constant, and in no chart: these variants move them by less than a tenth of their σ."
    cells = [
        (name, [Cell(text), Cell(", ".join(names), "wrap")]) for (name, text), names in rows.items()
    ]
    return Table(title, ["parameter", "value ± 2σ", "variants"], cells)


def _digits(value: float) -> str:
    """Three significant digits, with a true minus sign."""
    return f"{value:.3g}".replace("-", "−")


def _innovations_note(results: Results) -> str:
    if not any(one["innovations"] for one in results["series"]["variants"].values()):
        return "No sensor was judged: there are no innovations."
    return (
        "Measured less expected, over the standard deviation that it should have. Of a filter whose "
        "uncertainty is right, 95 % lie within ±2 (dashed) and 99.7 % within ±3; those beyond ±10 are "
        "not shown."
    )


def _innovation_table(results: Results) -> Table | None:
    names = list(
        dict.fromkeys(
            component
            for one in results["series"]["variants"].values()
            for component in one["innovations"]
        )
    )
    if not names:
        return None
    rows = []
    for name, one in results["series"]["variants"].items():
        if not one["innovations"]:
            continue
        cells: list[Cell] = []
        for component in names:
            values = one["innovations"].get(component, {}).get("normalised", [])
            known = [abs(value) for value in values if value is not None]
            if not known:
                cells.append(Cell("–"))
                continue
            beyond = [100.0 * sum(size > edge for size in known) / len(known) for edge in (2, 3)]
            cells.append(Cell(f"{beyond[0]:.1f} %", beneath=f"{beyond[1]:.1f} %"))
        rows.append((name, cells))
    title = "Share beyond ±2, and beneath it beyond ±3, of the innovations shown (ideal: 4.6 % and 0.3 %)"
    return Table(title, ["variant", *(one.replace("_", " ") for one in names)], rows)


def _dropped_by_filter(results: Results) -> Table:
    rows = []
    for name, one in page_text.filtered(results).items():
        used = ", ".join(f"{count} × {what}" for what, count in one["used"].items() if count)
        rejected = page_text.rejections_text(one) or "none"
        nis = ", ".join(f"{what} {number(value)}" for what, value in one["nis"].items() if value)
        cells = [Cell(text, "wrap") for text in (used, rejected, nis)]
        cells.append(Cell(str(one["standstill_updates"])))
        rows.append((name, cells))
    head = [
        "variant",
        "used",
        "rejected",
        "mean NIS per degree of freedom, ideal 1",
        "standstill updates",
    ]
    return Table("By each filter:", head, rows)
