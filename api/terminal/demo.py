"""The demo: the main job, end to end, on the embedded default, with its tables."""

from __future__ import annotations

import shutil
import socket
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote

from rich.console import Console
from rich.table import Table

from api import logs
from api.access.keys import EVERYTHING, Wanted
from api.demo.findings import ServiceAddress, get, lines, second_opinions, tables, to_do, track_lines, true_campaigns
from api.factory import open_store, raw_store
from api.pipeline import job_context, scheduled_jobs
from api.serving import create_server
from api.settings import Settings, load_settings
from api.terminal.keys import make_stored_key
from api.terminal.progress import bar
from api.terminal.simulate import simulate_with_progress
from api.terminal.stopping import stop_on_signals
from estimation.errors import StorageError
from estimation.jobs.job import Job, JobContext, run_job
from estimation.jobs.scheduler import serve_jobs
from estimation.values.runs import JobOutcome, JobTrigger
from estimation.values.units import DAY_NS, HOUR_NS
from fleet_db.migrate import upgrade
from fleet_db.records import Decision
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.input_file import InputFile
from ingest.receiver import Receiver
from ingest.registry_entry.contents import Entry, RegistryContents
from ingest.registry_entry.enter import enter
from ingest.registry_file import read_registry
from ingest.simulator.fleet import FleetReport, Recording, prepare
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario


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


def replay(settings: Settings, fleets: Sequence[Simulated], clock: ReplayClock, console: Console) -> Table:
    """Receive and estimate the whole history, campaigns of the first fleet first; return what was done, as a table."""
    shown = bar(console, "receiving and estimating, campaign by campaign", "{task.fields[what]}")
    with closing(open_store(settings)) as storage, shown as progress:
        contents = {fleet.report.registry: read_registry(fleet.report.registry) for fleet in fleets}
        context = replace(job_context(settings, storage), clock=clock)
        length_s = settings.window_length_s
        receiver = Receiver(storage, raw_store(settings), default_catalogue(), clock, window_length_s=length_s)
        receiver.reassembler.work_off()  # the registry is new, and there is no recording yet
        campaigns = [(end, received) for fleet in fleets for end, received in _by_campaign(fleet)]
        task = progress.add_task("", total=len(campaigns), what="")
        tally, entered_ns = _Tally(), clock.now
        for end_ns, received in campaigns:
            clock.now = max(clock.now, end_ns)
            for path, registry in contents.items():
                happened = on_file(registry, clock.now)
                if _events(happened) > _events(on_file(registry, entered_ns)):
                    _enter(happened, path, storage, clock)
            entered_ns = clock.now
            progress.update(task, what="receiving")
            tally.receive(receiver, received)
            tally.run_jobs(scheduled_jobs(settings), context, lambda job: progress.update(task, what=job))
            progress.update(task, advance=1)
        clock.now += HOUR_NS  # the runs after: windows on low friction are estimated again without it
        tally.run_jobs(scheduled_jobs(settings), context, lambda job: progress.update(task, what=job))
        progress.update(task, what="done")
    return tally.table()


def on_file(registry: RegistryContents, at_ns: int) -> RegistryContents:
    """Return the registry without what has not happened yet: visits to the lathe, measurements, other sensors."""
    return replace(
        registry,
        reprofilings=tuple(visit for visit in registry.reprofilings if visit.at_ns <= at_ns),
        measured_profiles=tuple(measured for measured in registry.measured_profiles if measured.at_ns <= at_ns),
        sensor_changes=tuple(change for change in registry.sensor_changes if change.at_ns <= at_ns),
    )


def _events(registry: RegistryContents) -> int:
    return len(registry.reprofilings) + len(registry.measured_profiles) + len(registry.sensor_changes)


def _enter(registry: RegistryContents, path: Path, storage: SqlStorage, clock: ReplayClock) -> None:
    with storage.write() as unit:
        enter(registry, unit, InputFile(path, {}), Entry(Decision(recorded_ns=clock.now_ns())))


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


