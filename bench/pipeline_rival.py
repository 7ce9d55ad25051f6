"""Bin tables by python-can, cantools, scipy filters, padasip and the ORM: what one would write without this product."""

from __future__ import annotations

import tempfile
import time
from importlib.resources import files
from itertools import islice
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
