"""Log files to decoded SI arrays, on one core: against python-can with cantools, python-can's readers, and asammdf.

Every rival reads the same frames; those that go frame by frame read a share of them, and the time is multiplied. What
is compared is processor time, ours with that of the process that reads the file. python-can's readers are given less to
do: they decode nothing.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import Any

import can
import cantools
import numpy as np

from bench.report import BenchRow, row_bench
from estimation.errors import TreadwatchError
from estimation.values.windows import ACCELERATIONS
from ingest.catalogue import ACCELERATION, SYNC, default_catalogue, sync_counter
from ingest.codec import decode, encode
from ingest.frames import FrameBatch, channel_number, concatenate, sort_by_time, take
from ingest.live.listening import messages_of
from ingest.logs import write_blf
from ingest.logs.formats import ReadCost, read_content

FRAMES, SHARE, ROUNDS = 1_000_000, 20, 5
DATABASE = files("ingest") / "dbc" / "treadwatch.dbc"
TEXT = {
    ".asc": (can.ASCWriter, can.ASCReader, "ASC"),
    ".log": (can.CanutilsLogWriter, can.CanutilsLogReader, "candump"),
}
NODES, START_NS = 8, 1_750_000_000_000_000_000
REACH_BLF, REACH_BLF_FRAMES, REACH_TEXT, REACH_MF4 = 15.0, 5e6, 5.0, 1.0


def rows(_options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    """Yield, by format, how many times faster than the rival, and frames per second."""
    batch = bus_frames(FRAMES)
    part = take(batch, slice(0, FRAMES // SHARE))
    yield _blf(folder, batch, part)
    for suffix in TEXT:
        yield _text(folder, batch, part, suffix)
    yield from _mf4(folder, batch)


def _blf(folder: Path, batch: FrameBatch, part: FrameBatch) -> BenchRow:
    write_log(folder / "whole.blf", batch)
    write_log(folder / "part.blf", part)
    database: Any = cantools.database.load_file(str(DATABASE))

    def theirs() -> None:
        with can.BLFReader(folder / "part.blf") as reader:
            for message in reader:
                database.decode_message(message.arbitration_id, message.data, decode_choices=False)

    ours_s, theirs_s, ratio = _compared(lambda: _decoded_s(folder / "whole.blf", len(batch)), _timed(theirs, SHARE))
    rate = len(batch) / ours_s
    return BenchRow(
        f"BLF file of {len(batch):,} frames to decoded SI arrays, against python-can and cantools",
        f"{rate / 1e6:.1f} M frames/s on one core, {ratio:.0f} times faster ({theirs_s:.1f} s)",
        f">= {REACH_BLF_FRAMES / 1e6:.0f} M frames/s, >= {REACH_BLF:.0f} times",
        rate >= REACH_BLF_FRAMES and ratio >= REACH_BLF,
    )


def _text(folder: Path, batch: FrameBatch, part: FrameBatch, suffix: str) -> BenchRow:
    _, reader, name = TEXT[suffix]
    for stem, frames in (("whole", batch), ("part", part)):
        write_log(folder / f"{stem}{suffix}", frames)

    def theirs() -> None:
        with reader(folder / f"part{suffix}") as log:
            for _ in log:
                pass

    ours_s, _, ratio = _compared(lambda: _decoded_s(folder / f"whole{suffix}", len(batch)), _timed(theirs, SHARE))
    return BenchRow(
        f"{name} file of {len(batch):,} frames to decoded SI arrays, against python-can's reader alone",
        f"{ratio:.1f} times faster ({len(batch) / ours_s / 1e6:.1f} M frames/s)",
        f">= {REACH_TEXT:.0f} times",
        ratio >= REACH_TEXT,
    )


def _mf4(folder: Path, batch: FrameBatch) -> Iterator[BenchRow]:
    from asammdf import MDF  # noqa: PLC0415 - an extra

    path = folder / "whole.mf4"
    write_log(path, batch)

    def raw() -> None:
        with closing(MDF(path)) as mdf:
            group = next(number for number, one in enumerate(mdf.groups) if one.channel_group.cycles_nr)
            for column in ("ID", "DLC", "DataBytes"):
                mdf.get(f"CAN_DataFrame.{column}", group=group)

    def decoded() -> None:
        with closing(MDF(path)) as mdf:
            databases: Any = {"CAN": [(str(DATABASE), 0)]}
            with closing(mdf.extract_bus_logging(database_files=databases)) as signals:
                for number, group in enumerate(signals.groups):
                    for index in range(1, len(group.channels)):
                        signals.get(group=number, index=index)

    ways = {
        "frames as arrays, against asammdf's get()": (raw, _read_s),
        "decoded SI arrays, against asammdf's extract_bus_logging() and get()": (decoded, _decoded_s),
    }
    for what, (theirs, ours) in ways.items():
        ours_s, theirs_s, ratio = _compared(lambda ours=ours: ours(path, len(batch)), _timed(theirs, 1))
        yield BenchRow(
            f"MF4 file of {len(batch):,} frames to {what}",
            f"{ratio:.2f} times as fast ({len(batch) / ours_s / 1e6:.1f} M frames/s; {theirs_s:.2f} s)",
            f">= {REACH_MF4:.0f} times",
            ratio >= REACH_MF4,
        )


def write_log(path: Path, batch: FrameBatch) -> None:
    """Write frames as a log file of the format of its suffix; only ours by our own writer."""
    if path.suffix == ".blf":
        write_blf(path, batch)
        return
    writer: Any = can.MF4Writer if path.suffix == ".mf4" else TEXT[path.suffix][0]
    with writer(path) as log:
        if path.suffix == ".asc":  # its date has whole milliseconds
            log.log_event("Start of measurement", float(int(batch.t_ns[0]) // 1_000_000_000))
        number = channel_number(batch.channel) - 1
        for message in messages_of(batch):
            message.channel = number
            log.on_message_received(message)


def _compared(ours: Callable[[], float], theirs: Callable[[], float]) -> tuple[float, float, float]:
    """Return our time, theirs, and how many times it is ours: medians of rounds that take turns, s."""
    ours()  # compile, and start the process that reads
    times = [(ours(), theirs()) for _ in range(ROUNDS)]
    ratio = median(rival / own for own, rival in times)
    return median(own for own, _ in times), median(rival for _, rival in times), ratio


def _timed(run: Callable[[], None], times: int) -> Callable[[], float]:
    def seconds() -> float:
        begin_s = time.process_time()
        run()
        return (time.process_time() - begin_s) * times

    return seconds


def _decoded_s(path: Path, frames: int) -> float:
    """Return the processor time from a file to SI arrays, s."""
    begin_s, costs = time.process_time(), list[ReadCost]()
    found = decode(default_catalogue(), read_content(path, cost=costs.append).batch)
    values = [message.values() for message in found.messages.values()]
    _all(sum(map(len, values)), frames, path)
    return time.process_time() - begin_s + sum(cost.cpu_s for cost in costs)


def _read_s(path: Path, frames: int) -> float:
    """Return the processor time from a file to frames as arrays, s."""
    begin_s, costs = time.process_time(), list[ReadCost]()
    batch = read_content(path, cost=costs.append).batch
    _all(len(batch) * bool(np.any(batch.data)), frames, path)
    return time.process_time() - begin_s + sum(cost.cpu_s for cost in costs)


def _all(found: int, frames: int, path: Path) -> None:
    if found != frames:
        raise TreadwatchError(f"{path.name} holds {frames} frames, of which {found} were found")


def bus_frames(count: int) -> FrameBatch:
    """Return a bus of SYNC and eight wheelset nodes, with a few values that are not available."""
    catalogue = default_catalogue()
    samples = count // (NODES + 1) + 1
    rng = np.random.default_rng(0)
    t_ns = START_NS + np.arange(samples) * catalogue.sample_interval_ns
    batches = [encode(catalogue.find(SYNC), t_ns, {"counter": sync_counter(np.arange(samples))})]
    for node in range(1, NODES + 1):
        values = {name: rng.normal(scale=2.0, size=samples) for name in ACCELERATIONS}
        values["yaw_acceleration"][::1000] = np.nan
        batches.append(encode(catalogue.find(ACCELERATION, node), t_ns + node * 200_000, values))
    return take(sort_by_time(concatenate(batches)), slice(0, count))


main = row_bench("logs", "Log files to decoded arrays", __doc__, rows).run
