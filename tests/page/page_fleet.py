"""The fleet that the page is tested with: that of the API's tests, and names that are no names."""

from __future__ import annotations

from dataclasses import replace

import api_fleet
import measured_fleet
import populated_fleet

from bench.put_values import put_geometry, put_trend
from estimation.storage import Storage
from estimation.values.opinions import CellFriction, LeftOut, SectionAdhesion
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from estimation.values.windows import WindowState

MARKUP = "<img src=x onerror=document.title='hacked'>"
UNSEEN = "WS\u202e-7\u0007"
FORMULA = "=1+1"
KNOWN = "WS-002"
"""Has a conicity at 3 mm and a trend."""
REFUSED, REFUSED_NAME = "R-1", "<b>12 %</b> of the samples"
"""Has refused windows and one that waits, and no estimate."""
EXTRA = [f"M-{number:04d}" for number in range(250)]


def populate(storage: Storage) -> None:
    """Store everything."""
    populated_fleet.populate(storage)
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
        put_geometry(unit, replace(geometry, wheelset=KNOWN, baseline=0, geometry=at_3_mm))
        put_trend(unit, replace(api_fleet.trend_record(api_fleet.RECORDED, 0.25), wheelset=KNOWN, baseline=0))
        unit.registry.add_wheelset(WheelsetRecord(REFUSED, "alpha", "P8", 0.4375, None, ()))
        for index in range(5):
            unit.windows.put(api_fleet.window(index, REFUSED), 100.0, api_fleet.RECORDED)
            why = ReasonCode.CLIPPED if index < 3 else ReasonCode.POSITION_UNCERTAIN
            if index < 4:
                key = (REFUSED, api_fleet.window(index).start_ns)
                unit.windows.mark(*key, WindowState.REFUSED, Reason(why, f"a sentence on {REFUSED_NAME}"))
        unit.adhesion.put_section(adhesion(), "test", "d" * 64)


def adhesion() -> SectionAdhesion:
    """Return low friction at one place of S-1, and a lower bound at the next; a vehicle contradicts the others."""
    bound = Estimate.unknown(Reason(ReasonCode.CREEP_TOO_SMALL, "at least 0.23"), 8.0)
    low, more = CellFriction(3, api_fleet.estimate(0.0625), 0.05, 0.99, 8), CellFriction(4, bound, 0.23, 0.01, 8)
    left_out = LeftOut("C-9", None, Reason(ReasonCode.FRICTION_DIFFERS, "vehicle C-9 shows 0.44 times the 1/friction"))
    to_ns = api_fleet.START + api_fleet.DAY
    return SectionAdhesion("S-1", api_fleet.START, to_ns, 24, (low, more), ((150.0, 200.0),), (left_out,))
