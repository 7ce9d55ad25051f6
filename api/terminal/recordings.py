"""Lists of recordings and of the quarantine on the terminal."""

from __future__ import annotations

from api.terminal.store import columns, reading
from api.times import to_rfc3339
from estimation.values.runs import Quarantined
from fleet_db.records import ChunkRecord, RecordingChange
from fleet_db.stores.chunks import ChosenChunks

DIGITS = 12  # of a digest, in lists: enough to name it

MOST_LISTED = 10_000


def recording_list(chosen: ChosenChunks, limit: int) -> str:
    """Return recordings as lines, the newest first."""
    with reading() as unit:
        records = unit.chunks.page(chosen, limit)
    head = ("digest", "kind", "vehicle", "received", "first", "last", "frames", "state", "reason")
    return columns([head, *map(recording_line, records)])


def recording_text(digest: str) -> str:
    """Return the receipt of a recording and the record of what was done to it."""
    with reading() as unit:
        record = unit.chunks.receipt(digest)
        changes = unit.recording_changes.list(record.digest)
    code = "" if record.reason is None else record.reason.code
    rows = [
        ("digest", record.digest),
        ("kind", record.suffix),
        ("file name", record.file_name or ""),
        ("bytes", str(record.size_bytes)),
        ("vehicle", record.vehicle),
        ("received", to_rfc3339(record.received_ns)),
        ("clock checked", "" if record.clock_checked_ns is None else to_rfc3339(record.clock_checked_ns)),
        ("span", " ".join(_times(record))),
        ("frames", str(record.frames)),
        ("state", record.state.value),
        ("reason code", code),
        ("reason", "" if record.reason is None else record.reason.text),
        *((name.replace("_", " "), str(count)) for name, count in sorted(record.counts.items())),
    ]
    return "\n".join([columns(rows), *map(_change_line, changes)])


def quarantine_list(*, everything: bool) -> str:
    """Return what is in quarantine as lines, by last failure."""
    with reading() as unit:
        items = unit.quarantine.all(MOST_LISTED) if everything else unit.quarantine.held()
    head = ("kind", "key", "stage", "state", "reason code", "attempts", "first", "last", "next", "error")
    return columns([head, *map(_quarantine_line, items)])


def recording_line(record: ChunkRecord) -> tuple[str, ...]:
    """Return the cells of a recording in a list."""
    reason = "" if record.reason is None else f"{record.reason.code}: {record.reason.text}"
    first, last = _times(record)
    received = to_rfc3339(record.received_ns)
    shown = (record.digest[:DIGITS], record.suffix, record.vehicle, received, first, last)
    return (*shown, str(record.frames), record.state.value, reason)


def _times(record: ChunkRecord) -> tuple[str, str]:
    if record.first_ns is None or record.last_ns is None:
        return "-", "-"
    return to_rfc3339(record.first_ns), to_rfc3339(record.last_ns)


def _change_line(change: RecordingChange) -> str:
    vehicles = (
        "" if change.vehicle_before == change.vehicle_after else f" {change.vehicle_before} -> {change.vehicle_after}"
    )
    states = f"{change.state_before} -> {change.state_after}"
    return f"{to_rfc3339(change.recorded_ns)} {change.action}{vehicles} ({states}) by {change.actor}: {change.why}"


def _quarantine_line(item: Quarantined) -> tuple[str, ...]:
    times = (to_rfc3339(item.first_ns), to_rfc3339(item.last_ns), to_rfc3339(item.due_ns))
    place = (item.kind.value, item.key, item.stage)
    return (*place, item.state.value, item.code.value, str(item.attempts), *times, item.error)
