"""Exchanges of runs: in any units and axes the same windows; what contradicts itself or the registry is named."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from exchange_runs import EXAMPLE, VEHICLE, register, true_run, write_csv
from test_ingest_command import run as command
from test_receiver import CountingClock
from vehicle_bus import Run

from estimation.errors import ConflictError, ExchangeError
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.windows import ACCELERATIONS, Window
from fleet_db.migrate import upgrade
from fleet_db.raw import FileRawStore
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.logs import write_blf
from ingest.receiver import Receiver
from ingest.vehicle_class_schema import shipped_class

PAGE = Path(__file__).parents[2] / "docs" / "exchange.md"
LENGTH_S = 10.0
G = 9.80665
SIGNALS = ("ay", "yaw", "roll", "aym")


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, FloatArray]:
    return true_run(tmp_path_factory.mktemp("motion"))


@pytest.fixture
def storage(sqlite_storage: SqlStorage) -> SqlStorage:
    with sqlite_storage.write() as unit:
        register(unit)
    return sqlite_storage


@dataclass(frozen=True)
class Received:
    storage: SqlStorage
    folder: Path

    @property
    def receiver(self) -> Receiver:
        return Receiver(
            self.storage,
            FileRawStore(self.folder / "raw"),
            default_catalogue(),
            CountingClock(),
            window_length_s=LENGTH_S,
        )

    def windows(self) -> dict[tuple[str, int], Window]:
        with self.storage.read() as unit:
            keys = [(r.wheelset, r.start_ns) for axle in (1, 2) for r in unit.windows.list(f"X-{axle}")]
            return {key: unit.windows.load(*key) for key in keys}

    def forget(self) -> None:
        """Delete what was received."""
        with self.storage.engine.begin() as connection:
            for table in ("windows", "chunks"):
                connection.exec_driver_sql(f"delete from {table}")  # noqa: S608 - two names of ours

    def nothing_stored(self) -> bool:
        with self.storage.read() as unit:
            receipts = unit.chunks.overlapping(VEHICLE, -(1 << 62), 1 << 62)
        return not receipts and not self.windows() and not [p for p in self.folder.glob("raw/**/*") if p.is_file()]


@pytest.fixture
def place(storage: SqlStorage, tmp_path: Path) -> Received:
    return Received(storage, tmp_path)


def example(folder: Path, columns: Mapping[str, FloatArray], *changes: tuple[str, str]) -> Path:
    """Write the example with parts of its TOML file replaced; return the path of that."""
    text = EXAMPLE
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    names = [match[1] for match in re.finditer(r'column = "(\w+)"', text)]
    write_csv(folder / "run.csv", {name: columns[name] for name in names if name in columns})
    (folder / "run.toml").write_text(text)
    return folder / "run.toml"


def rows_of(window: Window) -> IntArray:
    """Return the rows of the true motion that a window is made from."""
    return (window.start_ns - 1_767_592_800_000_000_000) // 2_000_000 + 2 * np.arange(2500)


def unlike(found: FloatArray, expected: FloatArray) -> float:
    """Return how far the running integrals of two accelerations differ, as a share: what the estimator is made of."""
    rates = [np.cumsum(values) for values in (found, expected)]
    t = np.arange(len(expected))
    rest = [rate - np.polyval(np.polyfit(t, rate, 1), t) for rate in rates]
    return float(np.std(rest[0] - rest[1]) / np.std(rest[1]))


def test_windows_are_the_true_motion(place: Received, motion: Mapping[str, FloatArray]) -> None:
    receipt = place.receiver.receive_exchange(example(place.folder, motion))
    windows = place.windows()
    assert receipt.windows_changed == len(windows) == 6
    assert receipt.record.suffix == ".exchange"
    inner = [window for window in windows.values() if window.quality.coverage == 1.0]
    assert len(inner) == 2
    for window in inner:
        at = rows_of(window)
        assert window.track_section == "LINE"
        assert np.abs(window.distance - motion["s"][at] + (2.0, 4.5)[window.axle - 1]).max() < 2e-6
        assert np.abs(window.speed - motion["v"][at]).max() < 1e-6
        expected = motion[f"ay_{window.axle}"][at] + 9.81 * motion[f"roll_angle_{window.axle}"][at]
        assert unlike(window.lateral_acceleration, expected) < 0.01
        assert unlike(window.yaw_acceleration, motion[f"yaw_{window.axle}"][at]) < 0.01
        assert unlike(window.roll_acceleration, motion[f"roll_{window.axle}"][at]) < 0.02
        mass = motion[f"aym_{window.axle}"][at] + 9.81 * motion[f"roll_angle_{window.axle}"][at]
        assert unlike(window.mass_lateral_acceleration, mass) < 0.01


def turned(columns: Mapping[str, FloatArray], *names: str) -> dict[str, FloatArray]:
    return {name: -values if name in names else values for name, values in columns.items()}


def in_other_units(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the run of x forward, y right, z down, in units of a measuring vehicle, gravity in the accelerometers."""
    found = {"t": 1e3 * columns["t"], "s": 1e-3 * columns["s"], "v": 3.6 * columns["v"]}
    for n in (1, 2):
        gravity = 9.81 * columns[f"roll_angle_{n}"]
        found |= {
            f"ay_{n}": -(columns[f"ay_{n}"] + gravity) / G,
            f"aym_{n}": -1e3 * (columns[f"aym_{n}"] + gravity),
            f"yaw_{n}": -np.rad2deg(columns[f"yaw_rate_{n}"]),
            f"roll_{n}": np.rad2deg(columns[f"roll_angle_{n}"]),
        }
    return found


