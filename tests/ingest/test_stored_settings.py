"""The window length and the buses of a deployment: stored with the first recording, checked by every service."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest
from test_own_bus import mapping
from test_receiver import CountingClock, files_of
from vehicle_bus import VEHICLE, Run, register

from api.factory import open_store
from api.settings import Settings
from estimation.errors import ParameterError
from estimation.values.registry import VehicleRecord
from fleet_db.raw import FileRawStore
from fleet_db.storage import SqlStorage
from ingest.catalogue import Catalogue, default_catalogue
from ingest.own_bus.bus import OwnBus
from ingest.own_bus.loading import load_own_bus
from ingest.receiver import Receiver
from ingest.stored_settings import BusChoice, bus_choice, claim

LENGTH_NS = 10_000_000_000
SHIPPED = bus_choice(default_catalogue(), [])


@pytest.fixture
def registered(storage: SqlStorage) -> SqlStorage:
    """Return a storage that knows a multiple unit and a coach, once on each database."""
    with storage.write() as unit:
        register(unit)
        unit.registry.add_vehicle(VehicleRecord("N-8", "north", "coach", 2, 40.0, (2.0, 4.5)))
    return storage


def receive(storage: SqlStorage, folder: Path, buses: BusChoice = SHIPPED) -> None:
    chosen = claim(storage, buses, LENGTH_NS, 1)
    receiver = Receiver(storage, FileRawStore(folder / "raw"), chosen, CountingClock(), LENGTH_NS / 1e9)
    receiver.receive_file(files_of([Run(seconds=12.0).frames()], folder)[0], VEHICLE)
    stale(storage)  # what the registry has left


def opened(storage: SqlStorage, seconds: float) -> None:
    url = storage.engine.url.render_as_string(hide_password=False).replace("+psycopg", "").replace("+pysqlite", "")
    open_store(Settings(database_url=url, data_dir=storage.data_dir, window_length_s=seconds)).close()


def own_bus(folder: Path, classes: tuple[str, ...], *changes: tuple[str, str]) -> OwnBus:
    return replace(load_own_bus(mapping(folder, *changes)), vehicle_classes=classes)


def stale(storage: SqlStorage) -> list[str]:
    """Return the vehicles that are to be assembled again, and forget that."""
    with storage.write() as unit:
        spans = unit.stale_spans.all()
        unit.stale_spans.remove(spans)
    return [span.vehicle for span in spans]


def test_another_window_length_is_refused_by_every_service_once_a_recording_is_stored(
    registered: SqlStorage,
) -> None:
    claim(registered, SHIPPED, 7_000_000_000, 1)
    opened(registered, 60.0)  # nothing is stored with it yet
    receive(registered, registered.data_dir.parent)
    opened(registered, 10.0)
    with pytest.raises(ParameterError, match=r"WINDOW_LENGTH_S.*is 60 s, and the windows .* have 10 s: set it to 10"):
        opened(registered, 60.0)
    with pytest.raises(ParameterError, match="is 20 s"):
        claim(registered, SHIPPED, 20_000_000_000, 2)


def test_a_changed_catalogue_makes_the_vehicles_stale_that_it_decodes(registered: SqlStorage, tmp_path: Path) -> None:
    receive(registered, tmp_path)
    plans = default_catalogue().messages
    turned = Catalogue(MappingProxyType(dict(reversed(plans.items()))), default_catalogue().sample_interval_ns)
    claim(registered, BusChoice(turned, {}), LENGTH_NS, 2)
    assert stale(registered) == [], "the order in the file means nothing"
    key, plan = next((key, plan) for key, plan in plans.items() if plan.signals)
    signals = (replace(plan.signals[0], scale=2.0 * plan.signals[0].scale), *plan.signals[1:])
    changed = Catalogue(MappingProxyType({**plans, key: replace(plan, signals=signals)}), 4_000_000)
    claim(registered, BusChoice(changed, {}), LENGTH_NS, 3)
    assert stale(registered) == [VEHICLE, "N-8"]
    claim(registered, BusChoice(changed, {}), LENGTH_NS, 4)
    assert stale(registered) == [], "once"
    claim(registered, bus_choice(changed, [own_bus(tmp_path, ("coach",))]), LENGTH_NS, 5)
    assert stale(registered) == ["N-8"]


def test_a_process_without_the_mapping_file_leaves_its_vehicles_alone(registered: SqlStorage, tmp_path: Path) -> None:
    receive(registered, tmp_path, bus_choice(default_catalogue(), [own_bus(tmp_path, ("coach",))]))
    chosen = claim(registered, SHIPPED, LENGTH_NS, 2)
    assert stale(registered) == []
    assert chosen.of_class("multiple unit") is default_catalogue()
    with pytest.raises(ParameterError, match=r"class 'coach' .* file that is not given .*TREADWATCH_CATALOGUES"):
        chosen.of_vehicle({"N-8": "coach"}.get, "N-8")
    again = claim(registered, bus_choice(default_catalogue(), [own_bus(tmp_path, ("coach",))]), LENGTH_NS, 3)
    assert isinstance(again.of_class("coach"), OwnBus)
    assert stale(registered) == []


def test_a_mapping_file_for_all_classes_is_missed_by_all(registered: SqlStorage, tmp_path: Path) -> None:
    receive(registered, tmp_path)
    claim(registered, bus_choice(default_catalogue(), [own_bus(tmp_path, ())]), LENGTH_NS, 2)
    assert stale(registered) == [VEHICLE, "N-8"]
    with pytest.raises(ParameterError, match="mapping file that is not given"):
        claim(registered, SHIPPED, LENGTH_NS, 3).of_vehicle({}.get, VEHICLE)
    assert stale(registered) == []
