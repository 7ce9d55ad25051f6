"""Why a wheelset has no number: its newest windows by what became of them, each with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.values.reasons import Reason
from estimation.values.windows import WindowState


@dataclass(frozen=True, slots=True)
class WindowsOfReason:
    """Windows of one wheelset with one state and one reason."""

    state: WindowState  # of all of them
    reason: Reason | None  # why they were refused or what they wait for, as it is of the newest; None of estimated ones
    windows: int  # how many
    newest_ns: int  # end of the newest, ns UTC on the vehicle's clock


@dataclass(frozen=True, slots=True)
class WithoutEstimate:
    """Why nothing is estimated of a wheelset, and what to do.

    Attributes:
        from_ns: Begin of the oldest window that was counted, ns UTC on the vehicle's clock; None where there is none.
    """

    reason: Reason  # in one sentence
    what_to_do: str  # in sentences; empty where there is nothing to do but to wait
    windows: tuple[WindowsOfReason, ...]  # its newest windows by state and reason, the most frequent first
    from_ns: int | None
    last_ns: int | None  # end of its newest window, whatever became of it; None where there is none

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
