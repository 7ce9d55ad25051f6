"""Why a wheelset has no number: its newest windows by what became of them, each with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from estimation.values.reasons import Reason
from estimation.values.served import Served
from estimation.values.windows import WindowState


@dataclass(frozen=True, slots=True)
class WindowsOfReason:
    """Windows of one wheelset with one state and one reason."""

    state: WindowState  # of all of them
    reason: Annotated[Reason | None, Served("Why they wait, are refused or give no number, as of the newest of them.")]
    windows: Annotated[int, Served("How many.")]
    newest_ns: Annotated[int, Served("End of the newest of them, on the vehicle's clock.")]


@dataclass(frozen=True, slots=True)
class WithoutEstimate:
    """Why nothing is estimated of a wheelset, and what to do."""

    reason: Reason  # in one sentence
    what_to_do: str  # in sentences; empty where there is nothing to do but to wait
    windows: Annotated[
        tuple[WindowsOfReason, ...], Served("The windows that are counted, the most frequent reason first.", "reasons")
    ]
    from_ns: Annotated[int | None, Served("Begin of the oldest that is counted; null without windows.", "counted_from")]
    last_ns: Annotated[int | None, Served("End of its newest window, whatever became of it.", "last_data_at")]

    def count(self, state: WindowState) -> int:
        """Return how many of the counted windows have a state."""
        return sum(one.windows for one in self.windows if one.state is state)

    @property
    def counted(self) -> int:
        """How many windows were counted."""
        return sum(one.windows for one in self.windows)


def remedies(reasons: Sequence[Reason | None]) -> str:
    """Return what to do about some reasons, each remedy once, in their order.

    Args:
        reasons: The most important one first.
    """
    return " ".join(dict.fromkeys(one.code.remedy for one in reasons if one is not None and one.code.remedy))
