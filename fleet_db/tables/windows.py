"""Windows, their bin tables and the sums of these; what is said of them beside the geometry."""

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

from estimation.values.geometry import COMBINATIONS, BinStatus
from estimation.values.windows import WindowState
from fleet_db.tables.base import (
    Base,
    Code,
    Count,
    Json,
    Name,
    Nanoseconds,
    Packed,
    Real,
    Serial,
    column,
    one_of,
    partial_index,
)

PENDING = text("state = 'pending'")
REFUSED, DOUBTED = text("reason_code IS NOT NULL"), text("implausible_code IS NOT NULL")
WITH_SAMPLES, PASSED_OVER = text("samples_purged_ns IS NULL"), text("passed_over IS NOT NULL")


class WindowRow(Base, table="windows"):
    """One window. A quality number that is not known is null; the samples are in the file of ``content_digest``.

    ``implausible`` is why its mileage is not believed. Where samples or bin table have been purged it stays as it is:
    ``passed_over`` says what would have changed it since.
    """

    constraints = (
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

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    length_ns: Nanoseconds
    vehicle: str = column(ForeignKey("vehicles.code"))
    axle: int
    track_section: str | None = column(ForeignKey("track_sections.code"))
    mileage_km: Real
    coverage: Real | None
    longest_gap_s: Real | None
    gaps: Count
    clipped: Real | None
    invalid: Real | None
    speed_min_m_s: Real | None
    speed_max_m_s: Real | None
    position_quality: Real | None
    sensor_fault: bool
    hunting_share: Real | None
    hunting_hz: Real | None
    hunting_amplitude_m: Real | None
    blows_share: Real | None
    blows_m_s2: Real | None
    blows_turn_m: Real | None
    blows_side: int | None
    state: str = column(String(16))
    reason: Name
    reason_code: Code | None
    content_digest: Code
    sample_bytes: Count
    recorded_ns: Nanoseconds
    odometer_excess_m: Real = column(server_default=text("0"))
    off_line_m: Real = column(server_default=text("0"))
    implausible: Name | None
    implausible_code: Code | None
    samples_purged_ns: Nanoseconds | None
    table_purged_ns: Nanoseconds | None
    passed_over: str | None = column(String(16))


class WindowBinTableRow(Base, table="window_bin_tables"):
    """The sufficient statistics of one window, packed; ``window_digest`` identifies the content of the window.

    ``content_digest`` is of the table itself. ``running_km`` is the mileage with which it was summed; null before that.
    """

    constraints = (
        ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
    )

    wheelset: str = column(String(64), primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    track_version: int | None
    window_digest: Code
    parameter_key: str = column(String(128))
    samples: Count
    content_digest: Code | None
    running_km: Real | None
    packed: Packed


class WindowDueRow(Base, table="window_due"):
    """A window that a stage has not made from what it is now (``fleet_db.due``); ``section`` is empty on none."""

    constraints = (Index(None, "stage", "section", "start_ns"), Index(None, "stage", "vehicle", "start_ns"))

    stage: str = column(String(32), primary_key=True)
    wheelset: str = column(String(64), primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    vehicle: Code
    section: Code
    version: Count


class WheelsetBinRow(Base, table="wheelset_bins"):
    """One bin of the current geometry of a wheelset; null where nothing is known."""

    constraints = tuple(one_of(f"{name}_status", BinStatus) for name in COMBINATIONS)

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    bin: int = column(primary_key=True)
    geometry_id: Count = column(ForeignKey("results.result_id"))
    lateral_displacement_low_m: Real
    lateral_displacement_high_m: Real
    samples: Real | None
    rolling_radius_sum_m: Real | None
    rolling_radius_sum_std_m: Real | None
    rolling_radius_sum_status: str = column(String(40))
    rolling_radius_difference_m: Real | None
    rolling_radius_difference_std_m: Real | None
    rolling_radius_difference_status: str = column(String(40))
    contact_angle_sum_rad: Real | None
    contact_angle_sum_std_rad: Real | None
    contact_angle_sum_status: str = column(String(40))
    contact_angle_difference_rad: Real | None
    contact_angle_difference_std_rad: Real | None
    contact_angle_difference_status: str = column(String(40))


class RollUpRow(Base, table="roll_ups"):
    """Sums of the tables of one interval, plain and with forgetting, packed; ``summary`` is of its windows."""

    constraints = (
        UniqueConstraint(
            *("wheelset", "baseline", "baseline_interval", "side", "table_key", "vehicle_class"), name="uq_roll_ups_key"
        ),
        CheckConstraint("windows >= 0", name="windows_counted"),
    )

    number: Serial
    wheelset: str = column(ForeignKey("wheelsets.serial"))
    baseline: int
    baseline_interval: int
    side: int
    table_key: str = column(String(128))
    vehicle_class: Code
    windows: Count
    content: Code
    first_ns: Nanoseconds
    last_ns: Nanoseconds
    sealed: bool = column(server_default=false())
    summary: Json
    plain: Packed
    forgetting: Packed | None


class RollUpStateRow(Base, table="roll_up_states"):
    """What the roll-ups of a wheelset were made by, and the forgetting sum of the intervals that are over."""

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    rules: Code
    classes: Json
    earlier_digest: Code | None
    earlier: Packed | None


class RollingSumsRow(Base, table="rolling_sums"):
    """What a window says of its rolling radius, packed; of the windows that stand for an interval."""

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    window_digest: Code
    assumed: str = column(String(192))
    packed: Packed


class RailCellRow(Base, table="rail_cells"):
    """What the windows of a wheelset in one mileage interval, on one section in one period, give.

    ``document`` holds the conicities by amplitude, or why there are none.
    """

    constraints = (
        CheckConstraint("baseline >= 0", name="baseline_counted"),
        CheckConstraint("period >= 0", name="period_counted"),
    )

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    baseline: int = column(Integer, primary_key=True)
    mileage_interval: int = column(Integer, primary_key=True)
    section: str = column(String(64), ForeignKey("track_sections.code"), primary_key=True)
    period: int = column(Integer, primary_key=True)
    digest: Code
    interval_digest: Code
    document: Json


class WindowAdhesionRow(Base, table="window_adhesion"):
    """The creep of one window; ``packed`` holds forces and sums of friction by place."""

    constraints = (Index(None, "track_section", "start_ns"),)

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    track_section: str | None = column(ForeignKey("track_sections.code"))
    content_digest: Code
    with_sums: bool
    packed: Packed


class SectionAdhesionRow(Base, table="section_adhesion"):
    """The friction along a section over some hours, which end with the window that began at ``to_ns``."""

    constraints = (CheckConstraint("from_ns <= to_ns", name="from_before_to"),)

    track_section: str = column(ForeignKey("track_sections.code"), primary_key=True)
    to_ns: Nanoseconds = column(primary_key=True)
    from_ns: Nanoseconds
    code_version: Name
    made_with: Code
    packed: Packed


class WindowDamperRow(Base, table="window_dampers"):
    """What one window says of the damper of a running gear; ``packed`` holds its sums."""

    constraints = (CheckConstraint("first_axle > 0", name="first_axle_positive"),)

    vehicle: str = column(ForeignKey("vehicles.code"), primary_key=True)
    first_axle: int = column(primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    wheelset: str = column(ForeignKey("wheelsets.serial"))
    content_digest: Code
    packed: Packed


class WearSignatureRow(Base, table="wear_signatures"):
    """The signatures of one window, packed, or why it has none. ``speed_band_m_s`` is the lower end of 5 m/s."""

    constraints = (CheckConstraint("places >= 0", name="places_counted"),)

    wheelset: str = column(ForeignKey("wheelsets.serial"), primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    vehicle: str = column(ForeignKey("vehicles.code"))
    section: str | None = column(ForeignKey("track_sections.code"))
    speed_band_m_s: int | None
    window_digest: Code
    assumed: Code
    places: Count
    reason: Name
    reason_code: Code | None
    packed: Packed
