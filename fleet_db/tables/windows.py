"""Windows, their bin tables, and the sums of these."""

from __future__ import annotations

from sqlalchemy import (
    CheckConstraint,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    String,
    UniqueConstraint,
    false,
    text,
)
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.geometry import BinStatus
from estimation.values.windows import WindowState
from fleet_db.tables.base import (
    Base,
    Code,
    Count,
    Digest,
    Json,
    Name,
    Nanoseconds,
    Packed,
    Real,
    ReasonCodeColumn,
    Serial,
    one_of,
)

PENDING = text("state = 'pending'")
REFUSED, DOUBTED = text("reason_code IS NOT NULL"), text("implausible_code IS NOT NULL")
WITH_SAMPLES, PASSED_OVER = text("samples_purged_ns IS NULL"), text("passed_over IS NOT NULL")


class WindowRow(Base):
    """One window. A quality number that is not known is null; the samples are in the file of ``content_digest``.

    ``implausible`` is why its mileage is not believed. Where samples or bin table have been purged it stays as it is:
    ``passed_over`` says what would have changed it since.
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
    samples_purged_ns: Mapped[Nanoseconds | None]
    table_purged_ns: Mapped[Nanoseconds | None]
    passed_over: Mapped[str | None] = mapped_column(String(16))


class WindowBinTableRow(Base):
    """The sufficient statistics of one window, packed; ``window_digest`` identifies the content of the window.

    ``content_digest`` is of the table itself. ``running_km`` is the mileage with which it was summed; null before that.
    """

    __tablename__ = "window_bin_tables"
    __table_args__ = (
        ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
    )

    wheelset: Mapped[str] = mapped_column(String(64), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    track_version: Mapped[int | None]
    window_digest: Mapped[Digest]
    parameter_key: Mapped[str] = mapped_column(String(128))
    samples: Mapped[Count]
    content_digest: Mapped[Digest | None]
    running_km: Mapped[Real | None]
    packed: Mapped[Packed]


class WindowDueRow(Base):
    """A window that a stage has not made from what it is now (``fleet_db.due``); ``section`` is empty on none."""

    __tablename__ = "window_due"
    __table_args__ = (Index(None, "stage", "section", "start_ns"), Index(None, "stage", "vehicle", "start_ns"))

    stage: Mapped[str] = mapped_column(String(32), primary_key=True)
    wheelset: Mapped[str] = mapped_column(String(64), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    vehicle: Mapped[Code]
    section: Mapped[Code]
    version: Mapped[Count]


class WheelsetBinRow(Base):
    """One bin of the current geometry of a wheelset; null where nothing is known."""

    __tablename__ = "wheelset_bins"
    __table_args__ = tuple(
        one_of(f"{name}_status", BinStatus)
        for name in (
            "rolling_radius_sum",
            "rolling_radius_difference",
            "contact_angle_sum",
            "contact_angle_difference",
        )
    )

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    bin: Mapped[int] = mapped_column(primary_key=True)
    geometry_id: Mapped[Count] = mapped_column(ForeignKey("results.result_id"))
    lateral_displacement_low_m: Mapped[Real]
    lateral_displacement_high_m: Mapped[Real]
    samples: Mapped[Real | None]
    rolling_radius_sum_m: Mapped[Real | None]
    rolling_radius_sum_std_m: Mapped[Real | None]
    rolling_radius_sum_status: Mapped[str] = mapped_column(String(40))
    rolling_radius_difference_m: Mapped[Real | None]
    rolling_radius_difference_std_m: Mapped[Real | None]
    rolling_radius_difference_status: Mapped[str] = mapped_column(String(40))
    contact_angle_sum_rad: Mapped[Real | None]
    contact_angle_sum_std_rad: Mapped[Real | None]
    contact_angle_sum_status: Mapped[str] = mapped_column(String(40))
    contact_angle_difference_rad: Mapped[Real | None]
    contact_angle_difference_std_rad: Mapped[Real | None]
    contact_angle_difference_status: Mapped[str] = mapped_column(String(40))


class RollUpRow(Base):
    """Sums of the tables of one interval, plain and with forgetting, packed; ``summary`` is of its windows."""

    __tablename__ = "roll_ups"
    __table_args__ = (
        UniqueConstraint(
            *("wheelset", "baseline", "baseline_interval", "side", "table_key", "vehicle_class"), name="uq_roll_ups_key"
        ),
        CheckConstraint("windows >= 0", name="windows_counted"),
    )

    number: Mapped[Serial]
    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"))
    baseline: Mapped[int]
    baseline_interval: Mapped[int]
    side: Mapped[int]
    table_key: Mapped[str] = mapped_column(String(128))
    vehicle_class: Mapped[Code]
    windows: Mapped[Count]
    content: Mapped[Digest]
    first_ns: Mapped[Nanoseconds]
    last_ns: Mapped[Nanoseconds]
    sealed: Mapped[bool] = mapped_column(server_default=false())
    summary: Mapped[Json]
    plain: Mapped[Packed]
    forgetting: Mapped[Packed | None]


class RollUpStateRow(Base):
    """What the roll-ups of a wheelset were made by, and the forgetting sum of the intervals that are over."""

    __tablename__ = "roll_up_states"

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    rules: Mapped[Digest]
    classes: Mapped[Json]
    earlier_digest: Mapped[Digest | None]
    earlier: Mapped[Packed | None]


class RollingSumsRow(Base):
    """What a window says of its rolling radius, packed; of the windows that stand for an interval."""

    __tablename__ = "rolling_sums"

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    window_digest: Mapped[Digest]
    assumed: Mapped[str] = mapped_column(String(192))
    packed: Mapped[Packed]
