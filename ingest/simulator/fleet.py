"""A whole scenario: every vehicle and campaign simulated and recorded, with registry and truth beside."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
from scipy.interpolate import CubicSpline

from estimation.errors import ParameterError, ScenarioError
from estimation.values.arrays import FloatArray
from estimation.values.units import SECOND_NS
from ingest.catalogue import default_catalogue
from ingest.frames import FrameBatch
from ingest.live.listening import send
from ingest.logs.blf_layout import write_blf
from ingest.simulator.axle_motion import (
    DerailmentError,
    GeometryTruth,
    axle_motions,
    contact_of,
    together,
    true_geometry,
    wear_at,
)
from ingest.simulator.bus_frames import vehicle_frames
from ingest.simulator.campaign import (
    TURNED,
    failed,
    length_ahead,
    runs_rear_first,
    scenario_track,
    seen_from_ahead,
    vehicle_run,
    wheelset_record,
    with_margins,
)
from ingest.simulator.drawn_fleet import no_wear_left, shares_of_wear, with_less_wear
from ingest.simulator.scenario import Scenario, Stream, VehiclePlan, generator, seed_of
from ingest.simulator.sensors import SensorRecord
from ingest.simulator.side_files import WheelsetTruth, write_registry, write_truth
from ingest.simulator.track import TrackTruth, from_zero, make_track, read_track

LEAST_SHARE = 0.9  # of the section that the survey of another one must cover


def surveyed(scenario: Scenario, track: TrackTruth) -> TrackTruth:
    """Return the track that is on file of the scenario's section, its curves as built.

    The survey's own errors are white, of the survey's standard deviations, smoothed over some 2 m as a chord does. The
    other ways in which it may be wrong come before them: another section, of all or of the gauge alone, a shift along
    the track, a factor.
    """
    plan, section = scenario.section.survey, scenario.section
    source = track
    if plan.other_section or plan.gauge_other_section:
        other = _other_section(scenario, track)
        source = other if plan.other_section else replace(track, gauge_deviation=other.gauge_deviation)
    if plan.shift:
        source = replace(_on_grid(source, source.s - plan.shift), s=source.s)  # at its ends the first and last value
    rng = generator(scenario.seed, Stream.SURVEY)
    alignment_error = _error(len(track.s), section.survey_alignment_std, track.interval, rng)
    gauge_error = _error(len(track.s), section.survey_gauge_std, track.interval, rng)
    alignment, gauge = plan.alignment_factor * source.alignment, plan.gauge_factor * source.gauge_deviation
    if not plan.gauge:
        gauge, gauge_error = np.zeros_like(gauge), np.zeros_like(gauge)
    return TrackTruth(track.s, alignment + alignment_error, gauge + gauge_error, track.curves)


def _other_section(scenario: Scenario, track: TrackTruth) -> TrackTruth:
    """Return another section on the grid of ``track``: in a file, or of the same recipe with another seed."""
    section = scenario.section
    if section.survey.file is None:
        assert section.recipe is not None
        return make_track(with_margins(scenario, section.recipe), seed_of(scenario.seed, Stream.OTHER_SECTION))
    other = from_zero(read_track(section.survey.file))
    if other.length < LEAST_SHARE * track.length:
        reason = f"has {other.length:.0f} m of track, the section {track.length:.0f} m"
        raise ScenarioError(reason, file=section.survey.file, field="section.survey.file")
    return _on_grid(other, track.s)


def _on_grid(track: TrackTruth, s: FloatArray) -> TrackTruth:
    at = np.clip(s, track.s[0], track.s[-1])
    values = CubicSpline(track.s, np.column_stack([track.alignment, track.gauge_deviation]))(at)
    return TrackTruth(s, values[:, 0], values[:, 1])


def _error(n: int, std: float, interval: float, rng: np.random.Generator) -> FloatArray:
    white = rng.standard_normal(n)
    if std == 0.0:
        return np.zeros(n)
    window = np.hanning(max(3, round(4.0 / interval)))
    return np.asarray(std * np.convolve(white, window / np.sqrt((window**2).sum()), mode="same"))


STAMP = "%Y%m%dT%H%M%SZ"


@dataclass(frozen=True, slots=True)
class Recording:
    """One campaign of one vehicle, written."""

    vehicle: str
    campaign: int  # from 1
    path: Path
    frames: int
    wheelset_seconds: float
    truths: tuple[WheelsetTruth, ...]


@dataclass(frozen=True, slots=True)
class FleetReport:
    """What a run of a scenario left behind."""

    recordings: tuple[Recording, ...]
    registry: Path
    truth: Path

    @property
    def frames(self) -> int:
        """Frames written."""
        return sum(item.frames for item in self.recordings)

    @property
    def wheelset_seconds(self) -> float:
        """Simulated time, summed over wheelsets, s."""
        return sum(item.wheelset_seconds for item in self.recordings)


Progress = Callable[[int, int, Recording], None]
"""Called after each recording with how many are done, how many there are, and the one just written."""


def run_fleet(
    scenario: Scenario,
    out: Path,
    *,
    vehicles: Sequence[str] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> FleetReport:
    """Simulate ``scenario`` into ``out``: recordings per vehicle and campaign, ``registry.json``, ``truth.json``.

    Recordings are ``<vehicle>/<vehicle>__<start, UTC>.blf``; the same scenario gives the same bytes, however many
    workers there are (by default as many as cores, at most the recordings; 1 is this process). The registry names all
    vehicles, also where only some are simulated.
    """
    chosen = [scenario.vehicle(code) for code in vehicles] if vehicles is not None else list(scenario.vehicles)
    track = scenario_track(scenario)
    registry = prepare(scenario, out)
    every = tuple(range(scenario.sessions.campaigns))
    tasks: list[tuple[str, Campaigns]] = [(plan.code, (campaign,)) for campaign in every for plan in chosen]
    if scenario.drawn is not None:  # the wear of a drawn vehicle follows from all of its campaigns
        tasks = [(plan.code, every) for plan in chosen]
    total = sum(len(campaigns) for _, campaigns in tasks)
    count = workers if workers is not None else min(os.cpu_count() or 1, len(tasks))
    recordings: list[Recording] = []
    for written in _recordings(scenario, out, track, tasks, count):
        for recording in written:
            recordings.append(recording)
            if progress is not None:
                progress(len(recordings), total, recording)
    recordings.sort(key=lambda item: (item.campaign, item.vehicle))
    truth = write_truth(out, scenario, [truth for item in recordings for truth in item.truths])
    return FleetReport(tuple(recordings), registry, truth)


def prepare(scenario: Scenario, out: Path) -> Path:
    """Write the registry of ``scenario`` and the track that is on file into ``out``; return the registry's path."""
    out.mkdir(parents=True, exist_ok=True)
    track = scenario_track(scenario)
    return write_registry(out, scenario, track, surveyed(scenario, track))