OTHER_UNITS = (
    ('y = "left"\nz = "up"', 'y = "right"\nz = "down"'),
    ("includes_gravity = false", "includes_gravity = true"),
    ('column = "t"\nunit = "s"', 'column = "t"\nunit = "ms"'),
    ('column = "s"\nunit = "m"', 'column = "s"\nunit = "km"'),
    ('unit = "m/s"\n', 'unit = "km/h"\n'),
    *((f'column = "ay_{n}", unit = "m/s2"', f'column = "ay_{n}", unit = "g"') for n in (1, 2)),
    *((f'column = "aym_{n}", unit = "m/s2"', f'column = "aym_{n}", unit = "mm/s²"') for n in (1, 2)),
    *((f'column = "yaw_{n}", unit = "rad/s2"', f'column = "yaw_{n}", unit = "deg/s"') for n in (1, 2)),
    *((f'column = "roll_{n}", unit = "rad/s2"', f'column = "roll_{n}", unit = "deg"') for n in (1, 2)),
)


def test_units_and_axes_change_nothing(place: Received, motion: Mapping[str, FloatArray]) -> None:
    place.receiver.receive_exchange(example(place.folder, motion))
    first = place.windows()
    place.forget()
    place.receiver.receive_exchange(example(place.folder, in_other_units(motion), *OTHER_UNITS))
    second = place.windows()
    assert set(first) == set(second)
    for key, window in first.items():
        other = second[key]
        if window.quality.coverage == other.quality.coverage == 1.0:
            for name in ACCELERATIONS:
                assert unlike(getattr(other, name), getattr(window, name)) < 0.01, name


@pytest.mark.parametrize("rate", [250.0, 125.0])
def test_rates_other_than_ours_are_resampled(place: Received, motion: Mapping[str, FloatArray], rate: float) -> None:
    step = round(500.0 / rate)
    thinned = {name: values[::step] for name, values in motion.items()}
    place.receiver.receive_exchange(example(place.folder, thinned, ("rate_hz = 500", f"rate_hz = {rate:g}")))
    window = next(w for w in place.windows().values() if w.quality.coverage == 1.0)
    at = rows_of(window)
    expected = motion[f"ay_{window.axle}"][at] + 9.81 * motion[f"roll_angle_{window.axle}"][at]
    assert unlike(window.lateral_acceleration, expected) < 0.02


def test_a_vibration_above_the_new_rate_does_not_fold_back(place: Received, motion: Mapping[str, FloatArray]) -> None:
    shaken = dict(motion)
    shaken["ay_1"] = motion["ay_1"] + 20.0 * np.sin(2 * np.pi * 251.0 * motion["t"])  # would fold back to 1 Hz
    place.receiver.receive_exchange(example(place.folder, shaken))
    window = next(w for w in place.windows().values() if w.quality.coverage == 1.0 and w.axle == 1)
    at = rows_of(window)
    expected = motion["ay_1"][at] + 9.81 * motion["roll_angle_1"][at]
    assert unlike(window.lateral_acceleration, expected) < 0.01


def test_parquet_gives_what_csv_gives(place: Received, motion: Mapping[str, FloatArray]) -> None:
    path = example(place.folder, motion, ('data = "run.csv"', 'data = "run.parquet"'))
    pq.write_table(pa.table(dict(motion)), place.folder / "run.parquet", compression="zstd")
    place.receiver.receive_exchange(path)
    assert len(place.windows()) == 6


def test_a_csv_file_of_another_country(place: Received, motion: Mapping[str, FloatArray]) -> None:
    csv = '[csv]\ndelimiter = ";"\ndecimal = ","\nheader_line = 2\nfirst_line = 4\n\n[run]'
    path = example(place.folder, motion, ("[run]", csv))
    names = [match[1] for match in re.finditer(r'column = "(\w+)"', path.read_text())]
    write_csv(place.folder / "run.csv", {name: motion[name] for name in names}, delimiter=";", decimal=",")
    header, rest = (place.folder / "run.csv").read_text().split("\n", 1)
    (place.folder / "run.csv").write_text(f"a simulation\n{header}\n{';'.join('x' for _ in names)}\n{rest}")
    place.receiver.receive_exchange(path)
    assert len(place.windows()) == 6


