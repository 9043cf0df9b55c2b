"""The paper's numbers from friction: rows, fits, Table II, and the contradiction."""

import numpy as np
import pytest

from icreckon.estimator.robot.soil import Soil
from icreckon.simulation.contact.contact import Body, Contact, equally_spaced
from icreckon.simulation.paper.dynamic_map import DynamicMap
from icreckon.simulation.paper.fits import index_columns, motions_in_fits, weighted_fit
from icreckon.simulation.paper.published import PUBLISHED, published_parameters
from icreckon.simulation.paper.reproduction import (
    Reproduction,
    check_intercepts,
    map_of_published_model,
    paper_map,
    reproduce,
    table_2_with_published_parameters,
)


@pytest.fixture(scope="module")
def best() -> Reproduction:
    return reproduce()


@pytest.fixture(scope="module")
def plain() -> DynamicMap:
    """Motions on another ground than that which ships."""
    soil = Soil(friction=0.9, rolling_resistance=0.074)
    geometry = equally_spaced(0.42, half_length=0.39, count=5)
    return paper_map(Contact(soil, geometry, Body(258.0, -0.015, 0.04, 0.79)))


def test_rows_are_the_published_numbers(best: Reproduction) -> None:
    assert [row.name for row in best.rows[:-1]] == [number.name for number in PUBLISHED]
    assert best.rows[-1].name == "largest_eta"
    for row in best.rows:
        assert row.published == float(row.printed)
        difference = 100.0 * (row.reproduced - row.published) / abs(row.published)
        assert row.difference_percent == pytest.approx(difference)
        if row.rounds_to_published:
            assert row.reproduced == pytest.approx(row.published, abs=5e-2)
    by_name = {row.name: row for row in best.rows}
    assert by_name["eta0"].reproduced == best.parameters.eta0
    assert by_name["mean_x_ICRr"].reproduced == best.icrs.x_ICRr
    assert by_name["rmse_constant_w"].reproduced == best.errors.constant.w
    assert by_name["largest_eta"].reproduced == np.nanmax(best.mapped.indices.eta)


def test_means_and_fits_count_motions_under_little_inertia(best: Reproduction) -> None:
    mapped = best.mapped
    counted = motions_in_fits(mapped)
    assert (counted == (mapped.turning & (mapped.magnitude <= 120.0))).all()
    assert best.icrs.x_ICRr == np.mean(np.asarray(mapped.icrs.x_ICRr)[counted])
    # At the solution the gradient of the errors, each times w², is zero.
    offset, gain = best.parameters.zeta0, best.parameters.zeta1
    (zeta, columns), *_ = index_columns(mapped, counted, best.parameters.H)
    weighted = columns * mapped.motion.twist.w[counted, None] ** 2
    left = weighted.T @ (zeta - columns @ [offset, gain])
    assert np.abs(left).max() < 1e-9 * np.abs(weighted.T @ zeta).max()


def test_table_2_with_the_published_parameters(plain: DynamicMap) -> None:
    errors = table_2_with_published_parameters(plain)
    assert list(errors) == ["measured", "literal", "smooth"]
    for of in errors.values():
        assert of.constant == errors["measured"].constant
        for inertia, constant in zip(of.inertia_based, of.constant, strict=True):
            assert inertia < 0.65 * constant
    # The machinery on motions that the published parameters make themselves: no error.
    own = table_2_with_published_parameters(map_of_published_model())
    assert max(own["measured"].inertia_based) < 1e-12
    assert max(own["literal"].inertia_based) < 1e-12
    assert own["measured"].constant.w > 0.01


def test_published_means_and_fits_contradict_each_other(plain: DynamicMap) -> None:
    check = check_intercepts(plain)
    assert check.needed == pytest.approx(-18.2, abs=0.05)
    low, high = check.needed_range
    assert low < check.needed < high < -15.0
    assert check.of_published_model == pytest.approx(21.0, abs=1.0)
    assert check.of_map > 10.0


def test_the_published_model_needs_no_contact() -> None:
    mapped, published = map_of_published_model(), published_parameters()
    fitted = [
        gain
        for target, columns in index_columns(mapped, mapped.turning, published.H)
        for gain in weighted_fit(columns, target, np.ones_like(target))
    ]
    np.testing.assert_allclose(fitted, published.as_array()[1:8], rtol=1e-7)
