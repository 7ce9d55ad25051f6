"""The accuracy table says which intervals cover too often or too rarely, and what it takes for a row to be met."""

from __future__ import annotations

from typing import Any

import pytest

from bench.coverage import Verdict
from bench.section import KINDS, SHORT, summaries, tables

CONICITIES, BINS, SEEDS = 96, 200, 60
NO_GAUGE = {"gauge": 0.0, "gauge_published": 0, "gauge_covered": 0}


def count(published: int, covered: int) -> dict[str, int]:
    return {"published": published, "covered": covered}


def case(row: str = "known", error: float = 0.004, **covered: int) -> dict[str, Any]:
    """Return a case of one wheelset as JSON holds it; ``covered`` says of how many of 200 intervals by kind."""
    counts = {kind: count(BINS, covered.get(kind, 190)) for kind in KINDS} | {"zero_crossing": count(0, 0)}
    numbers = [[error, 0.01, place < counts["conicity"]["covered"]] for place in range(BINS)]
    wheelset = counts | {"serial": "W00", "error": error, "signed": error, "asked": CONICITIES}
    wheelset |= {"compared": numbers, "withheld": []}
    return {
        "row": row,
        "pair": "P8/113A",
        "seed": 0,
        "drawn": False,
        "verdicts": [],
        "wheelsets": [wheelset],
        "alignment": None,
        "status": "recorded",
        "reason": "",
        "cpu_s": [0.0, 0.0, 1.0],
    }


def printed(cases: list[dict[str, Any]]) -> str:
    (table,) = tables(cases)
    return table.markdown()


def test_nothing_is_outside_where_everything_covers_as_it_should() -> None:
    (row,) = summaries([case()] * SEEDS)
    assert row.outside == ()
    assert row.met is Verdict.YES


@pytest.mark.parametrize(("kind", "covered", "expected"), [
    ("nonlinearity", 198, "NP 99.0 %"), ("difference", 180, "R bins 90.0 %"), ("other_bins", 200, "D bins 100.0 %"),
])  # fmt: skip
def test_a_kind_that_covers_too_often_or_too_rarely_is_named_and_does_not_decide(
    kind: str, covered: int, expected: str
) -> None:
    (row,) = summaries([case(**{kind: covered})] * SEEDS)
    assert row.outside == (expected,)
    assert row.met is Verdict.YES


def test_of_conicity_the_share_decides() -> None:
    (row,) = summaries([case(conicity=200)] * SEEDS)
    assert (row.outside, row.met) == (("conicity 100.0 %",), Verdict.NO)


def test_few_fleets_say_nothing() -> None:
    (row,) = summaries([case(nonlinearity=200, conicity=200)] * 3)
    assert (row.outside, row.met) == ((), Verdict.OPEN)


def test_places_of_the_alignment_count_too() -> None:
    aligned = case("unknown")
    aligned["alignment"] = NO_GAUGE | {"band": 4e-5, "filtered": 3e-5, **count(1000, 999)}
    (row,) = summaries([aligned] * SEEDS)
    assert row.outside == ("alignment 99.9 %",)


def test_the_table_names_every_kind_and_what_is_outside() -> None:
    shown = printed([case(nonlinearity=198)] * SEEDS)
    assert "NP 99.0 %" in shown
    assert "outside 92-98 %" in shown
    assert all(name in shown for name in SHORT.values())


def test_a_found_gauge_is_reported_and_a_row_without_a_limit_is_not_taken_for_one_without_information() -> None:
    found = NO_GAUGE | {"band": 1e-4, "filtered": 1e-4, "published": 200, "covered": 190}
    scored = found | {"gauge": 0.26e-3, "gauge_published": 200, "gauge_covered": 188}
    cases = [case("mine") | {"alignment": one, "status": "estimated"} for one in (found, scored)]
    (row,) = summaries(cases)
    assert row.coverage["gauge"] == [(0, 0), (200, 188)]
    assert row.gauge == pytest.approx(0.26e-3)
    assert row.false_estimated == 0
    assert row.met is Verdict.OPEN
    shown = printed(cases)
    assert "0.26 mm" in shown
    assert "none estimated" not in shown
