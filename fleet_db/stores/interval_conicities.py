"""The known conicities of a geometry, kept beside it as text: a trend reads hundreds of them, and no bins."""

from __future__ import annotations

import json
from itertools import starmap
from typing import Any

from sqlalchemy import Row

from estimation.errors import DamagedError
from estimation.values.geometry import (
    IntervalConicities,
    KnownConicity,
    WheelsetGeometry,
    known_conicities,
    why_no_conicity,
)
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.rows import nan_if_null, table_of
from fleet_db.tables import GeometryRow

NAMES = (
    *("baseline", "baseline_interval", "mileage_km", "from_ns", "to_ns", "windows"),
    *("input_digest", "code_version", "conicities"),
)
COLUMNS = tuple(table_of(GeometryRow).c[name] for name in NAMES)


def conicities_text(geometry: WheelsetGeometry) -> str:
    """Return the known conicities of a geometry as text, exact; where there is none, its reason."""
    reason = why_no_conicity(geometry)
    why = None if reason is None else [reason.code.value, reason.text]
    return json.dumps([known_conicities(geometry), why], separators=(",", ":"), allow_nan=False)


def conicities_of(row: Row[Any]) -> IntervalConicities:
    """Return what a row says.

    Args:
        row: Of ``COLUMNS``, with a text.

    Raises:
        DamagedError: The text is not one of :func:`conicities_text`.
    """
    try:
        known, why = json.loads(row.conicities)
        listed = tuple(starmap(KnownConicity, known))
        reason = None if why is None else Reason(ReasonCode(why[0]), why[1])
    except (ValueError, TypeError, LookupError) as error:
        place = f"conicities of baseline {row.baseline}, interval {row.baseline_interval}"
        raise DamagedError(f"{place}: damaged ({error})") from error
    return IntervalConicities(
        baseline=row.baseline,
        interval=row.baseline_interval,
        mileage_km=nan_if_null(row.mileage_km),
        from_ns=row.from_ns,
        to_ns=row.to_ns,
        windows=row.windows,
        input_digest=row.input_digest,
        code_version=row.code_version,
        known=listed,
        reason=reason,
    )
