"""Windows of running time, without their samples; and, by their reasons, why nothing is estimated of a wheelset."""

from __future__ import annotations

from typing import Any, Self

from pydantic import Field

from api.schemas.common import finite, why
from api.schemas.derived import Derived
from api.times import Timestamp, to_rfc3339
from estimation.values import windows as values
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.windows import WindowsOfReason, WindowState, WithoutEstimate


class WindowQuality(Derived, of=values.WindowQuality, without=("hunting", "blows")):
    """What the gates looked at."""

    hunting_1: float | None = Field(description="Share of the running time in which the wheelset hunts.")
    hunting_hz: float | None = Field(description="Frequency of the hunting; null where there is none.")
    hunting_amplitude_mm: float | None = Field(description="At least that; null where there is none.")
    blows_1: float | None = Field(description="Share of the running time in which a wheel strikes once a turn.")
    blows_m_s2: float | None = Field(description="Lateral acceleration of these blows; null where there are none.")


class Window(
    Derived,
    of=values.WindowRecord,
    without=("length_ns", "implausible", "samples_purged"),
    columns="wheelset measured_from measured_to vehicle axle track_section mileage_km state reason reason_code quality"
    " content_digest recorded_at",
):
    """A stored window, `[measured_from, measured_to)` on the vehicle's clock."""

    measured_to: Timestamp
    reason: str | None = Field(description="Why it is refused, or what it waits for; null where it is estimated.")
    reason_code: ReasonCode | None
    quality: WindowQuality


def window(record: values.WindowRecord, reason: Reason | None) -> Window:
    """Return the representation of a window."""
    hunting, blows = record.quality.hunting, record.quality.blows
    return Window.made(
        record,
        measured_to=to_rfc3339(record.start_ns + record.length_ns),
        **why(reason),
        quality=WindowQuality.made(
            record.quality,
            hunting_1=finite(hunting.share),
            hunting_hz=finite(hunting.frequency_hz) if hunting.share else None,
            hunting_amplitude_mm=finite(hunting.amplitude, 1000.0) if hunting.share else None,
            blows_1=finite(blows.share),
            blows_m_s2=finite(blows.size) if blows.share else None,
        ),
    )


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
