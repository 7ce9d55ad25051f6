"""Track sections, their epochs and alignments, positions, and findings on suspensions."""

from __future__ import annotations

from sqlalchemy import CheckConstraint, ForeignKey, ForeignKeyConstraint, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.quantities import Status
from estimation.values.track import AlignmentSource
from fleet_db.tables.base import Base, Code, Count, Json, Name, Nanoseconds, Packed, Real, Serial, one_of


class TrackSectionRow(Base, table="track_sections"):
    """One section of line; ``number`` identifies it on the vehicles' bus."""

    __table_args__ = (CheckConstraint("length_m > 0", name="length_positive"),)

    code: Mapped[str] = mapped_column(String(64), primary_key=True)
    number: Mapped[int] = mapped_column(unique=True)
    name: Mapped[Name]
    rail_profile: Mapped[Name]
    rail_inclination: Mapped[Real]
    nominal_gauge_m: Mapped[Real]
    length_m: Mapped[Real]
    line: Mapped[Json | None]
    tonnage_mgt_per_year: Mapped[Real | None]


class TrackAlignmentRow(Base, table="track_alignments"):
    """One version of what is known of a section; never changed. The arrays are in ``packed``."""

    __table_args__ = (one_of("status", Status), CheckConstraint("version > 0", name="version_positive"))

    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    status: Mapped[str] = mapped_column(String(16))
    points: Mapped[Count]
    content_digest: Mapped[Code]
    packed: Mapped[Packed]


class TrackVersionRow(Base, table="track_versions"):
    """Where a version of an alignment came from, beside it; one without this row is a recording.

    ``same_since`` is the oldest version from which this one differs by less than that one left unknown.
    ``cut_off_m`` is null where every wavelength is known. ``superseded_ns`` is when it ceased to follow from what is
    stored, since something came late or was corrected; null while it does.
    """

    __table_args__ = (
        one_of("source", AlignmentSource),
        CheckConstraint("same_since <= version", name="same_since_before"),
        ForeignKeyConstraint(["section", "version"], ["track_alignments.section", "track_alignments.version"]),
    )

    section: Mapped[str] = mapped_column(String(64), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    source: Mapped[str] = mapped_column(String(16))
    same_since: Mapped[int]
    cut_off_m: Mapped[Real | None]
    scale_std: Mapped[Real]
    gauge_known: Mapped[bool]
    alignment_std_m: Mapped[Real | None]
    recorded_ns: Mapped[Nanoseconds]
    superseded_ns: Mapped[Nanoseconds | None]


class TrackReportRow(Base, table="track_reports", numbered=True):
    """What a run of the alignment job found of a section; ``version`` is the one in force afterwards, if any."""

    __table_args__ = (one_of("status", Status), Index(None, "section", "report_id"))

    report_id: Mapped[Serial]
    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"))
    version: Mapped[int | None]
    made: Mapped[bool]
    status: Mapped[str] = mapped_column(String(16))
    reason: Mapped[Name]
    reason_code: Mapped[Code | None]
    windows: Mapped[Count]
    input_digest: Mapped[Code]
    code_version: Mapped[Name]
    report: Mapped[Json]
    recorded_ns: Mapped[Nanoseconds]


class WindowPositionRow(Base, table="window_positions"):
    """Where a window was along its section: true position = measured + offset + scale (measured - middle).

    ``reason`` explains why that is not known. ``content_digest`` is of the samples that were used.
    """

    __table_args__ = (
        ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
    )

    wheelset: Mapped[str] = mapped_column(String(64), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    content_digest: Mapped[Code]
    version: Mapped[int | None]
    offset_m: Mapped[Real]
    scale: Mapped[Real]
    middle_m: Mapped[Real]
    reason: Mapped[Name]
    reason_code: Mapped[Code | None]


class TrackLayoutRow(Base, table="track_layouts"):
    """One version of the horizontal layout of a section; never changed. The arrays are in ``packed``."""

    __table_args__ = (CheckConstraint("version > 0", name="version_positive"),)

    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    points: Mapped[Count]
    content_digest: Mapped[Code]
    packed: Mapped[Packed]


class TrackEpochRow(Base, table="track_epochs"):
    """One epoch of a section as it was computed last, in vehicle time; replaced when its windows change.

    ``stale``: one of its windows has gone since, or where that was has been forgotten.
    """

    __table_args__ = (CheckConstraint("number > 0", name="number_positive"),)

    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    before: Mapped[Name]
    input_digest: Mapped[Code]
    horizon_ns: Mapped[Nanoseconds]
    windows: Mapped[Count]
    waits: Mapped[bool]
    stale: Mapped[bool]
    version: Mapped[int | None]
    same_since: Mapped[int | None]
    estimated_on: Mapped[int | None]
    survey: Mapped[Name]
    survey_code: Mapped[Code | None]
    report: Mapped[Count]
    recorded_ns: Mapped[Nanoseconds]


class TrackEpochWindowRow(Base, table="track_epoch_windows"):
    """A window of an epoch as it was when the epoch was computed; it stays when the window itself is gone.

    ``estimated_version`` is of the alignment that the window was refused on last, null where it was not.
    """

    __table_args__ = (
        ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
        Index(None, "section", "epoch"),
    )

    wheelset: Mapped[str] = mapped_column(String(64), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    section: Mapped[str] = mapped_column(String(64))
    epoch: Mapped[int]
    vehicle: Mapped[str] = mapped_column(String(64))
    content_digest: Mapped[Code]
    mileage_km: Mapped[Real]
    context: Mapped[Code]
    assumed: Mapped[Code]
    estimated_version: Mapped[int | None]


class TrackEpochVehicleRow(Base, table="track_epoch_vehicles"):
    """A vehicle whose windows are estimated on no older version than that of an epoch, for what that found of it."""

    __table_args__ = (
        ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
    )

    section: Mapped[str] = mapped_column(String(64), primary_key=True)
    vehicle: Mapped[str] = mapped_column(String(64), primary_key=True)
    epoch: Mapped[int] = mapped_column(primary_key=True)
    version: Mapped[int]
    stiffness_ratio: Mapped[Real]


class SuspensionFindingRow(Base, table="suspension_findings"):
    """Yaw stiffness over creep coefficient of one vehicle on one section in one epoch, of the assumed one."""

    __table_args__ = (
        CheckConstraint("ratio > 0", name="ratio_positive"),
        CheckConstraint("ratio_std > 0", name="ratio_std_positive"),
        CheckConstraint("assumed_m > 0", name="assumed_positive"),
        CheckConstraint("from_ns <= to_ns", name="from_before_to"),
    )

    vehicle: Mapped[str] = mapped_column(ForeignKey("vehicles.code"), primary_key=True)
    section: Mapped[str] = mapped_column(ForeignKey("track_sections.code"), primary_key=True)
    to_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    from_ns: Mapped[Nanoseconds]
    ratio: Mapped[Real]
    ratio_std: Mapped[Real]
    assumed_m: Mapped[Real]
    code_version: Mapped[Name]
    epoch: Mapped[int | None]
    recorded_ns: Mapped[Nanoseconds]
