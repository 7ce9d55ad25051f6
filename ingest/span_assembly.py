"""The windows of a vehicle over a span of its clock, and what they were made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from estimation.values.registry import VehicleRecord
from fleet_db.receipts import ChunkRecord
from fleet_db.storage import SqlUnitOfWork
from ingest.align.windows import MountedWindow, RegistryLookup
from ingest.recordings import Span


@dataclass(frozen=True, slots=True)
class SpanAssembly:
    """The windows of a vehicle that overlap a span of its clock, and everything that went into them.

    Attributes:
        from_ns, to_ns: Start of the first window of the span, end of its last.
        windows: All that recordings and registry give in the span, but for those of ``kept``.
        kept: Spans in which a recording cannot be read any more: what is stored of them stays.
        lost: Receipts of those whose raw file is lost or damaged, and was not purged.
        again: Receipts of recordings that the vehicle's bus, another one now, places elsewhere than when they were
            decoded, or cannot read.
        counts: What was left out.
    """

    vehicle: str
    from_ns: int
    to_ns: int
    sources: frozenset[str]
    lookup: RegistryLookup
    windows: tuple[MountedWindow, ...]
    kept: tuple[Span, ...]
    lost: tuple[ChunkRecord, ...]
    again: tuple[ChunkRecord, ...]
    counts: Mapping[str, int]

    def keeps(self, start_ns: int, length_ns: int) -> bool:
        """Whether what is stored of a window stays, because a recording of it cannot be read."""
        return any(first < start_ns + length_ns and last >= start_ns for first, last in self.kept)


def registry_lookup(unit: SqlUnitOfWork, vehicle: VehicleRecord, from_ns: int, to_ns: int) -> RegistryLookup:
    """Return what the registry contains of a vehicle over a span of its clock.

    Args:
        from_ns, to_ns: The span, its end excluded.
    """
    sections = unit.tracks.sections()
    return RegistryLookup(
        vehicle,
        tuple(unit.registry.mountings_on(vehicle.code, from_ns, to_ns)),
        {section.number: section.code for section in sections},
        {section.code: section.line for section in sections if section.line is not None},
    )
