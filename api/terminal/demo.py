"""The demo: the main job, end to end, on the embedded default, with its tables."""

from __future__ import annotations

import shutil
import threading
import time
from pathlib import Path
from urllib.parse import quote

from rich.console import Console

from api import logs
from api.access.caller import EVERYTHING
from api.access.making import Wanted
from api.demo.own_rules import with_rules
from api.demo.replay import ending_now, replay
from api.demo.service import free_port, serving
from api.demo.table import ServiceAddress, get, lines, tables
from api.demo.track import track_lines
from api.settings import Settings, load_settings
from api.terminal.keys import make_stored_key
from api.terminal.simulate import simulate_with_progress
from estimation.errors import StorageError
from estimation.jobs.stop_signals import stop_on_signals
from fleet_db.migrate import upgrade
from ingest.simulator.scenario_file import load_scenario

MARKER = "made-by-treadwatch-demo"


def run_demo(scenario: str, folder: Path, port: int, *, keep_serving: bool) -> None:
    """Simulate, receive, estimate, serve, and print tables of estimate beside truth.

    Parameters
    ----------
    scenario
        Name of a built-in scenario, or a TOML file.
    folder
        The demo's own folder; emptied first.
    port
        Port of the API; another if it is taken.
    keep_serving
        Whether to serve on until a signal comes.

    Raises
    ------
    StorageError
        ``folder`` holds files that are not the demo's, a job failed, or the API did not start.
    """
    began = time.monotonic()
    console = Console()
    plan = ending_now(load_scenario(scenario), time.time_ns())
    _recreate(folder)
    recordings, data = folder / "recordings", folder / "data"
    settings = load_settings(data_dir=data)
    embedded = {
        "database_url": None,
        "database_host": None,
        "raw_store": None,
        "host": "127.0.0.1",
        "log_level": "warning",
    }
    settings = settings.model_copy(update=embedded)
    settings = with_rules(settings, plan.name, folder)
    settings = settings.model_copy(update={"docs": "open"})  # on this machine alone, and a browser sends no key there
    logs.configure(settings)
    console.print(f"[bold]{plan.name}[/bold]: {plan.description}", highlight=False)
    report = simulate_with_progress(plan, recordings, console)
    upgrade(settings.url)
    console.print(replay(settings, plan, report, console))
    key = _own_key(settings)
    # chosen only now: another process may have taken the port during the minutes before
    with serving(settings.model_copy(update={"port": free_port(settings.host, port)})) as url:
        service = ServiceAddress(url, key)
        found = lines(service, report.truth)
        for table in tables(found, console):
            console.print(table)
        for sentence in track_lines(service):
            console.print(sentence, highlight=False)
        covered = [line.covers for line in found if line.covers is not None]
        console.print(
            f"{sum(covered)} of {len(covered)} intervals cover; {report.frames:,} CAN frames, "
            f"{report.wheelset_seconds / 3600:.1f} wheelset-hours; table after {time.monotonic() - began:.0f} s",
            highlight=False,
        )
        if keep_serving:
            _print_urls(service, console)
            console.print("serving; the jobs continue on their schedules; stop with Ctrl-C", highlight=False)
            stopping = threading.Event()
            stop_on_signals(stopping)
            stopping.wait()


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
    alerts = get(service, "/v1/alerts?open=true&limit=1")["items"]
    serial = alerts[0]["wheelset"] if alerts else get(service, "/v1/wheelsets?limit=1")["items"][0]["serial"]
    serial = quote(serial, safe="")
    section = quote(get(service, "/v1/track-sections?limit=1")["items"][0]["code"], safe="")
    for path, what in (
        ("/docs", "every endpoint, to try in a browser"),
        (f"/v1/wheelsets/{serial}", "one wheelset, with links to all of it"),
        (f"/v1/wheelsets/{serial}/geometry", "its bin table and conicity"),
        (f"/v1/wheelsets/{serial}/trend", "its wear trend and forecast"),
        (f"/v1/track-sections/{section}/alignments", "versions of the track's alignment"),
        ("/v1/alerts/feed", "what maintenance systems poll"),
        ("/v1/jobs", "what the scheduled jobs did"),
    ):
        console.print(f"  {url}{path:<42} {what}", highlight=False, soft_wrap=True)
