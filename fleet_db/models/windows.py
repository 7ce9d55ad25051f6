"""Windows: their quality, their state, and where their samples are."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, false, text
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.windows import WindowState
from fleet_db.models.base import Base, Count, Digest, Name, Nanoseconds, Real, ReasonCodeColumn, one_of

PENDING = text("state = 'pending'")
REFUSED, DOUBTED = text("reason_code IS NOT NULL"), text("implausible_code IS NOT NULL")
UNJUDGED = text("judged = 0")
UNJUDGED_POSTGRESQL = text("NOT judged")
WITH_SAMPLES, PASSED_OVER = text("samples_purged_ns IS NULL"), text("passed_over IS NOT NULL")


class WindowRow(Base):
    """One window. A quality number that is not known is null; the samples are in the file of ``content_digest``.

    ``implausible`` is why its mileage is not believed; ``judged`` whether that was looked at since it was stored. Where
    samples or bin table have been purged it stays as it is: ``passed_over`` says what would have changed it since.
    """

    __tablename__ = "windows"
    __table_args__ = (
        one_of("state", WindowState),
        CheckConstraint("length_ns > 0", name="length_positive"),
        Index(None, "track_section", "start_ns"),
        Index(None, "vehicle", "start_ns"),
        Index("ix_windows_pending", "wheelset", "start_ns", sqlite_where=PENDING, postgresql_where=PENDING),
        Index("ix_windows_refused", "wheelset", "reason_code", sqlite_where=REFUSED, postgresql_where=REFUSED),
        Index("ix_windows_implausible", "wheelset", "start_ns", sqlite_where=DOUBTED, postgresql_where=DOUBTED),
        Index("ix_windows_with_samples", "start_ns", sqlite_where=WITH_SAMPLES, postgresql_where=WITH_SAMPLES),
        Index("ix_windows_passed_over", "wheelset", "start_ns", sqlite_where=PASSED_OVER, postgresql_where=PASSED_OVER),
        Index("ix_windows_unjudged", "wheelset", sqlite_where=UNJUDGED, postgresql_where=UNJUDGED_POSTGRESQL),
    )

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    length_ns: Mapped[Nanoseconds]
    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"))
    axle: Mapped[int]
    track_section: Mapped[str | None] = mapped_column(ForeignKey("track_sections.code"))
    mileage_km: Mapped[Real]
    coverage: Mapped[Real | None]
    longest_gap_s: Mapped[Real | None]
    gaps: Mapped[Count]
    clipped: Mapped[Real | None]
    invalid: Mapped[Real | None]
    speed_min_m_s: Mapped[Real | None]
    speed_max_m_s: Mapped[Real | None]
    position_quality: Mapped[Real | None]
    sensor_fault: Mapped[bool]
    hunting_share: Mapped[Real | None]
    hunting_hz: Mapped[Real | None]
    hunting_amplitude_m: Mapped[Real | None]
    blows_share: Mapped[Real | None]
    blows_m_s2: Mapped[Real | None]
    blows_turn_m: Mapped[Real | None]
    blows_side: Mapped[int | None]
    state: Mapped[str] = mapped_column(String(16))
    reason: Mapped[Name]
    reason_code: Mapped[ReasonCodeColumn | None]
    content_digest: Mapped[Digest]
    sample_bytes: Mapped[Count]
    recorded_ns: Mapped[Nanoseconds]
    odometer_excess_m: Mapped[Real] = mapped_column(server_default=text("0"))
    off_line_m: Mapped[Real] = mapped_column(server_default=text("0"))
    implausible: Mapped[Name | None]
    implausible_code: Mapped[ReasonCodeColumn | None]
    judged: Mapped[bool] = mapped_column(server_default=false())
    samples_purged_ns: Mapped[Nanoseconds | None]
    table_purged_ns: Mapped[Nanoseconds | None]
    passed_over: Mapped[str | None] = mapped_column(String(16))
