"""Self-contained HTML page of a calibration, made from its results only."""

from __future__ import annotations

from pathlib import Path

from icreckon.replay.base.outputs import written_beside
from icreckon.replay.comparison.results import Results
from icreckon.report.calibration.tables import (
    footnotes,
    log_table,
    model_table,
    parameter_table,
)
from icreckon.report.drawing import unless_missing
from icreckon.report.pages import Picture, render

ORIGIN = ("versions", "inputs", "format")


def write_calibration_page(path: Path, results: Results) -> Path:
    """Write the page.

    Args:
        path: the file, which must not exist.
        results: output of `icreckon.replay.calibration.results.summarise_calibration`, of JSON's types.

    Raises:
        ReplayError: the file exists, or cannot be written.
    """
    with written_beside(path, overwrite=False) as new:
        new.write_text(calibration_page(results), encoding="utf-8")
    return path


def calibration_page(results: Results) -> str:
    """Render the page as HTML; argument as for `write_calibration_page`."""
    logs = results["logs"]
    count = f"{len(logs)} {'log' if len(logs) == 1 else 'logs'}"
    distance = sum(one["distance_m"] for one in logs)
    return render(
        "calibration.html",
        title=f"{results['robot']['name']}, calibrated",
        subtitle=f"icreckon calibrate · {count} · {distance:.0f} m",
        headline=results["verdict"],
        pictures=_pictures(results),
        tables=[model_table(results), parameter_table(results), log_table(results)],
        notes=footnotes(results),
        configuration=results["configuration"],
        robot=results["robot"],
        origin={key: results[key] for key in ORIGIN},
    )


def _pictures(results: Results) -> list[Picture]:
    pictures: list[Picture] = []
    with unless_missing():
        from icreckon.report.calibration.figure import calibration_pictures

        pictures += calibration_pictures(results)
    return pictures