Campaigns = tuple[int, ...]  # campaigns (from 0) of one vehicle that are simulated together


def record(scenario: Scenario, out: Path, track: TrackTruth, vehicle: str, campaigns: Campaigns) -> list[Recording]:
    """Simulate campaigns of one vehicle and write their recordings, each whole or not at all."""
    if scenario.drawn is None:
        plan = scenario.vehicle(vehicle)
        return [_write(scenario, out, plan, c, *simulate_campaign(scenario, track, plan, c)) for c in campaigns]
    axles: list[_Axle] = []
    for group in _groups(scenario, scenario.vehicle(vehicle)):
        scenario, moved = _group_on_the_rails(scenario, track, vehicle, group, campaigns)
        axles += moved
    plan = scenario.vehicle(vehicle)
    return [
        _write(scenario, out, plan, campaign, *_campaign(scenario, track, plan, axles, campaign))
        for campaign in campaigns
    ]


_Axle = tuple[Mapping[int, SensorRecord | None], GeometryTruth]
"""What a wheelset's node measures by campaign, None where it has failed; the geometry, which does not wear between."""


def _groups(scenario: Scenario, vehicle: VehiclePlan) -> list[tuple[int, ...]]:
    groups = (together(scenario, vehicle, axle) for axle in range(len(vehicle.wheelsets)))
    return list(dict.fromkeys(groups))


def _group_on_the_rails(
    scenario: Scenario, track: TrackTruth, vehicle: str, group: tuple[int, ...], campaigns: Campaigns
) -> tuple[Scenario, list[_Axle]]:
    """Return the scenario with as much wear as keeps wheelsets on the rails, and these.

    In narrow places a worn wheelset may hunt until it leaves the rails, and a nearly new one too: no railway runs them.
    """
    shares = {axle: shares_of_wear(scenario.vehicle(vehicle).wheelsets[axle]) for axle in group}
    tries = dict.fromkeys(group, 0)
    while True:
        tried = scenario
        for axle in group:
            tried = with_less_wear(tried, vehicle, axle, shares[axle][tries[axle]])
        try:
            return tried, _group(tried, track, vehicle, group, campaigns)
        except DerailmentError as error:
            tries[error.axle] += 1
            if tries[error.axle] == len(shares[error.axle]):
                raise no_wear_left(scenario, vehicle, error.axle, error) from error


