"""The accuracy table says which intervals cover too often or too rarely, and what it takes for a row to be met."""

from __future__ import annotations

from typing import Any

import pytest

from bench.section import KINDS, SHORT, summaries, tables

CONICITIES, BINS = 96, 200
NO_GAUGE = {"gauge": 0.0, "gauge_published": 0, "gauge_covered": 0}


def count(published: int, covered: int) -> dict[str, int]:
    return {"published": published, "covered": covered}


def case(row: str = "known", error: float = 0.004, **covered: int) -> dict[str, Any]:
    """Return a case of one wheelset as JSON holds it; ``covered`` says of how many of 200 intervals by kind."""
    counts = {kind: count(BINS, covered.get(kind, 190)) for kind in KINDS} | {"zero_crossing": count(0, 0)}
    wheelset = counts | {"serial": "W00", "error": error, "signed": error, "asked": CONICITIES}
    return {
        "row": row,
        "pair": "P8/113A",
        "seed": 0,
        "drawn": False,
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
    (row,) = summaries([case()])
    assert row.outside == ()
    assert row.met


@pytest.mark.parametrize(("kind", "covered", "expected"), [
    ("nonlinearity", 198, "NP 99.0 %"), ("difference", 180, "R bins 90.0 %"), ("other_bins", 200, "D bins 100.0 %"),
])  # fmt: skip
def test_a_kind_that_covers_too_often_or_too_rarely_is_named_and_does_not_decide(
    kind: str, covered: int, expected: str
) -> None:
    (row,) = summaries([case(**{kind: covered})])
    assert row.outside == (expected,)
    assert row.met


def test_of_conicity_the_share_decides() -> None:
    (row,) = summaries([case(conicity=200)])
    assert (row.outside, row.met) == (("conicity 100.0 %",), False)


def test_few_intervals_say_nothing() -> None:
    few = case()
    few["wheelsets"][0]["nonlinearity"] = count(99, 99)
    (row,) = summaries([few])
    assert row.outside == ()
    few["wheelsets"][0]["nonlinearity"] = count(100, 100)
    (row,) = summaries([few])
    assert row.outside == ("NP 100.0 %",)


def test_places_of_the_alignment_count_too() -> None:
    aligned = case("unknown")
    aligned["alignment"] = NO_GAUGE | {"band": 4e-5, "filtered": 3e-5, **count(1000, 999)}
    (row,) = summaries([aligned])
    assert row.outside == ("alignment 99.9 %",)


def test_the_table_names_every_kind_and_what_is_outside() -> None:
    shown = printed([case(nonlinearity=198)])
    assert "NP 99.0 %" in shown
    assert "outside 92-98 %" in shown
    assert all(name in shown for name in SHORT.values())


def test_a_found_gauge_is_reported_and_a_row_without_a_limit_is_not_taken_for_one_without_information() -> None:
    found = NO_GAUGE | {"band": 1e-4, "filtered": 1e-4, "published": 200, "covered": 190}
    scored = found | {"gauge": 0.26e-3, "gauge_published": 200, "gauge_covered": 188}
    cases = [case("mine") | {"alignment": one, "status": "estimated"} for one in (found, scored)]
    (row,) = summaries(cases)
    assert row.coverage["gauge"] == (200, 188)
    assert row.gauge == pytest.approx(0.26e-3)
    assert row.false_estimated == 0
    assert row.met
    shown = printed(cases)
    assert "0.26 mm" in shown
    assert "none estimated" not in shown
