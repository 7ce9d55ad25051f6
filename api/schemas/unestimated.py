"""Why nothing is estimated of a wheelset: its newest windows by reason, and what to do."""

from __future__ import annotations

from typing import Any, Self

from pydantic import Field

from api.schemas.derived import Derived
from estimation.values.reasons import code_of
from estimation.values.windows import WindowsOfReason, WindowState, WithoutEstimate


class WindowsByReason(Derived, of=WindowsOfReason):
    """Windows of one state and reason."""

    meaning: str | None = Field(description="What the code stands for; null without one.")
    what_to_do: str | None = Field(description="Null where there is nothing to do but to wait.")

    @classmethod
    def made(cls, value: WindowsOfReason, **own: Any) -> Self:  # noqa: ANN401 - as of every derived class
        """Return the representation of windows of one reason."""
        code = code_of(value.reason)
        told = (None, None) if code is None else (code.meaning, code.remedy or None)
        return super().made(value, meaning=told[0], what_to_do=told[1], **own)


class UnestimatedBecause(Derived, of=WithoutEstimate, without=("reason",)):
    """Why nothing is estimated of a wheelset now."""

    windows: int = Field(description="Windows that are counted: the newest since the last reprofiling, at most 1,000.")
    pending: int = Field(description="Those of them that wait.")
    refused: int = Field(description="Those of them that are refused.")
    estimated: int = Field(description="Those of them that have a bin table.")
    what_to_do: str | None = Field(description="Null where there is nothing to do but to wait.")


def unestimated_because(found: WithoutEstimate | None) -> UnestimatedBecause | None:
    """Return the representation of why nothing is estimated; None where something is."""
    if found is None:
        return None
    counts = {state.value: found.count(state) for state in WindowState}
    return UnestimatedBecause.made(found, windows=found.counted, **counts, what_to_do=found.what_to_do or None)