def _group(
    scenario: Scenario, track: TrackTruth, code: str, group: tuple[int, ...], campaigns: Campaigns
) -> list[_Axle]:
    """Return what the nodes of wheelsets that move together measure in every campaign, and their geometry at first."""
    plan = scenario.vehicle(code)
    wheelsets = [plan.wheelsets[axle] for axle in group]
    contacts = [contact_of(scenario, track, wheelset, scenario.odometer(campaigns[0])) for wheelset in wheelsets]
    records: list[dict[int, SensorRecord | None]] = [{} for _ in group]
    for campaign in campaigns:
        working = [not failed(wheelset, campaign) for wheelset in wheelsets]
        for found in records:
            found[campaign] = None
        if not any(working):
            continue
        run = vehicle_run(scenario, track, plan, campaign)
        back = runs_rear_first(scenario, campaign)
        if back:
            seen, vehicle = seen_from_ahead(scenario, plan)
            ahead = replace(run, vehicle=vehicle, distance=run.distance + length_ahead(plan))
            places = tuple(len(vehicle.wheelsets) - 1 - axle for axle in reversed(group))
            turned = [contact_of(seen, track, vehicle.wheelsets[place], run.odometer).table for place in places]
            motions = axle_motions(seen, track, ahead, places, turned)[::-1]
        else:
            motions = axle_motions(scenario, track, run, group, [contact.table for contact in contacts])
        for found, axle, motion, works in zip(records, group, motions, working, strict=True):
            if works:
                record = wheelset_record(scenario, run, axle, motion)
                found[campaign] = replace(record, values=record.values * TURNED) if back else record
    truths = (true_geometry(scenario, *pair) for pair in zip(wheelsets, contacts, strict=True))
    return list(zip(records, truths, strict=True))


def _campaign(
    scenario: Scenario, track: TrackTruth, vehicle: VehiclePlan, axles: Sequence[_Axle], campaign: int
) -> tuple[FrameBatch, tuple[WheelsetTruth, ...]]:
    run = vehicle_run(scenario, track, vehicle, campaign)
    batch = vehicle_frames(default_catalogue(), scenario, run, [records[campaign] for records, _ in axles])
    wears = [wear_at(wheelset, run.odometer) for wheelset in vehicle.wheelsets]
    truths = (
        WheelsetTruth(vehicle.code, place, campaign + 1, wear, geometry)
        for place, (wear, (_, geometry)) in enumerate(zip(wears, axles, strict=True), start=1)
    )
    return batch, tuple(truths)


def _write(
    scenario: Scenario,
    out: Path,
    vehicle: VehiclePlan,
    campaign: int,
    batch: FrameBatch,
    truths: tuple[WheelsetTruth, ...],
) -> Recording:
    start = datetime.fromtimestamp(scenario.start_ns(vehicle, campaign) // SECOND_NS, tz=UTC).strftime(STAMP)
    path = out / vehicle.code / f"{vehicle.code}__{start}.blf"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_blf(path, batch)
    whole = scenario.sessions.whole_section
    seconds = 1e-9 * float(batch.t_ns[-1] - batch.t_ns[0]) if whole else scenario.duration(vehicle)
    seconds *= len(vehicle.wheelsets)
    return Recording(vehicle.code, campaign + 1, path, len(batch), seconds, truths)


def simulate_campaign(
    scenario: Scenario, track: TrackTruth, vehicle: VehiclePlan, campaign: int
) -> tuple[FrameBatch, tuple[WheelsetTruth, ...]]:
    """Return all frames of one campaign of one vehicle, and the truth of its wheelsets."""
    groups = _groups(scenario, vehicle)
    axles = [axle for group in groups for axle in _group(scenario, track, vehicle.code, group, (campaign,))]
    return _campaign(scenario, track, vehicle, axles, campaign)


def _recordings(
    scenario: Scenario, out: Path, track: TrackTruth, tasks: Sequence[tuple[str, Campaigns]], workers: int
) -> Iterator[list[Recording]]:
    """Yield recordings as they are done; the first failure cancels what has not begun."""
    if workers <= 1:
        for code, campaigns in tasks:
            yield record(scenario, out, track, code, campaigns)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        futures: list[Future[list[Recording]]] = [
            pool.submit(record, scenario, out, track, code, campaigns) for code, campaigns in tasks
        ]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


PAUSE_S = 5.0  # pause between two campaigns: longer than a receiver extrapolates the vehicle's clock


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
    rate of SYNC. ``progress`` is called with (campaign from 1, frames sent so far) before each campaign.
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
        if speed_up != 1.0 and len(batch):
            since = (batch.t_ns - batch.t_ns[0]) / speed_up
            batch = replace(batch, t_ns=batch.t_ns[0] + since.astype(batch.t_ns.dtype))
        sent += send(bus, batch, stop=ended)
        if ended.is_set():
            break
    return sent
