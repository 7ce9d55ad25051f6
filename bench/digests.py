"""Show that a change of the code changes no number: ``python bench/digests.py [--write FILE] [--against FILE]``.

Two small simulated fleets, one on a surveyed track and one on a track without a survey with positions off by
20 m, go through the command line (``simulate``, ``ingest``, ``estimate``) campaign by campaign. Every result is then
read over the REST API of ``treadwatch serve``. Nothing of the code is imported, so that the same file runs at commits
whose modules have other names: set ``PYTHONPATH`` to the checkout that is to be measured (default: the one that holds
this file). ``--scenario tiny`` is a third fleet, small enough for the tests.

Only numbers, states, codes and times of measurement are compared, never sentences, times of recording, code versions
or links. Digests cover every bit of every float.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

START_S = 60.0
ANSWER_S = 60.0
SHOWN_DIFFERENCES = 20
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

RULES = """\
[no_data]  # the recordings are years old
days = 3650.0
critical_days = 3650.0
"""

SCENARIOS = Path(__file__).with_name("digest_scenarios")
DEFAULT = ("known", "unknown")
ALL = (*DEFAULT, "tiny")

ESTIMATE_KEYS = {"value", "std", "interval_95", "n_windows", "status"}
KEPT: dict[str, set[str] | None] = {
    "geometry": ESTIMATE_KEYS
    | {
        *("wheelset", "baseline", "mileage_km", "measured_from", "measured_to", "equivalent_conicity_1"),
        *("equivalent_conicity_amplitude_mm", "conicity_by_amplitude", "amplitude_mm", "nonlinearity_parameter_per_mm"),
        *("zero_crossing_mm", "bins", "lower_mm", "upper_mm", "samples_1", "rolling_radius_sum_mm"),
        *("rolling_radius_difference_mm", "contact_angle_sum_rad", "contact_angle_difference_rad"),
    },
    "trend": ESTIMATE_KEYS
    | {
        *("wheelset", "quantity", "baseline", "points", "mileage_km", "measured_at", "value_1", "std_1", "current_1"),
        *("slope_1_per_1000_km", "slope_1_per_year", "limit_1", "distance_to_limit_km", "date_of_limit"),
        *("p10", "p50", "p90", "probability_over_limit_1"),
    },
    "alerts": ESTIMATE_KEYS
    | {
        *("wheelset", "scope", "kind", "severity", "condition", "occurrence_count", "probability_1", "raise_limit"),
        *("clear_limit", "limit_unit", "evidence", "action", "events", "event"),
        *("quantity", "conicity", "windows", "limit", "slope_per_1000_km", "current", "distance_to_limit_km"),
        *("within_km", "points", "limit_days", "faulty_windows", "p10", "p50", "p90"),
        *("offset_mm", "shape_mm", "leading", "members", "with", "mistake"),
    },
    "tracks": {
        *("code", "section", "version", "status", "cut_off_m", "scale_std_1", "gauge_known"),
        *("same_since_version", "position_m", "alignment_mm", "alignment_std_mm", "gauge_deviation_mm"),
        *("gauge_deviation_std_mm", "passes", "made_version", "n_windows", "wheelsets", "mean_passes_1"),
        *("diversity_1", "covered_1", "converged", "rounds", "moved_m", "residual_rms_mm", "refused_windows"),
        *("journeys", "vehicle", "measured_from", "offset_m", "scale_1", "middle_m", "used"),
        *("report", "versions"),
    },
    "windows": {
        *("wheelset", "measured_from", "measured_to", "vehicle", "axle", "track_section", "mileage_km", "state"),
        *("quality", "coverage_1", "longest_gap_s", "gaps", "clipped_1", "invalid_1", "speed_min_km_h"),
        *("speed_max_km_h", "position_quality_1", "sensor_fault"),
    },
    "adhesion": None,
    "rails": None,
    "signature": None,
    "dampers": None,
    "worklist": None,
}
"""Keys that are compared, at any depth; a key that an answer gains later changes no digest. None: all but these:"""

LEFT_OUT = {"links", "recorded_at", "opened_at", "code_version", "input_digest", "parameters", "id"} | {
    *("reason", "text", "sentence", "description", "content_digest", "revision"),
}

TIME = re.compile(r"\d{4}-\d\d-\d\dT[\d:]+(\.\d+)?Z")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the digests; return 1 when they differ from those of ``--against``."""
    parser = argparse.ArgumentParser("python bench/digests.py", description=__doc__)
    parser.add_argument("--scenario", choices=ALL, action="append", help="only this one; may be repeated")
    parser.add_argument("--write", type=Path, metavar="FILE", help="store the canonical JSON")
    parser.add_argument("--against", type=Path, metavar="FILE", help="compare with a stored file")
    parser.add_argument("--relative", type=float, default=0.0, help="difference of a number that is none; default 0")
    given = parser.parse_args(arguments)
    results = {name: run(name) for name in given.scenario or DEFAULT}
    for scenario, groups in results.items():
        for group, value in groups.items():
            print(f"{scenario:8s} {group:9s} {digest(value)}")
    if given.write:
        given.write.write_text(canonical(results) + "\n", encoding="utf-8")
    if given.against is None:
        return 0
    reference = json.loads(given.against.read_text(encoding="utf-8"))
    reference = {name: reference[name] for name in results}
    found = list(differences(reference, results, relative=given.relative))
    print(f"{len(found)} differences from {given.against}")
    for line in found[:SHOWN_DIFFERENCES]:
        print(f"  {line}")
    return 1 if found else 0


