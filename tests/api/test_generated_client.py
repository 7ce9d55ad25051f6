"""The client that is generated from the document, and the poller of docs/client, typed and against the real service."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import api_fleet
import pytest
from running_service import Service

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent.parent
POLLER = ROOT / "docs" / "client" / "poller.py"
LINES = 30


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a client that was generated from the committed document, without a warning."""
    folder = tmp_path_factory.mktemp("client")
    command = ["-m", "openapi_python_client", "generate", "--path", str(ROOT / "api" / "openapi.json")]
    command += ["--meta", "none", "--output-path", str(folder / "treadwatch_client"), "--fail-on-warning"]
    tools = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # it calls ruff by its name
    environment = os.environ | {"PATH": tools}
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_poller_is_short_and_has_no_casts() -> None:
    text = POLLER.read_text()
    written = [line for line in text.splitlines() if line.strip()]
    assert len(written) <= LINES
    assert "cast" not in text
    assert "type: ignore" not in text
    assert "Any" not in text


def test_the_poller_is_typed_by_the_generated_client(generated: Path) -> None:
    settings = ["--strict", "--follow-imports=silent", "--no-incremental", "--config-file="]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *settings, str(POLLER)],
        cwd=generated,
        env={**os.environ, "MYPYPATH": str(generated)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_the_poller_hands_every_event_over_once(generated: Path, service: Service, tmp_path: Path) -> None:
    state = tmp_path / "cursor"

    def poll() -> list[str]:
        variables = {"TREADWATCH_URL": service.url, "TREADWATCH_KEY": "none", "POLLER_STATE": str(state)}
        done = subprocess.run(
            [sys.executable, str(POLLER)],
            env={**os.environ, **variables, "PYTHONPATH": str(generated)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    with service.storage.read() as unit:
        known = unit.alerts.feed(0, 1000)
    assert len(known) > 10
    assert [line.split()[:2] for line in poll()] == [[one.kind.value, str(one.alert.alert_id)] for one in known]
    assert poll() == []
    raised = api_fleet.raised(service.storage, "WS-022", "wheel_asymmetry")
    assert [line.split()[:2] for line in poll()] == [["raised", str(raised.alert_id)]]
    state.write_text("garbage")
    with pytest.raises(AssertionError, match="cursor"):
        poll()
