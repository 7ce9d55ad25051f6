"""Stages: windows to their signatures, each once; again where samples, class, parameters or layouts are others."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

from estimation.errors import DamagedError, PurgedError, TreadwatchError
from estimation.jobs.job import JobContext
from estimation.jobs.parameters import WORK
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.jobs.steps.assumptions import Assumed, ClassLookup
from estimation.jobs.steps.load_window import WindowLoader
from estimation.jobs.work import fails_alone
from estimation.motion.integration import WindowParameters
from estimation.signatures.parameters import SIGNATURE
from estimation.signatures.window_signatures import SignatureParameters, window_signatures
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Facet, SubjectKind, code_of_error, first_line
from estimation.values.signatures import SIGNATURES, KnownSignatures, Signature, WindowSignatures
from estimation.values.track import TrackLayout
from estimation.values.windows import Window, key_of_text, text_of_key

JOB_NAME = "refresh_signatures"
VERSION = 2
"""Of what signatures are; with another one all are made again."""
OF_SIGNATURES = ("step", "cell", "block", "wavelengths")


def load_assumptions(
    unit: UnitOfWork, serials: Sequence[str], context: JobContext
) -> Mapping[str, tuple[tuple[str, str], ...]]:
    """Return vehicle and digest of what the signatures of some wheelsets rest on there, where its class is on file."""
    expected = _Expected.of(unit, context)
    expected.classes.look_up(serials)
    expected_of: dict[str, tuple[tuple[str, str], ...]] = {}
    for wheelset, vehicle in unit.signatures.vehicles(serials):
        if digest := expected.digest(vehicle, wheelset):
            expected_of[wheelset] = (*expected_of.get(wheelset, ()), (vehicle, digest))
    return expected_of


def list_other(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[tuple[tuple[str, str], ...], Outcome[None]]]
) -> Mapping[str, int]:
    """List the windows whose signatures were made with other assumptions, or that waited for their class."""
    unit.signatures.list_other([(serial, *expected) for serial, (listed, _) in made.items() for expected in listed])
    return {}


@dataclass(frozen=True, slots=True)
class _Expected:
    """What signatures are made with now."""

    classes: ClassLookup
    layouts: Mapping[str, int | None]  # versions by section
    parameters: SignatureParameters
    _digests: dict[tuple[str, str], str] = field(default_factory=dict)

    @classmethod
    def of(cls, unit: UnitOfWork, context: JobContext) -> _Expected:
        versions = {code: standing.layout for code, standing in unit.tracks.standings().items()}
        layouts = {section.code: versions.get(section.code) for section in unit.tracks.sections()}
        return cls(ClassLookup(unit, context.settings.estimation), layouts, context.settings.signatures)

    def digest(self, vehicle: str, wheelset: str) -> str:
        """Return the digest of all that signatures rest on beside samples; empty where the class is not on file."""
        if (vehicle, wheelset) not in self._digests:
            assumed = self.classes.assumed(vehicle, wheelset)
            self._digests[vehicle, wheelset] = "" if isinstance(assumed, Reason) else self._digest(assumed)
        return self._digests[vehicle, wheelset]

    def _digest(self, assumed: Assumed) -> str:
        chosen = {name: value for name, value in asdict(self.parameters).items() if name in OF_SIGNATURES}
        chosen["least_step"] = SIGNATURE.least_step
        text = repr((VERSION, assumed.digest, sorted(chosen.items()), sorted(self.layouts.items(), key=str)))
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class WindowInputs:
    """What the signatures of a window are made from."""

    wheelset: str
    start_ns: int
    vehicle: str
    digest: str  # of the samples
    assumed: str  # digest of class, parameters and layouts
    again: bool  # whether there are signatures that were made with other assumptions
    without: str  # name under which a window is counted of which none can be made now; empty for the others
    window: Window | Reason | None = field(metadata={"made_from": False})  # None where it cannot
    made_with: WindowParameters | None = field(metadata={"made_from": False})
    layout: TrackLayout | None = field(metadata={"made_from": False})
    parameters: SignatureParameters = field(metadata={"made_from": False})


def load_windows(unit: UnitOfWork, keys: Sequence[str], context: JobContext) -> Mapping[str, WindowInputs]:
    """Return windows with their samples; those that are gone, or have signatures of what they are now, are left out."""
    windows = [key_of_text(key) for key in keys]
    made_of, expected = unit.signatures.made_of(windows), _Expected.of(unit, context)
    records = sorted(unit.windows.several(windows), key=lambda record: (record.vehicle, record.start_ns, record.axle))
    expected.classes.look_up([record.wheelset for record in records], {record.vehicle for record in records})
    loader = WindowLoader(unit, {record.key: record for record in records})
    inputs = {}
    for record in (record for record in records if not record.samples_purged):
        assumed, before = expected.classes.assumed(record.vehicle, record.wheelset), made_of.get(record.key)
        digest = expected.digest(record.vehicle, record.wheelset)
        is_same = before is not None and (before.window_digest, before.assumed) == (record.content_digest, digest)
        if before is not None and is_same and not before.lacked_others:
            continue
        without, window = "waiting_for_class", None
        if not isinstance(assumed, Reason):
            try:
                without, window = "", loader.load(record, assumed.window_parameters.vehicle_class)
            except (DamagedError, PurgedError):
                without = "damaged"
        inputs[text_of_key(*record.key)] = WindowInputs(
            *(record.wheelset, record.start_ns, record.vehicle, record.content_digest, digest),
            again=before is not None and not is_same and before.window_digest == record.content_digest,
            without=without,
            window=window,
            made_with=None if isinstance(assumed, Reason) else assumed.window_parameters,
            layout=None if record.track_section is None else unit.tracks.layout(record.track_section),
            parameters=context.settings.signatures,
        )
    return inputs


def sign(inputs: WindowInputs) -> Outcome[WindowSignatures]:
    """Return the signatures of a window, or why it has none."""
    if inputs.without or inputs.window is None or inputs.made_with is None:
        return Outcome(counted=inputs.without)
    made = inputs.window if isinstance(inputs.window, Reason) else _signatures(inputs, inputs.window, inputs.made_with)
    signatures = WindowSignatures(
        wheelset=inputs.wheelset,
        start_ns=inputs.start_ns,
        vehicle=inputs.vehicle,
        window_digest=inputs.digest,
        assumed=inputs.assumed,
        signatures=() if isinstance(made, Reason) else made,
        reason=made if isinstance(made, Reason) else None,
    )
    return Outcome([Part(signatures)], counted="signed" if signatures.signatures else "without_signature")


def _signatures(inputs: WindowInputs, window: Window, made_with: WindowParameters) -> tuple[Signature, ...] | Reason:
    try:
        return window_signatures(window, made_with, inputs.parameters, inputs.layout)
    except Exception as error:
        if isinstance(error, TreadwatchError | OSError | MemoryError) or not fails_alone(error):
            raise
        return Reason(code_of_error(error), first_line(error))


def store_windows(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[WindowInputs, Outcome[WindowSignatures]]]
) -> Mapping[str, int]:
    """Store signatures of windows that have the same samples still; return how many are made again."""
    signed = [part.value for _, outcome in made.values() for part in outcome.parts if part.value is not None]
    if not signed:
        return {}
    keys = [(window.wheelset, window.start_ns) for window in signed]
    now = {record.key: record.content_digest for record in unit.windows.several(keys, held=True)}
    unit.signatures.put_all([w for w in signed if now.get((w.wheelset, w.start_ns)) == w.window_digest])
    return {"made_again": sum(inputs.again for inputs, _ in made.values())}


ASSUMED = Stage(
    name="signature_assumptions",
    job=JOB_NAME,
    kind=SubjectKind.WHEELSET,
    facets=(Facet.REGISTRY, Facet.LAYOUTS),
    settings=lambda settings: (VERSION, settings.estimation, settings.signatures),
    load=load_assumptions,
    compute=lambda _: Outcome(),  # what follows is that windows are due
    counted=Counted(looked="wheelsets", changed="results"),
    numbers=(SIGNATURE,),
    store=list_other,
    at_once=200,
)
OF_WINDOWS = Stage(
    name=SIGNATURES,
    job=JOB_NAME,
    kind=SubjectKind.WINDOW,
    facets=(),
    settings=lambda _: VERSION,
    load=load_windows,
    compute=sign,
    counted=Counted(looked="windows", changed="results", more=("signed", "without_signature", "made_again")),
    store=store_windows,
    at_once=WORK.signature_windows,
)


def usable(
    unit: UnitOfWork, context: JobContext, signatures: Sequence[KnownSignatures]
) -> tuple[list[KnownSignatures], Counter[ReasonCode]]:
    """Return the signatures that are made as they would be now and are finite, and how many windows have none.

    Those that were made otherwise and whose samples are purged cannot be made again: their places may be others.
    """
    expected, standing, left_out = _Expected.of(unit, context), [], Counter[ReasonCode]()
    expected.classes.look_up([w.found.wheelset for w in signatures], {w.found.vehicle for w in signatures})
    for window in signatures:
        finite = tuple(item for item in window.found.signatures if item.finite)
        if expected.digest(window.found.vehicle, window.found.wheelset) != window.found.assumed:
            left_out[ReasonCode.SAMPLES_PURGED] += 1
        elif not finite:
            left_out[ReasonCode.NOT_FINITE] += 1
        else:
            standing.append(replace(window, found=replace(window.found, signatures=finite)))
    return standing, left_out
