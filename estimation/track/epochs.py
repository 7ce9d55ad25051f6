"""What goes into an epoch, and what an epoch's alignment changes: keys, digests, and differences that matter."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.ports import WheelsetRecord, WindowRecord
from estimation.track.passes import Pass, gridded
from estimation.track.screening import ScreeningParameters
from estimation.track.section import SectionParameters
from estimation.types import TrackAlignment


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Settings of the job that keeps alignments current."""

    section: SectionParameters = field(default_factory=SectionParameters)
    screening: ScreeningParameters = field(default_factory=ScreeningParameters)
    most_windows: int = 480  # of an epoch, the newest
    most_wheelsets: int = 48  # of an epoch, each life of a profile and mileage interval one
    pass_step: float = 0.2  # m, grid on which passes are kept
    trusted_offset: float = 5.0  # m: positions on a recorded section are believed as far as this
    same_share: float = 0.5  # of its std by which an alignment may differ and still be the same
    same_least: float = 0.03e-3  # m, of a difference or a std that matters: the geometry cannot tell
    same_std: float = 0.7  # times the std before: more certain than that is another alignment
    same_scale: float = 0.01  # of a scale that is left open and that matters
    same_coverage: float = 0.02  # of the section that is known now and was not


def material(old: TrackAlignment, new: TrackAlignment, settings: AlignmentSettings) -> bool:
    """Whether what was estimated with ``old`` should be estimated again with ``new``.

    It should where ``new`` differs by more than a share of what ``old`` left unknown, is much more certain, reaches
    further, or knows more of the section.
    """
    if old.source != new.source or old.cut_off != new.cut_off or old.gauge_known != new.gauge_known:
        return True
    if len(old.s) != len(new.s) or not np.array_equal(old.s, new.s):
        return True
    before, after = np.isfinite(old.alignment), np.isfinite(new.alignment)
    if (before != after).mean() > settings.same_coverage:
        return True
    both = before & after
    if not both.any():
        return False
    difference = np.sqrt(np.mean((new.alignment - old.alignment)[both] ** 2))
    std, std_now = (np.sqrt(np.mean(one.alignment_std[both] ** 2)) for one in (old, new))
    more_certain = std > settings.same_least and std_now < settings.same_std * std
    scale_known = old.scale_std > settings.same_scale and new.scale_std < settings.same_std * old.scale_std
    return bool(difference > max(settings.same_share * std, settings.same_least) or more_certain or scale_known)


def life(wheelset: WheelsetRecord, record: WindowRecord, interval_km: float) -> str:
    """Return the name under which a window's passes enter the panel: same wheelset, same profile, hardly more wear."""
    turned = [item for item in wheelset.reprofilings if item.at_ns <= record.start_ns]
    begin_km = max((item.mileage_km for item in turned), default=0.0)
    return f"{record.wheelset}#{len(turned)}#{int((record.mileage_km - begin_km) // interval_km)}"


def bounded(
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


def epoch_digest(records: Sequence[WindowRecord], version: int | None, code_version: str) -> str:
    """Return what tells an epoch from another: its windows, the version before, the code."""
    text = hashlib.sha256(f"{version} {code_version}\n".encode())
    for record in sorted(records, key=lambda item: (item.wheelset, item.start_ns)):
        text.update(f"{record.wheelset} {record.start_ns} {record.content_digest} {record.mileage_km!r}\n".encode())
    return text.hexdigest()


def reduced(item: Pass, name: str, step: float) -> Pass:
    """Return a pass on a grid, under the name of its wheelset's life."""
    first, displacement, difference = gridded(item, step)
    at = (first + np.arange(len(displacement))) * step
    return replace(
        item,
        wheelset=name,
        at=np.asarray(at, dtype=np.float64),
        displacement=displacement,
        difference=difference,
        elastic=None if item.elastic is None else np.interp(at, item.at, item.elastic),
    )
