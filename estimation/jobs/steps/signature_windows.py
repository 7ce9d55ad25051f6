"""Windows to their signatures, each once: again only where samples, class or layouts are others."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from estimation.errors import DamagedError, PurgedError
from estimation.jobs.job import JobContext
from estimation.jobs.steps.load_window import WindowLoader
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.jobs.steps.vehicle_lookup import VehicleLookup
from estimation.signatures.parameters import SignatureParameters
from estimation.signatures.window_signatures import window_signatures
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason
from estimation.values.signatures import WindowSignatures
from estimation.values.track import TrackLayout
from estimation.values.windows import WindowKey, WindowRecord

VERSION = 1
"""Of what signatures are; with another one all are made again."""
OF_SIGNATURES = ("step", "cell", "block", "wavelengths")
BATCH = 64


def refresh_windows(context: JobContext) -> Mapping[str, int]:
    """Store the signatures of windows that have none, batch by batch; return what was counted.

    Parameters
    ----------
    context
        Of the job.
    """
    counts: Counter[str] = Counter(signed=0, without_signature=0)
    counts["made_again"] = _forget_outdated(context)
    after: WindowKey | None = None
    done = 0
    while True:
        with context.storage.read() as unit:
            keys = unit.signatures.missing(BATCH, after)
            if not keys:
                return counts
            found = _made(unit, context, keys, counts)
        with context.storage.write() as unit:
            now = {record.key: record.content_digest for record in unit.windows.several(keys, held=True)}
            same = [one for one in found if now.get((one.wheelset, one.start_ns)) == one.window_digest]
            unit.signatures.put_all(same)
        counts["signed"] += sum(bool(one.signatures) for one in same)
        counts["without_signature"] += sum(not one.signatures for one in same)
        after, done = keys[-1], done + len(keys)
        context.checkpoint(done, done + len(keys))


def assumed_digest(assumed: Assumed, parameters: SignatureParameters, layouts: Mapping[str, int | None]) -> str:
    """Return the digest of all that the signatures of a wheelset on a vehicle rest on beside the samples.

    Parameters
    ----------
    assumed
        Class, filters and gates.
    parameters
        Cells and bands.
    layouts
        Versions by section.
    """
    chosen = {name: value for name, value in asdict(parameters).items() if name in OF_SIGNATURES}
    text = repr((VERSION, assumed.digest, sorted(chosen.items()), sorted(layouts.items(), key=str)))
    return hashlib.sha256(text.encode()).hexdigest()


def _layout_versions(unit: UnitOfWork) -> dict[str, int | None]:
    return {one.code: unit.tracks.layout_version(one.code) for one in unit.tracks.sections()}


def _forget_outdated(context: JobContext) -> int:
    """Remove signatures of another class, other parameters or layouts, whose samples are there; return how many."""
    with context.storage.write() as unit:
        classes, layouts, gone = ClassLookup(unit, context.settings.estimation), _layout_versions(unit), 0
        for vehicle, wheelset, before in unit.signatures.assumptions():
            assumed = classes.assumed(vehicle, wheelset)
            if isinstance(assumed, Reason):
                continue
            if assumed_digest(assumed, context.settings.signatures, layouts) != before:
                gone += unit.signatures.forget(vehicle, wheelset, before)
    return gone


def _made(
    unit: UnitOfWork, context: JobContext, keys: Sequence[WindowKey], counts: Counter[str]
) -> list[WindowSignatures]:
    classes, versions = ClassLookup(unit, context.settings.estimation), _layout_versions(unit)
    records = sorted(unit.windows.several(keys), key=lambda one: (one.vehicle, one.start_ns, one.axle))
    loader = WindowLoader(unit, VehicleLookup(unit))
    layouts: dict[str, TrackLayout | None] = {}
    found = []
    for record in records:
        assumed = classes.assumed(record.vehicle, record.wheelset)
        if isinstance(assumed, Reason):
            counts["waiting_for_class"] += 1
            continue
        if record.track_section is not None and record.track_section not in layouts:
            layouts[record.track_section] = unit.tracks.layout(record.track_section)
        layout = None if record.track_section is None else layouts[record.track_section]
        digest = assumed_digest(assumed, context.settings.signatures, versions)
        try:
            found.append(_of_window(loader, record, assumed, digest, layout, context.settings.signatures))
        except (DamagedError, PurgedError):
            counts["damaged"] += 1
    return found


def _of_window(
    loader: WindowLoader,
    record: WindowRecord,
    assumed: Assumed,
    digest: str,
    layout: TrackLayout | None,
    parameters: SignatureParameters,
) -> WindowSignatures:
    window = loader.load(record, assumed.windows.vehicle_class)
    made = window if isinstance(window, Reason) else window_signatures(window, assumed.windows, parameters, layout)
    return WindowSignatures(
        wheelset=record.wheelset,
        start_ns=record.start_ns,
        vehicle=record.vehicle,
        window_digest=record.content_digest,
        assumed=digest,
        signatures=() if isinstance(made, Reason) else made,
        reason=made if isinstance(made, Reason) else None,
    )
