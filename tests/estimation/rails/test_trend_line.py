"""The trend of a section: a line through its periods, only where they are on one, and why there is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from drawn_cells import AMPLITUDE, anchors, cell, wheel

from estimation.rails.apart import rails_apart
from estimation.rails.cell import Anchors
from estimation.rails.parameters import RailsParameters
from estimation.rails.published import line
from estimation.values.opinions import RailsApart, SectionConicity
from estimation.values.reasons import ReasonCode


def worn(excess: Sequence[float], *, std: float = 0.004, systematic: float = 0.0) -> list[SectionConicity]:
    """Return cells of wheels on A and B, whose rails add so much in each period of half a year."""
    return [
        cell(
            wheel(f"W{n}", p),
            s,
            0.2 + 0.02 * n + (more if s == "B" else 0.0),
            period=p,
            std=std,
            systematic=systematic * (0.2 + 0.02 * n + (more if s == "B" else 0.0)),
        )
        for n in range(6)
        for p, more in enumerate(excess)
        for s in ("A", "B")
    ]


def apart(cells: list[SectionConicity], held: Anchors | None = None) -> RailsApart:
    return rails_apart(cells, AMPLITUDE, held or anchors("A"), RailsParameters())


def code(found: RailsApart, section: str = "B") -> ReasonCode | None:
    return found.no_trends[section].code if section in found.no_trends else None


def test_rails_that_were_ground_have_no_trend() -> None:
    found = apart(worn([0.04, 0.08, 0.0, 0.02]))
    assert "B" not in found.trends
    assert code(found) is ReasonCode.TREND_NOT_A_LINE


def test_even_wear_has_a_trend_and_no_reason() -> None:
    found = apart(worn([0.02, 0.03, 0.04, 0.05]))
    assert found.trends["B"].per_year.value == pytest.approx(0.02, abs=1e-3)
    assert code(found) is None


@pytest.mark.parametrize(
    ("excess", "known", "expected"),
    [
        ([0.02, 0.03], ("A",), ReasonCode.TOO_FEW_PERIODS),
        ([0.02, 0.03, 0.04], (), ReasonCode.RAILS_LEVEL_OPEN),
    ],
)
def test_a_section_without_trend_says_why(excess: list[float], known: tuple[str, ...], expected: ReasonCode) -> None:
    found = apart(worn(excess), anchors(*known))
    assert code(found) is expected
    assert (code(found, "A") is ReasonCode.RAILS_ARE_REFERENCE) is bool(known)


def test_a_line_is_doubted_beyond_99_percent() -> None:
    """Pins ``doubted_share``: Fisher's distribution for one value over, with many degrees of freedom."""
    covariance = np.diag(np.full(3, 0.01**2))
    kink = np.array([0.0, 1.0, 0.0])  # weighted squares of what is left: kink^2 * 2/3
    for share, fits in ((0.99, True), (1.01, False)):
        height = share * 0.01 * np.sqrt(6.6349 * 1.5)
        found = line(np.array([0.0, 1.0, 2.0]), height * kink, covariance)
        assert found.squares == pytest.approx((share**2) * 6.6349, rel=1e-3)
        assert found.fits(1e9, RailsParameters().doubted_share) is fits


def test_the_error_of_a_trend_is_that_of_the_line_and_what_all_cells_share_in_proportion() -> None:
    """Pins the sampled and the systematic part of the trend."""
    alone, shared = (apart(worn([0.02, 0.06, 0.10, 0.14], systematic=s)).trends["B"].per_year for s in (0.0, 0.2))
    assert alone.std is not None
    assert shared.std is not None
    assert np.sqrt(shared.std**2 - alone.std**2) == pytest.approx(0.2 * 0.08, rel=0.05)
    found = apart(worn([0.02, 0.06, 0.10, 0.14]))
    value = [one.reference_wheel[1] for one in found.rails if one.rail.section == "B"]
    at = np.arange(4) * 0.5 - 0.75  # years
    independent = np.sqrt(np.mean([one.std**2 for one in value if one.std is not None]) / (at**2).sum())
    assert alone.std == pytest.approx(independent, rel=0.15)


def test_what_no_wheel_explains_is_in_every_period_of_a_trend() -> None:
    """Pins that the interaction of the wheel as designed is new in each of them: many wheels leave nothing else."""
    cells = [
        cell(wheel(f"W{n:03d}", p), s, 0.19 + 0.001 * n + 0.01 * p * (s == "B"), period=p, std=1e-4)
        for n in range(60)
        for p in range(4)
        for s in ("A", "B")
    ]
    found = apart(cells)
    least = float(found.interaction[1]) / np.sqrt((np.array([-0.75, -0.25, 0.25, 0.75]) ** 2).sum())
    assert least < (found.trends["B"].per_year.std or 0.0) < 1.3 * least
