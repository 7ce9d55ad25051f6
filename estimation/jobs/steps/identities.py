"""Changes of wheelsets on record: of their identity, and steps of their trend."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import lru_cache

import numpy as np

from estimation.accuracy.wheel_contact import RailShare
from estimation.alerts.rules.sensor_data import MOUNTED
from estimation.rails.cell import conicity_on_rails, designed_wheel
from estimation.storage import UnitOfWork
from estimation.values.alerts import Alert
from estimation.values.geometry import IntervalConicities
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.trend import (
    AFTER,
    IDENTITY,
    TREND,
    IdentityChange,
    StepSurroundings,
    TrendRecord,
    TrendStep,
    baseline_part,
    latest_identity_change,
)


def identity_change(unit: UnitOfWork, serial: str) -> IdentityChange | None:
    """Return the last identity change of a wheelset that is on record, from its alerts of this kind.

    One that was found in another place than the registry has for the wheelset now is none: what was recorded after it
    is another wheelset's by now.
    """
    return identity_changes(unit, [serial]).get(serial)


def identity_changes(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, IdentityChange]:
    """Return the last identity change of each of some wheelsets that has one on record, by serial."""
    alerts: dict[str, list[Alert]] = {}
    for alert in unit.alerts.of_kind(IDENTITY, serials):
        alerts.setdefault(str(alert.wheelset), []).append(alert)
    mountings = unit.registry.mountings_of(list(alerts)) if alerts else {}
    changes = {
        serial: latest_identity_change([one for one in own if _still_there(one, mountings.get(serial, ()))])
        for serial, own in alerts.items()
    }
    return {serial: change for serial, change in changes.items() if change is not None}


def suspected(unit: UnitOfWork) -> frozenset[str]:
    """Return the wheelsets with an identity alert, open or closed: all others have had no identity change."""
    return unit.alerts.wheelsets_of_kind(IDENTITY)


def _still_there(alert: Alert, mountings: Sequence[Mounting]) -> bool:
    """Whether a wheelset was mounted after a change where the alert says; its way round may have been corrected."""
    place, after_ns = alert.evidence.get(MOUNTED), alert.evidence.get(AFTER)
    if not isinstance(place, dict) or not isinstance(after_ns, int):
        return True
    at = [place.get(name) for name in ("vehicle", "axle", "from_ns")]
    same = [one for one in mountings if [one.vehicle, one.axle, one.from_ns] == at]
    return any(one.to_ns is None or one.to_ns > after_ns for one in same)


AMPLITUDES = (1e-3, 1.5e-3, 2e-3, 2.5e-3, 3e-3)  # m, at which a profile behind a step is compared with its design


def last_change(unit: UnitOfWork, wheelset: WheelsetRecord) -> IdentityChange | None:
    """Return the last change that data of a wheelset are not merged across: of its identity, or a step of its trend."""
    identity = identity_change(unit, wheelset.serial)
    changes = [identity, _step(unit, wheelset)]
    return max((one for one in changes if one is not None), key=lambda one: one.after_ns, default=None)


def _step(unit: UnitOfWork, wheelset: WheelsetRecord) -> IdentityChange | None:
    """Return the newest step of the present profile as a change; None where there is none."""
    trend = unit.results.latest_head(TREND, wheelset.serial)
    if trend is None or trend.part != baseline_part(len(wheelset.reprofilings)) or not isinstance(trend.head, list):
        return None
    before_ns, after_ns = trend.head
    assert isinstance(before_ns, int)
    assert isinstance(after_ns, int)
    return IdentityChange(before_ns, after_ns)


def step_of(record: TrendRecord | None, wheelset: WheelsetRecord) -> TrendStep | None:
    """Return the newest step of the present profile; None where there is none."""
    return None if record is None or record.baseline != len(wheelset.reprofilings) else record.trend.step


def surroundings(
    wheelset: WheelsetRecord,
    behind: Sequence[IntervalConicities],
    beside: Sequence[TrendStep | None],
    rails: Collection[RailShare],
) -> StepSurroundings:
    """Return what else is known about the time of a step: the design of the wheel, and the other wheelsets.

    Args:
        behind: Its intervals behind the step.
        beside: Steps of the other wheelsets of its vehicle that have a trend.
        rails: Of all sections.
    """
    newest = max(behind, key=lambda one: one.to_ns, default=None)
    return StepSurroundings(() if newest is None else newest.known, _designed(wheelset, rails), tuple(beside))


def rails_of(sections: Iterable[TrackSectionRecord]) -> frozenset[RailShare]:
    """Return the kinds of rails that there are."""
    return frozenset(RailShare(s.rail_profile, s.rail_inclination, s.nominal_gauge_m, 1.0) for s in sections)


def _designed(wheelset: WheelsetRecord, rails: Collection[RailShare]) -> Mapping[float, float] | None:
    if len(rails) != 1:
        return None  # on several kinds of rails no one conicity is that of the design
    found = _conicities(wheelset.wheel_profile, wheelset.nominal_radius_m, next(iter(rails)))
    return {at: value for at, value in zip(AMPLITUDES, found, strict=True) if np.isfinite(value)} or None


@lru_cache(64)
def _conicities(profile: str, radius: float, rails: RailShare) -> tuple[float, ...]:
    wheel = designed_wheel(profile, radius)
    if wheel is None:
        return (float("nan"),) * len(AMPLITUDES)
    return tuple(conicity_on_rails(wheel, rails, np.array(AMPLITUDES))[0].tolist())
