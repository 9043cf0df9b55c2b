"""Drift of all variants per horizon, with intervals, and the verdict."""

import math
from collections.abc import Mapping
from typing import Any

from icreckon.estimator.log.scores import DISTANCES, HORIZONS, Drift, Unit
from icreckon.estimator.streaming.smoother import SMOOTHED
from icreckon.replay.comparison.bootstrap import Estimate, PairedDrift, paired_drift

# Candidates for the baseline, wheels and gyro first: the first that was run.
BASELINES = ("gyro", "constant-online", "constant-fixed", "differential")
# Candidates for the horizon of the verdict: the first with an interval, or else with segments.
VERDICT_HORIZONS = ("30s", "10s", "30m", "10m", "5m", "60s", "50m")

Results = dict[str, Any]
# Label of the horizon -> name of the variant -> drift.
Drifts = dict[str, dict[str, Drift]]


def horizon_labels() -> dict[str, tuple[float, Unit]]:
    """Horizons with their units, by their labels in the keys of results, as "30s"."""
    horizons: list[tuple[float, Unit]] = [(seconds, "s") for seconds in HORIZONS]
    horizons += [(metres, "m") for metres in DISTANCES]
    return {f"{horizon:g}{unit}": (horizon, unit) for horizon, unit in horizons}


def paired_drifts(drifts: Drifts) -> dict[str, PairedDrift]:
    """Pair the drifts of all variants, by the label of the horizon."""
    return {label: paired_drift(by_name) for label, by_name in drifts.items()}


def baseline_of(names: list[str]) -> str:
    """First of `BASELINES` that was run, or else the first variant."""
    return next((name for name in BASELINES if name in names), names[0])


def drift_scores(drifts: Mapping[str, PairedDrift], name: str, baseline: str) -> Results:
    """Drift scores of a variant, by the horizon, with 95 % intervals."""
    scores: Results = {}
    for label, paired in drifts.items():
        percent, ratio = paired.percent(name), paired.ratio(name, baseline)
        scores[f"drift_percent_{label}_mean"] = percent.value
        scores[f"drift_percent_{label}_95"] = listed(percent)
        scores[f"drift_segments_{label}"] = len(paired.distances)
        scores[f"drift_ratio_{label}"] = ratio.value
        scores[f"drift_ratio_{label}_95"] = listed(ratio)
    return scores


def verdict(drifts: Mapping[str, PairedDrift], baseline: str) -> Results | None:
    """Name the filter with the least drift, and those not worse; None without scores."""
    labels = [label for label in VERDICT_HORIZONS if len(drifts[label].distances)]
    if not labels:
        return None
    # All variants have an interval, or none has: it depends on the number of blocks.
    first = drifts[labels[0]].names[0]
    label = next((label for label in labels if drifts[label].percent(first).interval), labels[0])
    paired = drifts[label]
    names = [name for name in paired.names if not name.endswith(SMOOTHED)]
    percents = {name: paired.percent(name) for name in names}
    best = min(names, key=lambda name: percents[name].value)
    ratios = {name: paired.ratio(name, best) for name in names if name != best}
    # A variant is worse if the lower end of its ratio to the best is above 1.
    lows = {name: ratio.interval[0] if ratio.interval else 0.0 for name, ratio in ratios.items()}
    baseline_ratio = paired.ratio(best, baseline)
    return {
        "horizon": label,
        "best": best,
        "drift_percent": percents[best].value,
        "drift_percent_95": listed(percents[best]),
        "baseline": baseline,
        "ratio": baseline_ratio.value,
        "ratio_95": listed(baseline_ratio),
        "segments": len(paired.distances),
        "blocks": paired.blocks,
        "ratios_to_best": {name: ratio.value for name, ratio in ratios.items()},
        "ratios_to_best_95": {name: listed(ratio) for name, ratio in ratios.items()},
        "not_shown_worse": [name for name, low in lows.items() if low <= 1.0],
    }


def listed(estimate: Estimate) -> list[float] | None:
    """Interval of an estimate as a list; None if there is none."""
    if estimate.interval is None or not all(map(math.isfinite, estimate.interval)):
        return None
    return list(estimate.interval)
