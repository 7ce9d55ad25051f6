"""What the wear signatures of a wheelset show, beside what its geometry says."""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

from pydantic import Field

from api.schemas.common import Links, Representation, Uncertain, finite, uncertain
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.signatures.answer import most_likely
from estimation.values.reasons import ReasonCode, code_of, text_of
from estimation.values.signatures import METHOD, Basis, ConicitySource, SignatureRecord, StateProbability


class StateOfWear(Representation):
    """A range of the equivalent conicity at 3 mm, and how likely the wheelset is in it."""

    from_1: float = Field(description="Least equivalent conicity of the state.")
    to_1: float | None = Field(description="Where the next state begins; null for the last.")
    probability: float = Field(description="That the conicity is in this state.")


class UsedEntry(Representation):
    """A wheelset of the library on a section, and how much it counts for the answer."""

    wheelset: str
    section: str
    equivalent_conicity_1: float = Field(description="On file, at 3 mm.")
    weight: float = Field(description="Share of all entries that were used.")
    source: ConicitySource = Field(description="How its conicity is known.")


class MethodsCompared(Representation):
    """How far signature and geometry are apart, both at 3 mm."""

    difference_1: float = Field(description="Signature less geometry.")
    difference_std_1: float = Field(description="Standard deviation of the difference.")
    disagree: bool = Field(description="Whether their 95 % intervals are apart: a finding.")
    reason: str | None
    reason_code: ReasonCode | None


class SignatureAnswer(Representation):
    """What a library of other wheelsets' raw signals says of this one; never mixed into its geometry."""

    wheelset: str = Field(examples=["WS-0001"])
    method: Literal["signature"] = Field(description="How the conicity was found; that of the geometry is `geometry`.")
    equivalent_conicity_at_3_mm_1: Uncertain = Field(description="`n_windows` counts signatures: stretches of track.")
    basis: Basis | None = Field(description="Whether the library has the places that the wheelset passed.")
    state: StateOfWear | None = Field(description="The most likely state; null where nothing is said.")
    states: list[StateOfWear] = Field(description="All states; empty where nothing is said.")
    used_entries: list[UsedEntry] = Field(
        description="Those that count most, at most ten; without those of fleets that you do not see."
    )
    library_wheelsets: int = Field(description="Wheelsets that the library has for this one.")
    library_sections: int = Field(description="Sections that it has.")
    left_out: dict[str, int] = Field(description="Library entries and windows that do not count, by reason.")
    novelty: float | None = Field(description="Distance from the library; above 1 nothing is said.")
    geometry_at_3_mm_1: Uncertain | None = Field(
        description="What the geometry says; null without one of this profile."
    )
    compared: MethodsCompared | None = Field(description="Null where one of the two says nothing.")
    baseline: int = Field(description="Number of reprofilings before it.")
    measured_from: Timestamp | None
    measured_to: Timestamp | None
    recorded_at: Timestamp
    code_version: str
    input_digest: str
    links: Links


def _state(found: StateProbability) -> StateOfWear:
    return StateOfWear(from_1=found.low, to_1=finite(found.high), probability=found.probability)


def signature_answer(record: SignatureRecord, seen: Collection[str]) -> SignatureAnswer:
    """Return the representation of an answer.

    Args:
        seen: Wheelsets of the library that may be named.
    """
    found, differs = record.answer, record.disagreement
    own = f"/v1/wheelsets/{segment(record.wheelset)}"
    return SignatureAnswer(
        wheelset=record.wheelset,
        method=METHOD,
        equivalent_conicity_at_3_mm_1=uncertain(found.conicity),
        basis=found.basis,
        state=_state(most_likely(found.states)) if found.states else None,
        states=[_state(one) for one in found.states],
        used_entries=[
            UsedEntry(
                wheelset=one.wheelset,
                section=one.section,
                equivalent_conicity_1=one.conicity,
                weight=one.weight,
                source=one.source,
            )
            for one in found.used
            if one.wheelset in seen
        ],
        library_wheelsets=found.library_wheelsets,
        library_sections=found.library_sections,
        left_out=dict(record.left_out),
        novelty=finite(found.novelty),
        geometry_at_3_mm_1=None if record.geometry is None else uncertain(record.geometry),
        compared=None
        if differs is None
        else MethodsCompared(
            difference_1=differs.difference,
            difference_std_1=differs.std,
            disagree=differs.disagrees,
            reason=text_of(differs.reason),
            reason_code=code_of(differs.reason),
        ),
        baseline=record.baseline,
        measured_from=None if record.from_ns is None else to_rfc3339(record.from_ns),
        measured_to=None if record.to_ns is None else to_rfc3339(record.to_ns),
        recorded_at=to_rfc3339(record.recorded_ns),
        code_version=record.code_version,
        input_digest=record.input_digest,
        links={"self": f"{own}/signature", "wheelset": own, "geometry": f"{own}/geometry", "windows": f"{own}/windows"},
    )
