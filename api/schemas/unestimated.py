"""Why nothing is estimated of a wheelset: its newest windows by reason, and what to do."""

from __future__ import annotations

from pydantic import Field

from api.schemas.common import Representation
from api.times import Timestamp, to_rfc3339
from estimation.values.reasons import ReasonCode, code_of, text_of
from estimation.values.window_reasons import WindowsOfReason, WithoutEstimate
from estimation.values.windows import WindowState


class WindowsByReason(Representation):
    """Windows of one state and reason."""

    state: WindowState
    reason: str | None = Field(description="Why they wait, are refused or give no number, as of the newest of them.")
    reason_code: ReasonCode | None
    meaning: str | None = Field(description="What the code stands for; null without one.")
    what_to_do: str | None = Field(description="Null where there is nothing to do but to wait.")
    windows: int = Field(description="How many.")
    newest_at: Timestamp = Field(description="End of the newest of them, on the vehicle's clock.")


class UnestimatedBecause(Representation):
    """Why nothing is estimated of a wheelset now."""

    windows: int = Field(description="Windows that are counted: the newest since the last reprofiling, at most 1,000.")
    pending: int = Field(description="Those of them that wait.")
    refused: int = Field(description="Those of them that are refused.")
    estimated: int = Field(description="Those of them that have a bin table.")
    counted_from: Timestamp | None = Field(description="Begin of the oldest that is counted; null without windows.")
    last_data_at: Timestamp | None = Field(description="End of its newest window, whatever became of it.")
    what_to_do: str | None = Field(description="Null where there is nothing to do but to wait.")
    reasons: list[WindowsByReason] = Field(description="The windows that are counted, the most frequent reason first.")


def unestimated_because(found: WithoutEstimate) -> UnestimatedBecause:
    """Return the representation of why nothing is estimated."""
    return UnestimatedBecause(
        windows=found.counted,
        pending=found.count(WindowState.PENDING),
        refused=found.count(WindowState.REFUSED),
        estimated=found.count(WindowState.ESTIMATED),
        counted_from=_time(found.from_ns),
        last_data_at=_time(found.last_ns),
        what_to_do=found.what_to_do or None,
        reasons=[_windows(one) for one in found.windows],
    )


def _windows(one: WindowsOfReason) -> WindowsByReason:
    return WindowsByReason(
        state=one.state,
        reason=text_of(one.reason),
        reason_code=code_of(one.reason),
        meaning=None if one.reason is None else one.reason.code.meaning,
        what_to_do=None if one.reason is None else one.reason.code.remedy or None,
        windows=one.windows,
        newest_at=to_rfc3339(one.newest_ns),
    )


def _time(t_ns: int | None) -> str | None:
    return None if t_ns is None else to_rfc3339(t_ns)
