"""A small vehicle on a bus, made for tests: two wheelsets whose every sample is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from estimation.storage import UnitOfWork
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord, WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import ACCELERATIONS
from ingest import catalogue as kinds
from ingest.catalogue import default_catalogue, sync_counter, time_of_day
from ingest.codec import encode
from ingest.frames import FrameBatch, concatenate, sort_by_time

CATALOGUE = default_catalogue()
INTERVAL_NS = CATALOGUE.sample_interval_ns
SECOND_NS = 1_000_000_000
START_NS = 1_750_000_000 * SECOND_NS + 3 * SECOND_NS
VEHICLE = "N-7"
OFFSETS_M = (2.0, 4.5)
SECTION = 12
SLOT_NS = 200_000


@dataclass(frozen=True)
class Run:
    """A run of the vehicle; ``changes`` replace signals by message kind and name (arrays over ticks, or numbers)."""

    seconds: float = 25.0
    start_ns: int = START_NS
    recorder_offset_ns: int = 37_123_456_789
    speed: float = 20.0
    distance: float = 100.0
    odometer: float = 5_000_000.0
    seed: int = 1
    changes: Mapping[tuple[str, int], Mapping[str, object]] = field(default_factory=dict)

    @property
    def ticks(self) -> np.ndarray:
        return self.start_ns // INTERVAL_NS + np.arange(round(self.seconds * SECOND_NS / INTERVAL_NS))

    def accelerations(self, node: int) -> dict[str, np.ndarray]:
        """Return what a node says, on whole counts: different for every node, signal and sample."""
        rng = np.random.default_rng([self.seed, node])
        plan = CATALOGUE.find(kinds.ACCELERATION, node)
        return {name: rng.integers(-9000, 9000, len(self.ticks)) * plan.signal(name).scale for name in ACCELERATIONS}

    def metres(self) -> np.ndarray:
        return self.speed * (self.ticks - self.ticks[0]) * INTERVAL_NS * 1e-9

    def frames(self) -> FrameBatch:
        ticks = self.ticks
        metres = self.metres()
        milliseconds, days = time_of_day(ticks * INTERVAL_NS)
        said: list[tuple[str, int | None, Mapping[str, object]]] = [
            (kinds.SYNC, None, {"counter": sync_counter(ticks)}),
            (kinds.TIME, None, {"milliseconds": milliseconds, "days": days}),
            (kinds.MOTION, 16, {"speed": self.speed, "odometer": self.odometer + metres}),
            (
                kinds.POSITION,
                16,
                {"track_section": SECTION, "distance": self.distance + metres, "position_quality": 0.9},
            ),
        ]
        if (kinds.PLACE, 16) in self.changes:
            said.append((kinds.PLACE, 16, {}))
        for node in (1, 2):
            said.append((kinds.ACCELERATION, node, self.accelerations(node)))
            said.append((kinds.STATUS, node, {"sample_counter": 1000 + np.arange(len(ticks))}))
        batches = []
        for slot, (kind, node, values) in enumerate(said):
            plan = CATALOGUE.find(kind, node)
            at = np.flatnonzero(ticks * INTERVAL_NS % plan.cycle_ns == 0)
            changed = {**values, **self.changes.get((kind, node or 0), {})}
            given = {name: np.broadcast_to(value, ticks.shape)[at] for name, value in changed.items()}
            stamps = ticks[at] * INTERVAL_NS + self.recorder_offset_ns + slot * SLOT_NS
            batches.append(encode(plan, stamps, given))
        return sort_by_time(concatenate(batches))


def register(unit: UnitOfWork) -> None:
    """Store what the registry must know of the vehicle."""
    registry = unit.registry
    registry.add_fleet(FleetRecord("north", "North"))
    registry.add_vehicle(VehicleRecord(VEHICLE, "north", "multiple unit", 2, 40.0, OFFSETS_M))
    unit.tracks.add_section(TrackSectionRecord("KM12", SECTION, "km 12", "56E1", 0.05, 1.435, 20_000.0))
    for axle in (1, 2):
        registry.add_wheelset(WheelsetRecord(f"WS-{axle}", "north", "P8", 0.45, None))
        registry.add_mounting(Mounting(f"WS-{axle}", VEHICLE, axle, 0, None, 4000.0, 700.0 * axle))
