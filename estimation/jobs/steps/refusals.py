"""What windows were refused for in a run: counted by code, and in words."""

from __future__ import annotations

from collections.abc import Mapping

from estimation.values.reasons import Reason, ReasonCode

REFUSED = "refused_"
"""Begin of the names under which a run counts refused windows by reason code."""


def count_of(reason: Reason) -> str:
    """Return the name under which a window is counted that was refused for a reason."""
    return f"{REFUSED}{reason.code.value}"


def refusals(counts: Mapping[str, int]) -> dict[ReasonCode, int]:
    """Return how many windows a run has refused, by reason code, the most frequent first."""
    known = {count_of(Reason(code, "")): code for code in ReasonCode}
    found = {known[name]: count for name, count in counts.items() if name in known and count}
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0].value)))


def refusals_text(counts: Mapping[str, int]) -> str:
    """Return what windows were refused for, with what to do; empty where none was."""
    parts = []
    for code, count in refusals(counts).items():
        remedy = code.remedy.rstrip(".")
        parts.append(f"{count} {code.value}" + (f" ({remedy})" if remedy else ""))
    return ", ".join(parts)
