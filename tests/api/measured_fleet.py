"""Wheelsets of the API's fleet whose profiles were measured: one near its estimate, one far from it, one without."""

from __future__ import annotations

from dataclasses import replace

import api_fleet as fleet
import numpy as np

from bench.put_values import put_geometry
from estimation.contact.profiles import MeasuredProfiles, wheel_profile
from estimation.contact.wear import TreadWear, worn
from estimation.storage import Storage
from estimation.values.geometry import BinStatus, BinValues, GeometryRecord
from estimation.values.quantities import Estimate, Status
from estimation.values.registry import Mounting
from estimation.values.windows import WindowState

SERIAL, OTHER, BARE = fleet.WHEELSETS[20], fleet.WHEELSETS[21], fleet.WHEELSETS[22]
LATER = fleet.START + 2 * fleet.DAY
NEW = wheel_profile("P8")
WORN = worn(NEW, TreadWear(1.0e-3, 3e-3, 44e-3, 1.0e-3))


def measure(storage: Storage) -> None:
    """Store the measurements, and two estimates."""
    with storage.write() as unit:
        unit.registry.add_mounting(Mounting(SERIAL, "V-0", 1, 0, fleet.START, 0.0, 0.0))
        for serial, conicity in ((SERIAL, 0.26), (OTHER, 0.60)):
            unit.windows.put(replace(fleet.window(0), wheelset=serial), 9300.0, fleet.RECORDED)
            unit.windows.mark(serial, fleet.window(0).start_ns, WindowState.ESTIMATED)
            put_geometry(unit, replace(estimated(serial, conicity), from_ns=fleet.window(0).start_ns))
        for serial in (SERIAL, OTHER, BARE):
            unit.registry.add_measured_profiles(MeasuredProfiles(serial, LATER, 9500.0, WORN, NEW, 0.125e-3))


def estimated(serial: str, conicity: float, interval: int = 9) -> GeometryRecord:
    """Return the geometry of an interval with a conicity at 3 mm and a straight rL - rR."""
    edges = np.arange(-4.0, 4.5, 0.5) * 1e-3
    centres = 0.5 * (edges[1:] + edges[:-1])
    b = len(centres)
    known = BinValues(2.0 * conicity * centres, np.full(b, 5e-5), (BinStatus.ESTIMATED,) * b)
    nothing = BinValues(np.full(b, np.nan), np.full(b, np.nan), (BinStatus.UNOBSERVABLE,) * b)
    one = Estimate(conicity, 0.02, conicity - 0.04, conicity + 0.04, 6.0, Status.ESTIMATED)
    geometry = replace(
        fleet.geometry(),
        bin_edges=edges,
        samples=np.full(b, 1000.0),
        rolling_radius_sum=nothing,
        rolling_radius_difference=known,
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        amplitude=np.array([1.0, 2.0, 3.0]) * 1e-3,
        conicity=(one, one, one),
        reported_amplitude=3e-3,
        equivalent_conicity=one,
    )
    record = fleet.geometry_record(fleet.RECORDED, conicity)
    return replace(
        record, wheelset=serial, baseline=0, interval=interval, mileage_km=1e3 * interval + 400.0, geometry=geometry
    )
