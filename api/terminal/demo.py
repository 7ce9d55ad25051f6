"""The demo: the main job, end to end, on the embedded default, with its tables."""

from __future__ import annotations

import shutil
import threading
import time
from pathlib import Path
from urllib.parse import quote

from rich.console import Console

from api import logs
from api.demo.replay import ending_now, replay
from api.demo.service import free_port, serving
from api.demo.table import get, lines, tables
from api.demo.track import track_lines
from api.settings import load_settings
from api.terminal.simulate import simulate_with_progress
from estimation.errors import StorageError
from estimation.jobs.scheduler import stop_on_signals
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
    settings = settings.model_copy(update={"database_url": None, "host": "127.0.0.1", "log_level": "warning"})
    logs.configure(settings)
    console.print(f"[bold]{plan.name}[/bold]: {plan.description}", highlight=False)
    report = simulate_with_progress(plan, recordings, console)
    upgrade(settings.url)
    console.print(replay(settings, plan, report, console))
    # chosen only now: another process may have taken the port during the minutes before
    with serving(settings.model_copy(update={"port": free_port(settings.host, port)})) as url:
        found = lines(url, report.truth)
        for table in tables(found, console):
            console.print(table)
        for sentence in track_lines(url):
            console.print(sentence, highlight=False)
        covered = [line.covers for line in found if line.covers is not None]
        console.print(
            f"{sum(covered)} of {len(covered)} intervals cover; {report.frames:,} CAN frames, "
            f"{report.wheelset_seconds / 3600:.1f} wheelset-hours; table after {time.monotonic() - began:.0f} s",
            highlight=False,
        )
        _print_urls(url, console)
        if keep_serving:
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


def _print_urls(url: str, console: Console) -> None:
    """Print where to look first: addresses below ``url`` of a wheelset with an alert, its track, and the feed."""
    alerts = get(url, "/v1/alerts?open=true&limit=1")["items"]
    serial = alerts[0]["wheelset"] if alerts else get(url, "/v1/wheelsets?limit=1")["items"][0]["serial"]
    serial = quote(serial, safe="")
    section = quote(get(url, "/v1/track-sections?limit=1")["items"][0]["code"], safe="")
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