def _by_campaign(fleet: Simulated) -> list[tuple[int, list[Recording]]]:
    campaigns: defaultdict[int, list[Recording]] = defaultdict(list)
    for recording in fleet.report.recordings:
        campaigns[recording.campaign].append(recording)
    scenario, visits = fleet.scenario, []
    for campaign in sorted(campaigns):  # from 1
        last_ns = max(scenario.start_ns(vehicle, campaign - 1) for vehicle in scenario.vehicles)
        visits.append((last_ns + round(scenario.sessions.duration * 1e9) + HOUR_NS, campaigns[campaign]))
    return visits


START_S = 30.0


@contextmanager
def serving(settings: Settings) -> Iterator[str]:
    """Serve the REST API and run the jobs on schedule; yield the base URL, and end both on leaving."""
    stopping = threading.Event()

    def schedule() -> None:
        with closing(open_store(settings)) as storage:
            serve_jobs(job_context(settings, storage), scheduled_jobs(settings), stopping, holder="demo")

    scheduler = threading.Thread(target=schedule, name="scheduler", daemon=True)
    with serving_api(settings) as url:
        scheduler.start()
        try:
            yield url
        finally:
            stopping.set()
            scheduler.join(settings.shutdown_timeout_s)


@contextmanager
def serving_api(settings: Settings) -> Iterator[str]:
    """Serve the REST API alone; yield its base URL."""
    api = create_server(settings)
    thread = threading.Thread(target=api.run, name="api", daemon=True)
    thread.start()
    try:
        deadline = time.monotonic() + START_S
        while not api.started:
            if time.monotonic() > deadline or not thread.is_alive():
                raise StorageError(f"the API did not start on {settings.host}:{settings.port}")
            time.sleep(0.05)
        yield f"http://{settings.host}:{settings.port}"
    finally:
        api.should_exit = True
        thread.join(settings.shutdown_timeout_s)


def free_port(host: str, wanted: int) -> int:
    """Return ``wanted`` if it can be listened on, else a free port."""
    for port in (wanted, 0):
        with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise StorageError(f"no port can be listened on at {host}")


FILE = "rules.toml"


def with_rules(settings: Settings, name: str, folder: Path) -> Settings:
    """Return settings with the rules of a scenario, put into the folder, unless the deployment names others."""
    shipped = files("api.demo").joinpath("rules", f"{name}.toml")
    if settings.rules_file is not None or not shipped.is_file():
        return settings
    file = folder / FILE
    file.write_text(shipped.read_text(encoding="utf-8"), encoding="utf-8")
    return settings.model_copy(update={"rules_file": file})


BESIDE = {"demo": ("demo_autumn", "demo_coach")}  # scenarios that are shown beside a built-in one
MARKER = "made-by-treadwatch-demo"


def run_demo(scenario: str, folder: Path, port: int, *, keep_serving: bool) -> None:
    """Simulate, receive, estimate, serve, and print tables of estimate beside truth."""
    began = time.monotonic()
    console = Console()
    plans = [ending_now(load_scenario(name), time.time_ns()) for name in (scenario, *BESIDE.get(scenario, ()))]
    _empty(folder)
    embedded = dict.fromkeys(("database_url", "database_host", "raw_store"))
    here = {"host": "127.0.0.1", "log_level": "warning", "docs": "open"}  # a browser sends no key to /docs
    settings = load_settings(data_dir=folder / "data").model_copy(update=embedded | here)
    settings = with_rules(settings, plans[0].name, folder)
    logs.configure(settings)
    upgrade(settings.url)
    clock = ReplayClock(min(plan.sessions.start_ns for plan in plans) - DAY_NS)
    recordings = {plan.name: folder / "recordings" / plan.fleet_code for plan in plans}
    with closing(open_store(settings)) as storage:  # a registry that is refused is so before minutes of simulation
        for plan in plans:
            path = prepare(plan, recordings[plan.name])
            _enter(on_file(read_registry(path), clock.now), path, storage, clock)
    fleets = []
    for plan in plans:
        console.print(f"[bold]{plan.name}[/bold]: {plan.description}", highlight=False)
        fleets.append(Simulated(plan, simulate_with_progress(plan, recordings[plan.name], console)))
    console.print(replay(settings, fleets, clock, console))
    key = None  # access is open
    if settings.access == "keys":
        _, key = make_stored_key(settings, Wanted("demo", EVERYTHING, None, None))
    # chosen only now: another process may have taken the port during the minutes before
    with serving(settings.model_copy(update={"port": free_port(settings.host, port)})) as url:
        service = ServiceAddress(url, key)
        covered = _print_findings(service, fleets, console)
        console.print(
            f"{sum(covered)} of {len(covered)} intervals cover; {sum(fleet.report.frames for fleet in fleets):,} CAN"
            f" frames, {sum(fleet.report.wheelset_seconds for fleet in fleets) / 3600:.1f} wheelset-hours; table after"
            f" {time.monotonic() - began:.0f} s",
            highlight=False,
        )
        console.print("[bold]what to do, the most urgent first[/bold]")
        shown = {serial for fleet in _followed(fleets) for serial in true_campaigns(fleet.report.truth)}
        for sentence in to_do(service, shown):
            console.print(f"  {sentence}", highlight=False)
        if keep_serving:
            _print_urls(service, console)
            console.print("serving; the jobs continue on their schedules; stop with Ctrl-C", highlight=False)
            stopping = threading.Event()
            stop_on_signals(stopping)
            stopping.wait()


