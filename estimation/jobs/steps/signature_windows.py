"""Windows to their signatures, each once: again only where samples, class or layouts are others."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

from estimation.errors import DamagedError, PurgedError, TreadwatchError
from estimation.failures import code_of_error, first_line
from estimation.jobs.isolation import fails_alone
from estimation.jobs.job import JobContext
from estimation.jobs.steps.load_window import WindowLoader
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.jobs.steps.vehicle_lookup import VehicleLookup
from estimation.signatures.parameters import SignatureParameters
from estimation.signatures.window_signatures import window_signatures
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import KnownSignatures, WindowSignatures
from estimation.values.track import TrackLayout
from estimation.values.windows import WindowKey, WindowRecord

VERSION = 2
"""Of what signatures are; with another one all are made again."""
OF_SIGNATURES = ("step", "cell", "block", "wavelengths")
BATCH = 64  # windows
TOGETHER = 200  # wheelsets asked for in one statement


def refresh_windows(context: JobContext, wheelsets: Sequence[str]) -> Mapping[str, int]:
    """Store the signatures of windows that have none, batch by batch; return what was counted.

    Args:
        wheelsets: Serials of those that may have such windows.
    """
    counts: Counter[str] = Counter(signed=0, without_signature=0, made_again=0)
    for first in range(0, len(wheelsets), TOGETHER):
        together = wheelsets[first : first + TOGETHER]
        counts["made_again"] += _forget_outdated(context, together)
        after: WindowKey | None = None
        while (keys := _stored(context, together, after, counts)) is not None:
            after = keys[-1]
            context.checkpoint(first, len(wheelsets))
    return counts


def _stored(
    context: JobContext, wheelsets: Sequence[str], after: WindowKey | None, counts: Counter[str]
) -> Sequence[WindowKey] | None:
    """Store the signatures of the next windows and return their keys; None where there are none."""
    with context.storage.read() as unit:
        keys = unit.signatures.missing(wheelsets, BATCH, after)
        if not keys:
            return None
        found = _made(unit, context, keys, counts)
    with context.storage.write() as unit:
        now = {record.key: record.content_digest for record in unit.windows.several(keys, held=True)}
        same = [one for one in found if now.get((one.wheelset, one.start_ns)) == one.window_digest]
        unit.signatures.put_all(same)
    counts["signed"] += sum(bool(one.signatures) for one in same)
    counts["without_signature"] += sum(not one.signatures for one in same)
    return keys


def assumed_digest(assumed: Assumed, parameters: SignatureParameters, layouts: Mapping[str, int | None]) -> str:
    """Return the digest of all that the signatures of a wheelset on a vehicle rest on beside the samples.

    Args:
        layouts: Versions by section.
    """
    chosen = {name: value for name, value in asdict(parameters).items() if name in OF_SIGNATURES}
    text = repr((VERSION, assumed.digest, sorted(chosen.items()), sorted(layouts.items(), key=str)))
    return hashlib.sha256(text.encode()).hexdigest()


def usable(
    unit: UnitOfWork, context: JobContext, known: Sequence[KnownSignatures]
) -> tuple[list[KnownSignatures], Counter[ReasonCode]]:
    """Return the signatures that are made as they would be now and are finite, and how many windows have none.

    Those that were made otherwise and whose samples are purged cannot be made again: their places may be others.
    """
    classes, layouts = ClassLookup(unit, context.settings.estimation), _layout_versions(unit)
    found, left_out, digests = [], Counter[ReasonCode](), dict[tuple[str, str], str]()
    for one in known:
        pair = one.found.vehicle, one.found.wheelset
        if pair not in digests:
            assumed = classes.assumed(*pair)
            digests[pair] = (
                "" if isinstance(assumed, Reason) else assumed_digest(assumed, context.settings.signatures, layouts)
            )
        finite = tuple(item for item in one.found.signatures if item.finite)
        if digests[pair] != one.found.assumed:
            left_out[ReasonCode.SAMPLES_PURGED] += 1
        elif not finite:
            left_out[ReasonCode.NOT_FINITE] += 1
        else:
            found.append(replace(one, found=replace(one.found, signatures=finite)))
    return found, left_out


def _layout_versions(unit: UnitOfWork) -> dict[str, int | None]:
    standings = unit.tracks.standings()
    versions = {code: standing.layout for code, standing in standings.items()}
    return {one.code: versions.get(one.code) for one in unit.tracks.sections()}


def _forget_outdated(context: JobContext, wheelsets: Sequence[str]) -> int:
    """Remove signatures of another class, other parameters or layouts, whose samples are there; return how many."""
    with context.storage.write() as unit:
        classes, layouts, gone = ClassLookup(unit, context.settings.estimation), _layout_versions(unit), 0
        for vehicle, wheelset, before in unit.signatures.assumptions(wheelsets):
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
    try:
        window = loader.load(record, assumed.windows.vehicle_class)
        made = window if isinstance(window, Reason) else window_signatures(window, assumed.windows, parameters, layout)
    except Exception as error:
        if isinstance(error, TreadwatchError | OSError | MemoryError) or not fails_alone(error):
            raise
        made = Reason(code_of_error(error), first_line(error))
    return WindowSignatures(
        wheelset=record.wheelset,
        start_ns=record.start_ns,
        vehicle=record.vehicle,
        window_digest=record.content_digest,
        assumed=digest,
        signatures=() if isinstance(made, Reason) else made,
        reason=made if isinstance(made, Reason) else None,
    )
