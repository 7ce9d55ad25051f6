"""Records of the registry voided and restored, and what was decided on them."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from functools import partial
from http import HTTPStatus
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, Field

from api.access.gate import Scope, requires
from api.answers import require_match
from api.asking import CODE, TEXT, UNNAMED, AskedChange, AskedListDep, ChangeDep, Key
from api.problems import ProblemError, described, invalid
from api.routes import tracks, vehicles
from api.routes.dated_records import SensorChangeRecord
from api.schemas import common
from api.schemas.common import Body, Derived, Page, Representation
from api.services import writer_slot
from api.times import Moment, Timestamp, to_rfc3339
from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import TreadwatchError
from estimation.values.registry import Mounting, Reprofiling, SensorChange, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.vehicle.vehicle_class import ClassOnFile, class_of_document
from fleet_db.packed_values import unpack_wheel_pair
from fleet_db.records import Decision, RecordAction, RecordKind, RegistryEvent
from fleet_db.rows import present, value_of_row
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey
from ingest.registry_entry.enter import refuse_contradicted

RecordKindName = Literal[
    "mounting", "reprofiling", "measurement", "wheelset", "section", "vehicle", "vehicle_class", "sensor_change"
]


class RecordDecision(Body):
    """Which record is voided or restored, and why."""

    kind: RecordKindName = Field(description="What kind of record.", examples=["reprofiling"])
    key: Key = Field(description="Serial of the wheelset; code of the vehicle, class or section.", examples=["WS-0001"])
    at: Moment | None = Field(
        default=None,
        description="Time of a mounting (`mounted_from`), reprofiling, measurement or sensor change.",
        examples=["2026-03-01T06:00:00Z"],
    )
    reason: str = Field(
        min_length=1, max_length=2000, pattern=TEXT, description="Kept for ever.", examples=["of another wheelset"]
    )
    by: Key | None = Field(
        default=None,
        description="Who; 'unnamed client' if left out where access control is off; else at most the key's owner.",
        examples=["j.smith"],
    )


class WheelsetValues(Derived, of=WheelsetRecord, without=("mounting", "reprofilings")):
    """What a wheelset is, without its life."""


Record = (
    common.MountingPeriod
    | common.ReprofilingRecord
    | common.MeasuredProfilesRecord
    | WheelsetValues
    | common.Vehicle
    | vehicles.VehicleClassRepresentation
    | tracks.TrackSection
    | SensorChangeRecord
)


class RegistryDecision(Representation):
    """One decision on a record: entered, changed, voided or restored."""

    id: int = Field(description="In the order of the decisions.", examples=[17])
    kind: RecordKind
    key: str = Field(description="Serial or code.", examples=["WS-0001"])
    at: Timestamp | None = Field(description="Time of a dated record.")
    action: RecordAction = Field(description="What was decided.")
    by: str = Field(description="Who; empty where a registry file was loaded with recordings.", examples=["j.smith"])
    reason: str = Field(examples=["of another wheelset"])
    recorded_at: Timestamp | None = Field(description="Our time; null where it is not known.")
    before: Record | None = Field(
        description="The record before; null where it is new, was restored, or can no longer be read."
    )
    after: Record | None = Field(description="The record since; null where it was voided, or is not known.")


def _shown_decision(event: RegistryEvent) -> RegistryDecision:
    restored = event.action is RecordAction.RESTORED
    return RegistryDecision(
        id=event.id,
        kind=event.kind,
        key=event.subject,
        at=None if event.at_ns is None else to_rfc3339(event.at_ns),
        action=event.action,
        by=event.actor,
        reason=event.reason,
        recorded_at=None if event.recorded_ns is None else to_rfc3339(event.recorded_ns),
        before=None if restored else _record(event.kind, event.record),
        after=_record(event.kind, event.record if restored else event.after),
    )


def _record(kind: RecordKind, values: Mapping[str, Any] | None) -> Record | None:
    """Return a record as the history keeps it; None where that cannot be read any more."""
    if not values:
        return None
    try:
        return _represented(kind, dict(values))
    except (TreadwatchError, KeyError, TypeError, ValueError):
        return None


def _represented(kind: RecordKind, values: dict[str, Any]) -> Record:  # noqa: PLR0911 - one line a kind
    match kind:
        case RecordKind.MOUNTING:
            return common.MountingPeriod.made(value_of_row(Mounting, values))
        case RecordKind.REPROFILING:
            return common.ReprofilingRecord.made(value_of_row(Reprofiling, values))
        case RecordKind.MEASUREMENT:
            left, right = unpack_wheel_pair(base64.b64decode(values["packed"]), where="history of the registry")
            measured = value_of_row(MeasuredProfiles, values, left=left, right=right, std=values["std_m"])
            return common.measured_profiles(measured)
        case RecordKind.WHEELSET:
            return WheelsetValues.made(value_of_row(WheelsetRecord, values))
        case RecordKind.VEHICLE:
            return common.Vehicle.made(value_of_row(VehicleRecord, values))
        case RecordKind.VEHICLE_CLASS:
            return vehicles.vehicle_class(ClassOnFile(class_of_document(values)))
        case RecordKind.SECTION:
            return tracks.section(value_of_row(TrackSectionRecord, values))
        case RecordKind.SENSOR_CHANGE:
            return SensorChangeRecord.made(value_of_row(SensorChange, values))


router = APIRouter(prefix="/v1/registry", tags=["registry"])
_ADMIN = [Depends(requires(Scope.ADMIN)), Depends(writer_slot)]
_post = partial(router.post, status_code=201, dependencies=_ADMIN, responses=described(404, 409, 412, 413, 415, 428))
_OF_VEHICLE = frozenset({RecordKind.VEHICLE, RecordKind.SENSOR_CHANGE})
_SHARED = frozenset({RecordKind.SECTION, RecordKind.VEHICLE_CLASS})
KindFilter = Annotated[RecordKind | None, Query(description="Only records of this kind.")]
KeyFilter = Annotated[str | None, Query(pattern=CODE, description="Only of this serial or code.")]


@router.get("/history", response_model=Page[RegistryDecision], responses=described(400))
def list_registry_history(asked: AskedListDep, kind: KindFilter = None, of: KeyFilter = None) -> Response:
    """List what was decided on records of the registry, oldest first: who, when, why, before and after."""
    filters = {"kind": kind, "of": of}
    after = asked.after_number(filters)
    with asked.read() as unit:
        rows = unit.registry_history.list(of, after, asked.limit + 1, kind)
    return asked.page(filters, rows, lambda event: event.id, _shown_decision)


@_post("/void", response_model=RegistryDecision)
def void_record(asked: ChangeDep, body: RecordDecision) -> Response:
    """Take a record out that was wrong; what rests on it is made again, and `as_of` keeps what was believed.

    `If-Match` carries the ETag of the wheelset, vehicle, class or section that the record is of; `*` for a
    voided class or section.
    """
    return _decide(asked, body, RecordAction.VOIDED)


@_post("/restore", response_model=RegistryDecision)
def restore_record(asked: ChangeDep, body: RecordDecision) -> Response:
    """Put a record back that was voided, as it was.

    `If-Match` carries the ETag of the wheelset, vehicle, class or section that the record is of; `*` for a
    voided class or section.
    """
    return _decide(asked, body, RecordAction.RESTORED)


def _decide(asked: AskedChange, body: RecordDecision, action: RecordAction) -> Response:
    kind = RecordKind(body.kind)
    if kind.dated != (body.at is not None):
        detail = f"is required for a {kind}" if kind.dated else f"is not allowed for a {kind}"
        raise invalid("#/at", detail, f"at: {detail}")
    key = RecordKey(kind, body.key, body.at)
    if key.kind in _SHARED and asked.caller.fleets is not None:
        raise ProblemError(403, "forbidden", "this needs a key of all fleets")
    # 404 before anything is decided
    with asked.read() as unit:
        _matched_resource(unit, key)
    actor = asked.caller.acts_as(body.by, UNNAMED)

    def decide(unit: SqlUnitOfWork, now_ns: int) -> RegistryDecision:
        decision = Decision(actor, body.reason, now_ns)
        require_match(asked.if_match, _matched_resource(unit, key))
        if action is RecordAction.VOIDED:
            unit.corrections.void(key, decision)
        else:
            unit.corrections.restore(key, decision)
            refuse_contradicted(unit, key, now_ns)
        event = unit.registry_history.latest(key, action)
        assert event is not None
        return _shown_decision(event)

    return asked.once(body, decide, HTTPStatus.CREATED)


def _matched_resource(unit: SqlUnitOfWork, key: RecordKey) -> BaseModel:
    if key.kind in _OF_VEHICLE:
        return common.Vehicle.made(unit.registry.vehicle(key.subject))
    if key.kind not in _SHARED:
        return common.wheelset(unit.registry.wheelset(key.subject))
    if key.kind is RecordKind.SECTION and any(section.code == key.subject for section in unit.tracks.sections()):
        return tracks.section(unit.tracks.section(key.subject))
    on_file = unit.registry.vehicle_class(key.subject) if key.kind is RecordKind.VEHICLE_CLASS else None
    if on_file is not None:
        return vehicles.vehicle_class(on_file)
    voided = present(unit.registry_history.latest(key, RecordAction.VOIDED), key.kind.value, key.subject)
    return _shown_decision(voided)  # there is no other representation of it: send If-Match: *
