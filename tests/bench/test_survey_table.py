"""The tables of the bench of surveys, and what its page of results shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.report import RESULTS
from bench.survey_fleets import drawn_track
from bench.surveys import ROWS, SURVEYS, Paired, differences, figures, most_share, rows_of, summary


def conicity(error: float, half_width: float = 0.02, key: str = "W 3") -> dict[str, Any]:
    return {"key": key, "error": error, "half_width": half_width, "covered": abs(error) <= half_width}


def case(survey: str, *published: dict[str, Any], **changes: Any) -> dict[str, Any]:  # noqa: ANN401 - JSON values
    plan = SURVEYS[survey]
    plain = {
        "row": "plain", "seed": 0, "survey": survey, "positions": "0.5 m", "code": "survey_confirmed",
        "right": plan.std is not None and plan.right, "understated": plan.stated is not None, "refused": False,
        "asked": 1, "published": list(published), "rival": None, "alignment_std": 1e-4, "alignment_error": 1e-4,
    }  # fmt: skip
    return plain | changes


def met(cases: list[dict[str, Any]], what: str) -> bool:
    return next(row.met for row in summary(cases) if what in row.what)


def test_figures_of_published_numbers() -> None:
    found = figures([case("0.3 mm", conicity(0.01), conicity(-0.03))])
    assert (found.count, found.cover.share) == (2, 0.5)
    assert found.error == pytest.approx(0.02)
    assert found.score == pytest.approx(0.04 + 0.5 * 40 * 0.01)
    assert found.z == pytest.approx(1.959964 * (0.5 * (0.25 + 2.25)) ** 0.5)


def test_a_right_survey_that_is_refused_and_a_wrong_one_that_is_confirmed_fall_short() -> None:
    right, wrong = case("0.3 mm", conicity(0.0)), case("sign", conicity(0.1), code="survey_mirrored", refused=True)
    assert met([right, wrong], "right surveys refused")
    assert met([right, wrong], "wrong surveys found")
    assert not met([right | {"refused": True}, wrong], "right surveys refused")
    assert not met([right, wrong | {"code": "survey_confirmed", "refused": False}], "wrong surveys found")
    doubted = wrong | {"code": "survey_not_assessable", "refused": False}
    assert not met([right, doubted], "wrong surveys found")  # its interval does not hold the truth
    assert met([right, doubted | {"published": [conicity(0.1, 0.2)]}], "wrong surveys found")


def none(*published: dict[str, Any], true: float = 0.02, seed: int = 0) -> dict[str, Any]:
    rival = {"published": [one | {"half_width": true} for one in published]}
    return case("none", *published, code="", seed=seed, rival=rival)


def fleets(without: list[dict[str, Any]], survey: list[dict[str, Any]], true: float = 0.02) -> list[dict[str, Any]]:
    """Return the cases of four fleets that are alike."""
    pairs = ((none(*without, true=true, seed=seed), case("0.3 mm", *survey, seed=seed)) for seed in range(4))
    return [one for pair in pairs for one in pair]


def test_a_survey_is_compared_with_none_over_what_both_publish() -> None:
    alone, same = [conicity(0.01), conicity(0.5, key="other")], [conicity(0.01), conicity(0.0, key="third")]
    cases = fleets(alone, same)
    assert met(cases, "0.3 mm for none: error")
    assert met(cases, "0.3 mm for none: interval score")
    assert not met(cases[:6], "0.3 mm for none: error")  # too few decide nothing
    assert not met(fleets(alone, same[:1]), "0.3 mm for none: error")  # fewer are published
    assert not met([case("0.3 mm", conicity(0.01)), none()], "0.3 mm for none: numbers of both")
    elsewhere = case("0.3 mm", conicity(0.3), conicity(0.0, key="third"), positions="2 m")
    assert met([*cases, elsewhere], "0.3 mm for none: error")


@pytest.mark.parametrize(("more", "spread", "worse"), [(4e-4, 0.0, False), (6e-4, 0.0, True), (6e-4, 1e-3, False)])
def test_worse_is_what_is_seen_and_no_chance(more: float, spread: float, *, worse: bool) -> None:
    cases = []
    for seed in range(4):
        own = 0.01 + more + spread * (-1) ** seed
        cases += [none(conicity(0.01), seed=seed), case("0.3 mm", conicity(own), seed=seed)]
    assert met(cases, "0.3 mm for none: error") != worse


def test_widths_are_compared_with_those_that_none_states_and_with_those_it_should() -> None:
    cases = fleets([conicity(0.01, 0.02)], [conicity(0.01, 0.025)], true=0.03)
    assert not met(cases, "0.3 mm for none: interval score")
    assert met(cases, "0.3 mm for none: the same with its true std")
    assert differences(cases, ["0.3 mm"]) == [("plain", "+0.0000, +0.0100, -0.0100")]


def test_numbers_of_one_fleet_share_their_errors() -> None:
    apart = Paired.of([np.array([1.0, 1.0]), np.array([3.0, 3.0])] * 2)
    assert (apart.mean, apart.fleets) == (2.0, 4)
    assert apart.std == pytest.approx((16.0 * 4 / 3) ** 0.5 / 8)
    assert Paired.of([np.array([1.0, 3.0])] * 4).std == 0.0
    assert Paired.of([np.array([1.0, 3.0])] * 3).std == np.inf


def test_a_share_that_is_not_seen_has_a_bound() -> None:
    assert most_share(0, 600) == pytest.approx(0.005, abs=1e-4)
    assert most_share(2, 2) == 1.0


def test_coverage_of_understated_surveys() -> None:
    rows = [conicity(0.0)] * 92 + [conicity(0.1)] * 8
    assert met([case("0.5 mm stated as 0.1", *rows)], "understated")
    assert not met([case("0.5 mm stated as 0.1", *rows, conicity(0.1))], "understated")
    assert rows_of([case("0.5 mm stated as 0.1", *rows)], "survey")[0][4] == "100"


def test_a_track_has_its_switches() -> None:
    plain, with_switches = drawn_track(3), drawn_track(3, switches=True)
    assert abs(plain.gauge_deviation).max() == 0.0
    assert abs(with_switches.gauge_deviation).max() == pytest.approx(8e-3, rel=0.05)


def test_the_page_of_results_shows_what_has_to_be_reached_and_what_is() -> None:
    page = (RESULTS / "surveys.md").read_text(encoding="utf-8")
    lines = [line for line in page.splitlines() if line.startswith("| ")]
    for what in ("right surveys refused", "std understated five times"):
        (line,) = [line for line in lines if line.startswith(f"| {what}")]
        assert line.endswith("| yes |")
    for survey in ("0.05 mm", "0.1 mm", "0.3 mm", "1 mm", "3 mm"):
        (line,) = [line for line in lines if line.startswith(f"| survey of {survey} for none: error")]
        assert line.endswith("| yes |")
    assert set(ROWS) >= {"plain", "coach", "slow", "few passes", "one vehicle", "switches", "one flat"}
