"""The fleet that the page is tested with: that of the API's tests, and names that are no names."""

from __future__ import annotations

from dataclasses import replace

import api_fleet
import measured_fleet

from estimation.storage import Storage
from estimation.values.registry import WheelsetRecord

MARKUP = "<img src=x onerror=document.title='hacked'>"
UNSEEN = "WS\u202e-7\u0007"
FORMULA = "=1+1"
KNOWN = "WS-002"
"""Has a conicity at 3 mm and a trend."""
EXTRA = [f"M-{number:04d}" for number in range(250)]


def populate(storage: Storage) -> None:
    """Store everything."""
    api_fleet.populate(storage)
    measured_fleet.measure(storage)
    with storage.write() as unit:
        for serial in (MARKUP, UNSEEN, FORMULA, *EXTRA):
            unit.registry.add_wheelset(WheelsetRecord(serial, "alpha", "P8", 0.4375, None, ()))
        geometry = api_fleet.geometry_record(api_fleet.RECORDED, 0.25)
        at_3_mm = replace(
            geometry.geometry,
            conicity=(api_fleet.estimate(0.2),) * 2 + (api_fleet.estimate(0.25),),
            reported_amplitude=3e-3,
        )
        unit.geometries.put(replace(geometry, wheelset=KNOWN, baseline=0, geometry=at_3_mm))
        unit.trends.put(replace(api_fleet.trend_record(api_fleet.RECORDED, 0.25), wheelset=KNOWN, baseline=0))
