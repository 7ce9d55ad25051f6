"""Rules over names and sizes: what no path, file name or railway can have, and what hardly one has."""

from __future__ import annotations

import unicodedata
from collections.abc import Collection

from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.errors import ProfileError
from ingest.registry_entry.contradiction import Contradiction, RecordName, Rule

LEAST_RADIUS_MM, MOST_RADIUS_MM = 140.0, 650.0
"""Of usual wheels: of low-floor wagons, worn; of electric locomotives, new."""

GAUGE_TO_CONTACTS_MM = (20.0, 120.0)
"""Distance between the contact points of a wheelset minus the gauge: about the width of a rail head."""

RESERVED = ("/", "__", "\\")
_NOT_PRINTED = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
"""Categories of Unicode: control and formatting characters, halves of characters, separators of lines."""


def unusable_code(record: RecordName, field: str) -> list[Contradiction]:
    """Return what is said against a new code or serial number."""
    code = record.key
    wrong = next((mark for mark in RESERVED if mark in code), None)
    if wrong is not None:
        why = f"has {wrong!r}, which divides paths" if wrong != "__" else "has '__', which ends the code in a file name"
    elif any(unicodedata.category(letter) in _NOT_PRINTED for letter in code):
        why = "has a character that cannot be seen"
    elif code != code.strip():
        why = "begins or ends with a blank"
    else:
        return []
    return [Contradiction(Rule.CODE_UNUSABLE, record, field, f"{code!r} {why}: give another")]


def unusual_radius(record: RecordName, nominal_radius_m: float) -> list[Contradiction]:
    """Return what is said against a nominal radius that hardly a railway wheel has.

    Args:
        nominal_radius_m: Its nominal radius, m.
    """
    radius_mm = 1e3 * nominal_radius_m
    if LEAST_RADIUS_MM - 1e-6 <= radius_mm <= MOST_RADIUS_MM + 1e-6:
        return []
    hint = "a diameter? " if radius_mm > MOST_RADIUS_MM else ""
    reason = f"{radius_mm:g} mm: {hint}radii of wheels are {LEAST_RADIUS_MM:g} to {MOST_RADIUS_MM:g} mm"
    return [Contradiction(Rule.UNUSUAL_RADIUS, record, "nominal_radius_mm", reason)]


def unusual_gauge(record: RecordName, nominal_gauge_m: float, contacts_m: Collection[float]) -> list[Contradiction]:
    """Return what is said against a track gauge on which no vehicle that is known runs.

    Args:
        nominal_gauge_m: Its gauge, m.
        contacts_m: Distances between the contact points of a wheelset, of the classes of all vehicles, m; none says
            nothing.
    """
    gauge_mm = 1e3 * nominal_gauge_m
    least, most = GAUGE_TO_CONTACTS_MM
    beyond_mm = [1e3 * one - gauge_mm for one in contacts_m]
    if not beyond_mm or any(least - 1e-6 <= one <= most + 1e-6 for one in beyond_mm):
        return []
    apart = ", ".join(f"{1e3 * one:g}" for one in sorted(set(contacts_m)))
    reason = f"{gauge_mm:g} mm: no vehicle on file runs on it, their wheels touch the rails {apart} mm apart"
    return [Contradiction(Rule.UNUSUAL_GAUGE, record, "nominal_gauge_mm", reason)]


def unknown_profile(record: RecordName, field: str, name: str) -> list[Contradiction]:
    """Return what is said against a design profile that is not built in.

    Args:
        record, field: What names it: ``wheel_profile`` or ``rail_profile``.
    """
    try:
        (rail_profile if field == "rail_profile" else wheel_profile)(name)
    except ProfileError as error:
        reason = error.reason.removesuffix("; give any other as a file")
        return [Contradiction(Rule.UNKNOWN_PROFILE, record, field, reason)]
    return []
