"""Wheelsets swapped in the registry, or turned round, through the real store and jobs."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from made_once import made_once
from paper_class import paper_class
from smooth_wheelset import SmoothTable, alignment, mems_windows, track
from test_bad_input_jobs import run_jobs

from estimation.storage import Storage
from estimation.values.geometry import WheelsetGeometry
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.track import AlignmentSource, TrackAlignment, TrackSectionRecord
from estimation.values.windows import Window
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear

LENGTH = 2800.0
SECONDS, WINDOW_S = 120, 40
VISITS, EVENT = 4, 2  # visits of a thousand kilometres, and the first one after the mistake
VISIT_NS = 10**14
FILE = "treadwatch.sqlite3"
Lives = Mapping[str, Sequence[Sequence[Window]]]
Continued = Callable[[Path, Lives], Storage]
WHEELS = {  # cone, unevenness of the left tread in 1/m, speed in m/s
    "A": (0.10, 20.0, 21.0),
    "B": (0.16, 0.0, 19.0),
    "C": (0.05, 0.0, 17.0),
    "D": (0.07, 0.0, 23.0),
}


@dataclass(frozen=True)
class UnevenTable(SmoothTable):
    """A left wheel whose tread is hollow by as much more; ``turned`` exchanges the sides."""

    uneven: float = 0.0
    turned: bool = False

    def left(self, x: np.ndarray) -> np.ndarray:
        return self._right(-x) if self.turned else self._left(x)

    def right(self, x: np.ndarray) -> np.ndarray:
        return self._left(-x) if self.turned else self._right(x)

    def _left(self, x: np.ndarray) -> np.ndarray:
        return super().left(x) + self.uneven * x**2

    def _right(self, x: np.ndarray) -> np.ndarray:
        return super().right(x)


@cache
def motion(name: str, *, turned: bool) -> WheelsetMotion:
    cone, uneven, speed = WHEELS[name]
    table = UnevenTable(cone, uneven, turned)
    return simulate_gear(RunningGear(), [table], track(1), np.full(SECONDS * 1000, speed), 10.0)[0]


@cache
def visit(name: str, number: int, *, turned: bool = False) -> tuple[Window, ...]:
    """Return the windows of a visit, measured with other noise each time."""
    found = mems_windows(motion(name, turned=turned), seed=1000 * number + ord(name), length_s=WINDOW_S)
    return tuple(replace(w, start_ns=w.start_ns + (number + 1) * VISIT_NS, track_section="S1") for w in found)


def known() -> TrackAlignment:
    full = alignment(track(1))
    part = full.s <= LENGTH
    arrays = ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std", "passes")
    cut = {name: getattr(full, name)[part] for name in arrays}
    return replace(full, **(cut | {"alignment_std": np.full(int(part.sum()), 0.05e-3)}))


def registered(storage: Storage, *, recorded: bool) -> None:
    """Register the wheelsets, each on a vehicle of its own, with the track on file or not."""
    with storage.write() as unit:
        unit.registry.add_vehicle_class(paper_class("metro"), 1)
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "56E1", 0.05, 1.435, LENGTH))
        if recorded:
            unit.tracks.add_alignment(known())
        for name in WHEELS:
            unit.registry.add_vehicle(VehicleRecord(name, "F", "metro", 1, 40.0, (0.0,)))
            unit.registry.add_wheelset(WheelsetRecord(name, "F", "P8", 0.45, None))
            unit.registry.add_mounting(Mounting(name, name, 1, 0, None, 0.0, 0.0))


def visited(storage: Storage, lives: Lives, numbers: Iterable[int]) -> None:
    """Put the windows of these visits, and run the jobs after each."""
    for number in numbers:
        with storage.write() as unit:
            for name, visits in lives.items():
                for window in visits[number]:
                    unit.windows.put(replace(window, wheelset=name, vehicle=name), 1000.0 * number + 500.0, 1)
        run_jobs(storage)


def valid_windows() -> dict[str, list[tuple[Window, ...]]]:
    return {name: [visit(name, number) for number in range(VISITS)] for name in WHEELS}


def current(storage: Storage, name: str) -> WheelsetGeometry:
    with storage.read() as unit:
        record = unit.geometries.current(name)
    assert record is not None
    return record.geometry


def mistakes(storage: Storage) -> dict[str | None, tuple[object, object]]:
    with storage.read() as unit:
        found = [alert for alert in unit.alerts.all_open() if alert.kind == "identity"]
    return {alert.wheelset: (alert.evidence["mistake"], alert.evidence["partner"]) for alert in found}


@pytest.fixture(
    scope="module",
    params=[True, pytest.param(False, marks=pytest.mark.slow)],
    ids=["track on file", "track found by the fleet"],
)
def recorded(request: pytest.FixtureRequest) -> bool:
    """Return whether the section has been recorded; else the passes determine it, the mistaken ones included."""
    found: bool = request.param
    return found


def kind(*, recorded: bool) -> str:
    return "recorded" if recorded else "found"


@pytest.fixture(scope="module")
def continued(
    migrated_sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory, *, recorded: bool
) -> Iterator[Continued]:
    """Yield what goes on from the visits before the mistake, which all have in common, with those behind it."""

    def until_the_event(folder: Path) -> None:
        shutil.copyfile(migrated_sqlite_file, folder / FILE)
        with closing(SqlStorage(database_engine(f"sqlite:///{folder / FILE}"), folder)) as storage:
            registered(storage, recorded=recorded)
            visited(storage, valid_windows(), range(EVENT))

    common = made_once(tmp_path_factory, f"identity-{kind(recorded=recorded)}", until_the_event)
    made: list[SqlStorage] = []

    def go_on(folder: Path, lives: Lives) -> Storage:
        shutil.copytree(common, folder, dirs_exist_ok=True)
        made.append(SqlStorage(database_engine(f"sqlite:///{folder / FILE}"), folder))
        visited(made[-1], lives, range(EVENT, VISITS))
        run_jobs(made[-1])
        return made[-1]

    yield go_on
    for storage in made:
        storage.close()


@pytest.fixture(scope="module")
def without(continued: Continued, tmp_path_factory: pytest.TempPathFactory, *, recorded: bool) -> Iterator[Storage]:
    """Yield the state without a mistake, to read."""
    name = f"identity-{kind(recorded=recorded)}-without"
    folder = made_once(tmp_path_factory, name, lambda folder: continued(folder, valid_windows()))
    with closing(SqlStorage(database_engine(f"sqlite:///{folder / FILE}"), folder)) as storage:
        yield storage


def same_curve(first: WheelsetGeometry, second: WheelsetGeometry, within: float) -> bool:
    values = [one.rolling_radius_difference.value for one in (first, second)]
    centre = first.bin_centres
    both = np.isfinite(values[0] + values[1]) & (np.abs(centre) < 2.5e-3)
    assert both.sum() >= 8
    return bool(np.abs((values[0] - values[1])[both]).max() <= within)


def as_they_were(storage: Storage, without: Storage, *names: str, recorded: bool) -> None:
    """Assert that nothing of them changes; on found track no more than with other passes, far below their std."""
    for name in names:
        now, then = current(storage, name), current(without, name)
        assert now.windows == then.windows
        assert same_curve(now, then, 1e-12 if recorded else 0.005e-3)
        (first, std), (second, _) = (
            (one.equivalent_conicity.value, one.equivalent_conicity.std) for one in (now, then)
        )
        assert first is not None
        assert second is not None
        assert abs(first - second) <= (1e-9 if recorded else 0.25 * std)


@pytest.mark.slow
def test_nothing_is_said_against_those_who_are_what_they_are(without: Storage, *, recorded: bool) -> None:
    assert mistakes(without) == {}
    with without.read() as unit:
        versions = unit.tracks.versions("S1", None, 10)
    assert {one.source for one in versions} == {AlignmentSource.RECORDED if recorded else AlignmentSource.FLEET}


@pytest.mark.slow
def test_two_swapped_wheelsets_are_reported_and_not_averaged(
    continued: Continued, without: Storage, tmp_path: Path, *, recorded: bool
) -> None:
    lives = valid_windows()
    lives["A"], lives["B"] = (lives[one][:EVENT] + lives[other][EVENT:] for one, other in (("A", "B"), ("B", "A")))
    storage = continued(tmp_path, lives)
    assert mistakes(storage) == {"A": ("swapped", "B"), "B": ("swapped", "A")}
    for one, other in (("A", "B"), ("B", "A")):
        now = current(storage, one)
        assert now.windows == (VISITS - EVENT) * SECONDS // WINDOW_S
        assert same_curve(now, current(without, other), 0.03e-3)  # whole, not a mixture
        with storage.read() as unit:
            kinds = {alert.kind for alert in unit.alerts.all_open(one)}
            trend = unit.trends.latest(one)
        assert not kinds & {"conicity_limit", "limit_forecast", "wheel_asymmetry"}
        assert trend is not None
        assert len(trend.trend.value) == VISITS - EVENT
    as_they_were(storage, without, "C", "D", recorded=recorded)


@pytest.mark.slow
def test_a_wheelset_turned_round_is_reported_and_as_before_when_that_is_on_file(
    continued: Continued, without: Storage, tmp_path: Path, *, recorded: bool
) -> None:
    lives = valid_windows()
    lives["A"] = [visit("A", number, turned=number >= EVENT) for number in range(VISITS)]
    storage = continued(tmp_path, lives)
    assert mistakes(storage) == {"A": ("reversed", None)}
    turned = current(storage, "A")
    assert not same_curve(turned, current(without, "A"), 0.03e-3)
    as_they_were(storage, without, "B", "C", "D", recorded=recorded)
    with storage.write() as unit:  # what the workshop had not written down
        then = (EVENT + 1) * VISIT_NS
        unit.registry.add_mounting(Mounting("A", "A", 1, 0, then, 0.0, 0.0))
        unit.registry.add_mounting(Mounting("A", "A", 1, then, None, 2500.0, 2500.0, reversed=True))
    run_jobs(storage)
    run_jobs(storage)
    assert mistakes(storage) == {}
    assert same_curve(current(storage, "A"), current(without, "A"), 0.03e-3)
