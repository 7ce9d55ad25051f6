"""The true motion of wheelsets of a scenario, with whatever else moves with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from estimation.contact.geometry import ContactTable
from ingest.simulator.axle_motion import axle_motions, contact_of, together
from ingest.simulator.campaign import VehicleRun
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.scenario import Scenario
from ingest.simulator.track import TrackTruth


def wheelset_motion(
    scenario: Scenario, track: TrackTruth, run: VehicleRun, axle: int, table: ContactTable | None = None
) -> WheelsetMotion:
    """Return the true motion of the wheelset at ``axle`` (from 0) over ``run``.

    ``table`` is its contact geometry where that is at hand already; made here otherwise.
    """
    axles = together(scenario, run.vehicle, axle)
    tables = [
        contact_of(scenario, track, run.vehicle.wheelsets[place], run.odometer).table
        if table is None or place != axle
        else table
        for place in axles
    ]
    return axle_motions(scenario, track, run, axles, tables)[axles.index(axle)]


def gears_of(
    scenario: Scenario, track: TrackTruth, run: VehicleRun, tables: Sequence[ContactTable]
) -> Iterator[tuple[tuple[int, ...], tuple[WheelsetMotion, ...]]]:
    """Yield the axles that move together and their motions, for each running gear of a vehicle over ``run``."""
    axles = together(scenario, run.vehicle, 0)
    for first in range(0, len(run.vehicle.wheelsets), len(axles)):
        axles = together(scenario, run.vehicle, first)
        yield axles, axle_motions(scenario, track, run, axles, [tables[axle] for axle in axles])
