"""One vehicle of a scenario on a live bus: its campaigns, one after the other, at the pace of its own clock."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import can

from estimation.errors import ParameterError
from ingest.bus import send
from ingest.frames import FrameBatch
from ingest.simulator.campaign import scenario_track
from ingest.simulator.fleet import simulate_campaign
from ingest.simulator.scenario import Scenario

PAUSE_S = 5.0
"""Pause between two campaigns: longer than a receiver extrapolates the vehicle's clock."""


def transmit(
    scenario: Scenario,
    bus: can.BusABC,
    vehicle: str,
    *,
    speed_up: float = 1.0,
    stop: threading.Event | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Send every campaign of ``vehicle`` on ``bus``; return the frames sent.

    The kilometres between campaigns are not waited for: the vehicle's clock and odometer jump. With ``speed_up`` the
    frames come faster than by the vehicle's clock. A receiver refuses that, because its signal catalogue contains the
    rate of SYNC.

    Args:
        progress: Called with (campaign from 1, frames sent so far) before each campaign.
    """
    if not speed_up > 0.0:
        raise ParameterError(f"{speed_up} is not positive", field="speed_up")
    plan, track, ended, sent = scenario.vehicle(vehicle), scenario_track(scenario), stop or threading.Event(), 0
    for campaign in range(scenario.sessions.campaigns):
        if campaign > 0 and ended.wait(PAUSE_S / speed_up):
            break
        if progress is not None:
            progress(campaign + 1, sent)
        batch, _ = simulate_campaign(scenario, track, plan, campaign)
        sent += send(bus, _scaled_time(batch, speed_up), stop=ended)
        if ended.is_set():
            break
    return sent


def _scaled_time(batch: FrameBatch, speed_up: float) -> FrameBatch:
    if speed_up == 1.0 or len(batch) == 0:
        return batch
    first = batch.t_ns[0]
    return replace(batch, t_ns=first + ((batch.t_ns - first) / speed_up).astype(batch.t_ns.dtype))
