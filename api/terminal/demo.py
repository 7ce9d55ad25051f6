"""The demo: the main job, end to end, on the embedded default, with its tables."""

from __future__ import annotations

import shutil
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote

from rich.console import Console

from api import logs
from api.access.caller import EVERYTHING
from api.access.key_ring import Wanted
from api.demo.findings import ServiceAddress, get, lines, second_opinions, tables, to_do, track_lines, true_campaigns
from api.demo.replay import Simulated, ending_now, replay
from api.factory import create_server, job_context, open_store, scheduled_jobs
from api.settings import Settings, load_settings
from api.terminal.clients import make_stored_key
from api.terminal.simulate import simulate_with_progress
from estimation.errors import StorageError
from estimation.jobs.scheduler import serve_jobs
from estimation.jobs.stop_signals import stop_on_signals
from fleet_db.migrate import upgrade
from ingest.simulator.scenario_file import load_scenario

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


BESIDE = {"demo": ("demo_autumn",)}  # scenarios that are shown beside a built-in one
MARKER = "made-by-treadwatch-demo"


def run_demo(scenario: str, folder: Path, port: int, *, keep_serving: bool) -> None:
    """Simulate, receive, estimate, serve, and print tables of estimate beside truth."""
    began = time.monotonic()
    console = Console()
    plans = [ending_now(load_scenario(name), time.time_ns()) for name in (scenario, *BESIDE.get(scenario, ()))]
    _recreate(folder)
    settings = load_settings(data_dir=folder / "data")
    embedded = {
        "database_url": None,
        "database_host": None,
        "raw_store": None,
        "host": "127.0.0.1",
        "log_level": "warning",
    }
    settings = settings.model_copy(update=embedded)
    settings = with_rules(settings, plans[0].name, folder)
    settings = settings.model_copy(update={"docs": "open"})  # on this machine alone, and a browser sends no key there
    logs.configure(settings)
    fleets = []
    for plan in plans:
        console.print(f"[bold]{plan.name}[/bold]: {plan.description}", highlight=False)
        report = simulate_with_progress(plan, folder / "recordings" / plan.fleet_code, console)
        fleets.append(Simulated(plan, report))
    upgrade(settings.url)
    console.print(replay(settings, fleets, console))
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
        for sentence in to_do(service, fleets[0].scenario.fleet_code):
            console.print(f"  {sentence}", highlight=False)
        if keep_serving:
            _print_urls(service, console)
            console.print("serving; the jobs continue on their schedules; stop with Ctrl-C", highlight=False)
            stopping = threading.Event()
            stop_on_signals(stopping)
            stopping.wait()


def _print_findings(service: ServiceAddress, fleets: Sequence[Simulated], console: Console) -> list[bool]:
    """Print what the API says of each fleet and of its track; return of each interval whether it covers."""
    covered: list[bool] = []
    for number, fleet in enumerate(fleets):
        truth = fleet.report.truth
        found = lines(service, truth, fleet.scenario.fleet_code)
        if number == 0:
            for table in tables(found, console):
                console.print(table)
        covered += [line.covers for line in found if line.covers is not None]
        for text, covers in second_opinions(service, fleet.scenario, true_campaigns(truth)):
            console.print(text, highlight=False)
            covered += [] if covers is None else [covers]
    for sentence in track_lines(service):
        console.print(sentence, highlight=False)
    return covered


def _recreate(folder: Path) -> None:
    """Empty the demo's own folder; never one that the demo did not make."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise StorageError(f"{folder} is no folder of its own; choose another with --folder")
    if folder.exists():
        if not (folder / MARKER).is_file() and any(folder.iterdir()):
            raise StorageError(f"{folder} holds files that are not the demo's; choose another with --folder")
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    (folder / MARKER).touch()


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
