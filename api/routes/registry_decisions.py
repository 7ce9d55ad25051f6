"""Records of the registry voided and restored, and what was decided on them."""

from __future__ import annotations

from functools import partial
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel

from api.access.scopes import Scope, requires
from api.answers import answer, require_match
from api.asking import AskedChange, AskedListDep, ChangeDep
from api.idempotency import idempotent_post
from api.parameters import CODE
from api.problems import ProblemError, ProblemItem, described
from api.registry_changes import UNNAMED
from api.schemas import registry, registry_changes, tracks, vehicle_classes
from api.schemas.common import Page
from api.schemas.registry_changes import RecordDecision as Body
from api.services import writer_slot
from estimation.errors import NotFoundError
from fleet_db.registry_events import Decision, RecordAction, RecordKind
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey
from ingest.registry_entry.enter import refuse_contradicted

router = APIRouter(prefix="/v1/registry", tags=["registry"])
_ADMIN = [Depends(requires(Scope.ADMIN)), Depends(writer_slot)]
_post = partial(router.post, status_code=201, dependencies=_ADMIN, responses=described(404, 409, 412, 413, 415, 428))
_OF_VEHICLE = frozenset({RecordKind.VEHICLE, RecordKind.SENSOR_CHANGE})
_SHARED = frozenset({RecordKind.SECTION, RecordKind.VEHICLE_CLASS})
KindFilter = Annotated[RecordKind | None, Query(description="Only records of this kind.")]
KeyFilter = Annotated[str | None, Query(pattern=CODE, description="Only of this serial or code.")]


@router.get("/history", response_model=Page[registry_changes.RegistryDecision], responses=described(400))
def list_registry_history(asked: AskedListDep, kind: KindFilter = None, of: KeyFilter = None) -> Response:
    """List what was decided on records of the registry, oldest first: who, when, why, before and after."""
    filters = {"kind": kind, "of": of}
    after = asked.after_number(filters)
    with asked.read() as unit:
        rows = unit.registry_history.list(of, after, asked.limit + 1, kind)
    return asked.page(filters, rows, lambda event: event.id, registry_changes.decision)


@_post("/void", response_model=registry_changes.RegistryDecision)
def void_record(asked: ChangeDep, body: Body) -> Response:
    """Take a record out that was wrong; what rests on it is made again, and `as_of` keeps what was believed.

    `If-Match` carries the ETag of the wheelset, vehicle, class or section that the record is of.
    """
    return _decide(asked, body, RecordAction.VOIDED)


@_post("/restore", response_model=registry_changes.RegistryDecision)
def restore_record(asked: ChangeDep, body: Body) -> Response:
    """Put a record back that was voided, as it was.

    `If-Match` carries the ETag of the wheelset, vehicle, class or section that the record is of.
    """
    return _decide(asked, body, RecordAction.RESTORED)


def _decide(asked: AskedChange, body: Body, action: RecordAction) -> Response:
    """Void or restore a record under If-Match and Idempotency-Key, in one transaction."""
    key = _key(body)
    if key.kind in _SHARED and asked.caller.fleets is not None:
        raise ProblemError(403, "forbidden", "this needs a key of all fleets")
    with asked.read() as unit:
        _asset(unit, key)
    post = idempotent_post(asked.request, asked.key, body)
    now_ns = asked.services.clock.now_ns()
    decision = Decision(asked.caller.acts_as(body.by, UNNAMED), body.reason, now_ns)
    with asked.services.storage.write() as unit:
        earlier = post.earlier(asked.request, unit)
        if earlier is not None:
            return earlier
        require_match(asked.if_match, _asset(unit, key))
        if action is RecordAction.VOIDED:
            unit.corrections.void(key, decision)
        else:
            unit.corrections.restore(key, decision)
            refuse_contradicted(unit, key, now_ns)
        event = unit.registry_history.latest(key, action)
        assert event is not None
        done = registry_changes.decision(event)
        post.remember(unit, HTTPStatus.CREATED, done, now_ns)
    return answer(asked.request, done, status=HTTPStatus.CREATED)


def _key(body: Body) -> RecordKey:
    kind = RecordKind(body.kind)
    if kind.dated != (body.at is not None):
        detail = f"is needed: a {kind} is one of a time" if kind.dated else f"is no part of a {kind}"
        item = ProblemItem(part="body", pointer="#/at", detail=detail)
        raise ProblemError(422, "invalid-request", f"at: {detail}", [item])
    return RecordKey(kind, body.key, body.at)


def _asset(unit: SqlUnitOfWork, key: RecordKey) -> BaseModel:
    """Return the representation of what a record is of."""
    if key.kind in _OF_VEHICLE:
        return registry.vehicle(unit.registry.vehicle(key.subject))
    if key.kind not in _SHARED:
        return registry.wheelset(unit.registry.wheelset(key.subject))
    if key.kind is RecordKind.SECTION and any(one.code == key.subject for one in unit.tracks.sections()):
        return tracks.section(unit.tracks.section(key.subject))
    found = unit.registry.vehicle_class(key.subject) if key.kind is RecordKind.VEHICLE_CLASS else None
    if found is not None:
        return vehicle_classes.vehicle_class(found)
    voided = unit.registry_history.latest(key, RecordAction.VOIDED)
    if voided is None:
        raise NotFoundError(key.kind.value, key.subject)
    return registry_changes.decision(voided)  # there is no other representation of it: send If-Match: *
