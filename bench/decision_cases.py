"""The accuracy scenario received once, estimated under changed settings, compared with its truth."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from api.factory import SystemClock, open_store, raw_store
from api.settings import Settings
from bench.mems import HIGH, LOW, is_scored
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.motion.integration import SignalParameters
from estimation.motion.window_motion import motion
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import FloatArray
from estimation.values.geometry import COMBINATIONS, BinTable, WheelsetGeometry
from estimation.values.reasons import Reason
from estimation.values.track import TrackAlignment
from estimation.values.windows import Motion, Window
from fleet_db.migrate import upgrade
from ingest.catalogue import default_catalogue
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import FleetReport

UNIT = {name: "mm" if name.startswith("rolling") else "rad" for name in COMBINATIONS}


@dataclass(frozen=True, slots=True)
class Case:
    """One wheelset of one seed: its windows, the track on file, and its true conicity by amplitude."""

    windows: tuple[Window, ...]
    track: TrackAlignment
    amplitude_mm: FloatArray
    conicity: FloatArray
    displacement_mm: FloatArray
    curves: dict[str, FloatArray]  # the four combinations over displacement_mm, mm and rad


@dataclass(frozen=True, slots=True)
class Score:
    """Of one or more wheelsets."""

    errors: list[float]
    covered: list[bool]
    half_widths: list[float]

    def __str__(self) -> str:
        return (
            f"mean absolute error {np.mean(self.errors):.4f}, half width {np.mean(self.half_widths):.4f}, "
            f"{100 * np.mean(self.covered):.0f} % of {len(self.covered)} intervals cover"
        )


def received(report: FleetReport, window_s: float, folder: Path) -> Iterator[Case]:
    """Receive the recordings of one seed with windows of ``window_s``."""
    data = Path(tempfile.mkdtemp(dir=folder))
    settings = Settings(data_dir=data, database_url=None, window_length_s=window_s)
    upgrade(settings.url)
    with closing(open_store(settings)) as storage:
        with storage.write() as unit:
            load_registry(report.registry, unit, 1)
        receiver = Receiver(storage, raw_store(settings), default_catalogue(), SystemClock(), window_s)
        for recording in report.recordings:
            receiver.receive_file(recording.path, recording.vehicle)
        with storage.read() as unit:
            for truth in json.loads(report.truth.read_text(encoding="utf-8"))["wheelsets"]:
                found = unit.windows.list(truth["serial"])
                track = unit.tracks.alignment("BENCH-16")
                assert track is not None
                yield Case(
                    tuple(unit.windows.load(w.wheelset, w.start_ns) for w in found),
                    track,
                    np.array(truth["campaigns"][0]["amplitude_mm"]),
                    np.array(truth["campaigns"][0]["equivalent_conicity"], dtype=np.float64),
                    np.array(truth["campaigns"][0]["lateral_displacement_mm"]),
                    {name: np.array(truth["campaigns"][0][f"{name}_{UNIT[name]}"]) for name in COMBINATIONS},
                )


def paper_bins(signals: SignalParameters) -> BinParameters:
    """Return the parameters of the bin tables of band-limited motion of the paper's vehicle."""
    return BinParameters(source=signals.source, band_limited=True)


def moved(case: Case, signals: SignalParameters) -> list[Motion]:
    """Return the motion of every window that is not refused."""
    found = [motion(window, case.track, signals) for window in case.windows]
    return [m for m in found if not isinstance(m, Reason)]


def merged(motions: Sequence[Motion], parameters: BinParameters) -> BinTable:
    """Return one table of all windows."""
    return bin_table.merge_all([bin_table.tabulate(m, parameters) for m in motions], parameters)


def score(cases: Sequence[Case], estimates: Sequence[WheelsetGeometry]) -> Score:
    """Compare conicities with the truth."""
    result = Score([], [], [])
    for case, estimate in zip(cases, estimates, strict=True):
        for amplitude, value in zip(1e3 * estimate.amplitude, estimate.conicity, strict=True):
            at = np.flatnonzero(np.isclose(case.amplitude_mm, amplitude))
            if (
                not is_scored(amplitude)
                or not len(at)
                or value.value is None
                or value.low is None
                or value.high is None
            ):
                continue
            true = case.conicity[at[0]]
            result.covered.append(bool(value.low <= true <= value.high))
            if LOW <= amplitude <= HIGH:
                result.errors.append(abs(value.value - true))
                result.half_widths.append(0.5 * (value.high - value.low))
    return result


def estimated(
    cases: Sequence[Case],
    signals: SignalParameters | None = None,
    change: Callable[[BinParameters], BinParameters] = lambda p: p,
    published: GeometryParameters | None = None,
) -> list[WheelsetGeometry]:
    """Estimate every case again."""
    signals = signals or SignalParameters()
    parameters = change(paper_bins(signals))
    published = published or GeometryParameters()
    return [estimate_geometry(merged(moved(case, signals), parameters), parameters, published) for case in cases]
