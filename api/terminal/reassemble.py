"""Windows made again by hand, with a line that gives what changed."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime

from rich.console import Console

from api import factory
from api.factory import SystemClock, open_store
from api.settings import load_settings
from api.terminal.ingest import changes_line
from estimation.errors import ParameterError
from fleet_db.stores.stale_spans import EARLIEST_NS, LATEST_NS
from ingest.receiver import ChunkReceipt

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def reassemble_and_report(vehicle: str, begin: datetime | None, end: datetime | None) -> None:
    """Make the windows of a vehicle in ``[begin, end)`` again and print what changed; None is an open end."""
    from_ns, to_ns = _nanoseconds(begin, "--from"), _nanoseconds(end, "--to")
    if from_ns is not None and to_ns is not None and to_ns <= from_ns:
        raise ParameterError("is not after --from", field="--to")
    settings = load_settings()
    console = Console(stderr=True)
    with closing(open_store(settings)) as storage:
        receiver = factory.receiver(settings, storage, SystemClock())
        with storage.read() as unit:
            waiting = [record for record in unit.chunks.of_known_vehicles() if record.vehicle == vehicle]
        for outcome in receiver.decode(waiting):
            if not isinstance(outcome, ChunkReceipt):
                console.print(f"not decoded: {outcome}", highlight=False, soft_wrap=True)
        changes = receiver.reassembler.reassemble(vehicle, from_ns, to_ns)
    Console().print(f"vehicle {vehicle}: {changes_line(changes)}", highlight=False, soft_wrap=True)


def _nanoseconds(moment: datetime | None, field: str) -> int | None:
    """Return a time as ns since 1970; one without a zone is UTC."""
    if moment is None:
        return None
    since = (moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)) - EPOCH
    found = (since.days * 86_400_000_000 + since.seconds * 1_000_000 + since.microseconds) * 1000
    if not EARLIEST_NS <= found <= LATEST_NS:
        raise ParameterError(f"{moment.year} is outside the years that can be stored; leave it out", field=field)
    return found
