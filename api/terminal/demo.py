"""The demo: the main job, end to end, on the embedded default, with its tables."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from rich.console import Console

from api import logs
from api.access.caller import EVERYTHING
from api.access.key_ring import Wanted
from api.demo.own_rules import with_rules
from api.demo.replay import Simulated, ending_now, replay
from api.demo.second_opinions import second_opinions
from api.demo.service import free_port, serving
from api.demo.table import ServiceAddress, get, lines, tables, true_campaigns
from api.demo.to_do import to_do
from api.demo.track import track_lines
from api.settings import Settings, load_settings
from api.terminal.clients import make_stored_key
from api.terminal.simulate import simulate_with_progress
from estimation.errors import StorageError
from estimation.jobs.stop_signals import stop_on_signals
from fleet_db.migrate import upgrade
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario

BESIDE = {"demo": ("demo_autumn",)}
"""Scenarios that are shown beside a built-in one."""
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
    fleets = [_simulated(plan, folder / "recordings" / plan.fleet_code, console) for plan in plans]
    upgrade(settings.url)
    console.print(replay(settings, fleets, console))
    key = _own_key(settings)
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


def _simulated(plan: Scenario, out: Path, console: Console) -> Simulated:
    console.print(f"[bold]{plan.name}[/bold]: {plan.description}", highlight=False)
    return Simulated(plan, simulate_with_progress(plan, out, console))


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
        for opinion in second_opinions(service, fleet.scenario, true_campaigns(truth)):
            console.print(opinion.text, highlight=False)
            covered += [] if opinion.covers is None else [opinion.covers]
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


def _own_key(settings: Settings) -> str | None:
    """Return a key of the demo's own for everything; None where access is open."""
    if settings.access != "keys":
        return None
    _, secret = make_stored_key(settings, Wanted("demo", EVERYTHING, None, None))
    return secret


def _print_urls(service: ServiceAddress, console: Console) -> None:
    """Print where to look first: the page with its key, a wheelset with an alert, its track, and the feed."""
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
