"""What people and maintenance systems do to alerts: acknowledge, shelve, unshelve, link to work of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus

from fastapi import APIRouter, Depends, Response

from api.access.scopes import Scope, requires
from api.answers import require_match
from api.asking import AskedChange, ChangeDep
from api.idempotency import idempotent_post
from api.parameters import Number
from api.problems import described
from api.schemas import alerts
from api.schemas.common import Request as Body
from api.services import writer_slot
from estimation.alerts.life_cycle import acknowledge, link, shelve, unshelve
from estimation.values.alerts import Alert, Transition

router = APIRouter(
    prefix="/v1/alerts", tags=["alerts"], dependencies=[Depends(requires(Scope.ACT)), Depends(writer_slot)]
)
MAINTENANCE_SYSTEM = "maintenance system"
"""Who links to work of its own where access is open and nobody is named."""
_REFUSALS = described(404, 409, 412, 413, 415, 428)


@dataclass(frozen=True, slots=True)
class Change:
    """What is to be done to an alert: by whom, why, and the transition."""

    actor: str
    note: str
    apply: Callable[[Alert], Transition | None]


def _change(asked: AskedChange, alert_id: int, body: Body, change: Change) -> Response:
    """Apply a change under If-Match and Idempotency-Key, in one transaction."""
    post = idempotent_post(asked.request, asked.key, body)
    now_ns = asked.services.clock.now_ns()
    with asked.services.storage.write() as unit:
        earlier = post.earlier(asked.request, unit)
        if earlier is not None:
            return earlier
        current = unit.alerts.get(alert_id)
        require_match(asked.if_match, alerts.alert(current, now_ns))
        transition = change.apply(current)
        if transition is not None:
            current = unit.alerts.save(transition.alert, transition.events, now_ns, change.actor, change.note)
        changed = alerts.alert(current, now_ns)
        post.remember(unit, HTTPStatus.OK, changed, now_ns)
    return asked.answer(changed)


@router.post("/{alert_id}/acknowledge", response_model=alerts.Alert, responses=_REFUSALS)
def acknowledge_alert(asked: ChangeDep, alert_id: Number, body: alerts.Acknowledgement) -> Response:
    """Acknowledge the alert; the acknowledgement ends when the alert clears or becomes more severe."""
    now_ns = asked.services.clock.now_ns()
    actor = asked.caller.acts_as(body.by)
    change = Change(actor, body.note, lambda alert: acknowledge(alert, actor, now_ns))
    return _change(asked, alert_id, body, change)


@router.post("/{alert_id}/shelve", response_model=alerts.Alert, responses=_REFUSALS)
def shelve_alert(asked: ChangeDep, alert_id: Number, body: alerts.Shelving) -> Response:
    """Put the alert out of sight until a time; it comes back by itself."""
    now_ns = asked.services.clock.now_ns()
    change = Change(
        asked.caller.acts_as(body.by), body.reason, lambda alert: shelve(alert, body.until, body.reason, now_ns)
    )
    return _change(asked, alert_id, body, change)


@router.post("/{alert_id}/unshelve", response_model=alerts.Alert, responses=_REFUSALS)
def unshelve_alert(asked: ChangeDep, alert_id: Number, body: alerts.Unshelving) -> Response:
    """Bring a shelved alert back before its time; one that is not shelved is refused (409)."""
    now_ns = asked.services.clock.now_ns()
    change = Change(asked.caller.acts_as(body.by), body.note, lambda alert: unshelve(alert, now_ns))
    return _change(asked, alert_id, body, change)


@router.post("/{alert_id}/external-refs", response_model=alerts.Alert, responses=_REFUSALS)
def add_external_ref(asked: ChangeDep, alert_id: Number, body: alerts.ExternalReference) -> Response:
    """Write back the identity that a maintenance system gave to its work on the alert."""
    change = Change(asked.caller.acts_as(body.by, MAINTENANCE_SYSTEM), body.ref, lambda alert: link(alert, body.ref))
    return _change(asked, alert_id, body, change)
