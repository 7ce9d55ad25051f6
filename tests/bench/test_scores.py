"""The figures that every bench of accuracy prints, of clusters of numbers and of what is withheld."""

from __future__ import annotations

import numpy as np
import pytest

from bench.scores import COLUMNS, Cluster, Compared, Figures, compared_at, figures_table, withheld_at
from estimation.values.quantities import Estimate, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import NORMAL_95

AT = np.array([1e-3, 2e-3, 3e-3])
WHY = Reason(ReasonCode.TOO_FEW_POINTS, "too few")
FOUND = [with_interval(0.1, 0.01), Estimate.unknown(WHY), Estimate.unknown(None, 0.0, Status.INVALID)]


def test_a_number_is_compared_or_withheld_for_a_reason() -> None:
    numbers = compared_at(AT, np.array([0.12, 0.2, 0.2]), AT, FOUND)
    assert numbers[1:] == [None, None]
    assert numbers[0] is not None
    assert numbers[0].error == pytest.approx(-0.02)
    assert numbers[0].half_width == pytest.approx(NORMAL_95 * 0.01)
    assert not numbers[0].covered
    assert withheld_at(AT, AT, FOUND) == ["", str(ReasonCode.TOO_FEW_POINTS), str(Status.INVALID)]


def test_figures_are_of_all_numbers_and_their_share_of_what_was_asked() -> None:
    first = Cluster([Compared(0.01, NORMAL_95 * 0.01, covered=True), Compared(-0.03, NORMAL_95 * 0.01, covered=False)])
    second = Cluster([Compared(0.01, NORMAL_95 * 0.01, covered=True)], ["low", "low", "other", "third", "fourth"])
    found = Figures.of([first, second])
    assert (found.count, found.cover.share) == (3, pytest.approx(2 / 3))
    assert found.error == pytest.approx(0.05 / 3)
    assert found.z == pytest.approx(np.sqrt(11 / 3))
    assert found.mean_z == pytest.approx(-1 / 3)
    assert found.score == pytest.approx(2 * NORMAL_95 * 0.01 + 40 * (0.03 - NORMAL_95 * 0.01) / 3)
    assert found.kept_back == "62 %: 25 % low, 12 % other"
    assert len(found.cells) == len(COLUMNS) == len(Figures.of([Cluster([], ["low"])]).cells)
    assert figures_table("", [("row", [first, second])]).header == ("", *COLUMNS)


def test_numbers_as_they_are_kept_are_read() -> None:
    kept = Cluster.read([[0.01, 0.02, True]], ["low"])
    assert kept == Cluster([Compared(0.01, 0.02, covered=True)], ["low"])
