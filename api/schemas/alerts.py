"""Alerts, their events, and what people and maintenance systems may do to them."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, TypeVar

from pydantic import AfterValidator, Field, WithJsonSchema

from api.schemas.common import Body, Derived, Links, Representation, segment
from api.schemas.evidence import AnyEvidence, evidence_of
from api.times import Moment
from estimation.alerts.rule_book import ALERT_RULES
from estimation.values.alerts import Alert as AlertValue
from estimation.values.alerts import AlertEvent, AlertScope, Condition
from fleet_db.stores.alerts import AlertOutline

_WORDS = r"^[^\x00]*$"
LIMIT_UNITS = {rule.kind: rule.limit_unit for rule in ALERT_RULES}


def _known(kind: str) -> str:
    if kind not in LIMIT_UNITS:
        raise ValueError(f"is none of {', '.join(LIMIT_UNITS)}")
    return kind


# the schema lists the kinds of today's rules; a stored alert keeps that of a rule that is gone
AlertKind = Annotated[str, WithJsonSchema({"type": "string", "enum": [rule.kind for rule in ALERT_RULES]})]
KnownKind = Annotated[AlertKind, AfterValidator(_known)]


class DisplayState(StrEnum):
    """One word for a list on a screen, derived from the facts; programs should read the facts."""

    CLOSED = "closed"
    CLEARED = "cleared"
    SHELVED = "shelved"
    ACKNOWLEDGED = "acknowledged"
    UNKNOWN = "unknown"
    ACTIVE = "active"
    PENDING = "pending"


class Alert(
    Derived,
    of=AlertValue,
    also=("scope",),
    columns="id fleet wheelset scope track_section fleet_alert_id kind severity condition display_state opened_at"
    " last_seen_at cleared_at closed_at close_reason close_reason_code occurrence_count probability_1 raise_limit"
    " clear_limit limit_unit evidence action acknowledged_by acknowledged_at shelved_until shelved_reason external_refs"
    " rules_version version links",
):
    """One alert of one wheelset, or one fleet alert that stands for many; at most one of a kind is open at a time."""

    kind: AlertKind
    display_state: DisplayState
    close_reason: str | None
    limit_unit: str | None = Field(examples=["1"], description="Unit of both limits; fixed for a kind.")
    evidence: AnyEvidence = Field(
        description="Numbers, intervals, windows and limits that led to it; of a fleet alert, how many members it has."
    )
    links: Links


class Event(Derived, of=AlertEvent, without=("sequence",), columns="event recorded_at actor note alert"):
    """Something that happened to an alert, with the alert as it was right after."""

    alert: Alert = Field(description="The alert as it was right after.")


class Feed(Representation):
    """Events in commit order; poll again with `next_cursor`, which is there even when nothing is new."""

    items: list[Event]
    next_cursor: str = Field(description="Keep it, and hand it back as `after`.")
    next: str = Field(description="The path with which to go on.")


class Events(Representation):
    """Everything that happened to one alert, oldest first."""

    items: list[Event]


By = Annotated[
    str | None,
    Field(
        min_length=1,
        max_length=200,
        pattern=_WORDS,
        description="Who does it: the owner of the key, meant where it is left out; required where access is open.",
        examples=["j.smith"],
    ),
]


class Acknowledgement(Body):
    """Acknowledge the alert."""

    by: By = None
    note: str = Field(default="", max_length=2000, pattern=_WORDS, examples=["Inspection planned"])


class Shelving(Body):
    """Shelve the alert until then."""

    by: By = None
    until: Moment = Field(description="When it comes back by itself.", examples=["2027-01-31T00:00:00Z"])
    reason: str = Field(min_length=1, max_length=2000, pattern=_WORDS, examples=["Reprofiling ordered"])


class Unshelving(Body):
    """Bring the alert back before the end of its shelving."""

    by: By = None
    note: str = Field(default="", max_length=2000, pattern=_WORDS, examples=["The lathe is free today"])


class ExternalReference(Body):
    """The identity that a maintenance system gave to its work on the alert."""

    ref: str = Field(
        description="The identity, as that system writes it.",
        min_length=1,
        max_length=200,
        pattern=_WORDS,
        examples=["maximo:WO-4711"],
    )
    by: By = None


def display_state(alert: AlertValue | AlertOutline, now_ns: int) -> DisplayState:
    """Return the one word that is shown for an alert now."""
    if alert.closed_ns is not None:
        return DisplayState.CLOSED
    if alert.condition is Condition.CLEARED:
        return DisplayState.CLEARED
    if alert.shelved_until_ns is not None and alert.shelved_until_ns > now_ns:
        return DisplayState.SHELVED
    if alert.acknowledged_ns is not None:
        return DisplayState.ACKNOWLEDGED
    return DisplayState(alert.condition.value)


def _links(record: AlertValue) -> dict[str, str]:
    path = f"/v1/alerts/{record.alert_id}"
    links = {"self": path, "events": f"{path}/events"}
    if record.track_section is not None:
        return links | {"adhesion": f"/v1/track-sections/{segment(record.track_section)}/adhesion"}
    if record.wheelset is None:
        return links | {"members": f"/v1/alerts?fleet_alert={record.alert_id}"}
    wheelset = f"/v1/wheelsets/{segment(record.wheelset)}"
    links |= {"wheelset": wheelset, "geometry": f"{wheelset}/geometry", "trend": f"{wheelset}/trend"}
    if record.fleet_alert_id is not None:
        links["fleet_alert"] = f"/v1/alerts/{record.fleet_alert_id}"
    return links


AlertT = TypeVar("AlertT", bound=Alert)


def alert(record: AlertValue, now_ns: int, model: type[AlertT] = Alert, **more: object) -> AlertT:  # type: ignore[assignment]  # the bound itself
    """Return the representation of an alert at this time; ``more`` is what another ``model`` has beside."""
    return model.made(
        record,
        display_state=display_state(record, now_ns),
        close_reason=None if record.close_reason is None else record.close_reason.sentence,
        limit_unit=None if record.scope is AlertScope.FLEET else LIMIT_UNITS.get(record.kind),
        evidence=evidence_of(record),
        links=_links(record),
        **more,
    )


def event(record: AlertEvent) -> Event:
    """Return the representation of an event; the alert's display state is the one at the event."""
    return Event.made(record, alert=alert(record.alert, record.recorded_ns))


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
