"""What the wear signatures of a wheelset show, beside what its geometry says."""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

from pydantic import Field

from api.schemas.common import Links
from api.schemas.derived import Derived, provenance
from api.schemas.registry import segment
from api.times import Timestamp
from estimation.signatures.answer import most_likely
from estimation.values import signatures as values
from estimation.values.results import Result


class StateOfWear(Derived, of=values.StateProbability):
    """A range of the equivalent conicity at 3 mm, and how likely the wheelset is in it."""


class UsedEntry(Derived, of=values.UsedEntry):
    """A wheelset of the library on a section, and how much it counts for the answer."""


class MethodsCompared(Derived, of=values.Disagreement):
    """How far signature and geometry are apart, both at 3 mm."""


class _Said(Derived, of=values.SignatureAnswer, without=("used",)):
    """What the library says."""


class SignatureAnswer(_Said, of=values.SignatureFinding, without=("answer", "signatures")):
    """What a library of other wheelsets' raw signals says of this one; never mixed into its geometry."""

    method: Literal["signature"] = Field(description="How the conicity was found; that of the geometry is `geometry`.")
    state: StateOfWear | None = Field(description="The most likely state; null where nothing is said.")
    used_entries: list[UsedEntry] = Field(
        description="Those that count most, at most ten; without those of fleets that you do not see."
    )
    recorded_at: Timestamp
    code_version: str
    input_digest: str
    links: Links


def signature_answer(result: Result[values.SignatureFinding], seen: Collection[str]) -> SignatureAnswer:
    """Return the representation of an answer."""
    assert result.value is not None
    found, own = result.value.answer, f"/v1/wheelsets/{segment(result.subject)}"
    return SignatureAnswer.made(
        result.value,
        **provenance(result),
        **dict(_Said.made(found)),
        method=values.METHOD,
        state=StateOfWear.made(most_likely(found.states)) if found.states else None,
        used_entries=[UsedEntry.made(one) for one in found.used if one.wheelset in seen],
        links={"self": f"{own}/signature", "wheelset": own, "geometry": f"{own}/geometry", "windows": f"{own}/windows"},
    )
