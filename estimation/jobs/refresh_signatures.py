"""Job: the signatures of new windows, and what the library of all says of every wheelset, the others' data alone.

Where nothing has happened to any wheelset, counters say so. Otherwise a wheelset is judged again when its signatures or
anything in the library have changed; libraries are shared (``estimation.signatures.retirement``), so that a run costs
seven of them at most for each class, axle position and pair of profiles, however many wheelsets there are.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from estimation.errors import DamagedError
from estimation.jobs.isolation import Isolation
from estimation.jobs.job import Job, JobContext
from estimation.jobs.steps.identities import identity_change, suspected
from estimation.jobs.steps.signature_entries import Entries, EntryReader
from estimation.jobs.steps.signature_windows import VERSION, refresh_windows, usable
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.jobs.steps.vehicle_lookup import VehicleLookup
from estimation.signatures.answer import compared, judged
from estimation.signatures.parameters import SignatureParameters
from estimation.signatures.retirement import Change, Libraries, Subject, current
from estimation.storage import UnitOfWork
from estimation.trend.extrapolation import conicity_at_limit_amplitude
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Look, SubjectKind
from estimation.values.signatures import (
    NO_PAIR,
    AxlePosition,
    DesignPair,
    KnownSignatures,
    LibraryEntry,
    Place,
    Signature,
    SignatureAnswer,
    SignatureRecord,
)
from estimation.values.windows import key_of_text, text_of_key

STAGE = "refresh_signatures"
NEWEST = 12  # windows that a wheelset is judged by

_Kind = tuple[str, AxlePosition]


def run(context: JobContext) -> Mapping[str, int]:
    """Make signatures of new windows, and answers of wheelsets for which something has changed."""
    counts: Counter[str] = Counter(signed=0, without_signature=0, made_again=0, retired=0, answered=0, unchanged=0)
    isolation = Isolation(context, STAGE)
    failed = _held(isolation)
    with context.storage.read() as unit:
        seen, looks = unit.looks.of(STAGE), wheelset_looks(unit, context)
    news = [serial for serial, look in looks.items() if seen.get(serial) != look or serial in failed]
    if not news:
        counts["unchanged"] = len(looks)
        return counts
    counts.update(refresh_windows(context, news))
    counts.update(_judge(context, isolation))
    counts["quarantined"] = isolation.quarantined
    out = _held(isolation)
    with context.storage.write() as unit:
        for serial in news:
            if serial not in out:
                unit.looks.note(STAGE, serial, looks[serial])
    return counts


def _held(isolation: Isolation) -> frozenset[str]:
    """Return the wheelsets that failed, or something of which is damaged."""
    windows = {key_of_text(item.key)[0] for item in isolation.held(SubjectKind.WINDOW)}
    return frozenset({item.key for item in isolation.held(SubjectKind.WHEELSET)} | windows)


def wheelset_looks(unit: UnitOfWork, context: JobContext) -> dict[str, Look]:
    """Return by wheelset what is said of it rests on, by what has happened to it, and what is common to all.

    Args:
        unit: As one transaction sees it, before the look.
    """
    codes = unit.registry.classes_in_use()
    classes = [(code, None if (found := unit.registry.vehicle_class(code)) is None else found.digest) for code in codes]
    layouts = sorted((code, standing.layout) for code, standing in unit.tracks.standings().items())
    settings = context.settings
    common = repr(
        (classes, unit.tracks.sections(), layouts, settings.estimation.as_json(), settings.signatures, VERSION)
    )
    text = f"{hashlib.sha256(common.encode()).hexdigest()} {context.code_version}"
    touched = unit.looks.touched()
    return {serial: Look(_sha(f"{touched[serial]} {text}")) for serial in sorted(touched)}


def _sha(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _judge(context: JobContext, isolation: Isolation) -> Mapping[str, int]:
    """Judge the wheelsets for which something has changed; return what was counted."""
    counts: Counter[str] = Counter()
    with context.storage.read() as unit:
        classes = ClassLookup(unit, context.settings.estimation)
        reader = EntryReader(unit, classes, VehicleLookup(unit), context.settings.signatures)
        stored = unit.signatures.known()
        known, without = usable(unit, context, stored.known)
        made, answered = reader.entries(known), unit.signatures.answered()
        subjects = _subjects(reader, known, answered, context.settings.signatures.most_mileage_km)
        geometries = {serial: _geometry(unit, serial, one.baseline) for serial, one in subjects.items()}
    _set_aside(context, isolation, stored.damaged)
    unreadable = {serial: one for serial, one in geometries.items() if isinstance(one, DamagedError)}
    unreadable.update(made.damaged)
    for serial, error in sorted(unreadable.items()):
        isolation.keep(SubjectKind.WHEELSET, serial, "", error)
    shelf = _shelved(made, without, context.settings.signatures)
    counts["retired"] = shelf.retired
    for done, (serial, subject) in enumerate(subjects.items()):
        context.checkpoint(done, len(subjects))
        geometry = geometries[serial]
        if serial in unreadable or isinstance(geometry, DamagedError):
            continue
        digest = _digest(context, shelf, subject, geometry)
        if answered.get(serial) == (digest, context.code_version):
            counts["unchanged"] += 1
            isolation.release(SubjectKind.WHEELSET, serial)
            continue
        with isolation.alone(SubjectKind.WHEELSET, serial):
            record = _record(context, shelf, subject, geometry, digest)
            with context.storage.write() as unit:
                unit.signatures.put_answer(record)
            counts["answered"] += 1
            counts["estimated"] += record.answer.conicity.value is not None
            counts["disagreeing"] += record.disagreement is not None and record.disagreement.disagrees
    return counts


def _set_aside(context: JobContext, isolation: Isolation, damaged: Sequence[tuple[str, int, str]]) -> None:
    """Keep windows in quarantine whose signatures cannot be read; these are made again where samples are there."""
    keys = [(wheelset, start_ns) for wheelset, start_ns, _ in damaged]
    for wheelset, start_ns, text in damaged:
        isolation.keep(SubjectKind.WINDOW, text_of_key(wheelset, start_ns), "", DamagedError(text))
    if keys:
        with context.storage.write() as unit:
            unit.signatures.drop(keys)
    for item in isolation.held(SubjectKind.WINDOW):
        if key_of_text(item.key) not in keys:
            isolation.release(SubjectKind.WINDOW, item.key)


@dataclass(frozen=True, slots=True)
class _Subject:
    """A wheelset, and the signatures that it is judged by."""

    wheelset: str
    baseline: int
    pair: DesignPair
    kind: _Kind | None  # None without signatures since it was last turned
    signatures: tuple[Signature, ...]
    digests: tuple[str, ...]
    shares_data: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Shelf:
    """Entries by kind that are of the present track, and where it has changed."""

    libraries: Libraries
    changes: Mapping[tuple[_Kind, Place], Change]
    left_out: Mapping[ReasonCode, int]
    retired: int
    digest: str


def _shelved(made: Entries, without: Mapping[ReasonCode, int], parameters: SignatureParameters) -> _Shelf:
    by_kind: dict[_Kind, list[LibraryEntry]] = defaultdict(list)
    for entry in made.found:
        by_kind[entry.signature.vehicle_class, entry.signature.position].append(entry)
    entries, changes, retired = {}, {}, 0
    for kind, members in by_kind.items():
        found = current(members)
        entries[kind] = found.entries
        changes.update({(kind, change.place): change for change in found.changes})
        retired += len(found.retired)
    libraries = Libraries([entry for kept in entries.values() for entry in kept], parameters)
    left_out = Counter(made.left_out) + Counter(without)
    if retired:
        left_out[ReasonCode.SECTION_CHANGED] += retired
    return _Shelf(libraries, changes, dict(left_out), retired, _sha(repr(sorted(map(_line, libraries.entries)))))


def _line(entry: LibraryEntry) -> str:
    """Return all of an entry."""
    one = entry.signature
    spectra = hashlib.sha256(one.spectra.tobytes()).hexdigest()
    about = (one.wheelset, one.start_ns, one.order, one.vehicle_class, one.position, one.place, one.speed)
    known = (entry.baseline, entry.conicity, entry.std, entry.source, entry.shares_data, entry.pair)
    return repr((about, known, spectra))


def _subjects(
    reader: EntryReader, known: Sequence[KnownSignatures], answered: Collection[str], most_km: float
) -> dict[str, _Subject]:
    """Return who is judged, by serial: every wheelset that has signatures, or had some when it was judged last.

    By signatures of the wheelset that it is now: of none from before its identity has changed.
    """
    of_wheelset: dict[str, list[KnownSignatures]] = {serial: [] for serial in answered}
    for one in known:
        of_wheelset.setdefault(one.found.wheelset, []).append(one)
    found, doubted = {}, suspected(reader.unit)
    for serial, mine in sorted(of_wheelset.items()):
        last = reader.lives(serial)[-1]
        change = identity_change(reader.unit, serial) if serial in doubted else None
        begin_ns = last.from_ns if change is None else max(last.from_ns, change.after_ns)
        now = [one for one in mine if one.found.start_ns >= begin_ns]
        newest = now[-1] if now else None
        near = [one for one in now if newest and newest.mileage_km - one.mileage_km <= most_km][-NEWEST:]
        kind = _kind(near[-1]) if near else None
        pair = reader.pair(mine[-1]) if mine else NO_PAIR
        chosen = [one for one in near if _kind(one) == kind and reader.pair(one) == pair]
        found[serial] = _Subject(
            wheelset=serial,
            baseline=last.number,
            pair=pair,
            kind=kind,
            signatures=tuple(item for one in chosen for item in one.found.signatures),
            digests=tuple(one.found.window_digest + one.found.assumed for one in chosen),
            shares_data=frozenset(other for one in chosen for other in reader.sharing(one)),
        )
    return found


def _kind(one: KnownSignatures) -> _Kind:
    first = one.found.signatures[0]
    return first.vehicle_class, first.position


def _geometry(unit: UnitOfWork, serial: str, baseline: int) -> Estimate | DamagedError | None:
    """Return the conicity at 3 mm by the geometry; None without one of the present profile."""
    try:
        record = unit.geometries.current(serial)
    except DamagedError as error:
        return error
    if record is None or record.baseline != baseline:
        return None
    return conicity_at_limit_amplitude(record.geometry)


def _digest(context: JobContext, shelf: _Shelf, subject: _Subject, geometry: Estimate | None) -> str:
    text = repr((shelf.digest, sorted(shelf.left_out.items()), subject, geometry, context.settings.signatures))
    return _sha(text)


def _record(
    context: JobContext,
    shelf: _Shelf,
    subject: _Subject,
    geometry: Estimate | None,
    digest: str,
) -> SignatureRecord:
    """Return the answer about a wheelset."""
    signatures = tuple(one for one in subject.signatures if _of_present_track(one, shelf))
    left_out = Counter(shelf.left_out)
    answer = None if signatures else _silent(subject)
    if answer is None and subject.kind is not None:
        judges = Subject(subject.wheelset, *subject.kind, subject.pair, subject.shares_data)
        left_out.update(shelf.libraries.admitted(judges).left_out)
        found = shelf.libraries.library(judges)
        if isinstance(found, Reason):
            answer = SignatureAnswer(subject.wheelset, Estimate.unknown(found))
        else:
            answer = judged(subject.wheelset, signatures, found, context.settings.signatures)
    assert answer is not None
    return SignatureRecord(
        answer=answer,
        baseline=subject.baseline,
        signatures=len(signatures),
        from_ns=min((one.start_ns for one in signatures), default=None),
        to_ns=max((one.start_ns for one in signatures), default=None),
        left_out={code.value: count for code, count in sorted(left_out.items())},
        geometry=geometry,
        disagreement=None if geometry is None else compared(answer.conicity, geometry),
        input_digest=digest,
        code_version=context.code_version,
        recorded_ns=context.clock.now_ns(),
    )


def _of_present_track(one: Signature, shelf: _Shelf) -> bool:
    """Whether a signature is of the track as it is now."""
    if one.place is None:
        return True
    change = shelf.changes.get(((one.vehicle_class, one.position), one.place))
    return change is None or one.start_ns > change.after_ns


def _silent(subject: _Subject) -> SignatureAnswer:
    text = "there is no signature of the wheelset since it was last turned, on the track as it is now"
    reason = Reason(ReasonCode.NO_SIGNATURE, text)
    return SignatureAnswer(subject.wheelset, Estimate.unknown(reason))


JOB = Job(
    name=STAGE,
    description="Make wear signatures of new windows, and judge every wheelset by those of the others",
    every_s=900.0,
    run=run,
)
