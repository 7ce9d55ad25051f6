"""Small simulated fleets on one section, and deployments that are to get their recordings while something happens."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from api.comparison.trial import Recorded, copied, deploy, receive, record, register
from api.factory import open_store
from api.settings import Settings
from bench.made_scenario import scenario_of
from bench.services import created
from fleet_db.migrate import upgrade
from fleet_db.storage import SqlStorage
from ingest.simulator.scenario import Scenario

LARGEST_SPEED = 22.0  # m/s
APPLICATION_AT = 8
"""Place of four bytes of a BLF file that name the program: with them each copy has a digest of its own."""

START = datetime(2024, 1, 8, 5, 30, tzinfo=UTC)


def small_fleet(
    code: str,
    wheelsets: Mapping[str, Sequence[tuple[float, float]]],
    offsets: Sequence[float],
    minutes: float,
    *,
    campaigns: int = 2,
    surveyed: bool = True,
    seed: int = 3,
    km_between: float = 300.0,
    position_m: float | None = None,
    within_m: float | None = None,
) -> Scenario:
    """Return vehicles on one section; wheelsets by vehicle have wear and wear by 100,000 km, mm."""
    section, length = f"{code}-1", LARGEST_SPEED * 60.0 * minutes + 100.0 + 2.0 * (within_m or 0.0)
    return scenario_of(
        {
            "name": "BENCH",
            "description": "vehicles on one section",
            "seed": seed,
            "fleet": {"code": code, "name": f"Fleet {code}"},
            "section": {
                "code": section,
                "number": 1,
                "name": f"Section {section}",
                "length_m": length,
                "surveyed": surveyed,
            },
            "speed": {"lowest_m_s": 14.0, "highest_m_s": LARGEST_SPEED},
            "sensors": {"kind": "mems"},
            "bus": {"recorder_clock_offset_s": 1.5},
            **({"position": {"largest_offset_m": position_m, "largest_scale_percent": 0.1}} if position_m else {}),
            "sessions": {
                "start": START,
                "campaigns": campaigns,
                "minutes_each": minutes,
                "first_odometer_km": 1000.0,
                "km_between": km_between,
                "km_per_day": 500.0,
                **({"start_within_m": within_m} if within_m else {}),
            },
            "vehicles": [_vehicle(f"{code}-{vehicle}", offsets, worn) for vehicle, worn in wheelsets.items()],
        }
    )


def _vehicle(code: str, offsets: Sequence[float], wheelsets: Sequence[tuple[float, float]]) -> dict[str, Any]:
    return {
        "code": code,
        "class": "railcar",
        "max_speed_km_h": 120.0,
        "axle_offsets_m": list(offsets),
        "wheelsets": [
            {"serial": f"{code}{axle}", "initial_wear_mm": worn, "wear_mm_per_100000_km": wear}
            for axle, (worn, wear) in enumerate(wheelsets, start=1)
        ],
    }


def cars(vehicles: int, wear: float = 0.0) -> dict[str, list[tuple[float, float]]]:
    """Return vehicles of four wheelsets."""
    return {str(number): [(round(0.2 * axle, 2), wear) for axle in range(1, 5)] for number in range(1, vehicles + 1)}


FOUR_AXLES = (2.0, 4.5, 14.0, 16.5)


@dataclass(frozen=True, slots=True)
class Workload:
    """A deployment, and the recordings that it is to get.

    ``received`` is copied for each measurement; its database is one of ``server`` where there is one.
    """

    received: Settings
    recordings: Sequence[tuple[str, Path]]
    server: str | None = None
    password: str | None = None

    @property
    def recorded(self) -> Recorded:
        """The recordings, for a receiver."""
        return Recorded(tuple(self.recordings), self.received.data_dir)

    def copy(self, folder: Path) -> Settings:
        """Return a deployment of its own, in a new folder."""
        settings = copied(self.received, folder)
        if self.server is None:
            return settings.model_copy(update={"database_url": None})
        url = created(self.server, f"d{uuid.uuid4().hex[:12]}", "received", self.password)
        return settings.model_copy(update={"database_url": url})


def deployed(
    folder: Path, scenario: Scenario, server: str | None = None, password: str | None = None, workers: int = 2
) -> Workload:
    """Return a deployment that has received nothing, and the recordings of a scenario; its server is PostgreSQL's."""
    recorded = record(scenario, folder / "recordings", workers=workers)
    home = folder / ("sqlite" if server is None else "postgresql")
    settings = deploy(scenario, home)
    if server is not None:
        settings = settings.model_copy(update={"database_url": created(server, "received", password=password)})
        upgrade(settings.url)
        register(scenario, settings, home / "registered")
    return Workload(settings, recorded.recordings, server, password)


def workload(
    folder: Path, vehicles: int, minutes: float, server: str | None = None, *, surveyed: bool = True
) -> Workload:
    """Return two journeys of each of some vehicles of four wheelsets, of which the first is received already."""
    scenario = small_fleet("K", cars(vehicles), FOUR_AXLES, minutes, surveyed=surveyed)
    load = deployed(folder, scenario, server)
    receive(replace(load, recordings=load.recordings[:1]).recorded, load.received)
    return replace(load, recordings=load.recordings[1:])


def kept_for_ever(folder: Path) -> Path:
    """Return a retention file: the recordings are older than what is kept by default."""
    file = folder / "retention.toml"
    file.write_text('[days]\nwindow_samples = "for ever"\nwindow_bin_tables = "for ever"\n', encoding="utf-8")
    return file


def put_copies(storage: SqlStorage, model: str, codes: Sequence[str]) -> None:
    """Put copies of a vehicle with its wheelsets on file."""
    with storage.write() as unit:
        like = unit.registry.vehicle(model)
        mounted = [one for one in unit.registry.wheelsets() if one.mounting and one.mounting.vehicle == model]
        for code in codes:
            unit.registry.add_vehicle(replace(like, code=code))
            for wheelset in mounted:
                assert wheelset.mounting is not None
                serial = f"{code}-{wheelset.mounting.axle}"
                own = replace(wheelset.mounting, wheelset=serial, vehicle=code)
                unit.registry.add_wheelset(replace(wheelset, serial=serial, mounting=own))
            unit.stale_spans.remove(unit.stale_spans.all(code))  # it has no recording yet


def put_copies_into(settings: Settings, model: str, codes: Sequence[str]) -> None:
    """Put copies of a vehicle on file in a deployment that nobody has open."""
    with closing(open_store(settings)) as storage:
        put_copies(storage, model, codes)


def copy_of(content: bytes, number: int) -> bytes:
    """Return a BLF file with another digest."""
    own = bytearray(content)
    own[APPLICATION_AT : APPLICATION_AT + 4] = number.to_bytes(4, "little")
    return bytes(own)


def copies(folder: Path, content: bytes, vehicles: int) -> tuple[tuple[str, Path], ...]:
    """Return vehicles with copies of a recording, each with a digest of its own."""
    folder.mkdir()
    found = []
    for number in range(vehicles):
        found.append((code_of(number), folder / f"{number:05d}.blf"))
        found[-1][1].write_bytes(copy_of(content, number))
    return tuple(found)


def code_of(number: int) -> str:
    """Return the code of a copied vehicle."""
    return f"C-{number:05d}"
