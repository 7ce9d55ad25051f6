"""docker-compose.yml as this machine can run it: the same commands and environment, without containers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
_VARIABLE = re.compile(r"\$\{(?P<name>[A-Z0-9_]+)(?:(?P<kind>:[-?])(?P<word>[^}]*))?\}")


@dataclass(frozen=True)
class ServiceCommand:
    """What one service runs, with the paths of its volumes moved to this machine."""

    name: str
    arguments: list[str]
    environment: dict[str, str]


def services(variables: Mapping[str, str], *profiles: str) -> dict[str, dict[str, Any]]:
    """Return the services of the file that run with these profiles, with variables filled in as compose does."""
    text = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    found: dict[str, dict[str, Any]] = yaml.safe_load(_VARIABLE.sub(lambda match: _value(match, variables), text))[
        "services"
    ]
    return {name: one for name, one in found.items() if {*profiles} >= {*one.get("profiles", ())}}


def _value(match: re.Match[str], variables: Mapping[str, str]) -> str:
    given = variables.get(match["name"], "")
    if given:
        return given
    assert match["kind"] != ":?", f"{match['name']} has no value: {match['word']}"
    return match["word"] or ""


def native(service: Mapping[str, Any], name: str, mounts: Mapping[str, Path]) -> ServiceCommand:
    """Return a service's command with every path inside of a volume moved to where the volume is here."""

    def moved(text: str) -> str:
        for inside, here in mounts.items():
            text = text.replace(inside, str(here))
        return text

    environment = {
        key: moved("" if value is None else str(value)) for key, value in service.get("environment", {}).items()
    }
    return ServiceCommand(name, [moved(part) for part in service["command"]], environment)


def mounts(everything: Mapping[str, Mapping[str, Any]], directory: Path) -> dict[str, Path]:
    """Return for every path in a container where its volume is here; one volume is one folder for all services.

    A file of the repository stays where it is.
    """
    found: dict[str, Path] = {}
    for service in everything.values():
        for volume in service.get("volumes", ()):
            source, inside = volume.split(":")[:2]
            here = ROOT / source if source.startswith("./") else directory / source
            assert found.get(inside, here) == here, f"{inside} is two volumes"
            found[inside] = here
    return found


def scraped(job: str) -> list[str]:
    """Return what Prometheus asks for the measures of a job, as host and port."""
    found = yaml.safe_load((ROOT / "docs" / "operations" / "prometheus.yml").read_text(encoding="utf-8"))
    (config,) = (one for one in found["scrape_configs"] if one["job_name"] == job)
    return [target for group in config["static_configs"] for target in group["targets"]]
