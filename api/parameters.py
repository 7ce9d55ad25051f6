"""Path and query parameters that several resources share."""

from __future__ import annotations

from typing import Annotated

from fastapi import Path, Query

from api.problems import ProblemError, ProblemItem
from api.times import Moment, to_rfc3339

CODE = r"^[^\x00-\x1f\x7f]{1,64}$"
_INT64_MAX = 2**63 - 1

Code = Annotated[str, Path(pattern=CODE, examples=["demo"])]
Serial = Annotated[str, Path(pattern=CODE, description="Serial of the wheelset.", examples=["WS-0001"])]
Number = Annotated[int, Path(ge=1, le=_INT64_MAX, examples=[1])]
FleetFilter = Annotated[str | None, Query(pattern=CODE, description="Only of this fleet.")]
VehicleFilter = Annotated[str | None, Query(pattern=CODE, description="Only what runs under this vehicle now.")]
WheelsetFilter = Annotated[str | None, Query(pattern=CODE, description="Only of this wheelset.")]
AsOf = Annotated[
    Moment | None,
    Query(description="The result as recorded at this time; reproducible.", examples=["2026-01-31T12:00:00Z"]),
]
MeasuredFrom = Annotated[Moment | None, Query(alias="from", description="Measured at or after this time.")]
MeasuredTo = Annotated[Moment | None, Query(alias="to", description="Measured before this time.")]


def require_order(from_ns: int | None, to_ns: int | None, begin: str = "from", end: str = "to") -> None:
    """Refuse (422) a range that ends before it begins; an empty one, `[t, t)`, is allowed; None is open."""
    if from_ns is not None and to_ns is not None and from_ns > to_ns:
        item = ProblemItem(part="query", pointer=f"#/{begin}", detail=f"is after `{end}`")
        raise ProblemError(422, "invalid-request", f"{begin} is after {end}", [item])


def not_in_the_future(as_of_ns: int | None, now_ns: int) -> None:
    """Refuse (422) a time in the future."""
    if as_of_ns is not None and as_of_ns > now_ns:
        item = ProblemItem(part="query", pointer="#/as_of", detail="is in the future")
        raise ProblemError(422, "invalid-request", "as_of is in the future", [item])


def not_purged(as_of_ns: int | None, purged_before_ns: int | None) -> None:
    """Refuse (410) a time from which replaced results are not kept any more: what was known then is not known now."""
    if as_of_ns is not None and purged_before_ns is not None and as_of_ns < purged_before_ns:
        kept = to_rfc3339(purged_before_ns)
        raise ProblemError(410, "history-purged", f"replaced results are kept from {kept} on, see the retention")
