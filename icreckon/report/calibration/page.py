"""Self-contained HTML page of a calibration, made from its results only."""

from __future__ import annotations

from icreckon.replay.comparison.results import Results
from icreckon.report.calibration.tables import footnotes, log_table, model_table, parameter_table
from icreckon.report.drawing import unless_missing
from icreckon.report.pages import Picture, render

ORIGIN = ("versions", "inputs", "format")


def calibration_page(results: Results) -> str:
    """Render the page as HTML."""
    logs = results["logs"]
    count = f"{len(logs)} {'log' if len(logs) == 1 else 'logs'}"
    distance = sum(one["distance_m"] for one in logs)
    return render(
        "calibration.html",
        title=f"{results['robot']['name']}, calibrated",
        subtitle=f"icreckon calibrate · {count} · {distance:.0f} m",
        headline=results["headline"],
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
