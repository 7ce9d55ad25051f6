"""A window with what its vehicle's class adds to it: whether gravity is in it, and the yaw of its bogie frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.errors import NotFoundError, PurgedError
from estimation.motion.axle_distance import check_axle_distance
from estimation.motion.bogie_frame import with_frame_yaw
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window, WindowRecord
from estimation.vehicle.vehicle_class import VehicleClass


def load_window(unit: UnitOfWork, record: WindowRecord, vehicle_class: VehicleClass) -> Window | Reason:
    """Return a stored window as its vehicle's class reads it, or why it is not to be used.

    The registry may have another wheelset there by now, while the window is still to be made again, or cannot be; the
    bogie's frame may be unknown or another.

    Parameters
    ----------
    unit
        Windows, vehicles and mountings are read.
    record
        Of the window.
    vehicle_class
        Of its vehicle.

    Raises
    ------
    PurgedError
        The samples of the window have been purged.
    DamagedError
        The samples of the window, or of the one on the other axle, are damaged; names the file.
    """
    window = unit.windows.load(record.wheelset, record.start_ns)
    elsewhere = _elsewhere(unit, window)
    if elsewhere is not None:
        return elsewhere
    window = replace(window, measures_gravity=vehicle_class.sensors.measures_gravity)
    partner_axle = vehicle_class.partner(record.axle)
    if partner_axle is None:
        return window
    offsets = unit.registry.vehicle(record.vehicle).axle_offsets_m
    partner = _partner(unit, record, partner_axle)
    if isinstance(partner, Reason):
        return partner
    if partner.sample_interval_s != window.sample_interval_s or len(partner.valid) != len(window.valid):
        return _unknown(partner_axle, "is sampled otherwise")
    ahead = offsets[partner_axle - 1] - offsets[record.axle - 1]
    contradiction = check_axle_distance(window, partner, ahead)
    return with_frame_yaw(window, partner, ahead) if contradiction is None else contradiction


def partner_digest(unit: UnitOfWork, record: WindowRecord, vehicle_class: VehicleClass) -> str | None:
    """Return the digest of the window on the other axle of the bogie; None where there is no such window.

    Parameters
    ----------
    unit
        Windows and mountings are read.
    record
        Of the window.
    vehicle_class
        Of its vehicle.
    """
    axle = vehicle_class.partner(record.axle)
    mounting = None if axle is None else unit.registry.mounting_at(record.vehicle, axle, record.start_ns)
    partner = None if mounting is None else unit.windows.get(mounting.wheelset, record.start_ns)
    return None if partner is None else partner.content_digest


def _elsewhere(unit: UnitOfWork, window: Window) -> Reason | None:
    """Return that the wheelset of a window was not at its axle, from its first valid sample to its last."""
    valid = np.flatnonzero(window.valid)
    first, last = (int(valid[0]), int(valid[-1])) if len(valid) else (0, len(window.valid) - 1)
    for place in (first, last):
        at_ns = window.start_ns + place * window.length_ns // len(window.valid)
        mounting = unit.registry.mounting_at(window.vehicle, window.axle, at_ns)
        if mounting is None or mounting.wheelset != window.wheelset:
            there = "no wheelset" if mounting is None else f"wheelset {mounting.wheelset}"
            text = f"the registry has {there} at axle {window.axle} of vehicle {window.vehicle} then"
            return Reason(ReasonCode.MOUNTING_DIFFERS, text)
    return None


def _partner(unit: UnitOfWork, record: WindowRecord, axle: int) -> Window | Reason:
    mounting = unit.registry.mounting_at(record.vehicle, axle, record.start_ns)
    if mounting is None:
        return _unknown(axle, "has no wheelset on file")
    try:
        partner = unit.windows.load(mounting.wheelset, record.start_ns)
    except NotFoundError:
        return _unknown(axle, "has no window of this time")
    except PurgedError:
        return _unknown(axle, "has no samples of this time any more")
    if (partner.vehicle, partner.axle) != (record.vehicle, axle):
        return _unknown(axle, f"has no window of this time of wheelset {mounting.wheelset}")
    return partner


def _unknown(axle: int, why: str) -> Reason:
    return Reason(ReasonCode.FRAME_UNKNOWN, f"the other axle of the bogie, axle {axle}, {why}")
