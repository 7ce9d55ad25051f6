"""Recordings from files, received under a progress bar, with a summary by vehicle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table

from api import logs
from api.factory import SystemClock, open_store
from api.logs import start_tracing
from api.pipeline import publishing
from api.pipeline import receiver as receiver_of
from api.schemas.windows import WindowReasons
from api.settings import load_settings
from api.terminal.estimate import line_of
from api.terminal.progress import bar
from api.terminal.registry import registry_lines
from api.terminal.store import print_line, user_name
from estimation.errors import InputError, ParameterError, TreadwatchError
from estimation.values.reasons import EPOCH
from fleet_db.records import Decision
from fleet_db.storage import SqlStorage
from fleet_db.stores.assembled import EARLIEST_NS, LATEST_NS
from ingest.logs import SUFFIXES
from ingest.receiver import ChunkReceipt, Receiver
from ingest.registry_entry.contents import Entry
from ingest.registry_file import load_registry
from ingest.span_commit import SpanChanges

SEPARATOR = "__"  # between the vehicle and the time in the name of a recording

NOT_COUNTS = ("recorder_first_ns", "recorder_last_ns", "own_time")

Outcome = tuple[Path, ChunkReceipt | Exception]


def ingest_and_report(
    places: Sequence[Path],
    exchanges: Sequence[Path],
    vehicle: str | None,
    registry: Path | None,
    catalogues: Sequence[Path],
    *,
    take_deleted: bool,
) -> None:
    """Receive recordings and exchanges of runs, print a summary, and exit 1 where one was rejected."""
    settings = load_settings()
    logs.configure(settings)
    start_tracing()
    console = Console(stderr=True)
    with closing(open_store(settings)) as storage, publishing(settings, lambda: storage) as announce:
        if registry is not None:
            load_and_say(registry, storage, console)
        taken_by = user_name() if take_deleted else None
        receiver = receiver_of(
            settings, storage, SystemClock(), catalogues, deleted_taken_by=taken_by, announce=announce
        )
        outcomes: list[Outcome] = []
        for outcome in receiver.decode_stored():  # what an earlier run stored but did not decode
            if isinstance(outcome, ChunkReceipt):
                outcomes.append((Path(outcome.record.digest), outcome))
            else:
                print_line(console, f"stored earlier, not decoded: {outcome}")
        _work_off(receiver, console)
        for path in exchanges:
            try:
                outcomes.append((path, receiver.receive_exchange(path)))
            except TreadwatchError as error:
                outcomes.append((path, error))
        if not exchanges:
            recordings, unnamed = recordings_of(places, vehicle)
            _say_left_out(places, console)
            outcomes += [*receive_with_progress(receiver, recordings, console), *unnamed]
        vehicles = {outcome.record.vehicle for _, outcome in outcomes if isinstance(outcome, ChunkReceipt)}
        with storage.read() as unit:
            reasons = WindowReasons(unit).waiting(vehicles=sorted(vehicles)) if vehicles else ()
    print_outcomes(outcomes, console, [line_of(windows) for windows in reasons])


def print_outcomes(outcomes: Sequence[Outcome], console: Console, waiting: Sequence[str] = ()) -> None:
    """Print a summary, what windows wait for, and what was not decoded or rejected; exit 1 where anything was."""
    Console().print(summary(outcomes))
    for line in waiting:
        print_line(console, f"windows: {line}")
    for path, outcome in outcomes:
        if isinstance(outcome, ChunkReceipt) and outcome.record.reason:
            print_line(console, f"stored, not decoded yet: {path}: {outcome.record.reason}")
        elif isinstance(outcome, Exception):
            print_line(console, f"rejected {path}: {outcome}", "red")
    if any(isinstance(outcome, Exception) for _, outcome in outcomes):
        raise typer.Exit(1)


def recordings_of(places: Iterable[Path], vehicle: str | None) -> tuple[list[tuple[Path, str]], list[Outcome]]:
    """Return every recording and its vehicle, folders searched through, in the order of their names.

    Files in folders whose names contain no vehicle come second, with why they are left out.
    """
    recordings: list[tuple[Path, str]] = []
    unnamed: list[Outcome] = []
    for place in places:
        if place.is_dir():
            inside = sorted(path for path in place.rglob("*") if path.suffix.lower() in SUFFIXES and not path.is_dir())
            if not inside:
                raise InputError(f"holds no recording ({', '.join(SUFFIXES)})", file=place)
            for path in inside:
                try:
                    recordings.append((path, vehicle or vehicle_in_name(path)))
                except InputError as error:
                    unnamed.append((path, error))
        elif place.exists():
            recordings.append((place, vehicle or vehicle_in_name(place)))
        else:
            raise InputError("does not exist", file=place)
    return recordings, unnamed


def _say_left_out(places: Iterable[Path], console: Console) -> None:
    inside = (path for place in places if place.is_dir() for path in place.rglob("*") if not path.is_dir())
    left_out = Counter(path.suffix or "none" for path in inside if path.suffix.lower() not in SUFFIXES)
    if left_out:
        suffixes = ", ".join(f"{suffix}: {count}" for suffix, count in sorted(left_out.items()))
        print_line(console, f"left out, not of {', '.join(SUFFIXES)}: {suffixes}")


def vehicle_in_name(path: Path) -> str:
    """Return the vehicle in ``<vehicle>__<time>.<suffix>``."""
    vehicle, separator, _ = path.stem.partition(SEPARATOR)
    if not (vehicle and separator):
        raise InputError("does not name its vehicle: name it <vehicle>__<time>, or give --vehicle", file=path)
    return vehicle


def receive_with_progress(
    receiver: Receiver, recordings: Sequence[tuple[Path, str]], console: Console
) -> Iterator[Outcome]:
    """Receive recordings under a progress bar; yield each with its receipt or its error."""
    with bar(console, "receiving recordings", "{task.fields[frames]:,} frames") as progress:
        task = progress.add_task("", total=len(recordings), frames=0)
        frames = 0
        for path, outcome in receiver.receive_files(recordings):
            frames += outcome.record.frames if isinstance(outcome, ChunkReceipt) else 0
            progress.update(task, advance=1, frames=frames)
            yield path, outcome


def summary(outcomes: Sequence[Outcome]) -> Table:
    """Return what was received, by vehicle, and what was marked on the way."""
    table = Table("vehicle", "recordings", "known before", "frames", "windows changed", "marked and counted")
    receipts = [outcome for _, outcome in outcomes if isinstance(outcome, ChunkReceipt)]
    for vehicle in sorted({receipt.record.vehicle for receipt in receipts}):
        of_vehicle = [receipt for receipt in receipts if receipt.record.vehicle == vehicle]
        fresh = [receipt for receipt in of_vehicle if not receipt.known]
        counts: Counter[str] = Counter()
        for receipt in fresh:
            counts.update(receipt.record.counts)
        marked = ", ".join(
            f"{count:,} {name.replace('_', ' ')}" for name, count in counts.items() if count and name not in NOT_COUNTS
        )
        table.add_row(
            vehicle,
            str(len(of_vehicle)),
            str(len(of_vehicle) - len(fresh)),
            f"{sum(receipt.record.frames for receipt in fresh):,}",
            str(sum(receipt.windows_changed for receipt in of_vehicle)),
            marked,
        )
    return table


def load_and_say(registry: Path, storage: SqlStorage, console: Console) -> None:
    """Load a registry file, and print what people must know of it."""
    with storage.write() as unit:
        now_ns = SystemClock().now_ns()
        loaded = load_registry(registry, unit, now_ns, Entry(Decision(recorded_ns=now_ns), now_ns))
    for line in registry_lines(loaded):
        print_line(console, line)


def _work_off(receiver: Receiver, console: Console) -> None:
    try:
        changes = receiver.reassembler.work_off()
    except TreadwatchError as error:  # it stays stale; what comes now does not wait for it
        print_line(console, f"not assembled again yet: {error}")
        return
    if changes.windows:
        print_line(console, f"assembled again: {changes_line(changes)}")


def changes_line(changes: SpanChanges) -> str:
    """Return how many windows are new, changed, removed and healed."""
    counts = {"new": changes.new, "changed": changes.changed, "removed": changes.removed, "healed": changes.healed}
    return "windows " + ", ".join(f"{name} {count:,}" for name, count in counts.items())


def reassemble_and_report(vehicle: str, begin: datetime | None, end: datetime | None) -> None:
    """Make the windows of a vehicle in ``[begin, end)`` again and print what changed; None is an open end."""
    from_ns, to_ns = _nanoseconds(begin, "--from"), _nanoseconds(end, "--to")
    if from_ns is not None and to_ns is not None and to_ns <= from_ns:
        raise ParameterError("is not after --from", field="--to")
    settings = load_settings()
    console = Console(stderr=True)
    with closing(open_store(settings)) as storage:
        receiver = receiver_of(settings, storage, SystemClock())
        with storage.read() as unit:
            waiting = [record for record in unit.chunks.of_known_vehicles() if record.vehicle == vehicle]
        for outcome in receiver.decode(waiting):
            if not isinstance(outcome, ChunkReceipt):
                print_line(console, f"not decoded: {outcome}")
        changes = receiver.reassembler.reassemble(vehicle, from_ns, to_ns)
    print_line(Console(), f"vehicle {vehicle}: {changes_line(changes)}")


def _nanoseconds(moment: datetime | None, field: str) -> int | None:
    if moment is None:
        return None
    since = (moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)) - EPOCH
    time_ns = (since.days * 86_400_000_000 + since.seconds * 1_000_000 + since.microseconds) * 1000
    if not EARLIEST_NS <= time_ns <= LATEST_NS:
        raise ParameterError(f"{moment.year} is outside the years that can be stored; leave it out", field=field)
    return time_ns
