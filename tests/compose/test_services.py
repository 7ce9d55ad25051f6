"""Every service of docker-compose.yml, started natively: frames on a multicast bus become geometry over REST."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from compose_file import ServiceCommand, mounts, native, scraped, services
from in_process_command import Done, Run

PATIENCE_S = 300.0
COMMAND = Path(sys.executable).with_name("treadwatch")
WINDOW_S = 10


class Deployment:
    """The services, with what differs here: the database, folders for volumes, free ports, short windows."""

    def __init__(self, database_url: str, directory: Path) -> None:
        self.directory = directory
        everything = services({"POSTGRES_PASSWORD": "unused"})
        folders = mounts(everything, directory)
        for folder in folders.values():
            if not folder.is_file():
                folder.mkdir(exist_ok=True)
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.health_port = probe.getsockname()[1]
        group = f"239.74.{random.randint(1, 254)}.{random.randint(1, 254)}"  # noqa: S311 - no secret
        # another PostgreSQL, free ports, and windows short enough for a test
        self.replaced = {
            "TREADWATCH_DATABASE_URL": database_url,
            "TREADWATCH_HOST": "127.0.0.1",
            "TREADWATCH_PORT": str(self.port),
            "TREADWATCH_WINDOW_LENGTH_S": str(WINDOW_S),
            "TREADWATCH_JOBS_EVERY_S": "2",
        }
        self.commands = {
            name: self._here(native(service, name, folders), group)
            for name, service in everything.items()
            if name != "postgres"
        }

    def _here(self, command: ServiceCommand, group: str) -> ServiceCommand:
        arguments = [{"239.74.163.2": group}.get(part, part) for part in command.arguments]
        if "--chunk-seconds" in arguments:
            arguments[arguments.index("--chunk-seconds") + 1] = str(WINDOW_S)
            arguments[arguments.index("--health-port") + 1] = str(self.health_port)
        needed = command.environment and self.replaced
        return ServiceCommand(command.name, arguments, command.environment | dict(needed))

    def once(self, run: Run, name: str, *instead: str) -> Done:
        """Run a service that ends, in this process; or another command in its place, as ``compose run`` does."""
        command = self.commands[name]
        environment = {key.removeprefix("TREADWATCH_").lower(): value for key, value in command.environment.items()}
        return run(*(instead or command.arguments), **environment)

    @contextmanager
    def running(self, name: str) -> Iterator[subprocess.Popen[bytes]]:
        """Run a service beside the test and stop it as compose does."""
        command = self.commands[name]
        with (self.directory / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                [COMMAND, *command.arguments],
                env=_environment(command.environment),
                cwd=self.directory,
                stdout=log,
                stderr=log,
            )
            try:
                yield process
            finally:
                process.terminate()
                process.wait(PATIENCE_S)

    def logs(self) -> str:
        """Return the end of every log."""
        return "\n".join(f"--- {path.name}\n{path.read_text()[-3000:]}" for path in self.directory.glob("*.log"))


def _environment(given: Mapping[str, str]) -> dict[str, str]:
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("TREADWATCH_")}
    return inherited | dict(given)


@pytest.fixture
def deployment(empty_postgres_url: str, tmp_path: Path) -> Deployment:
    """Return the deployment on a database that has not been migrated."""
    return Deployment(empty_postgres_url, tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("live_bus")
def test_frames_on_the_bus_become_geometry_over_rest(deployment: Deployment, treadwatch: Run) -> None:
    for name in ("migrate", "registry"):
        done = deployment.once(treadwatch, name)
        assert done.returncode == 0, done.stderr
    with ExitStack() as stack:
        key = deployment.once(
            treadwatch, "api", "keys", "create", "--owner", "planner", "--scope", "read", "--all-fleets"
        )
        headers = {"Authorization": f"Bearer {key.stdout.strip().splitlines()[-1]}"}
        address = f"http://127.0.0.1:{deployment.port}"
        client = stack.enter_context(httpx.Client(base_url=address, headers=headers, timeout=30.0))
        processes = {name: stack.enter_context(deployment.running(name)) for name in ("api", "scheduler", "receiver")}
        processes["simulated-fleet"] = stack.enter_context(deployment.running("simulated-fleet"))

        def eventually(path: str, wanted: Callable[[Any], bool]) -> Any:  # noqa: ANN401 - JSON
            return _eventually(lambda: _asked(client, path, wanted), processes, deployment)

        eventually("/readyz", lambda body: body["status"] == "ok")
        assert httpx.get(f"{address}/v1/wheelsets").status_code == 401
        (target,) = scraped("api")
        measures = httpx.get(f"{address}/metrics", headers={"Host": target})  # as Prometheus asks, without a key
        assert measures.status_code == 200, measures.text
        assert "treadwatch_database_up 1.0" in measures.text
        _eventually(lambda: _receiver_is_ready(deployment), processes, deployment)
        windows = eventually("/v1/wheelsets/LIVE-1/windows", lambda body: len(body["items"]) >= 1)["items"]
        assert windows[0]["vehicle"] == "L-1"
        assert windows[0]["track_section"] == "LIVE-5"
        assert 54.0 <= windows[0]["quality"]["speed_min_km_h"] <= windows[0]["quality"]["speed_max_km_h"] <= 90.0
        eventually(
            "/v1/wheelsets/LIVE-1/windows", lambda body: any(item["state"] == "estimated" for item in body["items"])
        )
        geometry = eventually("/v1/wheelsets/LIVE-1/geometry", lambda body: body["n_windows"] >= 1)
        assert sum(geometry["bins"]["samples_1"]) > 1000
        assert geometry["provenance"]["track_versions"] == {"LIVE-5": [1]}
        for job in eventually("/v1/jobs", lambda body: all(item["last_run"] for item in body["items"]))["items"]:
            assert job["last_run"]["trigger"] == "schedule"
            assert job["last_run"]["error"] is None
        alerts = client.get("/v1/alerts?kind=no_data").json()["items"]
        assert alerts == []  # the simulated vehicle's clock is in 2024; that is no silence
        second = deployment.once(treadwatch, "scheduler", "schedule")
        assert second.returncode == 2
        assert "another scheduler is already running" in second.stderr
    for name in ("scheduler", "receiver", "simulated-fleet"):
        assert processes[name].returncode == 0, deployment.logs()


def _asked(client: httpx.Client, path: str, wanted: Callable[[Any], bool]) -> Any | None:  # noqa: ANN401 - JSON
    try:
        response = client.get(path)
    except httpx.TransportError:
        return None
    if response.status_code != 200:
        return None
    return response.json() if wanted(response.json()) else None


def _receiver_is_ready(deployment: Deployment) -> bool | None:
    """Ask as the health check of the service does, on the port of this machine."""
    check = services({"POSTGRES_PASSWORD": "unused"})["receiver"]["healthcheck"]["test"]
    command = services({"POSTGRES_PASSWORD": "unused"})["receiver"]["command"]
    port = command[command.index("--health-port") + 1]
    asked = [part.replace(f":{port}/", f":{deployment.health_port}/") for part in check[1:]]
    done = subprocess.run([sys.executable, *asked[1:]], capture_output=True, check=False)
    return True if done.returncode == 0 else None


def _eventually(
    ask: Callable[[], Any | None], processes: Mapping[str, subprocess.Popen[bytes]], deployment: Deployment
) -> Any:  # noqa: ANN401 - JSON
    until = time.monotonic() + PATIENCE_S
    while True:
        found = ask()
        if found is not None:
            return found
        assert time.monotonic() < until, deployment.logs()
        for name, process in processes.items():
            assert process.poll() is None, f"{name} has ended\n{deployment.logs()}"
        time.sleep(1.0)  # a look costs a process or a request, beside services that start


def test_nothing_starts_on_a_database_that_is_not_migrated(deployment: Deployment, treadwatch: Run) -> None:
    for name in ("api", "scheduler", "receiver"):
        refused = deployment.once(treadwatch, name)
        assert refused.returncode == 2
        assert refused.stderr.strip().splitlines()[-1].endswith("run: treadwatch db upgrade")
        assert "Traceback" not in refused.stderr
