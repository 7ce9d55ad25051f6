"""What goes into an epoch: its windows, their keys and digests."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.passes import Pass, gridded
from estimation.values.registry import WheelsetRecord
from estimation.values.windows import WindowRecord


def life(wheelset: WheelsetRecord, record: WindowRecord, interval_km: float) -> str:
    """Return the name under which a window's passes enter the panel: same wheelset, same profile, hardly more wear."""
    turned = [item for item in wheelset.reprofilings if item.at_ns <= record.start_ns]
    begin_km = max((item.mileage_km for item in turned), default=0.0)
    return f"{record.wheelset}#{len(turned)}#{int((record.mileage_km - begin_km) // interval_km)}"


def limit_batch(
    records: Sequence[WindowRecord], lives: Sequence[str], most_wheelsets: int
) -> list[tuple[WindowRecord, str]]:
    """Return the first records with their lives, as many as do not exceed the number of lives, by place in time."""
    chosen: list[tuple[WindowRecord, str]] = []
    seen: set[str] = set()
    for record, name in zip(records, lives, strict=True):
        if name not in seen and len(seen) == most_wheelsets:
            break
        seen.add(name)
        chosen.append((record, name))
    return chosen


def epoch_digest(
    records: Sequence[WindowRecord],
    version: int | None,
    code_version: str,
    measured: Mapping[str, MeasuredCurve] | None = None,
) -> str:
    """Return what tells an epoch from another: its windows, the version before, the code, what has been measured."""
    text = hashlib.sha256(f"{version} {code_version}\n".encode())
    for record in sorted(records, key=lambda item: (item.wheelset, item.start_ns)):
        text.update(f"{record.wheelset} {record.start_ns} {record.content_digest} {record.mileage_km!r}\n".encode())
    for name, curve in sorted((measured or {}).items()):
        text.update(f"{name} {curve.name} {curve.std!r}\n".encode())
        text.update(curve.difference.tobytes() + curve.displacement.tobytes())
    return text.hexdigest()


def resampled(item: Pass, name: str, step: float) -> Pass:
    """Return a pass on a grid, under the name of its wheelset's life."""
    first, displacement, difference = gridded(item, step)
    at = (first + np.arange(len(displacement))) * step
    return replace(
        item,
        wheelset=name,
        at=np.asarray(at, dtype=np.float64),
        displacement=displacement,
        difference=difference,
        stiffness_term=None if item.stiffness_term is None else np.interp(at, item.at, item.stiffness_term),
    )
