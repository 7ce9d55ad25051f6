"""The last lines of the demo: what a planner has to do, the most urgent first, as the worklist of the API says it."""

from __future__ import annotations

import urllib.parse
from typing import Any

from api.demo.table import ServiceAddress, get
from estimation.values.alerts import Urgency

NOTHING_TO_DO = (Urgency.NOT_DUE, Urgency.NOT_MOUNTED)


def to_do(service: ServiceAddress, fleet: str) -> list[str]:
    """Ask the REST API for the worklist of a fleet; return a sentence for each wheelset that needs somebody."""
    query = urllib.parse.urlencode({"fleet": fleet, "sort": "urgency", "limit": 1000})
    rows = get(service, f"/v1/wheelsets?{query}")["items"]
    return [_sentence(row) for row in rows if row["state"]["urgency"] not in NOTHING_TO_DO]


def _sentence(row: dict[str, Any]) -> str:
    reasons = "; ".join(reason["text"] for reason in row["state"]["reasons"])
    return f"{row['serial']} (vehicle {row['vehicle']}, axle {row['axle']}): {reasons}"