AXES: list[tuple[tuple[str, ...], str, str]] = [
    (("ay", "aym"), "axes.y", 'y must be turned: y = "right"'),
    (("yaw",), "axes", 'the axis of yaw, z, must be turned: yaw = "front_right"'),
    (("roll",), "axes", 'the axis of roll, x, must be turned: roll = "left_down"'),
    (("aym",), "axes.y", "must be turned on each axle"),
]


@pytest.mark.parametrize(("signals", "field", "remedy"), AXES)
def test_axes_that_the_data_contradict_are_named(
    place: Received, motion: Mapping[str, FloatArray], signals: tuple[str, ...], field: str, remedy: str
) -> None:
    names = [f"{signal}_{axle}" for signal in signals for axle in (1, 2)]
    with pytest.raises(ExchangeError, match=re.escape(remedy)) as caught:
        place.receiver.receive_exchange(example(place.folder, turned(motion, *names)))
    assert caught.value.field == field
    assert caught.value.line is not None
    assert place.nothing_stored()


@pytest.mark.parametrize("signal", ["ay", "yaw", "roll", "aym"])
def test_a_sensor_that_is_turned_on_one_axle_is_named(
    place: Received, motion: Mapping[str, FloatArray], signal: str
) -> None:
    key = {"ay": "lateral", "aym": "mass_lateral"}.get(signal, signal)
    path = example(place.folder, turned(motion, f"{signal}_2"))
    with pytest.raises(ExchangeError, match=r"on axle 2, axles 1 do not: turn that sensor \(turned = true\)") as caught:
        place.receiver.receive_exchange(path)
    assert caught.value.field == f"axles[1].{key}"
    place.receiver.receive_exchange(
        example(
            place.folder,
            turned(motion, f"{signal}_2"),
            (f'column = "{signal}_2"', f'column = "{signal}_2", turned = true'),
        )
    )
    assert len(place.windows()) == 6


def test_gravity_is_as_the_sensors_of_the_class_have_it(place: Received, motion: Mapping[str, FloatArray]) -> None:
    with place.storage.write() as unit:
        unit.registry.add_vehicle(replace(unit.registry.vehicle(VEHICLE), vehicle_class="paper"))
        unit.registry.add_vehicle_class(shipped_class("paper"), 1)
    place.receiver.receive_exchange(example(place.folder, motion))
    window = next(w for w in place.windows().values() if w.quality.coverage == 1.0)
    at = rows_of(window)
    assert unlike(window.lateral_acceleration, motion[f"ay_{window.axle}"][at]) < 0.002


def test_the_same_exchange_again_changes_nothing(place: Received, motion: Mapping[str, FloatArray]) -> None:
    path = example(place.folder, motion)
    first = place.receiver.receive_exchange(path)
    again = place.receiver.receive_exchange(path)
    assert again.known
    assert again.windows_changed == 0
    assert again.record.digest == first.record.digest


def test_two_halves_in_any_order_give_the_same_windows(place: Received, motion: Mapping[str, FloatArray]) -> None:
    halves = []
    for number, part in enumerate((slice(0, 7_000), slice(7_000, None))):
        folder = place.folder / str(number)
        folder.mkdir()
        halves.append(example(folder, {name: values[part] for name, values in motion.items()}))
    found = []
    for order in (halves, halves[::-1]):
        for path in order:
            place.receiver.receive_exchange(path)
        with place.storage.read() as unit:
            found.append(
                {(r.wheelset, r.start_ns): r.content_digest for n in (1, 2) for r in unit.windows.list(f"X-{n}")}
            )
        place.forget()
    assert found[0] == found[1]
    assert len(found[0]) == 6


def test_logs_and_exchanges_do_not_share_windows(place: Received, motion: Mapping[str, FloatArray]) -> None:
    log = place.folder / f"{VEHICLE}__1.blf"
    write_blf(log, Run(seconds=12.0, start_ns=1_767_592_800_000_000_000 + 20_000_000_000).frames())
    place.receiver.receive_file(log, VEHICLE)
    with pytest.raises(ConflictError, match="an exchange of vehicle X-1 would share windows with a log that is stored"):
        place.receiver.receive_exchange(example(place.folder, motion))


def test_the_example_of_the_page_runs(
    motion: Mapping[str, FloatArray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sqlite_url: str
) -> None:
    text = re.search(r"```toml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert text is not None
    assert text[1] == EXAMPLE
    upgrade(sqlite_url)
    monkeypatch.setenv("TREADWATCH_DATABASE_URL", sqlite_url)
    monkeypatch.setenv("TREADWATCH_DATA_DIR", str(tmp_path / "data"))
    storage = SqlStorage(database_engine(sqlite_url), tmp_path / "data")
    with storage.write() as unit:
        register(unit)
    path = example(tmp_path, motion)
    code, said = command("--exchange", str(path))
    assert code == 0, said
    code, said = command("--exchange", str(path), "--exchange", str(tmp_path / "nowhere.toml"))
    assert code == 1
    assert "nowhere.toml: cannot be read" in said.replace("\n", "")
    with storage.read() as unit:
        assert unit.windows.counts()["pending"] == 2
    storage.close()
