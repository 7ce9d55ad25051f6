"""Windows of running time, without their samples."""

from __future__ import annotations

from pydantic import Field

from api.schemas.common import Representation, finite
from api.times import Timestamp, to_rfc3339
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.windows import WindowRecord, WindowState


class WindowQuality(Representation):
    """What the gates looked at."""

    coverage_1: float | None
    longest_gap_s: float | None
    gaps: int
    clipped_1: float | None
    invalid_1: float | None
    speed_min_m_s: float | None
    speed_max_m_s: float | None
    position_quality_1: float | None
    sensor_fault: bool
    hunting_1: float | None = Field(description="Share of the running time in which the wheelset hunts.")
    hunting_hz: float | None = Field(description="Frequency of the hunting; null where there is none.")
    hunting_amplitude_mm: float | None = Field(description="At least that; null where there is none.")
    blows_1: float | None = Field(description="Share of the running time in which a wheel strikes once a turn.")
    blows_m_s2: float | None = Field(description="Lateral acceleration of these blows; null where there are none.")


class Window(Representation):
    """A stored window, `[measured_from, measured_to)` on the vehicle's clock."""

    wheelset: str
    measured_from: Timestamp
    measured_to: Timestamp
    vehicle: str
    axle: int
    track_section: str | None
    mileage_km: float | None
    state: WindowState
    reason: str | None = Field(description="Why it is refused, or what it waits for; null where it is estimated.")
    reason_code: ReasonCode | None
    quality: WindowQuality
    content_digest: str
    recorded_at: Timestamp


def window(record: WindowRecord, reason: Reason | None) -> Window:
    """Return the representation of a window.

    Args:
        reason: Why it is refused, or what it waits for; None where it is estimated.
    """
    quality = record.quality
    return Window(
        wheelset=record.wheelset,
        measured_from=to_rfc3339(record.start_ns),
        measured_to=to_rfc3339(record.start_ns + record.length_ns),
        vehicle=record.vehicle,
        axle=record.axle,
        track_section=record.track_section,
        mileage_km=finite(record.mileage_km),
        state=record.state,
        reason=text_of(reason),
        reason_code=code_of(reason),
        quality=WindowQuality(
            coverage_1=finite(quality.coverage),
            longest_gap_s=finite(quality.longest_gap_s),
            gaps=quality.gaps,
            clipped_1=finite(quality.clipped),
            invalid_1=finite(quality.invalid),
            speed_min_m_s=finite(quality.speed_min_m_s),
            speed_max_m_s=finite(quality.speed_max_m_s),
            position_quality_1=finite(quality.position_quality),
            sensor_fault=quality.sensor_fault,
            hunting_1=finite(quality.hunting.share),
            hunting_hz=finite(quality.hunting.frequency_hz) if quality.hunting.share else None,
            hunting_amplitude_mm=finite(quality.hunting.amplitude, 1000.0) if quality.hunting.share else None,
            blows_1=finite(quality.blows.share),
            blows_m_s2=finite(quality.blows.size) if quality.blows.share else None,
        ),
        content_digest=record.content_digest,
        recorded_at=to_rfc3339(record.recorded_ns),
    )
