"""The setting of known sections: each has a day, a wrong one names the setting, and jobs get both."""

from __future__ import annotations

from dataclasses import replace

import pytest
from api_fleet import section_rails as stored

from api.pipeline import rails_settings
from api.routes.opinions import section_rails
from api.settings import known_sections, load_settings
from estimation.errors import ParameterError
from estimation.jobs.settings import KnownSection
from estimation.values.reasons import Reason, ReasonCode

DAY_NS = 86_400 * 10**9


def test_a_section_has_a_day_and_may_have_several() -> None:
    assert known_sections(" S@1@1970-01-02, S2@1970-01-03,S2@1971-01-01 ,") == [
        ("S@1", DAY_NS),
        ("S2", 2 * DAY_NS),
        ("S2", 365 * DAY_NS),
    ]
    found = rails_settings(load_settings(rails_known_sections="S1@1970-01-02", rails_limit=0.03))
    assert found.known_sections == frozenset({KnownSection("S1", DAY_NS)})
    assert found.model.limit == 0.03
    assert rails_settings(load_settings()).known_sections == frozenset()


@pytest.mark.parametrize("text", ["S1", "S1@", "@2026-03-01", "S1@2026-13-01", "S1@yesterday"])
def test_a_section_without_a_day_is_refused(text: str) -> None:
    with pytest.raises(ParameterError) as error:
        load_settings(rails_known_sections=text)
    assert error.value.field == "TREADWATCH_RAILS_KNOWN_SECTIONS"


def test_a_section_without_trend_says_why() -> None:
    why = Reason(ReasonCode.TREND_NOT_A_LINE, "ground")
    found = stored()
    assert found.value is not None
    shown = section_rails(replace(found, value=replace(found.value, trend=None, no_trend=why)))
    assert (shown.trend, shown.trend_reason, shown.trend_reason_code) == (None, "ground", why.code)
