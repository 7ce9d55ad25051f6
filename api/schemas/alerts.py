"""Alerts, their events, and what people and maintenance systems may do to them."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import AfterValidator, Field, WithJsonSchema

from api.schemas.common import Links, Representation, Request, finite
from api.schemas.evidence import AnyEvidence, evidence_of
from api.schemas.registry import segment
from api.times import Moment, Timestamp, to_rfc3339
from estimation.alerts.rules.book import ALERT_RULES
from estimation.values.alerts import Alert as AlertValue
from estimation.values.alerts import AlertEvent, AlertEventKind, AlertScope, CloseReason, Condition, Severity
from fleet_db.stores.alert_queries import AlertOutline

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


class Alert(Representation):
    """One alert of one wheelset, or one fleet alert that stands for many; at most one of a kind is open at a time."""

    id: int = Field(examples=[17])
    fleet: str = Field(examples=["demo"])
    wheelset: str | None = Field(examples=["WS-0001"], description="Null for an alert of a fleet or a section.")
    scope: AlertScope = Field(description="Whether it is about a wheelset, the fleet or a track section.")
    track_section: str | None = Field(description="Code of the section that it is about; null for all others.")
    fleet_alert_id: int | None = Field(description="The fleet alert that this one is a member of.")
    kind: AlertKind
    severity: Severity
    condition: Condition
    display_state: DisplayState
    opened_at: Timestamp
    last_seen_at: Timestamp
    cleared_at: Timestamp | None
    closed_at: Timestamp | None
    close_reason: str | None
    close_reason_code: CloseReason | None
    occurrence_count: int
    probability_1: float | None
    raise_limit: float | None = Field(description="As it was when the alert fired, in the unit of `limit_unit`.")
    clear_limit: float | None = Field(description="As it was when the alert fired, in the unit of `limit_unit`.")
    limit_unit: str | None = Field(examples=["1"], description="Unit of both limits; fixed for a kind.")
    evidence: AnyEvidence = Field(
        description="Numbers, intervals, windows and limits that led to it; of a fleet alert, how many members it has."
    )
    action: str = Field(description="Suggested action, from a code list.", examples=["reprofile"])
    acknowledged_by: str | None
    acknowledged_at: Timestamp | None
    shelved_until: Timestamp | None
    shelved_reason: str | None
    external_refs: list[str]
    rules_version: str | None = Field(description="The rules that it was raised by.")
    version: int
    links: Links


class Event(Representation):
    """Something that happened to an alert, with the alert as it was right after."""

    event: AlertEventKind
    recorded_at: Timestamp
    actor: str
    note: str
    alert: Alert


class Feed(Representation):
    """Events in commit order; poll again with `next_cursor`, which is there even when nothing is new."""

    items: list[Event]
    next_cursor: str = Field(description="Keep it, and hand it back as `after`.")
    next: str


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


class Acknowledgement(Request):
    """Acknowledge the alert."""

    by: By = None
    note: str = Field(default="", max_length=2000, pattern=_WORDS, examples=["Inspection planned"])


class Shelving(Request):
    """Shelve the alert until then."""

    by: By = None
    until: Moment = Field(examples=["2027-01-31T00:00:00Z"])
    reason: str = Field(min_length=1, max_length=2000, pattern=_WORDS, examples=["Reprofiling ordered"])


class Unshelving(Request):
    """Bring the alert back before the end of its shelving."""

    by: By = None
    note: str = Field(default="", max_length=2000, pattern=_WORDS, examples=["The lathe is free today"])


class ExternalReference(Request):
    """The identity that a maintenance system gave to its work on the alert."""

    ref: str = Field(min_length=1, max_length=200, pattern=_WORDS, examples=["maximo:WO-4711"])
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


def _time(t_ns: int | None) -> str | None:
    return None if t_ns is None else to_rfc3339(t_ns)


def _links(record: AlertValue) -> dict[str, str]:
    own = f"/v1/alerts/{record.alert_id}"
    links = {"self": own, "events": f"{own}/events"}
    if record.track_section is not None:
        return links | {"adhesion": f"/v1/track-sections/{segment(record.track_section)}/adhesion"}
    if record.wheelset is None:
        return links | {"members": f"/v1/alerts?fleet_alert={record.alert_id}"}
    wheelset = f"/v1/wheelsets/{segment(record.wheelset)}"
    links |= {"wheelset": wheelset, "geometry": f"{wheelset}/geometry", "trend": f"{wheelset}/trend"}
    if record.fleet_alert_id is not None:
        links["fleet_alert"] = f"/v1/alerts/{record.fleet_alert_id}"
    return links


def alert(record: AlertValue, now_ns: int) -> Alert:
    """Return the representation of an alert at this time."""
    return Alert(
        id=record.alert_id,
        fleet=record.fleet,
        wheelset=record.wheelset,
        scope=record.scope,
        track_section=record.track_section,
        fleet_alert_id=record.fleet_alert_id,
        kind=record.kind,
        severity=record.severity,
        condition=record.condition,
        display_state=display_state(record, now_ns),
        opened_at=to_rfc3339(record.opened_ns),
        last_seen_at=to_rfc3339(record.last_seen_ns),
        cleared_at=_time(record.cleared_ns),
        closed_at=_time(record.closed_ns),
        close_reason=None if record.close_reason is None else record.close_reason.sentence,
        close_reason_code=record.close_reason,
        occurrence_count=record.occurrence_count,
        probability_1=finite(record.probability),
        raise_limit=finite(record.raise_limit),
        clear_limit=finite(record.clear_limit),
        limit_unit=None if record.scope is AlertScope.FLEET else LIMIT_UNITS.get(record.kind),
        evidence=evidence_of(record),
        action=record.action,
        acknowledged_by=record.acknowledged_by,
        acknowledged_at=_time(record.acknowledged_ns),
        shelved_until=_time(record.shelved_until_ns),
        shelved_reason=record.shelved_reason,
        external_refs=list(record.external_refs),
        rules_version=record.rules_version,
        version=record.version,
        links=_links(record),
    )


def event(record: AlertEvent) -> Event:
    """Return the representation of an event; the alert's display state is the one at the event."""
    return Event(
        event=record.kind,
        recorded_at=to_rfc3339(record.recorded_ns),
        actor=record.actor,
        note=record.note,
        alert=alert(record.alert, record.recorded_ns),
    )


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