def run(scenario: str) -> dict[str, Any]:
    """Return the results of a scenario, from frames to REST answers, by group."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-digests-") as name:
        folder = Path(name)
        environment = environment_of(folder)
        simulated = simulate(scenario, folder, environment)
        by_campaign: dict[int, list[Path]] = {}
        for vehicle in sorted(path for path in simulated.iterdir() if path.is_dir()):
            for campaign, path in enumerate(sorted(vehicle.glob("*.blf"))):
                by_campaign.setdefault(campaign, []).append(path)
        command(["db", "upgrade"], folder, environment)
        for campaign, paths in sorted(by_campaign.items()):
            registry = [] if campaign else ["--registry", str(simulated / "registry.json")]
            command(["ingest", *registry, *map(str, paths)], folder, environment)
            command(["estimate"], folder, environment)
        with _served(folder, environment) as url:
            return _results(url)


def environment_of(folder: Path) -> dict[str, str]:
    """Return the environment of a deployment in a folder, with the code of ``PYTHONPATH`` and one thread."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("TREADWATCH_")}
    code = kept.get("PYTHONPATH") or str(Path(__file__).resolve().parents[1])
    kept["PYTHONPATH"] = os.pathsep.join(str(Path(part).resolve()) for part in code.split(os.pathsep) if part)
    rules = folder / "rules.toml"
    rules.write_text(RULES, encoding="utf-8")
    return kept | {
        **dict.fromkeys(ONE_THREAD, "1"),  # sums in another order are other sums
        "TREADWATCH_ACCESS": "open",
        "TREADWATCH_DATA_DIR": str(folder / "data"),
        "TREADWATCH_RULES_FILE": str(rules),
        "TREADWATCH_WINDOW_LENGTH_S": "30",
        "TREADWATCH_LOG_LEVEL": "warning",
    }


def simulate(name: str, folder: Path, environment: dict[str, str]) -> Path:
    """Return the folder of a scenario's recordings."""
    out = folder / "simulated"
    command(["simulate", "--scenario", str(SCENARIOS / f"{name}.toml"), "--out", str(out)], folder, environment)
    return out


def program() -> str:
    """Return the command line of this environment."""
    return str(Path(sys.executable).parent / "treadwatch")


