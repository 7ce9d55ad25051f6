"""Windows, their bin tables and the sums of these; what is said of them beside the geometry."""

from __future__ import annotations

from sqlalchemy import (
    CheckConstraint,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    String,
    UniqueConstraint,
    false,
    text,
)
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.geometry import COMBINATIONS, BinStatus
from estimation.values.windows import WindowState
from fleet_db.tables.base import Base, Code, Count, Json, Name, Nanoseconds, Packed, Real, Serial, one_of, partial_index

PENDING = text("state = 'pending'")
REFUSED, DOUBTED = text("reason_code IS NOT NULL"), text("implausible_code IS NOT NULL")
WITH_SAMPLES, PASSED_OVER = text("samples_purged_ns IS NULL"), text("passed_over IS NOT NULL")


class WindowRow(Base, table="windows"):
    """One window. A quality number that is not known is null; the samples are in the file of ``content_digest``.

    ``implausible`` is why its mileage is not believed. Where samples or bin table have been purged it stays as it is:
    ``passed_over`` says what would have changed it since.
    """

    __table_args__ = (
        one_of("state", WindowState),
        CheckConstraint("length_ns > 0", name="length_positive"),
        Index(None, "track_section", "start_ns"),
        Index(None, "vehicle", "start_ns"),
        partial_index("ix_windows_pending", "wheelset", "start_ns", where=PENDING),
        partial_index("ix_windows_refused", "wheelset", "reason_code", where=REFUSED),
        partial_index("ix_windows_implausible", "wheelset", "start_ns", where=DOUBTED),
        partial_index("ix_windows_with_samples", "start_ns", where=WITH_SAMPLES),
        partial_index("ix_windows_passed_over", "wheelset", "start_ns", where=PASSED_OVER),
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
    reason_code: Mapped[Code | None]
    content_digest: Mapped[Code]
    sample_bytes: Mapped[Count]
    recorded_ns: Mapped[Nanoseconds]
    odometer_excess_m: Mapped[Real] = mapped_column(server_default=text("0"))
    off_line_m: Mapped[Real] = mapped_column(server_default=text("0"))
    implausible: Mapped[Name | None]
    implausible_code: Mapped[Code | None]
    samples_purged_ns: Mapped[Nanoseconds | None]
    table_purged_ns: Mapped[Nanoseconds | None]
    passed_over: Mapped[str | None] = mapped_column(String(16))


class WindowBinTableRow(Base, table="window_bin_tables"):
    """The sufficient statistics of one window, packed; ``window_digest`` identifies the content of the window.

    ``content_digest`` is of the table itself. ``running_km`` is the mileage with which it was summed; null before that.
    """

    __table_args__ = (
        ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
    )

    wheelset: Mapped[str] = mapped_column(String(64), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    track_version: Mapped[int | None]
    window_digest: Mapped[Code]
    parameter_key: Mapped[str] = mapped_column(String(128))
    samples: Mapped[Count]
    content_digest: Mapped[Code | None]
    running_km: Mapped[Real | None]
    packed: Mapped[Packed]


class WindowDueRow(Base, table="window_due"):
    """A window that a stage has not made from what it is now (``fleet_db.due``); ``section`` is empty on none."""

    __table_args__ = (Index(None, "stage", "section", "start_ns"), Index(None, "stage", "vehicle", "start_ns"))

    stage: Mapped[str] = mapped_column(String(32), primary_key=True)
    wheelset: Mapped[str] = mapped_column(String(64), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    vehicle: Mapped[Code]
    section: Mapped[Code]
    version: Mapped[Count]


class WheelsetBinRow(Base, table="wheelset_bins"):
    """One bin of the current geometry of a wheelset; null where nothing is known."""

    __table_args__ = tuple(one_of(f"{name}_status", BinStatus) for name in COMBINATIONS)

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


class RollUpRow(Base, table="roll_ups"):
    """Sums of the tables of one interval, plain and with forgetting, packed; ``summary`` is of its windows."""

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
    content: Mapped[Code]
    first_ns: Mapped[Nanoseconds]
    last_ns: Mapped[Nanoseconds]
    sealed: Mapped[bool] = mapped_column(server_default=false())
    summary: Mapped[Json]
    plain: Mapped[Packed]
    forgetting: Mapped[Packed | None]


class RollUpStateRow(Base, table="roll_up_states"):
    """What the roll-ups of a wheelset were made by, and the forgetting sum of the intervals that are over."""

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    rules: Mapped[Code]
    classes: Mapped[Json]
    earlier_digest: Mapped[Code | None]
    earlier: Mapped[Packed | None]


class RollingSumsRow(Base, table="rolling_sums"):
    """What a window says of its rolling radius, packed; of the windows that stand for an interval."""

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    window_digest: Mapped[Code]
    assumed: Mapped[str] = mapped_column(String(192))
    packed: Mapped[Packed]


class RailCellRow(Base, table="rail_cells"):
    """What the windows of a wheelset in one mileage interval, on one section in one period, give.

    ``document`` holds the conicities by amplitude, or why there are none.
    """

    __table_args__ = (
        CheckConstraint("baseline >= 0", name="baseline_counted"),
        CheckConstraint("period >= 0", name="period_counted"),
    )

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    baseline: Mapped[int] = mapped_column(Integer, primary_key=True)
    mileage_interval: Mapped[int] = mapped_column(Integer, primary_key=True)
    section: Mapped[str] = mapped_column(String(64), ForeignKey("track_sections.code"), primary_key=True)
    period: Mapped[int] = mapped_column(Integer, primary_key=True)
    digest: Mapped[Code]
    interval_digest: Mapped[Code]
    document: Mapped[Json]


class WindowAdhesionRow(Base, table="window_adhesion"):
    """The creep of one window; ``packed`` holds forces and sums of friction by place."""

    __table_args__ = (Index(None, "track_section", "start_ns"),)

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    track_section: Mapped[str | None] = mapped_column(ForeignKey("track_sections.code"))
    content_digest: Mapped[Code]
    with_sums: Mapped[bool]
    packed: Mapped[Packed]


class SectionAdhesionRow(Base, table="section_adhesion"):
    """The friction along a section over some hours, which end with the window that began at ``to_ns``."""

    __table_args__ = (CheckConstraint("from_ns <= to_ns", name="from_before_to"),)

    track_section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    to_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    from_ns: Mapped[Nanoseconds]
    code_version: Mapped[Name]
    made_with: Mapped[Code]
    packed: Mapped[Packed]


class WindowDamperRow(Base, table="window_dampers"):
    """What one window says of the damper of a running gear; ``packed`` holds its sums."""

    __table_args__ = (CheckConstraint("first_axle > 0", name="first_axle_positive"),)

    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"), primary_key=True)
    first_axle: Mapped[int] = mapped_column(primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"))
    content_digest: Mapped[Code]
    packed: Mapped[Packed]


class WearSignatureRow(Base, table="wear_signatures"):
    """The signatures of one window, packed, or why it has none. ``speed_band_m_s`` is the lower end of 5 m/s."""

    __table_args__ = (CheckConstraint("places >= 0", name="places_counted"),)

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"))
    section: Mapped[str | None] = mapped_column(ForeignKey("track_sections.code"))
    speed_band_m_s: Mapped[int | None]
    window_digest: Mapped[Code]
    assumed: Mapped[Code]
    places: Mapped[Count]
    reason: Mapped[Name]
    reason_code: Mapped[Code | None]
    packed: Mapped[Packed]
