"""What goes into an epoch: its windows, their keys and digests."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.passes import Pass, gridded
from estimation.track.profile_life import ProfileLife
from estimation.values.windows import WindowRecord


def limit_batch(
    records: Sequence[WindowRecord], lives: Sequence[ProfileLife], most_wheelsets: int
) -> list[tuple[WindowRecord, ProfileLife]]:
    """Return the first records with their lives, as many as do not exceed the number of lives, by place in time.

    Parameters
    ----------
    records
        Windows by time.
    lives
        Profile life of each.
    most_wheelsets
        Number of lives at most.
    """
    chosen: list[tuple[WindowRecord, ProfileLife]] = []
    seen: set[ProfileLife] = set()
    for record, life in zip(records, lives, strict=True):
        if life not in seen and len(seen) == most_wheelsets:
            break
        seen.add(life)
        chosen.append((record, life))
    return chosen


def epoch_digest(
    records: Sequence[WindowRecord],
    version: int | None,
    code_version: str,
    measured: Mapping[ProfileLife, MeasuredCurve] | None = None,
    assumed: Mapping[tuple[str, int], str] | None = None,
) -> str:
    """Return a digest of what distinguishes an epoch: windows, version before, code, measured curves, vehicles.

    Parameters
    ----------
    records
        Windows of the epoch.
    version
        Of the alignment before; None where there is none.
    code_version
        Version of the numerics.
    measured
        Curves of measured profiles, by profile life.
    assumed
        Digest of what is assumed of the vehicle, by wheelset and start of the window.
    """
    given = assumed or {}
    text = hashlib.sha256(f"{version} {code_version}\n".encode())
    for record in sorted(records, key=lambda item: (item.wheelset, item.start_ns)):
        of_vehicle = given.get((record.wheelset, record.start_ns), "")
        line = f"{record.wheelset} {record.start_ns} {record.content_digest} {record.mileage_km!r} {of_vehicle}\n"
        text.update(line.encode())
    for life, curve in sorted((measured or {}).items()):
        text.update(f"{life.wheelset}#{life.profile}#{life.interval} {curve.name} {curve.std!r}\n".encode())
        text.update(curve.difference.tobytes() + curve.displacement.tobytes())
    return text.hexdigest()


def resampled(item: Pass, life: ProfileLife, step: float) -> Pass:
    """Return a pass on a grid, under the life of its wheelset's profile.

    Parameters
    ----------
    item
        The pass.
    life
        Of the profile of its wheelset.
    step
        Grid spacing, m.
    """
    first, displacement, difference = gridded(item, step)
    at = (first + np.arange(len(displacement))) * step
    return replace(
        item,
        life=life,
        at=np.asarray(at, dtype=np.float64),
        displacement=displacement,
        difference=difference,
        stiffness_term=None if item.stiffness_term is None else np.interp(at, item.at, item.stiffness_term),
    )