def command(arguments: Sequence[str], folder: Path, environment: dict[str, str]) -> None:
    """Run the command line; raise RuntimeError with its output when it fails."""
    done = subprocess.run(  # noqa: S603 - our own command
        [program(), *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        msg = f"treadwatch {' '.join(arguments)} ended with {done.returncode}:\n{done.stdout}{done.stderr}"
        raise RuntimeError(msg)


@contextmanager
def _served(folder: Path, environment: dict[str, str]) -> Iterator[str]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    own = environment | {"TREADWATCH_HOST": "127.0.0.1", "TREADWATCH_PORT": str(port)}
    with (
        (folder / "serve.log").open("w") as log,
        subprocess.Popen([program(), "serve"], cwd=folder, env=own, stdout=log, stderr=log) as server,  # noqa: S603
    ):
        url = f"http://127.0.0.1:{port}"
        try:
            deadline = time.monotonic() + START_S
            while not _ready(url):
                if time.monotonic() > deadline or server.poll() is not None:
                    raise RuntimeError(f"no REST API at {url}:\n{(folder / 'serve.log').read_text()}")
                time.sleep(0.1)
            yield url
        finally:
            server.terminate()


def _ready(url: str) -> bool:
    try:
        with urllib.request.urlopen(f"{url}/readyz", timeout=ANSWER_S):  # noqa: S310 - our own server
            return True
    except OSError:
        return False


def _get(url: str, path: str) -> Any:  # noqa: ANN401 - JSON
    """Return the JSON of one resource; None where there is none yet."""
    try:
        with urllib.request.urlopen(url + path, timeout=ANSWER_S) as answer:  # noqa: S310 - our own server
            return json.load(answer)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code != 404:
            raise
        return None


def _recorded(url: str, path: str) -> Any:  # noqa: ANN401 - JSON
    """Return the JSON of an estimate; None where nothing has ever been estimated."""
    found = _get(url, path)
    return found if found is None or found["recorded_at"] is not None else None


def _items(url: str, path: str) -> list[Any]:
    found: list[Any] = []
    following: str | None = f"{path}?limit=1000"
    while following:
        page = _get(url, following)
        found += page["items"]
        following = page["next"]
    return found


def _results(url: str) -> dict[str, Any]:
    wheelsets = sorted(item["serial"] for item in _items(url, "/v1/wheelsets"))
    sections = sorted(item["code"] for item in _items(url, "/v1/track-sections"))
    vehicles = sorted(item["code"] for item in _items(url, "/v1/vehicles"))

    def of_each(place: str, names: Sequence[str], kind: str, read: Callable[[str, str], Any] = _get) -> dict[str, Any]:
        return {name: read(url, f"/v1/{place}/{_quoted(name)}/{kind}") for name in names}

    answers = {
        "geometry": of_each("wheelsets", wheelsets, "geometry", _recorded),
        "trend": of_each("wheelsets", wheelsets, "trend", _recorded),
        "alerts": _alerts(url),
        "tracks": {code: _track(url, f"/v1/track-sections/{_quoted(code)}") for code in sections},
        "windows": of_each("wheelsets", wheelsets, "windows", _items),
        "adhesion": of_each("track-sections", sections, "adhesion") | of_each("wheelsets", wheelsets, "creep-forces"),
        "rails": of_each("track-sections", sections, "rails") | of_each("wheelsets", wheelsets, "rails"),
        "signature": of_each("wheelsets", wheelsets, "signature"),
        "dampers": of_each("vehicles", vehicles, "dampers"),
        "worklist": {row["serial"]: row for row in _items(url, "/v1/wheelsets")},
    }
    return {
        group: {key: _kept(answer, KEPT[group]) for key, answer in by_key.items()} for group, by_key in answers.items()
    }


def _quoted(name: str) -> str:
    return urllib.parse.quote(name, safe="")


def _alerts(url: str) -> dict[str, list[Any]]:
    """Return every alert there ever was, with the kinds of its events, by wheelset and kind."""
    found: dict[str, list[Any]] = {}
    for alert in sorted(_items(url, "/v1/alerts"), key=lambda item: int(item["id"])):
        alert["events"] = _get(url, f"/v1/alerts/{alert['id']}/events")["items"]
        found.setdefault(f"{alert['wheelset'] or 'fleet'} {alert['kind']}", []).append(alert)
        for event in alert["events"]:
            event.pop("alert")
    return found


def _track(url: str, path: str) -> dict[str, Any]:
    versions = sorted(item["version"] for item in _items(url, f"{path}/alignments"))
    return {
        "report": _get(url, f"{path}/alignment-report"),
        "versions": [_get(url, f"{path}/alignment?version={version}") for version in versions],
    }


def _kept(value: Any, names: set[str] | None) -> Any:  # noqa: ANN401 - JSON
    """Return the comparable part of an answer: named keys, and times as seconds."""
    if isinstance(value, dict):
        chosen = sorted(set(value) - LEFT_OUT if names is None else names & set(value))
        kept = {name: _kept(value[name], names) for name in chosen}
        if isinstance(value.get("refused_windows"), dict):  # its keys are sentences
            kept["refused_windows"] = sum(value["refused_windows"].values())
        return kept
    if isinstance(value, list):
        if value and all(isinstance(item, str) and not TIME.fullmatch(item) for item in value):
            return _relabelled(value)
        return [_kept(item, names) for item in value]
    if isinstance(value, str) and TIME.fullmatch(value):
        return datetime.fromisoformat(value).timestamp()
    return value


def _relabelled(states: list[str]) -> list[str]:
    """Return the states of a column numbered in order of appearance: the word for a state does not count."""
    order = list(dict.fromkeys(state for state in states if state != "estimated"))
    return [state if state == "estimated" else f"state {order.index(state)}" for state in states]


def canonical(value: object) -> str:
    """Return JSON with sorted keys and every bit of every float."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(value: object) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of the canonical JSON."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()[:16]


def differences(expected: Any, found: Any, *, relative: float = 0.0, path: str = "") -> Iterator[str]:  # noqa: ANN401 - JSON
    """Yield a line for every place where two canonical values differ by more than ``relative``."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for name in sorted({*expected, *found}):
            yield from differences(expected.get(name), found.get(name), relative=relative, path=f"{path}/{name}")
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        for i, (one, other) in enumerate(zip(expected, found, strict=True)):
            yield from differences(one, other, relative=relative, path=f"{path}/{i}")
    elif isinstance(expected, float) or isinstance(found, float):
        yield from _number_difference(expected, found, relative, path)
    elif expected != found:
        yield f"{path}: {_shown(expected)} became {_shown(found)}"


def _number_difference(expected: Any, found: Any, relative: float, path: str) -> Iterator[str]:  # noqa: ANN401 - JSON
    if not (isinstance(expected, int | float) and isinstance(found, int | float)):
        yield f"{path}: {_shown(expected)} became {_shown(found)}"
        return
    scale = max(abs(expected), abs(found))
    if abs(expected - found) > relative * scale:
        yield f"{path}: {expected!r} became {found!r}, relative difference {abs(expected - found) / scale:.1e}"


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


if __name__ == "__main__":
    sys.exit(main())
