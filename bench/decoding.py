"""Decoding against cantools frame by frame, and reading BLF against python-can, on the same frames."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import Any

import can
import cantools
import numpy as np

from bench.report import BenchRow
from estimation.values.windows import ACCELERATIONS
from ingest.catalogue import ACCELERATION, SYNC, default_catalogue, sync_counter
from ingest.codec import Decoded, decode, encode
from ingest.frames import FrameBatch, concatenate, sort_by_time, take
from ingest.logs import read_log, write_blf

FRAMES = 2_000_000
SHARE = 20
"""cantools and python-can are timed on every so many of the frames, and the time is multiplied."""

ROUNDS = 5
NODES = 8
START_NS = 1_750_000_000_000_000_000


def rows() -> Iterator[BenchRow]:
    """Measure, one row at a time."""
    batch = bus_frames(FRAMES)
    yield _decoding(batch)
    yield _reading(batch)


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


def _decoding(batch: FrameBatch) -> BenchRow:
    catalogue = default_catalogue()
    database: Any = cantools.database.load_file(str(files("ingest") / "dbc" / "treadwatch.dbc"))
    part = take(batch, slice(0, len(batch) // SHARE))
    frames = [
        (identifier, bytes(data)) for identifier, data in zip(part.arbitration_id.tolist(), part.data, strict=True)
    ]

    def by_frame() -> list[dict[str, float]]:
        return [database.decode_message(identifier, data, decode_choices=False) for identifier, data in frames]

    def at_once() -> dict[int, np.ndarray]:
        return {key: values.values() for key, values in decode(catalogue, batch).messages.items()}

    at_once()  # compile
    theirs_s, ours_s = zip(*((_seconds(by_frame) * SHARE, _seconds(at_once)) for _ in range(ROUNDS)), strict=True)
    ratio = median(theirs / ours for theirs, ours in zip(theirs_s, ours_s, strict=True))
    same = _same(decode(catalogue, part), by_frame())
    return BenchRow(
        f"decode {len(batch):,} frames to SI values, against cantools frame by frame",
        f"{ratio:.0f} times faster ({median(ours_s):.3f} s and {median(theirs_s):.1f} s), "
        f"{'same' if same else 'OTHER'} values",
        ">= 50 times faster, same values",
        ratio >= 50.0 and same,
    )


def _same(decoded: Decoded, theirs: list[dict[str, float]]) -> bool:
    """Whether every value is the same number, or one that both call not available."""
    for values in decoded.messages.values():
        found, raw = values.values(), values.raw
        for column, signal in enumerate(values.plan.signals):
            expected = np.array([theirs[at][signal.name] for at in values.index.tolist()])
            marked = (
                raw[:, column] == signal.raw_invalid if signal.raw_invalid is not None else np.zeros(len(raw), bool)
            )
            marked |= values.clipped()[:, column]
            if (
                not np.array_equal(found[~marked, column], expected[~marked])
                or not np.isnan(found[marked, column]).all()
            ):
                return False
    return True


def _reading(batch: FrameBatch) -> BenchRow:
    with tempfile.TemporaryDirectory() as folder:
        whole, part = Path(folder) / "whole.blf", Path(folder) / "part.blf"
        write_blf(whole, batch)
        write_blf(part, take(batch, slice(0, len(batch) // SHARE)))

        def by_frame() -> None:
            with can.BLFReader(part) as reader:
                for _ in reader:
                    pass

        theirs_s, ours_s = zip(
            *((_seconds(by_frame) * SHARE, _seconds(lambda: read_log(whole))) for _ in range(ROUNDS)), strict=True
        )
    ratio = median(theirs / ours for theirs, ours in zip(theirs_s, ours_s, strict=True))
    return BenchRow(
        f"read {len(batch):,} frames from a BLF file, against python-can",
        f"{ratio:.0f} times faster ({len(batch) / median(ours_s) / 1e6:.1f} M frames/s)",
        ">= 5 times faster",
        ratio >= 5.0,
    )


def _seconds(run: Callable[[], object]) -> float:
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


if __name__ == "__main__":
    for row in rows():
        print(row)
