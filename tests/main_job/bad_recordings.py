"""Recordings with something wrong with them: those of a sound vehicle with other frames in them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ingest import catalogue as kinds
from ingest.catalogue import default_catalogue
from ingest.codec import decode, encode
from ingest.frames import FrameBatch, concatenate, sort_by_time, take
from ingest.logs import read_log, write_blf

Signals = dict[str, npt.NDArray[np.float64]]
Change = Callable[[FrameBatch], FrameBatch]


def message(kind: str, node: int, change: Callable[[Signals], Mapping[str, npt.ArrayLike]]) -> Change:
    """Return what sends one message of a node with other values."""

    def changed(batch: FrameBatch) -> FrameBatch:
        plan = default_catalogue().find(kind, node)
        found = decode(default_catalogue(), batch).messages[plan.arbitration_id]
        values = found.values()
        faulty = change({name: values[:, i] for i, name in enumerate(plan.names)})
        new = encode(plan, batch.t_ns[found.index], faulty)
        kept = np.ones(len(batch), dtype=np.bool_)
        kept[found.index] = False
        return sort_by_time(concatenate([take(batch, kept), new]))

    return changed


def elsewhere(signals: Signals) -> Signals:
    """Return positions of a place 400 m further on: the samples are not from there."""
    return signals | {"distance": signals["distance"] + 400.0}


def jumping(signals: Signals) -> Signals:
    """Return positions that jump by 30 m half way."""
    half = np.arange(len(signals["distance"])) >= len(signals["distance"]) // 2
    return signals | {"distance": signals["distance"] + 30.0 * half}


def crawling(signals: Signals) -> Signals:
    """Return a speed of 2 m/s."""
    return signals | {"speed": np.full(len(signals["speed"]), 2.0)}


def standing(signals: Signals) -> Signals:
    """Return a speed of zero, and an odometer that does not move."""
    return signals | {"speed": 0.0 * signals["speed"], "odometer": 0.0 * signals["odometer"] + signals["odometer"][0]}


def stuck(signals: Signals) -> Signals:
    """Return a position that does not move."""
    return signals | {"distance": 0.0 * signals["distance"] + signals["distance"][0]}


def upside_down(signals: Signals) -> Signals:
    """Return what yaw sensors of the other sign measure: as if the vehicle ran backwards, on the mirrored track."""
    return {name: -values if name.startswith("yaw") else values for name, values in signals.items()}


def first_seconds(batch: FrameBatch) -> FrameBatch:
    """Return eight seconds: hardly longer than the longest wavelength."""
    return take(batch, batch.t_ns < batch.t_ns[0] + 8 * 10**9)


def _turned(batch: FrameBatch) -> FrameBatch:
    for node in (1, 2):
        batch = message(kinds.ACCELERATION, node, upside_down)(batch)
    return batch


def _stood(batch: FrameBatch) -> FrameBatch:
    moved = message(kinds.MOTION, kinds.VEHICLE_NODE, standing)(batch)
    return message(kinds.POSITION, kinds.VEHICLE_NODE, stuck)(moved)


WRONG: Mapping[str, tuple[Change, str]] = {
    "X-ELSE": (message(kinds.POSITION, kinds.VEHICLE_NODE, elsewhere), "other_section"),
    "X-BACK": (_turned, "other_section"),
    "X-CRAWL": (
        message(kinds.MOTION, kinds.VEHICLE_NODE, crawling),
        "odometer_implausible",
    ),
    "X-SHORT": (first_seconds, "interrupted"),
}
STANDING = ("X-STOP", _stood)
JUMPING = ("X-JUMP", message(kinds.POSITION, kinds.VEHICLE_NODE, jumping))


@dataclass(frozen=True)
class Edited:
    """A recording of a sound vehicle, with other frames, as that of another."""

    path: Path
    vehicle: str


def edited(source: Path, vehicle: str, change: Change, folder: Path) -> Edited:
    """Write the recording ``source`` changed, for ``vehicle``."""
    path = folder / f"{vehicle}.blf"
    write_blf(path, change(read_log(source)))
    return Edited(path, vehicle)


def registry_with(source: Path, target: Path, vehicles: Mapping[str, str], *, surveyed: bool) -> Path:
    """Write the registry ``source`` with more vehicles, each like another one; its track on file or not."""
    content: dict[str, Any] = json.loads(source.read_text(encoding="utf-8"))
    for name, like in vehicles.items():
        (vehicle,) = (item for item in content["vehicles"] if item["code"] == like)
        content["vehicles"].append(vehicle | {"code": name})
        for mounting in [item for item in content["mountings"] if item["vehicle"] == like]:
            (wheelset,) = (item for item in content["wheelsets"] if item["serial"] == mounting["wheelset"])
            serial = f"{name}-{mounting['axle']}"
            content["wheelsets"].append(wheelset | {"serial": serial})
            content["mountings"].append(mounting | {"vehicle": name, "wheelset": serial})
    if not surveyed:
        for section in content["track_sections"]:
            section.pop("alignment", None)
    target.mkdir(parents=True, exist_ok=True)
    for track in source.parent.glob("*.csv"):
        (target / track.name).write_bytes(track.read_bytes())
    path = target / "registry.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path
