"""What docker-compose.yml and the Dockerfile promise."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from compose_file import ROOT, services
from sqlalchemy import make_url

from api.cli import COMMANDS
from api.rules_file import load_rules
from api.settings import PREFIX, Settings
from estimation.alerts.rule_book import RuleBook

PASSWORD = {"POSTGRES_PASSWORD": "only-for-this-test"}
OURS = ["migrate", "registry", "api", "scheduler", "receiver", "simulated-fleet"]


def test_every_service_is_a_subcommand_of_one_image() -> None:
    everything = services(PASSWORD)
    assert set(everything) == {"postgres", *OURS}
    assert {everything[name]["image"] for name in OURS} == {"treadwatch"}
    known = {command.name for command in COMMANDS}
    for name in OURS:
        assert everything[name]["command"][0] in known
        assert "entrypoint" not in everything[name]


OF_TRACES = {"OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_RESOURCE_ATTRIBUTES"}
OF_A_BUCKET = {"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN"}


def test_every_variable_in_an_environment_is_a_setting() -> None:
    settings = {f"{PREFIX}{name.upper()}" for name in Settings.model_fields}
    everything = services(PASSWORD)
    for name in OURS:
        assert set(everything[name].get("environment", {})) <= settings | OF_TRACES | OF_A_BUCKET


def test_the_credentials_of_a_bucket_reach_the_services_and_are_in_no_file() -> None:
    everything = services(PASSWORD | dict.fromkeys(OF_A_BUCKET, "given"))
    for name in ("api", "scheduler", "receiver"):
        assert {key: everything[name]["environment"][key] for key in OF_A_BUCKET} == dict.fromkeys(OF_A_BUCKET, "given")
    assert {services(PASSWORD)["api"]["environment"][key] for key in OF_A_BUCKET} == {None}


def test_every_setting_reaches_the_services_from_the_env_file() -> None:
    fixed = {"TREADWATCH_DATA_DIR", "TREADWATCH_HOST", "TREADWATCH_PORT", "TREADWATCH_DATABASE_PASSWORD"}
    given = {f"{PREFIX}{name.upper()}": f"value of {name}" for name in Settings.model_fields}
    everything = services(PASSWORD | given)
    for name in ("migrate", "api", "scheduler", "receiver"):
        environment = everything[name]["environment"]
        wanted = given | {"TREADWATCH_HOSTS": f"{given['TREADWATCH_HOSTS']},api"}  # as Prometheus calls it
        assert {key: environment.get(key) for key in given if key not in fixed} == {
            key: value for key, value in wanted.items() if key not in fixed
        }
        assert environment["TREADWATCH_DATABASE_PASSWORD"] == PASSWORD["POSTGRES_PASSWORD"]


def test_a_variable_that_is_empty_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in Settings.model_fields:
        monkeypatch.setenv(f"{PREFIX}{name.upper()}", "")
    assert Settings(_env_file=None) == Settings.model_construct()


def test_a_password_may_contain_any_character() -> None:
    password = "p@ss:w/o%r d#?$é"  # noqa: S105 - of this test
    url = make_url(Settings(database_host="db", database_password=password, _env_file=None).url)
    assert (url.password, url.host, url.port, url.database) == (password, "db", 5432, "treadwatch")


def test_only_the_simulated_fleet_is_never_silent() -> None:
    book = load_rules(ROOT / "compose" / "rules.toml")
    assert not book.of("LIVE", "multiple unit").enabled("no_data")
    assert replace(book.of("mine", "multiple unit"), name="") == RuleBook()


def test_services_wait_for_what_they_need_and_say_whether_they_are_well() -> None:
    everything = services(PASSWORD)
    for name in ("api", "scheduler", "receiver"):
        assert everything[name]["depends_on"]["migrate"]["condition"] == "service_completed_successfully"
        assert everything[name]["healthcheck"]["test"]
    assert everything["migrate"]["depends_on"]["postgres"]["condition"] == "service_healthy"
    assert everything["postgres"]["healthcheck"]["test"]
    assert "postgres" not in everything["simulated-fleet"].get("depends_on", {})
    assert not everything["simulated-fleet"].get("environment")


def test_there_is_no_default_secret() -> None:
    with pytest.raises(AssertionError, match="POSTGRES_PASSWORD"):
        services({})
    for name in ("docker-compose.yml", "Dockerfile", ".env.example"):
        text = (ROOT / name).read_text(encoding="utf-8").replace("${POSTGRES_PASSWORD:?set it in .env}", "")
        for variable in OF_A_BUCKET:
            text = text.replace(f"${{{variable}:-}}", "")
        for match in re.finditer(r"(?i)(password|secret|token)\w*[ \t]*[:=][ \t]*(\S*)", text):
            assert match[2] == "", match[0]
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    assert ".env" in ignored


def test_the_image_runs_one_command_without_privileges_from_pinned_versions() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert 'ENTRYPOINT ["treadwatch"]' in text
    assert "--constraint constraints.txt" in text
    users = re.findall(r"^USER (\S+)$", text, re.MULTILINE)
    assert users[-1:] == ["treadwatch"]
    sent = {line[1:] for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines() if line[:1] == "!"}
    copied = [match.split()[:-1] for match in re.findall(r"^COPY (?!--from)(.*)$", text, re.MULTILINE)]
    assert {name for names in copied for name in names} == sent
    rooms = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"bench"}
    assert rooms <= sent


@pytest.mark.skipif(shutil.which("docker-compose") is None, reason="no docker-compose here")
def test_docker_compose_accepts_the_file_and_asks_for_the_password(tmp_path: Path) -> None:
    shutil.copy(ROOT / "docker-compose.yml", tmp_path)
    command = ["docker-compose", "config", "--quiet"]
    environment = {name: value for name, value in os.environ.items() if name != "POSTGRES_PASSWORD"}
    given = subprocess.run(
        command, cwd=tmp_path, env=environment | PASSWORD, capture_output=True, text=True, check=False
    )
    assert given.returncode == 0, given.stderr
    missing = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert missing.returncode != 0
    assert "set it in .env" in missing.stderr
