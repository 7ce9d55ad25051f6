"""Window files today against Parquet, on the windows of a simulated recording: size, time, import, installed size."""

from __future__ import annotations

import io
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import files as files_of
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from api.factory import SystemClock, raw_store
from api.settings import Settings
from bench.report import BenchRow
from estimation.values.arrays import FloatArray
from estimation.values.windows import ACCELERATIONS, Window, WindowQuality
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from fleet_db.telemetry import pack_window, unpack_window, window_digest
from ingest.catalogue import default_catalogue
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import run_fleet
from ingest.simulator.scenario_file import load_scenario

SMOOTH = ("speed", "distance")
ROUNDS = 9
IMPORTS = 7
MS = 1e3
LEVEL = 1  # of zstd, as in the window files
COUNT_LIMIT = 2**15
_METADATA = b"treadwatch"


@dataclass(frozen=True, slots=True)
class FileFormat:
    """A way to write a window into bytes and to read it back, bit for bit."""

    name: str
    write: Callable[[Window], bytes]
    read: Callable[[bytes], Window]


@dataclass(frozen=True, slots=True)
class ParquetLayout:
    """Encodings of the columns, and what the columns of speed and distance hold."""

    counts: str
    smooth: str
    smooth_as: Literal["values", "bits", "differences"]


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one window: bytes, and medians of the time to write and to read it, s."""

    size: float
    write_s: float
    read_s: float


def rows() -> Iterator[BenchRow]:
    """Yield the costs of each format per window, and of the libraries behind them."""
    windows = simulated_windows()
    formats = [FileFormat("today: channel by channel, byte shuffle, zstd", pack_window, _unpack), *_parquet_formats()]
    costs = [_cost(item, windows) for item in formats]
    samples = f"a window of {len(windows[0].valid):,} samples ({len(windows)} windows)"
    for item, cost in zip(formats, costs, strict=True):
        times = f"written in {cost.write_s * MS:.2f} ms, read in {cost.read_s * MS:.2f} ms"
        yield BenchRow(
            what=f"{samples}; {item.name}",
            measured=f"{cost.size / 1e3:.1f} kB, {times}",
            reach="no better than today's in size or time",
            met=cost.size >= costs[0].size and cost.write_s + cost.read_s >= costs[0].write_s + costs[0].read_s,
        )
    for package, module in (("zstandard", "zstandard"), ("pyarrow", "pyarrow.parquet")):
        yield BenchRow(
            what=f"library {package}",
            measured=f"{_installed(package) / 1e6:.1f} MB installed, {_import_s(module):.2f} CPU s to import",
            reach="",
            met=True,
        )


def _parquet_formats() -> list[FileFormat]:
    delta, split = "DELTA_BINARY_PACKED", "BYTE_STREAM_SPLIT"
    layouts = {
        f"Parquet, zstd: counts {delta}, speed and distance {split}": ParquetLayout(delta, split, "values"),
        f"Parquet, zstd: counts {split}, speed and distance {split}": ParquetLayout(split, split, "values"),
        f"Parquet, zstd: counts {delta}, bit patterns of speed and distance {delta}": ParquetLayout(
            delta, delta, "bits"
        ),
        f"Parquet, zstd: counts {split}, differences of bit patterns {split}": ParquetLayout(
            split, split, "differences"
        ),
    }
    return [
        FileFormat(name, partial(_to_parquet, layout=layout), partial(_from_parquet, layout=layout))
        for name, layout in layouts.items()
    ]


def simulated_windows() -> list[Window]:
    """Return the windows of the first vehicle's first campaign of demo_single, cut by the product's receiver."""
    plan = load_scenario("demo_single")
    plan = replace(plan, vehicles=plan.vehicles[:1], sessions=replace(plan.sessions, campaigns=1))
    with tempfile.TemporaryDirectory() as folder:
        report = run_fleet(plan, Path(folder) / "recordings", workers=1)
        settings = Settings(data_dir=Path(folder) / "data", database_url=None, _env_file=None)
        upgrade(settings.url)
        storage = SqlStorage(database_engine(settings.url), settings.data_dir)
        with storage.write() as unit:
            load_registry(report.registry, unit, 1)
        receiver = Receiver(
            storage, raw_store(settings), default_catalogue(), SystemClock(), window_length_s=settings.window_length_s
        )
        for recording in report.recordings:
            receiver.receive_file(recording.path, recording.vehicle)
        with storage.read() as unit:
            windows = [
                unit.windows.load(record.wheelset, record.start_ns)
                for wheelset in unit.registry.wheelsets()
                for record in unit.windows.list(wheelset.serial)
            ]
        storage.close()
    return windows


def _unpack(blob: bytes) -> Window:
    return unpack_window(blob, where="bench")


def _cost(item: FileFormat, windows: list[Window]) -> Cost:
    blobs = [item.write(window) for window in windows]
    for blob, window in zip(blobs, windows, strict=True):
        if window_digest(item.read(blob)) != window_digest(window):
            raise ArithmeticError(f"{item.name} does not give back the same window")
    size = statistics.fmean(len(blob) for blob in blobs)
    write_s = [_seconds(lambda: [item.write(window) for window in windows]) for _ in range(ROUNDS)]
    read_s = [_seconds(lambda: [item.read(blob) for blob in blobs]) for _ in range(ROUNDS)]
    return Cost(size, statistics.median(write_s) / len(windows), statistics.median(read_s) / len(windows))


def _seconds(work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


def _to_parquet(window: Window, *, layout: ParquetLayout) -> bytes:
    """Return a Parquet file: whole counts of accelerations (null where there is none), speed and distance."""
    columns: dict[str, pa.Array] = {}
    encodings = dict.fromkeys(ACCELERATIONS, layout.counts) | dict.fromkeys(SMOOTH, layout.smooth)
    for name, step in zip(ACCELERATIONS, window.resolution, strict=True):
        values = getattr(window, name)
        counts, missing = _counts(values, step)
        columns[name] = pa.array(counts, mask=missing)
    for name in SMOOTH:
        values = getattr(window, name)
        bits = values.view(np.int64)
        stored = {"values": values, "bits": bits, "differences": np.diff(bits, prepend=np.int64(0))}
        columns[name] = pa.array(stored[layout.smooth_as])
    columns["valid"] = pa.array(window.valid)
    scalars = {
        "resolution": [step.hex() for step in window.resolution],
        "quality": {name: getattr(window.quality, name) for name in WindowQuality.__dataclass_fields__},
        "sample_interval_s": window.sample_interval_s.hex(),
        "odometer_m": window.odometer_m.hex(),
        **{name: getattr(window, name) for name in _PLAIN},
    }
    table = pa.table(columns).replace_schema_metadata({_METADATA: json.dumps(scalars)})
    out = io.BytesIO()
    pq.write_table(
        table, out, compression="zstd", compression_level=LEVEL, use_dictionary=False, write_statistics=False,
        column_encoding=encodings, write_page_checksum=True, store_schema=True,
    )  # fmt: skip
    return out.getvalue()


def _counts(values: FloatArray, step: float) -> tuple[np.ndarray[Any, np.dtype[np.int32]], np.ndarray[Any, Any]]:
    missing = np.isnan(values)
    counts = np.rint(np.where(missing, 0.0, values / step)).astype(np.int32)
    if np.abs(counts).max(initial=0) >= COUNT_LIMIT or not np.array_equal(counts[~missing] * step, values[~missing]):
        raise ArithmeticError("the bench has windows of whole counts only")
    return counts, missing


_PLAIN = ("wheelset", "vehicle", "axle", "start_ns", "length_ns", "track_section")


def _from_parquet(blob: bytes, *, layout: ParquetLayout) -> Window:
    table = pq.read_table(pa.BufferReader(blob), use_threads=False, page_checksum_verification=True)
    scalars = json.loads(table.schema.metadata[_METADATA])
    steps: Any = tuple(float.fromhex(step) for step in scalars["resolution"])
    values: dict[str, Any] = {}
    for name, step in zip(ACCELERATIONS, steps, strict=True):
        column = table.column(name).combine_chunks()
        counts = column.fill_null(0).to_numpy(zero_copy_only=False)
        missing = column.is_null().to_numpy(zero_copy_only=False)
        values[name] = np.where(missing, np.nan, counts * np.float64(step))
    values["valid"] = table.column("valid").to_numpy()
    for name in SMOOTH:
        stored = table.column(name).to_numpy()
        summed = np.cumsum(stored) if layout.smooth_as == "differences" else stored
        values[name] = stored if layout.smooth_as == "values" else summed.view(np.float64)
    return Window(
        **{name: scalars[name] for name in _PLAIN},
        sample_interval_s=float.fromhex(scalars["sample_interval_s"]),
        odometer_m=float.fromhex(scalars["odometer_m"]),
        **values,
        resolution=steps,
        quality=WindowQuality(**scalars["quality"]),
    )


def _installed(package: str) -> int:
    return sum(
        path.stat().st_size for path in (Path(str(f.locate())) for f in files_of(package) or ()) if path.exists()
    )


def _import_s(module: str) -> float:
    """Return the CPU time of a fresh interpreter that imports ``module`` beyond one that imports numpy alone."""
    return _interpreter_s(f"import numpy, {module}") - _interpreter_s("import numpy")


def _interpreter_s(program: str) -> float:
    measured = f"import time; {program}; print(time.process_time())"
    taken = [
        float(subprocess.run([sys.executable, "-c", measured], capture_output=True, text=True, check=True).stdout)  # noqa: S603 - our own program
        for _ in range(IMPORTS)
    ]
    return statistics.median(taken)
