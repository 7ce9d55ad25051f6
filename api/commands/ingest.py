"""``treadwatch ingest``: receive recordings from files, or listen to a live bus."""

from __future__ import annotations

import tempfile
import threading
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from api.factory import SystemClock, open_store, raw_store
from api.settings import load_settings
from estimation.errors import InputError, ParameterError, TreadwatchError
from estimation.jobs.scheduler import stop_on_signals
from estimation.storage import Storage
from ingest.bus import INTERFACES, open_bus, record
from ingest.catalogue import default_catalogue
from ingest.logs import SUFFIXES
from ingest.receiver import ChunkReceipt, Receiver
from ingest.registry_file import load_registry

SEPARATOR = "__"
"""Between the vehicle and the time in the name of a recording."""

NOT_COUNTS = ("recorder_first_ns", "recorder_last_ns")

REMEMBERED = 1000
"""Recordings of a live bus that the summary at the end covers."""

Outcome = tuple[Path, ChunkReceipt | Exception]


def ingest(
    files: Annotated[list[Path] | None, typer.Argument(help="Recordings, or folders of them.")] = None,
    *,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle of the recordings; else what stands before '__' in the file's name.")
    ] = None,
    registry: Annotated[
        Path | None, typer.Option(help="Registry to load first: fleets, vehicles, wheelsets, sections.")
    ] = None,
    interface: Annotated[str | None, typer.Option(help=f"Listen to a live bus: {', '.join(INTERFACES)}.")] = None,
    channel: Annotated[str | None, typer.Option(help="Channel of the live bus, such as 239.74.163.2 or can0.")] = None,
    chunk_seconds: Annotated[float, typer.Option(min=1.0, help="Length of a recording cut from a live bus.")] = 60.0,
) -> None:
    """Receive CAN recordings of vehicles, from log files or a live bus, and cut them into windows.

    Every recording is kept as it is before it is decoded. What was received before changes nothing.
    """
    if (interface is None) == (not files):
        raise ParameterError("give recordings, or --interface with --channel and --vehicle", field="FILES")
    settings = load_settings()
    console = Console(stderr=True)
    with closing(open_store(settings)) as storage:
        if registry is not None:
            _load(registry, storage)
        receiver = Receiver(
            storage, raw_store(settings), default_catalogue(), SystemClock(), window_length_s=settings.window_length_s
        )
        outcomes = _unfinished(receiver, console)
        if interface is None:
            outcomes += _from_files(receiver, recordings_of(files or [], vehicle), console)
        else:
            outcomes += _live(receiver, interface, channel, vehicle, chunk_seconds, console)
    Console().print(summary(outcomes))
    for path, outcome in outcomes:
        if isinstance(outcome, ChunkReceipt) and outcome.record.reason:
            console.print(f"stored, not decoded yet: {path}: {outcome.record.reason}", highlight=False, soft_wrap=True)
        elif isinstance(outcome, Exception):
            console.print(f"rejected {path}: {outcome}", style="red", highlight=False, soft_wrap=True)
    if any(isinstance(outcome, Exception) for _, outcome in outcomes):
        raise typer.Exit(1)


def recordings_of(places: Iterable[Path], vehicle: str | None) -> list[tuple[Path, str]]:
    """Return every recording and its vehicle, folders searched through, in the order of their names.

    Raises
    ------
    InputError
        A place does not exist, a folder holds no recording, or a file does not tell its vehicle.
    """
    found: list[Path] = []
    for place in places:
        if place.is_dir():
            inside = sorted(path for path in place.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
            if not inside:
                raise InputError(f"holds no recording ({', '.join(SUFFIXES)})", file=place)
            found += inside
        elif place.exists():
            found.append(place)
        else:
            raise InputError("does not exist", file=place)
    return [(path, vehicle or vehicle_in_name(path)) for path in found]


def vehicle_in_name(path: Path) -> str:
    """Return the vehicle in ``<vehicle>__<time>.<suffix>``.

    Raises
    ------
    InputError
        The name has no such part.
    """
    vehicle, separator, _ = path.stem.partition(SEPARATOR)
    if not (vehicle and separator):
        raise InputError("does not tell its vehicle: name it <vehicle>__<time>, or give --vehicle", file=path)
    return vehicle


def receive_with_progress(
    receiver: Receiver, recordings: Sequence[tuple[Path, str]], console: Console
) -> Iterator[Outcome]:
    """Receive recordings under a bar of progress; yield what became of each."""
    columns = (
        SpinnerColumn(),
        TextColumn("receiving recordings"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[frames]:,} frames"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
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
        own = [receipt for receipt in receipts if receipt.record.vehicle == vehicle]
        fresh = [receipt for receipt in own if not receipt.known]
        counts: Counter[str] = Counter()
        for receipt in fresh:
            counts.update(receipt.record.counts)
        marked = ", ".join(
            f"{count:,} {name.replace('_', ' ')}" for name, count in counts.items() if count and name not in NOT_COUNTS
        )
        table.add_row(
            vehicle,
            str(len(own)),
            str(len(own) - len(fresh)),
            f"{sum(receipt.record.frames for receipt in fresh):,}",
            str(sum(receipt.windows_changed for receipt in own)),
            marked,
        )
    return table


def _load(registry: Path, storage: Storage) -> None:
    with storage.write() as unit:
        load_registry(registry, unit)


def _unfinished(receiver: Receiver, console: Console) -> list[Outcome]:
    """Decode what an earlier run stored and did not come to decode; what still cannot be stays stored."""
    outcomes: list[Outcome] = []
    for outcome in receiver.decode_stored():
        if isinstance(outcome, ChunkReceipt):
            outcomes.append((Path(outcome.record.digest), outcome))
        else:
            console.print(f"stored earlier, not decoded: {outcome}", highlight=False, soft_wrap=True)
    return outcomes


def _from_files(receiver: Receiver, recordings: Sequence[tuple[Path, str]], console: Console) -> list[Outcome]:
    return list(receive_with_progress(receiver, recordings, console))


def _live(
    receiver: Receiver,
    interface: str,
    channel: str | None,
    vehicle: str | None,
    chunk_seconds: float,
    console: Console,
) -> list[Outcome]:
    if channel is None or vehicle is None:
        raise ParameterError("a live bus needs --channel and --vehicle", field="--interface")
    stop = threading.Event()
    stop_on_signals(stop)
    outcomes: deque[Outcome] = deque(maxlen=REMEMBERED)
    with (
        tempfile.TemporaryDirectory(prefix="treadwatch-live-") as folder,
        open_bus(interface, channel) as bus,
    ):
        console.print(f"listening to {interface} {channel} for {vehicle}; stop with Ctrl-C")
        for chunk in record(bus, Path(folder), vehicle, chunk_seconds=chunk_seconds, stop=stop):
            outcomes.append((chunk.path, _received(receiver, chunk.path, vehicle)))
            chunk.path.unlink()
            console.print(f"{chunk.path.name}: {chunk.frames:,} frames, {chunk.dropped:,} dropped", highlight=False)
    return list(outcomes)


def _received(receiver: Receiver, path: Path, vehicle: str) -> ChunkReceipt | Exception:
    try:
        return receiver.receive_file(path, vehicle)
    except TreadwatchError as error:
        return error
