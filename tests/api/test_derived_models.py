"""Models that follow from frozen values: names, units, words, what is absent, and the order of columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from api.schemas.common import Derived
from estimation.values.arrays import FloatArray
from estimation.values.fields import Served
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import IN_MM

WHY = Reason(ReasonCode.TOO_FEW_WINDOWS, "two windows")


@dataclass(frozen=True)
class Wheel:
    """A wheel; what follows is for its developers."""

    serial: Annotated[str, Served("Of the wheelset.", example="WS-1")]
    radius: Annotated[float, Served(name="radius_mm", scale=IN_MM)]
    measured_ns: int
    wear: Annotated[float | None, Served(name="wear_mm", scale=IN_MM)]
    share: Annotated[float, Served(finite=False)]
    conicity: Annotated[Estimate, Served(name="conicity_1")]
    profile: Annotated[FloatArray, "n", Served(name="profile_mm", scale=IN_MM)]
    fleets: frozenset[str]
    reason: Reason | None
    doubt: Reason | None
    inner: str = "x"

    @property
    def half(self) -> Annotated[float, Served("Half of the radius.", "half_mm", IN_MM)]:
        """Half of the radius, m."""
        return 0.5 * self.radius


class WheelRow(Derived, of=Wheel, without=("inner",), also=("half",)):
    links: dict[str, str]


class Named(Derived, of=Wheel, without=Wheel.__annotations__.keys() - {"serial", "radius"}, columns="radius_mm serial"):
    """In the order of a table."""


WHEEL = Wheel(
    "WS-1", 0.45, 10**9, None, np.nan, Estimate.unknown(WHY), np.array([1e-3, np.inf]), frozenset("ba"), WHY, None
)


def test_a_model_has_the_names_units_and_words_of_the_value() -> None:
    row = WheelRow.made(WHEEL, links={"self": "/wheel"})
    served = row.model_dump(mode="json")
    assert served.pop("conicity_1")["reason_code"] == "too_few_windows"
    assert served == {
        "serial": "WS-1",
        "radius_mm": 450.0,
        "measured_at": "1970-01-01T00:00:01Z",
        "wear_mm": None,
        "share": None,
        "profile_mm": [1.0, None],
        "fleets": ["a", "b"],
        "reason": "two windows",
        "reason_code": "too_few_windows",
        "doubt": None,
        "doubt_code": None,
        "half_mm": 225.0,
        "links": {"self": "/wheel"},
    }
    described = WheelRow.model_fields["serial"]
    assert (described.description, described.examples) == ("Of the wheelset.", ["WS-1"])
    assert WheelRow.model_fields["half_mm"].description == "Half of the radius."


def test_what_is_given_goes_before_the_value() -> None:
    assert WheelRow.made(WHEEL, links={}, serial="WS-2").model_dump()["serial"] == "WS-2"


def test_columns_are_in_the_order_of_the_table() -> None:
    assert list(Named.model_fields) == ["radius_mm", "serial"]
    assert Named.made(WHEEL).model_dump() == {"radius_mm": 450.0, "serial": "WS-1"}
