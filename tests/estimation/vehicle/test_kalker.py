"""Creep coefficients against published tables of Hertz's and Kalker's theories, and against their limits."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from estimation.errors import ParameterError
from estimation.vehicle.kalker import (
    ContactRadii,
    ContactRadiiStd,
    contact_ellipse,
    creep_coefficient_std,
    creep_coefficients,
    table_coefficients,
)
from estimation.vehicle.vehicle_class import VehicleParameters

COACH = ContactRadii(wheel_rolling_radius=0.46, rail_head_radius=0.3, wheel_load=54.5e3)


@pytest.mark.parametrize(
    ("ratio", "published"),  # Kalker 1990, Table E3; Garg and Dukkipati 1984, Table 3.1: Poisson's ratio 0.25
    [
        (0.1, (3.31, 2.52, 0.473, 8.28)),
        (0.5, (3.62, 3.01, 0.929, 1.93)),
        (1.0, (4.12, 3.67, 1.47, 1.19)),
        (1 / 0.8, (4.36, 3.99, 1.75, 1.04)),
        (1 / 0.5, (5.10, 4.90, 2.62, 0.819)),
        (1 / 0.1, (11.7, 12.8, 14.6, 0.526)),
    ],
)
def test_the_coefficients_are_those_of_the_published_table(ratio: float, published: tuple[float, ...]) -> None:
    assert table_coefficients(ratio) == pytest.approx(published, rel=1e-9)


def test_the_narrow_end_of_the_table_approaches_the_limit_of_line_contact() -> None:
    c11, c22, _, _ = table_coefficients(0.1)  # strip theory: pi^2/4 / (1 - nu) and pi^2/4
    assert c11 == pytest.approx(math.pi**2 / 4 / 0.75, rel=0.01)
    assert c22 == pytest.approx(math.pi**2 / 4, rel=0.025)


def test_between_two_rows_a_value_is_between_theirs() -> None:
    for between, one, other in zip(*map(table_coefficients, (0.95, 0.9, 1.0)), strict=True):
        assert min(one, other) < between < max(one, other)


def test_two_equal_radii_touch_in_hertzs_circle() -> None:
    a, b = contact_ellipse(replace(COACH, wheel_rolling_radius=0.3))
    elastic = COACH.shear_modulus / (1 - COACH.poisson_ratio)  # two bodies of one steel: E / (2 (1 - nu^2))
    assert a == pytest.approx(b)
    assert a == pytest.approx((3 * COACH.wheel_load * 0.3 / (4 * elastic)) ** (1 / 3))


@pytest.mark.parametrize(("degrees", "m", "n"), [(30, 2.731, 0.493), (45, 1.926, 0.604), (60, 1.486, 0.717)])
def test_the_semi_axes_follow_hertzs_published_table(degrees: float, m: float, n: float) -> None:
    # S. Timoshenko, Theory of Elasticity: cos theta = (B - A) / (B + A), axes m, n (3 pi N (K1 + K2) / (4 K3))^(1/3)
    cosine = math.cos(math.radians(degrees))
    curvatures = (1 - cosine) / 2, (1 + cosine) / 2  # along and across, sum 1 per m
    contact = ContactRadii(1 / curvatures[0], 1 / curvatures[1], 50e3)
    modulus = 2 * contact.shear_modulus * (1 + contact.poisson_ratio)
    twice_k = 2 * (1 - contact.poisson_ratio**2) / (math.pi * modulus)  # K1 + K2
    size = (3 * math.pi * contact.wheel_load * twice_k / (4 * 0.5)) ** (1 / 3)  # K3 = (sum of curvatures)/2
    assert contact_ellipse(contact) == pytest.approx((m * size, n * size), rel=2e-3)


def test_a_flatter_direction_has_the_longer_axis() -> None:
    a, b = contact_ellipse(COACH)
    assert a > b
    across, along = contact_ellipse(replace(COACH, wheel_rolling_radius=0.3, rail_head_radius=0.46))
    assert along > across
    assert (along, across) == pytest.approx((a, b))


def test_those_of_the_paper_are_kalkers_of_one_ellipse() -> None:
    # f11, f22 and f23 of Table A.1 have two unknowns, a/b and a b: the third is a test of the table
    paper = VehicleParameters()
    c11, c22, c23, _ = table_coefficients(1 / 0.8)
    area = paper.longitudinal_creep_coefficient / (8.08e10 * c11)
    assert paper.lateral_creep_coefficient == pytest.approx(8.08e10 * area * c22, rel=0.01)
    assert paper.lateral_spin_creep_coefficient == pytest.approx(8.08e10 * area**1.5 * c23, rel=0.01)


def test_the_coefficients_grow_with_the_load_as_in_hertzs_theory() -> None:
    one, eightfold = creep_coefficients(COACH), creep_coefficients(replace(COACH, wheel_load=8 * COACH.wheel_load))
    assert eightfold.longitudinal == pytest.approx(4 * one.longitudinal)
    assert eightfold.lateral == pytest.approx(4 * one.lateral)
    assert eightfold.lateral_spin == pytest.approx(8 * one.lateral_spin)
    assert eightfold.spin == pytest.approx(16 * one.spin)


def test_what_is_open_of_load_and_rail_adds_to_the_rails_condition() -> None:
    clean = creep_coefficient_std(COACH, ContactRadiiStd(), rail_condition_std=0.0)
    assert clean.longitudinal == 0.0
    loaded = creep_coefficient_std(COACH, ContactRadiiStd(wheel_load=0.1), rail_condition_std=0.0)
    assert loaded.longitudinal == pytest.approx(1.1 ** (2 / 3) - 1)
    assert creep_coefficient_std(COACH, ContactRadiiStd()).lateral == pytest.approx(0.1)
    both = creep_coefficient_std(COACH, ContactRadiiStd(wheel_load=0.1), rail_condition_std=0.2)
    assert both.longitudinal == pytest.approx(math.hypot(0.2, loaded.longitudinal))


@pytest.mark.parametrize(
    ("radii", "reason"),
    [
        ({"wheel_transverse_radius": -0.25}, "do not touch in one point"),
        ({"wheel_transverse_radius": -0.3}, "do not touch in one point"),
        ({"wheel_load": -1.0}, "not a possible value"),
        ({"poisson_ratio": 0.5}, "not a possible value"),
        ({"wheel_rolling_radius": math.nan}, "not a possible value"),
    ],
)
def test_radii_that_make_no_contact_are_refused(radii: dict[str, float], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        replace(COACH, **radii)


def test_an_ellipse_outside_the_table_is_refused() -> None:
    with pytest.raises(ParameterError, match="the table holds"):
        creep_coefficients(replace(COACH, rail_head_radius=0.005))
    assert creep_coefficients(replace(COACH, wheel_transverse_radius=-0.36)).longitudinal > 0
