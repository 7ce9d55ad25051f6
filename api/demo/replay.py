"""Years of fleets in a minute: recordings come in campaign by campaign, and the jobs run after each.

The clock stands at the evening of each campaign, so that what is stored (receipts, geometries, trends, alerts raised
and closed) has the times it would have had.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from api.factory import job_context, open_store, raw_store, scheduled_jobs
from api.progress import bar
from api.settings import Settings
from estimation.errors import StorageError
from estimation.jobs.job import Job, JobContext, run_job
from estimation.values.runs import JobOutcome, JobTrigger
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.receiver import Receiver
from ingest.registry_entry.contents import RegistryContents
from ingest.registry_file import read_registry
from ingest.simulator.fleet import FleetReport, Recording
from ingest.simulator.scenario import Scenario

HOUR_NS = 3_600 * 1_000_000_000
DAY_NS = 24 * HOUR_NS


@dataclass(slots=True)
class ReplayClock:
    """A clock that stands where the replay has come to."""

    now: int

    def now_ns(self) -> int:
        """Return the replayed time, later at each call as recorded times must be."""
        self.now += 1_000_000
        return self.now


@dataclass(frozen=True, slots=True)
class Simulated:
    """A fleet as planned, and its recordings, registry and truth."""

    scenario: Scenario
    report: FleetReport


def ending_now(scenario: Scenario, now_ns: int) -> Scenario:
    """Return the scenario moved in time so that its last campaign was the day before ``now_ns``."""
    last = max(scenario.start_ns(vehicle, scenario.sessions.campaigns - 1) for vehicle in scenario.vehicles)
    days = (now_ns - last) // DAY_NS - 1
    return replace(scenario, sessions=replace(scenario.sessions, start_ns=scenario.sessions.start_ns + days * DAY_NS))


def replay(settings: Settings, fleets: Sequence[Simulated], console: Console) -> Table:
    """Receive and estimate the whole history, campaigns of the first fleet first; return what was done, as a table."""
    clock = ReplayClock(min(fleet.scenario.sessions.start_ns for fleet in fleets) - DAY_NS)
    shown = bar(console, "receiving and estimating, campaign by campaign", "{task.fields[what]}")
    with closing(open_store(settings)) as storage, shown as progress:
        contents = [read_registry(fleet.report.registry) for fleet in fleets]
        for one in contents:
            _register(storage, one, clock.now_ns())
        context = replace(job_context(settings, storage), clock=clock)
        length_s = settings.window_length_s
        receiver = Receiver(storage, raw_store(settings), default_catalogue(), clock, window_length_s=length_s)
        receiver.reassembler.work_off()  # the registry is new, and there is no recording yet
        campaigns = [(end, received) for fleet in fleets for end, received in _by_campaign(fleet)]
        task = progress.add_task("", total=len(campaigns), what="")
        tally = _Tally()
        for end_ns, received in campaigns:
            clock.now = max(clock.now, end_ns)
            for one in contents:
                _reprofile(storage, one, clock.now)
            progress.update(task, what="receiving")
            tally.receive(receiver, received)
            tally.run_jobs(scheduled_jobs(settings), context, lambda job: progress.update(task, what=job))
            progress.update(task, advance=1)
        clock.now += HOUR_NS  # the runs after: windows on low friction are estimated again without it
        tally.run_jobs(scheduled_jobs(settings), context, lambda job: progress.update(task, what=job))
        progress.update(task, what="done")
    return tally.table()


class _Tally:
    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.counts: defaultdict[str, Counter[str]] = defaultdict(Counter)

    def receive(self, receiver: Receiver, recordings: Sequence[Recording]) -> None:
        began = time.monotonic()
        files: list[tuple[Path, str]] = [(recording.path, recording.vehicle) for recording in recordings]
        for _, receipt in receiver.receive_files(files):
            if isinstance(receipt, Exception):
                raise receipt
            self.add("receive", {"recordings": 1, "windows": receipt.windows_changed}, 0.0)
            self.add("receive", {k: v for k, v in receipt.record.counts.items() if k in SHOWN}, 0.0)
        self.seconds["receive"] += time.monotonic() - began

    def run_jobs(self, jobs: Sequence[Job], context: JobContext, show: Callable[[str], None]) -> None:
        for job in jobs:
            show(job.name)
            self.run(job, context)

    def run(self, job: Job, context: JobContext) -> None:
        began = time.monotonic()
        run = run_job(job, context, JobTrigger.SCHEDULE)
        if run.outcome is not JobOutcome.SUCCEEDED:
            raise StorageError(f"job {job.name} {run.outcome}: {run.error}")
        self.add(job.name, {"runs": 1, **run.counts}, time.monotonic() - began)

    def add(self, what: str, counts: Mapping[str, int], seconds: float) -> None:
        self.counts[what].update(counts)
        self.seconds[what] += seconds

    def table(self) -> Table:
        table = Table("step", "seconds", "what it did")
        for what, counts in self.counts.items():
            text = ", ".join(f"{count:,} {name.replace('_', ' ')}" for name, count in counts.items() if count)
            table.add_row(what, f"{self.seconds[what]:.1f}", text)
        return table


SHOWN = ("frames", "samples_lost", "invalid_values", "emergencies")


def _register(storage: SqlStorage, contents: RegistryContents, known_since_ns: int) -> None:
    """Store what was known from the beginning."""
    with storage.write() as unit:
        for fleet in contents.fleets:
            unit.registry.add_fleet(fleet)
        for one in contents.classes:
            unit.registry.add_vehicle_class(one, known_since_ns)
        for vehicle in contents.vehicles:
            unit.registry.add_vehicle(vehicle)
        for wheelset in contents.wheelsets:
            unit.registry.add_wheelset(wheelset)
        for mounting in contents.mountings:
            unit.registry.add_mounting(mounting)
        for section in contents.sections:
            unit.tracks.add_section(section)
        for alignment in contents.alignments:
            unit.tracks.add_alignment(alignment)
        for layout in contents.layouts:
            unit.tracks.add_layout(layout)


def _reprofile(storage: SqlStorage, contents: RegistryContents, until_ns: int) -> None:
    """Store the visits to the lathe that have taken place; what is stored already does not change."""
    with storage.write() as unit:
        for reprofiling in contents.reprofilings:
            if reprofiling.at_ns <= until_ns:
                unit.registry.add_reprofiling(reprofiling)


def _by_campaign(fleet: Simulated) -> list[tuple[int, list[Recording]]]:
    campaigns: defaultdict[int, list[Recording]] = defaultdict(list)
    for recording in fleet.report.recordings:
        campaigns[recording.campaign].append(recording)
    scenario, found = fleet.scenario, []
    for campaign in sorted(campaigns):  # from 1
        last_ns = max(scenario.start_ns(vehicle, campaign - 1) for vehicle in scenario.vehicles)
        found.append((last_ns + round(scenario.sessions.duration * 1e9) + HOUR_NS, campaigns[campaign]))
    return found