def _empty(folder: Path) -> None:
    """Make the demo's folder, or empty it; never one that the demo did not make."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise StorageError(f"{folder} is no folder of its own; choose another with --folder")
    if folder.exists():
        if not (folder / MARKER).is_file() and any(folder.iterdir()):
            raise StorageError(f"{folder} holds files that are not the demo's; choose another with --folder")
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    (folder / MARKER).touch()


def _print_findings(service: ServiceAddress, fleets: Sequence[Simulated], console: Console) -> list[bool]:
    """Print what the API says of each fleet and of its track; return of each interval whether it covers."""
    of_fleets = {
        fleet.scenario.fleet_code: lines(service, fleet.report.truth, fleet.scenario.fleet_code) for fleet in fleets
    }
    covered = [line.covers for wheelsets in of_fleets.values() for line in wheelsets if line.covers is not None]
    for table in tables(
        [line for fleet in _followed(fleets) for line in of_fleets[fleet.scenario.fleet_code]], console
    ):
        console.print(table)
    for fleet in fleets:
        for text, covers in second_opinions(service, fleet.scenario, true_campaigns(fleet.report.truth)):
            console.print(text, highlight=False)
            covered += [] if covers is None else [covers]
    for sentence in track_lines(service):
        console.print(sentence, highlight=False)
    return covered


def _followed(fleets: Sequence[Simulated]) -> list[Simulated]:
    """Return the first fleet, and those beside it that run more than once, so that they have a trend."""
    return [fleet for number, fleet in enumerate(fleets) if not number or fleet.scenario.sessions.campaigns > 1]


def _print_urls(service: ServiceAddress, console: Console) -> None:
    url = service.url
    if service.key is not None:
        console.print(f"  {url}/#key={service.key}", highlight=False, soft_wrap=True)
        console.print(f"  export TREADWATCH_KEY={service.key}", highlight=False, soft_wrap=True)
    alerts = get(service, "/v1/alerts?open=true&limit=1000")["items"]
    serials = [alert["wheelset"] for alert in alerts if alert["wheelset"] is not None]
    serial = serials[0] if serials else get(service, "/v1/wheelsets?limit=1")["items"][0]["serial"]
    serial = quote(serial, safe="")
    section = quote(get(service, "/v1/track-sections?limit=1")["items"][0]["code"], safe="")
    for path, what in (
        ("/docs", "every endpoint, to try in a browser"),
        (f"/v1/wheelsets/{serial}", "one wheelset, with links to all of it"),
        (f"/v1/wheelsets/{serial}/geometry", "its bin table and conicity"),
        (f"/v1/wheelsets/{serial}/trend", "its wear trend and forecast"),
        (f"/v1/track-sections/{section}/alignments", "versions of the track's alignment"),
        (f"/v1/track-sections/{section}/adhesion", "friction along it"),
        ("/v1/alerts/feed", "what maintenance systems poll"),
        ("/v1/jobs", "what the scheduled jobs did"),
    ):
        console.print(f"  {url}{path:<42} {what}", highlight=False, soft_wrap=True)
