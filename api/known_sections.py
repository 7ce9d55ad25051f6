"""The setting that names the sections whose rails are as on file, each with the day for which that is known."""

from __future__ import annotations

from datetime import UTC, date, datetime, time

SECOND_NS = 1_000_000_000


def known_sections(text: str) -> list[tuple[str, int]]:
    """Return codes of sections, each with the begin of its day, ns UTC.

    Args:
        text: ``S1@2026-03-01,S2@2026-05-17``; a section may come several times.

    Raises:
        ValueError: An entry has no code, or no day.
    """
    found = []
    for entry in filter(None, (one.strip() for one in text.split(","))):
        code, at, day = entry.rpartition("@")
        if not at or not code:
            raise ValueError(
                "must be codes of sections, each with the day for which its rails are known: S1@2026-03-01"
            )
        try:
            begin = datetime.combine(date.fromisoformat(day), time(), UTC)
        except ValueError:
            raise ValueError(f"section {code} must have a day such as 2026-03-01 behind its @") from None
        found.append((code, int(begin.timestamp()) * SECOND_NS))
    return found
