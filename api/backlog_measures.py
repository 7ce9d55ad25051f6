"""Measures of what waits and who is silent, read from the database when they are scraped."""

from __future__ import annotations

from collections import Counter as Tally

from prometheus_client.core import GaugeMetricFamily, Metric

from api.services import Services
from fleet_db.receipts import ChunkState
from fleet_db.stores.backlog import Backlog, backlog_of

SILENT_AFTER_NS = 86_400 * 1_000_000_000
"""A vehicle without data for longer is counted as silent."""


def backlog_measures(services: Services) -> list[Metric]:
    """Return what waits, since when, and how many vehicles of each fleet are silent."""
    with services.storage.read() as unit:
        found = backlog_of(unit.connection)
    return [_recordings(found), _oldest(found), *_vehicles(found, services.clock.now_ns())]


def _recordings(found: Backlog) -> Metric:
    family = GaugeMetricFamily("treadwatch_recordings", "Recordings by state.", labels=["state"])
    for state in ChunkState:
        family.add_metric([state.value], found.recordings.get(state, 0))
    return family


def _oldest(found: Backlog) -> Metric:
    text = "Since when the oldest waits that is not decoded or estimated; 0 where none waits."
    family = GaugeMetricFamily("treadwatch_oldest_waiting_timestamp_seconds", text, labels=["what"])
    for what, at_ns in (("recording", found.oldest_recording_ns), ("window", found.oldest_window_ns)):
        family.add_metric([what], 0.0 if at_ns is None else at_ns / 1e9)
    return family


def _vehicles(found: Backlog, now_ns: int) -> list[Metric]:
    vehicles = GaugeMetricFamily("treadwatch_vehicles", "Vehicles with a mounted wheelset.", labels=["fleet"])
    silent = GaugeMetricFamily(
        "treadwatch_vehicles_silent", "Those of them without data for more than a day.", labels=["fleet"]
    )
    every = Tally(fleet for fleet, _ in found.last_data)
    quiet = Tally(fleet for fleet, at_ns in found.last_data if at_ns is None or at_ns < now_ns - SILENT_AFTER_NS)
    for fleet, count in sorted(every.items()):
        vehicles.add_metric([fleet], count)
        silent.add_metric([fleet], quiet[fleet])
    return [vehicles, silent]
