"""Track sections, their epochs and alignments, positions, and findings on suspensions."""

from sqlalchemy import CheckConstraint, ForeignKey, ForeignKeyConstraint, Index, String

from estimation.values.quantities import Status
from estimation.values.track import AlignmentSource, TrackEpoch, TrackReport, TrackSectionRecord
from estimation.values.trend import SuspensionFinding
from estimation.values.windows import WindowPosition
from fleet_db.tables.base import Base, Code, Count, Name, Nanoseconds, Packed, Real, Serial, column, one_of


class TrackSectionRow(Base, table="track_sections", of=TrackSectionRecord):
    """One section of line; ``number`` identifies it on the vehicles' bus."""

    constraints = (CheckConstraint("length_m > 0", name="length_positive"),)

    code: str = column(String(64), primary_key=True)
    number: int = column(unique=True)


class TrackAlignmentRow(Base, table="track_alignments"):
    """One version of what is known of a section; never changed. The arrays are in ``packed``."""

    constraints = (one_of("status", Status), CheckConstraint("version > 0", name="version_positive"))

    section: str = column(ForeignKey("track_sections.code"), primary_key=True)
    version: int = column(primary_key=True)
    status: str = column(String(16))
    points: Count
    content_digest: Code
    packed: Packed


class TrackVersionRow(Base, table="track_versions"):
    """Where a version of an alignment came from, beside it; one without this row is a recording.

    ``same_since`` is the oldest version from which this one differs by less than that one left unknown.
    ``cut_off_m`` is null where every wavelength is known. ``superseded_ns`` is when it ceased to follow from what is
    stored, since something came late or was corrected; null while it does.
    """

    constraints = (
        one_of("source", AlignmentSource),
        CheckConstraint("same_since <= version", name="same_since_before"),
        ForeignKeyConstraint(["section", "version"], ["track_alignments.section", "track_alignments.version"]),
    )

    section: str = column(String(64), primary_key=True)
    version: int = column(primary_key=True)
    source: str = column(String(16))
    same_since: int
    cut_off_m: Real | None
    scale_std: Real
    gauge_known: bool
    alignment_std_m: Real | None
    recorded_ns: Nanoseconds
    superseded_ns: Nanoseconds | None


class TrackReportRow(Base, table="track_reports", numbered=True, of=TrackReport):
    """What a run of the alignment job found of a section; ``version`` is the one in force afterwards, if any."""

    constraints = (Index(None, "section", "report_id"),)

    report_id: Serial
    section: str = column(ForeignKey("track_sections.code"))
    version: int | None
    input_digest: Code


class WindowPositionRow(Base, table="window_positions", of=WindowPosition):
    """Where a window was along its section: true position = measured + offset + scale (measured - middle).

    ``reason`` explains why that is not known. ``content_digest`` is of the samples that were used.
    """

    constraints = (
        ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
    )

    wheelset: str = column(String(64), primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    content_digest: Code
    version: int | None


class TrackLayoutRow(Base, table="track_layouts"):
    """One version of the horizontal layout of a section; never changed. The arrays are in ``packed``."""

    constraints = (CheckConstraint("version > 0", name="version_positive"),)

    section: str = column(ForeignKey("track_sections.code"), primary_key=True)
    version: int = column(primary_key=True)
    points: Count
    content_digest: Code
    packed: Packed


class TrackEpochRow(Base, table="track_epochs", of=TrackEpoch, without=("after",)):
    """One epoch of a section as it was computed last, in vehicle time; replaced when its windows change.

    ``stale``: one of its windows has gone since, or where that was has been forgotten.
    """

    constraints = (CheckConstraint("number > 0", name="number_positive"),)

    section: str = column(ForeignKey("track_sections.code"), primary_key=True)
    number: int = column(primary_key=True)
    input_digest: Code
    version: int | None
    same_since: int | None
    estimated_on: int | None
    survey: Name
    survey_code: Code | None


class TrackEpochWindowRow(Base, table="track_epoch_windows"):
    """A window of an epoch as it was when the epoch was computed; it stays when the window itself is gone.

    ``estimated_version`` is of the alignment that the window was refused on last, null where it was not.
    """

    constraints = (
        ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
        Index(None, "section", "epoch"),
    )

    wheelset: str = column(String(64), primary_key=True)
    start_ns: Nanoseconds = column(primary_key=True)
    section: str = column(String(64))
    epoch: int
    vehicle: str = column(String(64))
    content_digest: Code
    mileage_km: Real
    context: Code
    assumed: Code
    estimated_version: int | None


class TrackEpochVehicleRow(Base, table="track_epoch_vehicles"):
    """A vehicle whose windows are estimated on no older version than that of an epoch, for what that found of it."""

    constraints = (
        ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
    )

    section: str = column(String(64), primary_key=True)
    vehicle: str = column(String(64), primary_key=True)
    epoch: int = column(primary_key=True)
    version: int
    stiffness_ratio: Real


class SuspensionFindingRow(Base, table="suspension_findings", of=SuspensionFinding, without=("assumed",)):
    """Yaw stiffness over creep coefficient of one vehicle on one section in one epoch, of the assumed one."""

    constraints = (
        CheckConstraint("ratio > 0", name="ratio_positive"),
        CheckConstraint("ratio_std > 0", name="ratio_std_positive"),
        CheckConstraint("assumed_m > 0", name="assumed_positive"),
        CheckConstraint("from_ns <= to_ns", name="from_before_to"),
    )

    vehicle: str = column(ForeignKey("vehicles.code"), primary_key=True)
    section: str = column(ForeignKey("track_sections.code"), primary_key=True)
    to_ns: Nanoseconds = column(primary_key=True)
    assumed_m: Real
    epoch: int | None
