"""The fleet that the page is tested with: that of the API's tests, and names that are no names."""

from __future__ import annotations

import api_fleet

from estimation.storage import Storage
from estimation.values.registry import WheelsetRecord

MARKUP = "<img src=x onerror=document.title='hacked'>"
UNSEEN = "WS\u202e-7\u0007"
FORMULA = "=1+1"
EXTRA = [f"M-{number:04d}" for number in range(250)]


def populate(storage: Storage) -> None:
    """Store everything."""
    api_fleet.populate(storage)
    with storage.write() as unit:
        for serial in (MARKUP, UNSEEN, FORMULA, *EXTRA):
            unit.registry.add_wheelset(WheelsetRecord(serial, "alpha", "P8", 0.4375, None, ()))
