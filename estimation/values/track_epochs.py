"""Epochs of a section: what each of them rests on, and what was known after it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from estimation.values.reasons import Reason
from estimation.values.windows import WindowRecord

OPEN_NS = (1 << 63) - 1
"""Horizon of the last epoch of a section: whatever comes later may belong to it."""


@dataclass(frozen=True, slots=True)
class FoldState:
    """What is known of a section after some of its epochs.

    Attributes:
        version: Of the alignment in force; None where there is none.
        same_since: Oldest version of the chain from which it does not differ materially.
        survey: What the fleet has found of the survey; None where it was not checked.
    """

    version: int | None
    same_since: int | None
    survey: Reason | None = None

    def key(self, given: str) -> str:
        """Return what distinguishes this state as the start of an epoch; ``given`` is what all epochs rest on."""
        survey = "" if self.survey is None else f"{self.survey.code} {self.survey.text}"
        return f"{given} {self.version} {self.same_since} {survey}"


@dataclass(frozen=True, slots=True)
class TrackEpoch:
    """One epoch of a section as it was computed last. Key: (section, number), from 1 in vehicle time.

    Attributes:
        before: Key of the state that it started from.
        input_digest: Of the windows that it rests on, with what is assumed of each.
        horizon_ns: Up to when another window would change which windows are its own.
        waits: It identified nothing: its windows are looked at again together with those of the next.
        after: What is known after it.
        estimated_on: Version that its own windows are estimated on, as long as the last one does not differ materially.
        report: Number of its report.
    """

    section: str
    number: int
    before: str
    input_digest: str
    horizon_ns: int
    windows: int
    waits: bool
    after: FoldState
    estimated_on: int | None
    report: int
    recorded_ns: int


@dataclass(frozen=True, slots=True)
class FoundOfVehicles:
    """Of which vehicles an epoch has found what matters for their windows alone.

    Attributes:
        version: That holds it: windows of these vehicles are estimated on no older one.
        stiffness_ratio: By vehicle, as that version has it; 1 where it has none.
    """

    version: int
    stiffness_ratio: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class EpochMember:
    """A window of an epoch, as it was when the epoch was computed."""

    record: WindowRecord
    context: str  # digest of all that is on file of its wheelset on its vehicle
    assumed: str  # digest of what of it concerns this window


@dataclass(frozen=True, slots=True)
class EpochNews:
    """What has changed under the epochs of a section since they were computed.

    Attributes:
        from_ns: Start of the first window that is new, changed or gone; None where none is.
        unplaced: Epochs with windows whose positions have been forgotten.
    """

    from_ns: int | None
    unplaced: frozenset[int]
