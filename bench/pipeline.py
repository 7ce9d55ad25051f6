"""What recordings cost until alerts: ``python -m bench pipeline``.

Processor time of this process and of those that it starts is counted stage by stage, after a first journey has been
received and compiled everything. ``BEGIN`` is no statement.

Chunks of a fleet are received on a section that nobody has surveyed, whose alignment is estimated from the same
recordings, and on one that is on file. On the latter bin tables need the stages ``BIN_TABLES`` alone, and are compared
with what one would make of python-can, cantools, scipy, padasip and the ORM. That rival is given less to do: no
positions, no refusals, no checks. It is timed on a share of the same frames.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from importlib.resources import files
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import padasip
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfiltfilt
from sqlalchemy import create_engine
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column

from api.comparison.trial import opened, receive
from api.terminal.processes import executor_of
from bench.counting import run_all
from bench.measuring import INGEST, Stages, every, resident_of, tree
from bench.report import BenchRow, row_bench
from bench.small_fleets import Workload, workload
from fleet_db.storage import SqlStorage
from ingest.frames import take
from ingest.logs import read_log, write_blf

FRAMES = 100_000
"""So many of the first frames are taken; the time is counted for each of them."""

BINS, UNKNOWNS = 32, 2
SAMPLE_RATE, BAND = 250.0, (0.2, 20.0)  # Hz
_Floats = NDArray[np.float64]


class _Base(DeclarativeBase):
    pass


class _BinRow(_Base):
    __tablename__ = "bin"
    id: Mapped[int] = mapped_column(primary_key=True)
    node: Mapped[int]
    number: Mapped[int]
    slope: Mapped[float]
    offset: Mapped[float]
    count: Mapped[int]


def rival_s_per_frame(path: Path) -> float:
    """Return the CPU time that the rival takes for a frame of a BLF file, s."""
    begin_s = time.process_time()
    with can.BLFReader(path) as reader, tempfile.TemporaryDirectory() as folder:
        engine = create_engine(f"sqlite:///{folder}/bins.sqlite")
        _Base.metadata.create_all(engine)
        database: Any = cantools.database.load_file(str(files("ingest") / "dbc" / "treadwatch.dbc"))
        read, nodes = 0, dict[int, list[tuple[float, float]]]()
        for message in islice(reader, FRAMES):
            read += 1
            values = database.decode_message(message.arbitration_id, message.data, decode_choices=False)
            if "yaw_acceleration" in values:
                measured = (values["lateral_acceleration"], values["yaw_acceleration"])
                nodes.setdefault(message.arbitration_id, []).append(measured)
        with Session(engine) as session:
            for node, signals in nodes.items():
                session.add_all(_bins(node, np.array(signals)))
            session.commit()
        engine.dispose()
    return (time.process_time() - begin_s) / read


def _bins(node: int, signals: _Floats) -> list[_BinRow]:
    """Return one wheelset's table: yaw acceleration against displacement, by padasip's recursive filter in each bin."""
    sos = butter(4, BAND, "bandpass", fs=SAMPLE_RATE, output="sos")
    lateral, yaw = sosfiltfilt(sos, np.nan_to_num(signals), axis=0).T
    speed = sosfiltfilt(sos, cumulative_trapezoid(lateral, dx=1.0 / SAMPLE_RATE, initial=0.0))
    displacement = sosfiltfilt(sos, cumulative_trapezoid(speed, dx=1.0 / SAMPLE_RATE, initial=0.0))
    edges = np.quantile(displacement, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
    number = np.digitize(displacement, edges)
    rows = []
    for one in range(BINS):
        there = number == one
        inputs = np.column_stack([displacement[there], np.ones(np.count_nonzero(there))])
        rls = padasip.filters.FilterRLS(n=UNKNOWNS, mu=0.999)
        rls.run(yaw[there], inputs)
        rows.append(_BinRow(node=node, number=one, slope=rls.w[0], offset=rls.w[1], count=len(inputs)))
    return rows


CORES, AXLES = 2, 4
REACH_FRAMES, REACH_RATIO, REACH_HOUR_S, REACH_GIB, REACH_SHARE = 1e6, 20.0, 1.5, 4.0, 0.95
GIB = 2**30
BIN_TABLES = (INGEST, "estimate_windows")
"""Stages from a chunk to its bin tables where the track is on file."""


def _pipeline(options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    for chunk_s in options.chunk:
        for surveyed in (False, True):
            track = "surveyed" if surveyed else "unsurveyed"
            own = folder / f"{track}-{chunk_s:g}"
            load = workload(own, options.vehicles, options.minutes, surveyed=surveyed)
            chunks, frames = _chunks(load, own / "chunks", chunk_s)
            stages, peak = _measured(chunks, own / "measured")
            what = f"{options.vehicles * AXLES} wheelsets, {track} track, {options.minutes:g} min in chunks of"
            what += f" {chunk_s:g} s"
            hours = len(load.recordings) * AXLES * options.minutes / 60.0
            yield from _of_stages(what, stages, hours, len(chunks.recordings))
            if surveyed:
                yield from _beside_rival(load, stages, frames, hours)
            else:
                total = stages.whole_s / hours
                shown = f"{total:.2f} CPU s per wheelset-hour"
                yield BenchRow(f"{what}: all of it", shown, f"<= {REACH_HOUR_S}", total <= REACH_HOUR_S)
                jobs_s = stages.whole_s - stages.cpu_s[INGEST]
                share = 1.0 - _beside_workers_s(chunks, own / "workers") / jobs_s
                taken = f"{what}: share of the jobs' time that workers take over"
                yield BenchRow(taken, f"{share:.1%}", ">= 95 %", share >= REACH_SHARE)
            shown = f"{peak / GIB:.2f} GiB"
            yield BenchRow(f"{what}: memory of the processes at most", shown, "< 4 GiB", peak < REACH_GIB * GIB)


def _of_stages(what: str, stages: Stages, hours: float, chunks: int) -> Iterator[BenchRow]:
    for name, spent in stages.cpu_s.items():
        statements = stages.statements[name]
        shown = f"{spent / hours:.3f} CPU s per wheelset-hour, {statements} statements"
        shown += f", {statements / chunks:.0f} a chunk" if name == INGEST else ""
        shown += f", {statements / stages.windows:.1f} a window" if name in BIN_TABLES else ""
        yield BenchRow(f"{what}: {name}", shown, "", met=True)


def _beside_rival(load: Workload, stages: Stages, frames: int, hours: float) -> Iterator[BenchRow]:
    """Yield frames per second to bin tables, and the ratio to the rival."""
    spent = sum(stages.cpu_s[name] for name in BIN_TABLES)
    rate = CORES * frames / spent
    what = f"{frames:,} frames to persisted bin tables, {CORES} cores"
    yield BenchRow(what, f"{rate / 1e6:.2f} M frames/s of CPU time", ">= 1 M", rate >= REACH_FRAMES)
    theirs = rival_s_per_frame(load.recordings[0][1])
    ratio = theirs * frames / spent
    shown = f"{theirs * frames / hours:.1f} CPU s per wheelset-hour: {ratio:.1f} times ours"
    what = "the same by python-can, cantools, scipy, padasip and the ORM"
    yield BenchRow(what, shown, f">= {REACH_RATIO:.0f} times", ratio >= REACH_RATIO)


def _chunks(load: Workload, folder: Path, chunk_s: float) -> tuple[Workload, int]:
    """Return the load cut into chunks, and the number of frames."""
    folder.mkdir()
    found, frames = [], 0
    for number, (vehicle, path) in enumerate(load.recordings):
        batch = read_log(path)
        part = (batch.t_ns - batch.t_ns[0]) // round(chunk_s * 1e9)
        starts = [0, *(1 + i for i in range(len(part) - 1) if part[i] != part[i + 1]), len(part)]
        frames += len(part)
        for first, last in pairwise(starts):
            found.append((vehicle, folder / f"{number:04}_{first:09}.blf"))
            write_blf(found[-1][1], take(batch, slice(first, last)))
    return replace(load, recordings=found), frames


def _measured(load: Workload, folder: Path) -> tuple[Stages, int]:
    """Return what the stages took, and the largest memory of this process and those that it started, bytes."""
    settings, stages, largest = load.copy(folder), Stages(), [0]

    def look() -> None:
        largest[0] = max(largest[0], sum(map(resident_of, tree(os.getpid()))))

    with opened(settings) as (storage, context), ExitStack() as stack:
        assert isinstance(storage, SqlStorage)
        run_all(context)
        stack.enter_context(every(0.05, look))
        stages.measure(storage, context, settings, load.recorded)
    return stages, largest[0]


def _beside_workers_s(load: Workload, folder: Path) -> float:
    """Return the CPU time that this process spends on the same jobs where two workers do the units, s."""
    settings = load.copy(folder).model_copy(update={"workers": CORES})
    with opened(settings) as (_, context):
        run_all(context)
        receive(load.recorded, settings)
        with executor_of(settings) as executor:
            begin_s = time.process_time()
            run_all(replace(context, executor=executor))
            return time.process_time() - begin_s


main = row_bench(
    "pipeline",
    "From chunks to alerts",
    __doc__,
    _pipeline,
    {
        "vehicles": (3, "of four wheelsets"),
        "minutes": (15.0, "of a journey"),
        "chunk": ([900.0, 60.0], "length of a chunk, s"),
    },
).run
