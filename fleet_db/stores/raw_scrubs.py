"""Readings of all raw files, each with how far it has come."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from sqlalchemy import Connection, func, insert, select, update

from fleet_db.receipts import ChunkState
from fleet_db.rows import table_of, value_of_row
from fleet_db.tables import ChunkRow, RawScrubRow

SCRUBS, CHUNKS = table_of(RawScrubRow), table_of(ChunkRow)


@dataclass(frozen=True, slots=True)
class RawScrub:
    """One reading: begin and end (ns of our clock; None while it is not whole), the last digest, and what was found."""

    scrub_id: int
    started_ns: int
    finished_ns: int | None
    after_digest: str
    files: int
    file_bytes: int
    faults: int


@dataclass(frozen=True, slots=True)
class RawFile:
    """A raw file that a receipt refers to."""

    digest: str
    suffix: str
    size_bytes: int
    vehicle: str


@dataclass(frozen=True, slots=True)
class RawScrubStore:
    """Readings, in one transaction."""

    connection: Connection

    def last(self) -> RawScrub | None:
        """Return the newest; None before the first."""
        row = self.connection.execute(select(SCRUBS).order_by(SCRUBS.c.scrub_id.desc()).limit(1)).first()
        return None if row is None else value_of_row(RawScrub, row)

    def begin(self, now_ns: int) -> RawScrub:
        """Begin one, and return it."""
        number = int(self.connection.scalar(select(func.coalesce(func.max(SCRUBS.c.scrub_id), 0))) or 0) + 1
        begun = RawScrub(number, now_ns, None, "", 0, 0, 0)
        self.connection.execute(insert(SCRUBS).values(**asdict(begun)))
        return begun

    def put(self, scrub: RawScrub) -> None:
        """Keep how far one has come."""
        self.connection.execute(update(SCRUBS).where(SCRUBS.c.scrub_id == scrub.scrub_id).values(**asdict(scrub)))

    def files_after(self, digest: str, limit: int) -> Sequence[RawFile]:
        """Return raw files that must be there, in the order of their digests, behind one."""
        columns = (CHUNKS.c.digest, CHUNKS.c.suffix, CHUNKS.c.size_bytes, CHUNKS.c.vehicle)
        kept = (CHUNKS.c.purged_ns.is_(None), CHUNKS.c.state != ChunkState.DELETED.value, CHUNKS.c.digest > digest)
        found = self.connection.execute(select(*columns).where(*kept).order_by(CHUNKS.c.digest).limit(limit))
        return [RawFile(*row) for row in found]

    def count_after(self, digest: str) -> int:
        """Return how many raw files are still to be read behind a digest."""
        kept = (CHUNKS.c.purged_ns.is_(None), CHUNKS.c.state != ChunkState.DELETED.value, CHUNKS.c.digest > digest)
        return int(self.connection.scalar(select(func.count()).where(*kept)) or 0)
