"""Job: the signatures of new windows, and what the library of all says of every wheelset, the others' data alone.

A wheelset is judged again when its signatures or anything in the library have changed; libraries are shared
(``estimation.signatures.admission``), so that a run costs seven of them at most for each class, axle position and pair
of profiles, however many wheelsets there are.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter

from estimation.errors import DamagedError
from estimation.jobs.job import Job, JobContext
from estimation.jobs.parameters import JOBS
from estimation.jobs.runner import run_all
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.jobs.steps.assumptions import ClassLookup, identity_change, with_identity_alerts
from estimation.jobs.steps.signature_entries import Entries, EntryReader
from estimation.jobs.steps.signature_windows import ASSUMED, JOB_NAME, OF_WINDOWS, usable
from estimation.jobs.work import fails_alone
from estimation.signatures.answer import compared, judged
from estimation.signatures.library import Change, Libraries, Subject, current
from estimation.signatures.parameters import SIGNATURE
from estimation.signatures.window_signatures import SignatureParameters
from estimation.storage import UnitOfWork
from estimation.trend.extrapolation import conicity_at_limit_amplitude
from estimation.trend.parameters import CURVES
from estimation.values.geometry import GEOMETRY
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import EVERYTHING, Facet, SubjectKind
from estimation.values.signatures import (
    ANSWERS,
    NO_PAIR,
    SIGNATURES,
    AxlePosition,
    DesignPair,
    KnownSignatures,
    LibraryEntry,
    Place,
    Signature,
    SignatureAnswer,
    SignatureFinding,
)
from estimation.values.windows import WindowKey, text_of_key

BESIDE = {"wheelsets", "windows", "looks", "results"}  # counts of stages that are no counts of the job
NUMBERS = (SIGNATURE, CURVES)  # that answers are made with
NO_SIGNATURE = Reason(
    ReasonCode.NO_SIGNATURE, "there is no signature of the wheelset since it was last turned, on the track as it is now"
)

_Kind = tuple[str, AxlePosition]


def load_library(unit: UnitOfWork, _: Sequence[str], context: JobContext) -> Mapping[str, Library]:
    """Return what all answers are made from."""
    classes = ClassLookup(unit, context.settings.estimation)
    reader = EntryReader(unit, classes, context.settings.signatures)
    stored = unit.signatures.known()
    signatures, without = usable(unit, context, stored.known)
    answered = unit.results.made_from(ANSWERS)
    reader.read_ahead(signatures, answered)
    made = reader.entries(signatures)
    subjects = _subjects(reader, signatures, answered, context.settings.signatures.most_mileage_km)
    geometries, failed = {}, dict[tuple[SubjectKind, str], Exception]()
    for serial, subject in subjects.items():
        geometry = _geometry(unit, serial, subject.baseline)
        if isinstance(geometry, DamagedError):
            failed[SubjectKind.WHEELSET, serial] = geometry
        else:
            geometries[serial] = geometry
    failed |= {(SubjectKind.WHEELSET, serial): error for serial, error in made.damaged.items()}
    windows = [(wheelset, start_ns) for wheelset, start_ns, _text in stored.damaged]
    for wheelset, start_ns, text in stored.damaged:
        failed[SubjectKind.WINDOW, text_of_key(wheelset, start_ns)] = DamagedError(text)
    shelf = _shelved(made, without, context.settings.signatures)
    rest = (context.settings.signatures, context.code_version, answered, failed, windows)
    return {EVERYTHING: Library(shelf, subjects, geometries, *rest)}


def judge(library: Library) -> Outcome[SignatureFinding]:
    """Return the answers about wheelsets for which something has changed; one that fails stops no other."""
    parts, failed = [], dict(library.failed)
    for serial, subject in library.subjects.items():
        if (SubjectKind.WHEELSET, serial) in failed:
            continue
        geometry = library.geometries[serial]
        shelf = library.shelf
        of_shelf = (shelf.digest, sorted(shelf.left_out.items()))
        digest = _sha(repr((*of_shelf, subject, geometry, library.parameters, NUMBERS)))
        if library.answered.get(serial) == (digest, library.numerics):
            continue
        try:
            parts.append(Part(_finding(library, subject, geometry), subject=serial, made_from=digest))
        except Exception as error:
            if not fails_alone(error):
                raise
            failed[SubjectKind.WHEELSET, serial] = error
    return Outcome(parts, again_ns=0 if failed else None, failed=failed)


def store_answers(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[Library, Outcome[SignatureFinding]]]
) -> Mapping[str, int]:
    """Let signatures that cannot be read be made again; return what was counted of the answers."""
    library, outcome = made[EVERYTHING]
    unit.signatures.drop(library.damaged)
    findings = [part.value for part in outcome.parts if part.value is not None]
    disagreements = (finding.disagreement for finding in findings)
    return {
        "retired": library.shelf.retired,
        "estimated": sum(finding.answer.conicity.value is not None for finding in findings),
        "disagreeing": sum(disagreement is not None and disagreement.disagrees for disagreement in disagreements),
    }


def _sha(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


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

    libraries: Libraries = field(metadata={"made_from": False})
    changes: Mapping[tuple[_Kind, Place], Change] = field(metadata={"made_from": False})
    left_out: Mapping[ReasonCode, int]
    retired: int
    digest: str


def _shelved(made: Entries, without: Mapping[ReasonCode, int], parameters: SignatureParameters) -> _Shelf:
    by_kind: dict[_Kind, list[LibraryEntry]] = defaultdict(list)
    for entry in made.found:
        by_kind[entry.signature.vehicle_class, entry.signature.position].append(entry)
    entries, changes, retired = {}, {}, 0
    for kind, members in by_kind.items():
        on_track = current(members, parameters)
        entries[kind] = on_track.entries
        changes.update({(kind, change.place): change for change in on_track.changes})
        retired += len(on_track.retired)
    libraries = Libraries([entry for kept in entries.values() for entry in kept], parameters)
    left_out = Counter(made.left_out) + Counter(without)
    if retired:
        left_out[ReasonCode.SECTION_CHANGED] += retired
    return _Shelf(libraries, changes, dict(left_out), retired, _sha(repr(sorted(map(_line, libraries.entries)))))


def _line(entry: LibraryEntry) -> str:
    spectra = hashlib.sha256(entry.signature.spectra.tobytes()).hexdigest()
    about = attrgetter("wheelset", "start_ns", "order", "vehicle_class", "position", "place", "speed")(entry.signature)
    label = (entry.baseline, entry.conicity, entry.std, entry.source, entry.shares_data, entry.pair)
    return repr((about, label, spectra))


def _subjects(
    reader: EntryReader, signatures: Sequence[KnownSignatures], answered: Collection[str], most_km: float
) -> dict[str, _Subject]:
    """Return who is judged, by serial: every wheelset that has signatures, or had some when it was judged last.

    By signatures of the wheelset that it is now: of none from before its identity has changed.
    """
    of_wheelset: dict[str, list[KnownSignatures]] = {serial: [] for serial in answered}
    for window in signatures:
        of_wheelset.setdefault(window.found.wheelset, []).append(window)
    subjects, doubted = {}, with_identity_alerts(reader.unit)
    for serial, mine in sorted(of_wheelset.items()):
        last = reader.lives(serial)[-1]
        change = identity_change(reader.unit, serial) if serial in doubted else None
        begin_ns = last.from_ns if change is None else max(last.from_ns, change.after_ns)
        now = [window for window in mine if window.found.start_ns >= begin_ns]
        near = [window for window in now if now[-1].mileage_km - window.mileage_km <= most_km][-JOBS.judged_windows :]
        kind = _kind(near[-1]) if near else None
        pair = reader.pair(mine[-1]) if mine else NO_PAIR
        chosen = [window for window in near if _kind(window) == kind and reader.pair(window) == pair]
        subjects[serial] = _Subject(
            wheelset=serial,
            baseline=last.number,
            pair=pair,
            kind=kind,
            signatures=tuple(item for window in chosen for item in window.found.signatures),
            digests=tuple(window.found.window_digest + window.found.assumed for window in chosen),
            shares_data=frozenset(other for window in chosen for other in reader.sharing(window)),
        )
    return subjects


def _kind(window: KnownSignatures) -> _Kind:
    first = window.found.signatures[0]
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


@dataclass(frozen=True, slots=True)
class Library:
    """What all answers are made from."""

    shelf: _Shelf
    subjects: Mapping[str, _Subject]
    # conicities at 3 mm of those that are judged; None without one of the present profile
    geometries: Mapping[str, Estimate | None]
    parameters: SignatureParameters
    numerics: str
    # what the answers in force are made from, and by which numerics
    answered: Mapping[str, tuple[str, str]] = field(metadata={"made_from": False})
    # what cannot be read, by kind and key
    failed: Mapping[tuple[SubjectKind, str], Exception] = field(metadata={"made_from": False})
    damaged: Sequence[WindowKey] = field(metadata={"made_from": False})  # windows whose signatures cannot be read


def _finding(library: Library, subject: _Subject, geometry: Estimate | None) -> SignatureFinding:
    shelf, answer = library.shelf, SignatureAnswer(subject.wheelset, Estimate.unknown(NO_SIGNATURE))
    signatures = tuple(signature for signature in subject.signatures if _of_present_track(signature, shelf))
    left_out = Counter(shelf.left_out)
    if signatures and subject.kind is not None:
        judges = Subject(subject.wheelset, *subject.kind, subject.pair, subject.shares_data)
        left_out.update(shelf.libraries.admitted(judges).left_out)
        others = shelf.libraries.library(judges)
        if isinstance(others, Reason):
            answer = SignatureAnswer(subject.wheelset, Estimate.unknown(others))
        else:
            answer = judged(subject.wheelset, signatures, others, library.parameters)
    return SignatureFinding(
        answer=answer,
        baseline=subject.baseline,
        signatures=len(signatures),
        from_ns=min((signature.start_ns for signature in signatures), default=None),
        to_ns=max((signature.start_ns for signature in signatures), default=None),
        left_out={code.value: count for code, count in sorted(left_out.items())},
        geometry=geometry,
        disagreement=None if geometry is None else compared(answer.conicity, geometry),
    )


def _of_present_track(signature: Signature, shelf: _Shelf) -> bool:
    """Whether a signature is of the track as it is now."""
    if signature.place is None:
        return True
    change = shelf.changes.get(((signature.vehicle_class, signature.position), signature.place))
    return change is None or signature.start_ns > change.after_ns


OF_ALL = Stage(
    name=ANSWERS.stage,
    job=JOB_NAME,
    kind=SubjectKind.WHEELSET,
    facets=(SIGNATURES, Facet.WINDOWS, Facet.REGISTRY, Facet.LAYOUTS, Facet.RESTARTS, GEOMETRY.stage),
    settings=lambda settings: (settings.signatures, settings.estimation),
    load=load_library,
    compute=judge,
    counted=Counted(looked="looks", changed="answered", more=("retired",)),
    numbers=NUMBERS,
    results=ANSWERS,
    store=store_answers,
    together=True,
)


def run(context: JobContext) -> Mapping[str, int]:
    """Make signatures of new windows, and answers of wheelsets for which something has changed."""
    counted = run_all((ASSUMED, OF_WINDOWS, OF_ALL), context)
    counts = {name: count for name, count in counted.items() if name not in BESIDE}
    with context.storage.read() as unit:
        counts["unchanged"] = len(unit.results.made_from(ANSWERS)) - counts["answered"]
    return counts


JOB = Job(
    name=JOB_NAME,
    description="Make wear signatures of new windows, and judge every wheelset by those of the others",
    every_s=900.0,
    run=run,
)
