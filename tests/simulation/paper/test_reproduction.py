"""The paper's numbers from friction: rows, readings, Table II, and the contradiction."""

import msgspec
import numpy as np
import pytest

from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.paper.contact import (
    ContactParameters,
    PaperContact,
    load_paper_contact,
    make_contact,
)
from icreckon.simulation.paper.published import PUBLISHED, published_parameters
from icreckon.simulation.paper.readings import Reading, read_means, read_parameters
from icreckon.simulation.paper.reproduction import (
    Reproduction,
    check_intercepts,
    map_of_published_model,
    reproduce,
    table_2_with_published_parameters,
)


@pytest.fixture(scope="module")
def best() -> Reproduction:
    return reproduce(load_paper_contact())


@pytest.fixture(scope="module")
def plain() -> Reproduction:
    """The paper as written, with the contact that ships' values left out."""
    return reproduce(PaperContact())


def test_rows_are_the_published_numbers(best: Reproduction) -> None:
    assert [row.name for row in best.printed_rows] == [number.name for number in PUBLISHED]
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


def test_readings_differ_where_they_should(plain: Reproduction) -> None:
    mapped = plain.mapped
    right = np.asarray(mapped.icrs.x_ICRr)[mapped.turning]
    assert read_means(mapped, Reading(means="median")).x_ICRr == np.median(right)
    w = np.asarray(mapped.motion.twist.w)[mapped.turning] ** 2
    weighted = read_means(mapped, Reading(means="velocity")).x_ICRr
    assert weighted == pytest.approx(float((w * right).sum() / w.sum()))
    fits = [read_parameters(mapped, Reading(fit=fit)) for fit in ("plain", "velocity", "absolute")]
    assert len({fit.eta0 for fit in fits}) == 3
    assert len({fit.H for fit in fits}) == 1
    gentle = read_means(mapped, Reading(largest_inertia=60.0)).x_ICRr
    at = mapped.turning & (mapped.magnitude <= 60.0)
    assert gentle == np.mean(np.asarray(mapped.icrs.x_ICRr)[at])
    at = mapped.turning & (np.abs(mapped.motion.V_l - mapped.motion.V_r) >= 0.35)
    apart = read_means(mapped, Reading(least_difference=0.35)).x_ICRr
    assert apart == np.mean(np.asarray(mapped.icrs.x_ICRr)[at])


def test_least_absolute_deviations_are_no_more_than_any_other_fit_leaves(plain):
    mapped = plain.mapped
    at = mapped.turning

    def left(fit: str) -> float:
        reading = msgspec.convert({"fit": fit}, Reading)
        ours = read_parameters(mapped, reading)
        signed = mapped.magnitude * np.sign(mapped.motion.V_l - mapped.motion.V_r)
        signed = signed * np.sign(mapped.motion.V_l + ours.H * mapped.motion.V_r)
        modelled = ours.epsilon0 + ours.epsilon1 * signed
        return float(np.abs(mapped.indices.epsilon - modelled)[at].sum())

    assert left("absolute") < min(left("plain"), left("velocity"))


def test_table_2_with_the_published_parameters(plain: Reproduction) -> None:
    errors = table_2_with_published_parameters(plain.mapped, Reading())
    assert list(errors) == ["measured", "literal", "smooth"]
    for of in errors.values():
        assert of.constant == errors["measured"].constant
        for inertia, constant in zip(of.inertia_based, of.constant, strict=True):
            assert inertia < 0.65 * constant
    # The machinery on motions that the published parameters make themselves: no error.
    own = table_2_with_published_parameters(map_of_published_model(), Reading())
    assert max(own["measured"].inertia_based) < 1e-12
    assert max(own["literal"].inertia_based) < 1e-12
    assert own["measured"].constant.w > 0.01


def test_published_means_and_fits_contradict_each_other(plain: Reproduction) -> None:
    check = check_intercepts(plain.mapped)
    assert check.mean_epsilon == pytest.approx(0.086)
    assert check.needed == pytest.approx(-18.2, abs=0.05)
    low, high = check.needed_range
    assert low < check.needed < high < -15.0
    assert check.of_published_model == pytest.approx(21.0, abs=1.0)
    assert check.of_map > 10.0
    assert check.mean_eta == pytest.approx(2.5905, abs=1e-4)
    assert check.mean_eta_by_fit > check.mean_eta + 0.1


def test_contacts_are_what_their_parameters_say() -> None:
    contact = make_contact(ContactParameters(points=4, end_weight=2.0, tread_width=0.1))
    assert len(contact.geometry.positions) == 4
    assert contact.geometry.weights == (2.0, 1.0, 1.0, 2.0)
    assert contact.geometry.across == (-0.05, 0.0, 0.05)
    assert contact.soil.coefficients == (0.9, 0.9)
    assert contact.body == make_contact(ContactParameters()).body
    for wrong in ({"points": 1}, {"friction": 0.0}, {"tread_width": 0.5}, {"half_length": 0.01}):
        with pytest.raises(SimulationError, match="make no sense"):
            make_contact(msgspec.structs.replace(ContactParameters(), **wrong))


def test_the_published_model_needs_no_contact() -> None:
    mapped = map_of_published_model()
    fitted = read_parameters(mapped, Reading(), H=published_parameters().H)
    np.testing.assert_allclose(fitted.as_array(), published_parameters().as_array(), rtol=1e-7)
