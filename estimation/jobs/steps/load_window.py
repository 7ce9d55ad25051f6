"""A window as one of a vehicle that runs forward: blows bridged, with gravity and the yaw of its bogie's frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.errors import DamagedError, NotFoundError, PurgedError
from estimation.jobs.steps.vehicle_lookup import VehicleLookup
from estimation.motion.axle_distance import (
    bogie_runs_backwards,
    check_axle_distance,
    check_frame_sensors,
    runs_backwards,
    turned_over,
    with_frame_yaw,
)
from estimation.motion.without_blows import without_blows
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window, WindowKey, WindowRecord
from estimation.vehicle.vehicle_class import VehicleClass

KEPT = 4  # windows, of a megabyte each: both of a bogie need both


def load_window(unit: UnitOfWork, record: WindowRecord, vehicle_class: VehicleClass) -> Window | Reason:
    """Return a stored window as :meth:`WindowLoader.load` does.

    Raises:
        PurgedError, DamagedError: As :meth:`WindowLoader.load`.
    """
    return WindowLoader(unit, VehicleLookup(unit)).load(record, vehicle_class)


@dataclass(frozen=True, slots=True)
class WindowLoader:
    """Loads windows, as one transaction sees them; those that were loaded last are kept for the other of their bogie.

    Attributes:
        unit: Windows are read.
        vehicles: Of the same transaction.
        known: Records that the transaction has read; others are looked up.
    """

    unit: UnitOfWork
    vehicles: VehicleLookup
    known: Mapping[WindowKey, WindowRecord] = field(default_factory=dict)
    _kept: dict[WindowKey, Window] = field(default_factory=dict)

    def load(self, record: WindowRecord, vehicle_class: VehicleClass) -> Window | Reason:
        """Return a stored window as its vehicle's class reads it, or why it is not to be used.

        The registry may have another wheelset there by now, while the window is still to be made again, or cannot be;
        the bogie's frame may be unknown or another.

        Raises:
            PurgedError: The samples of the window have been purged.
            DamagedError: The samples of the window, or of the one on the other axle, are damaged; names the file.
        """
        window = self._samples(record.key)
        elsewhere = self._elsewhere(window)
        if elsewhere is not None:
            return elsewhere
        if window.measures_gravity != vehicle_class.sensors.measures_gravity:
            window = replace(window, measures_gravity=vehicle_class.sensors.measures_gravity)
        partner_axle = vehicle_class.partner(record.axle)
        if partner_axle is None:
            return self._as_it_travels(window, record)
        partner = self._partner(record, partner_axle)
        if isinstance(partner, Reason):
            return partner
        if partner.sample_interval_s != window.sample_interval_s or len(partner.valid) != len(window.valid):
            return _unknown(partner_axle, "is sampled otherwise")
        return self._in_bogie(window, replace(partner, measures_gravity=window.measures_gravity), record)

    def _in_bogie(self, window: Window, partner: Window, record: WindowRecord) -> Window | Reason:
        """Return the window of one axle of a bogie with the yaw of their frame, or what contradicts the registry."""
        offsets = self.vehicles.vehicle(record.vehicle).axle_offsets_m
        behind = offsets[record.axle - 1]
        ahead = offsets[partner.axle - 1] - behind
        backwards = bogie_runs_backwards(window, partner, ahead)
        contradiction = check_axle_distance(window, partner, -ahead if backwards else ahead)
        refusal = contradiction or check_frame_sensors(window, partner)
        if refusal is not None:
            return refusal
        framed = with_frame_yaw(window, partner, ahead)
        return turned_over(framed, behind) if backwards else framed

    def _as_it_travels(self, window: Window, record: WindowRecord) -> Window:
        """Return the window of a single wheelset as one of a vehicle that runs forward.

        A node that alone says that the vehicle runs backwards is the wrong way round itself.
        """
        if not runs_backwards(window):
            return window
        vehicle = self.vehicles.vehicle(record.vehicle)
        others = [runs_backwards(other) for other in self._others(window, vehicle.axles)]
        if others.count(False) > others.count(True):
            return window
        return turned_over(window, vehicle.axle_offsets_m[record.axle - 1])

    def _others(self, window: Window, axles: int) -> Iterator[Window]:
        """Yield what the other nodes of the vehicle measured at the time of a window."""
        for axle in range(1, axles + 1):
            mounting = self.vehicles.mounting_at(window.vehicle, axle, window.start_ns)
            if axle == window.axle or mounting is None:
                continue
            try:
                other = self._samples((mounting.wheelset, window.start_ns))
            except (NotFoundError, PurgedError, DamagedError):
                continue
            if other.vehicle == window.vehicle:
                yield replace(other, measures_gravity=window.measures_gravity)

    def _samples(self, key: WindowKey) -> Window:
        """Return a window as it is stored, but for blows."""
        if key not in self._kept:
            record = self.known.get(key)
            window = self.unit.windows.load(*key) if record is None else self.unit.windows.samples(record)
            window = without_blows(window)
            if len(self._kept) >= KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = window
        return self._kept[key]

    def _elsewhere(self, window: Window) -> Reason | None:
        """Return that the wheelset of a window was not at its axle, from its first valid sample to its last."""
        valid = np.flatnonzero(window.valid)
        first, last = (int(valid[0]), int(valid[-1])) if len(valid) else (0, len(window.valid) - 1)
        for place in (first, last):
            at_ns = window.start_ns + place * window.length_ns // len(window.valid)
            mounting = self.vehicles.mounting_at(window.vehicle, window.axle, at_ns)
            if mounting is None or mounting.wheelset != window.wheelset:
                there = "no wheelset" if mounting is None else f"wheelset {mounting.wheelset}"
                text = f"the registry has {there} at axle {window.axle} of vehicle {window.vehicle} then"
                return Reason(ReasonCode.MOUNTING_DIFFERS, text)
        return None

    def _partner(self, record: WindowRecord, axle: int) -> Window | Reason:
        mounting = self.vehicles.mounting_at(record.vehicle, axle, record.start_ns)
        if mounting is None:
            return _unknown(axle, "has no wheelset on file")
        try:
            partner = self._samples((mounting.wheelset, record.start_ns))
        except NotFoundError:
            return _unknown(axle, "has no window of this time")
        except PurgedError:
            return _unknown(axle, "has no samples of this time any more")
        if (partner.vehicle, partner.axle) != (record.vehicle, axle):
            return _unknown(axle, f"has no window of this time of wheelset {mounting.wheelset}")
        return partner


def _unknown(axle: int, why: str) -> Reason:
    return Reason(ReasonCode.FRAME_UNKNOWN, f"the other axle of the bogie, axle {axle}, {why}")
