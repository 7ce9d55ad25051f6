"""Windows that will probably stand for their roll-up: what they say of the rolling radius is summed with their tables.

A roll-up chooses the windows of the smallest digests. To which one a window will belong is decided later; the newest
one of its wheelset shows which digests are small there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from estimation.storage import UnitOfWork
from estimation.values.roll_up import MOST_CHOSEN
from estimation.values.windows import WindowKey, WindowRecord


def likely_chosen(unit: UnitOfWork, records: Sequence[WindowRecord]) -> set[WindowKey]:
    """Return which windows of a batch would be chosen beside those of the newest roll-up of their wheelset."""
    of_wheelset: defaultdict[str, list[WindowRecord]] = defaultdict(list)
    for record in records:
        if not record.quality.hunting.sustained:
            of_wheelset[record.wheelset].append(record)
    stored = unit.roll_ups.newest_chosen(sorted(of_wheelset)) if of_wheelset else {}
    found: set[WindowKey] = set()
    for wheelset, several in of_wheelset.items():
        digests = {*stored.get(wheelset, ()), *(record.content_digest for record in several)}
        smallest = set(sorted(digests)[:MOST_CHOSEN])
        found |= {record.key for record in several if record.content_digest in smallest}
    return found
