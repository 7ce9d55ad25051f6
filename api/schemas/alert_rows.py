"""Alerts as they are listed: with where the wheelset ran, in an order that shows what matters first."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field

from api.schemas.alerts import Alert, alert
from estimation.values.alerts import Alert as AlertValue


class AlertSort(StrEnum):
    """What alerts are listed by."""

    OLDEST = "id"
    NEWEST = "-id"
    WORST = "-severity"


class AlertRow(Alert):
    """An alert, with where its wheelset ran when it was opened; nulls for a fleet alert, or where none is on file."""

    vehicle: str | None = Field(
        description="That the wheelset ran under when the alert was opened.", examples=["V-101"]
    )
    axle: int | None = Field(description="Number of its axle there, from 1.", examples=[1])


def alert_row(record: AlertValue, now_ns: int, place: tuple[str | None, int | None]) -> AlertRow:
    """Return the representation of an alert in a list.

    Args:
        place: Vehicle and axle that its wheelset ran under when it was opened.
    """
    vehicle, axle = place
    return AlertRow(**dict(alert(record, now_ns)), vehicle=vehicle, axle=axle)
