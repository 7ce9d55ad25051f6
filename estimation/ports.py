"""What the jobs need from the world, as Protocols: storage in transactions, and the time.

``fleet_db`` implements them, one factory in ``api`` joins. Value types in and out, never rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from estimation.alerts import Alert, AlertEvent, AlertEventKind, AlertKind, AlertScope, Condition, JsonValue
from estimation.contact.profiles import Profile
from estimation.types import (
    BinTable,
    Status,
    TrackAlignment,
    TrackLayout,
    WearTrend,
    WheelsetGeometry,
    Window,
    WindowQuality,
)


class WindowState(StrEnum):
    """Where a window stands on its way to a bin table."""

    PENDING = "pending"
    ESTIMATED = "estimated"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class FleetRecord:
    """A fleet: who operates what."""

    code: str
    name: str


@dataclass(frozen=True, slots=True)
class VehicleRecord:
    """A vehicle and what its rules depend on."""

    code: str
    fleet: str
    vehicle_class: str
    axles: int
    max_speed_m_s: float
    axle_offsets_m: tuple[float, ...]  # distance of each axle behind the position reference, m


@dataclass(frozen=True, slots=True)
class Mounting:
    """Which wheelset ran at which axle of which vehicle, ``[from_ns, to_ns)`` on the vehicle's clock."""

    wheelset: str
    vehicle: str
    axle: int
    from_ns: int
    to_ns: int | None
    vehicle_odometer_km: float  # at from_ns
    wheelset_mileage_km: float  # at from_ns
    reversed: bool = False  # left wheel on the right-hand side


@dataclass(frozen=True, slots=True)
class Reprofiling:
    """A wheelset came back from the lathe; every later window belongs to a new baseline."""

    wheelset: str
    at_ns: int
    mileage_km: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class MeasuredProfiles:
    """Profiles of both wheels of a wheelset, as a profile gauge has told them. Key: (wheelset, at_ns).

    ``left`` is the wheelset's own left wheel, whichever way round it is mounted. ``std`` says how well the lateral
    displacement that belongs to a rolling radius difference follows from them.
    """

    wheelset: str
    at_ns: int
    mileage_km: float  # of the wheelset since new
    left: Profile
    right: Profile
    std: float  # m


@dataclass(frozen=True, slots=True)
class WheelsetRecord:
    """A wheelset by serial, with where it is now and its history of lathes."""

    serial: str
    fleet: str
    wheel_profile: str
    nominal_radius_m: float
    mounting: Mounting | None
    reprofilings: tuple[Reprofiling, ...] = ()


@dataclass(frozen=True, slots=True)
class TrackSectionRecord:
    """A stretch of line by code; ``number`` is what the vehicle says on its bus."""

    code: str
    number: int
    name: str
    rail_profile: str
    rail_inclination: float
    nominal_gauge_m: float
    length_m: float


@dataclass(frozen=True, slots=True)
class AlignmentRecord:
    """A version of a section's alignment without its arrays.

    ``same_since`` is the oldest version from which it differs by less than that one left unknown: what was estimated
    with any version since then need not be estimated again.
    """

    section: str
    version: int
    status: Status
    source: str
    same_since: int
    cut_off_m: float  # inf where every wavelength is known
    scale_std: float
    gauge_known: bool
    alignment_std_m: float | None  # median along the section; None of recordings before it was kept
    points: int
    recorded_ns: int | None


@dataclass(frozen=True, slots=True)
class TrackReport:
    """What a run of the alignment job found of a section; ``version`` is the one in force afterwards, if any."""

    section: str
    version: int | None
    made: bool  # whether that run made the version
    status: Status
    reason: str
    windows: int
    input_digest: str  # over keys and digests of windows, and the version before
    code_version: str
    report: Mapping[str, JsonValue]
    recorded_ns: int
    report_id: int = 0


@dataclass(frozen=True, slots=True)
class WindowPosition:
    """Where a window was along its section: true position = measured + offset + scale (measured - middle).

    ``reason`` says why that is not known. ``content_digest`` is of the samples that were looked at.
    """

    wheelset: str
    start_ns: int
    content_digest: str
    version: int | None  # of the alignment against which it was found
    offset_m: float = 0.0
    scale: float = 0.0
    middle_m: float = 0.0
    reason: str = ""


@dataclass(frozen=True, slots=True)
class WindowRecord:
    """A stored window without its samples. Key: (wheelset, start_ns)."""

    wheelset: str
    start_ns: int
    length_ns: int
    vehicle: str
    axle: int
    track_section: str | None
    mileage_km: float  # of the wheelset since new, at the start
    quality: WindowQuality
    state: WindowState
    reason: str
    content_digest: str  # sha256 of the samples; the same content again changes nothing
    recorded_ns: int


@dataclass(frozen=True, slots=True)
class GeometryRecord:
    """A geometry estimate with its provenance. Never changed; a later one with the same key supersedes it.

    Key: (wheelset, baseline, interval). ``baseline`` counts reprofilings before it; ``interval`` is the mileage
    interval since the baseline, and None for the current geometry (all windows since the baseline, with forgetting).
    """

    wheelset: str
    baseline: int
    interval: int | None
    mileage_km: float  # weighted mean mileage of its windows since new
    from_ns: int
    to_ns: int
    geometry: WheelsetGeometry
    input_digest: str  # over keys, digests and mileages of windows, and track versions
    track_versions: Mapping[str, Sequence[int]]  # by section, those that its windows were estimated with, increasing
    parameters: Mapping[str, JsonValue]
    code_version: str
    recorded_ns: int


@dataclass(frozen=True, slots=True)
class TrendRecord:
    """A trend as refreshed at ``recorded_ns``."""

    wheelset: str
    baseline: int
    trend: WearTrend
    input_digest: str
    code_version: str
    recorded_ns: int


@dataclass(frozen=True, slots=True)
class JobRun:
    """One run of one job; ``finished_ns`` None while running. ``counts`` are what it did."""

    run_id: int
    job: str
    trigger: str  # "schedule", "api", "cli"
    started_ns: int
    finished_ns: int | None
    outcome: str  # "running", "succeeded", "failed", "abandoned"
    counts: Mapping[str, int]
    error: str | None = None


@dataclass(frozen=True, slots=True)
class ChunkRecord:
    """The receipt of a recording: raw bytes are stored under their digest before this row is committed."""

    digest: str  # sha256 of the raw bytes
    vehicle: str
    suffix: str  # ".blf", ".asc", ".log", ".mf4"
    size_bytes: int
    state: str  # "stored", "decoded", "rejected"
    reason: str
    first_ns: int | None  # vehicle clock, once decoded
    last_ns: int | None
    frames: int
    counts: Mapping[str, int]  # marked and counted: unknown identifiers, wrong lengths, gaps, clipped, invalid ...
    received_ns: int
    recorded_ns: int


class Chunks(Protocol):
    """Receipts of recordings."""

    def get(self, digest: str) -> ChunkRecord | None: ...
    def put(self, record: ChunkRecord) -> bool: ...
    def update(self, record: ChunkRecord) -> None: ...
    def overlapping(self, vehicle: str, from_ns: int, to_ns: int) -> Sequence[ChunkRecord]: ...
    def with_state(self, state: str, limit: int = 100) -> Sequence[ChunkRecord]: ...


class Registry(Protocol):
    """Fleets, vehicles, wheelsets with what happened to them. Writes are upserts: a repeat changes nothing."""

    def fleets(self) -> Sequence[FleetRecord]: ...
    def vehicles(self, fleet: str | None = None) -> Sequence[VehicleRecord]: ...
    def vehicle(self, code: str) -> VehicleRecord: ...
    def wheelsets(self, fleet: str | None = None) -> Sequence[WheelsetRecord]: ...
    def wheelset(self, serial: str) -> WheelsetRecord: ...
    def mounting_at(self, vehicle: str, axle: int, at_ns: int) -> Mounting | None: ...
    def mountings(self, wheelset: str) -> Sequence[Mounting]: ...
    def measured_profiles(self, wheelset: str) -> Sequence[MeasuredProfiles]: ...
    def vehicles_page(self, fleet: str | None, after: str | None, limit: int) -> Sequence[VehicleRecord]: ...
    def wheelsets_page(
        self, fleet: str | None, vehicle: str | None, after: str | None, limit: int
    ) -> Sequence[WheelsetRecord]: ...
    def add_fleet(self, record: FleetRecord) -> None: ...
    def add_vehicle(self, record: VehicleRecord) -> None: ...
    def add_wheelset(self, record: WheelsetRecord) -> None: ...
    def add_mounting(self, record: Mounting) -> None: ...
    def add_reprofiling(self, record: Reprofiling) -> None: ...
    def add_measured_profiles(self, record: MeasuredProfiles) -> None: ...


class Tracks(Protocol):
    """Track sections and versions of their alignment."""

    def sections(self) -> Sequence[TrackSectionRecord]: ...
    def section(self, code: str) -> TrackSectionRecord: ...
    def section_by_number(self, number: int) -> TrackSectionRecord | None: ...
    def add_section(self, record: TrackSectionRecord) -> None: ...
    def alignment(self, section: str, version: int | None = None) -> TrackAlignment | None: ...
    def add_alignment(
        self, alignment: TrackAlignment, *, same_since: int | None = None, recorded_ns: int | None = None
    ) -> int: ...
    def layout(self, section: str, version: int | None = None) -> TrackLayout | None: ...
    def layout_version(self, section: str) -> int | None: ...
    def add_layout(self, layout: TrackLayout) -> int: ...
    def in_force(self, section: str) -> AlignmentRecord | None: ...
    def versions(self, section: str, after: int | None, limit: int) -> Sequence[AlignmentRecord]: ...
    def report(self, section: str, version: int | None = None) -> TrackReport | None: ...
    def add_report(self, report: TrackReport) -> int: ...
    def position(self, wheelset: str, start_ns: int) -> WindowPosition | None: ...
    def put_position(self, position: WindowPosition) -> bool: ...
    def forget_positions(self, section: str) -> int: ...


class Windows(Protocol):
    """Windows of samples and their state."""

    def put(self, window: Window, mileage_km: float, recorded_ns: int) -> bool: ...
    def pending(self, limit: int) -> Sequence[WindowRecord]: ...
    def ready(self, limit: int, waiting_sections: Sequence[str]) -> Sequence[WindowRecord]: ...
    def unplaced(self, track_section: str, limit: int) -> Sequence[WindowRecord]: ...
    def get(self, wheelset: str, start_ns: int) -> WindowRecord | None: ...
    def requeue(self, track_section: str, reason: str) -> int: ...
    def requeue_section(self, track_section: str) -> int: ...
    def load(self, wheelset: str, start_ns: int) -> Window: ...
    def mark(self, wheelset: str, start_ns: int, state: WindowState, reason: str) -> None: ...
    def list(self, wheelset: str, from_ns: int | None = None, to_ns: int | None = None) -> Sequence[WindowRecord]: ...
    def latest(self, wheelset: str) -> WindowRecord | None: ...
    def page(self, wheelset: str, after_start_ns: int | None, limit: int) -> Sequence[WindowRecord]: ...
    def counts(self) -> Mapping[str, int]: ...


class BinTables(Protocol):
    """One packed bin table per window."""

    def put(
        self, wheelset: str, start_ns: int, table: BinTable, track_version: int | None, window_digest: str
    ) -> None: ...
    def outdated(self, parameter_key: str, track_versions: Mapping[str, int]) -> Sequence[tuple[str, int]]: ...
    def index(
        self, wheelset: str, from_ns: int, to_ns: int | None
    ) -> Sequence[tuple[WindowRecord, str, int | None]]: ...
    def stream(
        self, wheelset: str, from_ns: int, to_ns: int | None
    ) -> Iterator[tuple[WindowRecord, BinTable, int | None]]: ...


class Geometries(Protocol):
    """Geometry estimates, append-only; reads give what was believed at ``as_of_ns`` (recorded time).

    ``change`` counts what happened to the inputs of a wheelset's geometry. Whoever reads inputs in one transaction
    and stores in another takes it with the inputs and hands it to ``settle`` with the results, so that a change in
    between is not lost; ``settle`` also ends the staleness of a wheelset of which nothing could be estimated.
    """

    def put(self, record: GeometryRecord) -> bool: ...
    def current(self, wheelset: str, as_of_ns: int | None = None) -> GeometryRecord | None: ...
    def intervals(
        self, wheelset: str, baseline: int | None = None, as_of_ns: int | None = None
    ) -> Sequence[GeometryRecord]: ...
    def stale(self, limit: int) -> Sequence[str]: ...
    def change(self, wheelset: str) -> int: ...
    def settle(self, wheelset: str, change: int) -> None: ...


class Trends(Protocol):
    """Trends, append-only."""

    def put(self, record: TrendRecord) -> bool: ...
    def latest(self, wheelset: str, as_of_ns: int | None = None) -> TrendRecord | None: ...


class Alerts(Protocol):
    """Alerts and their feed; at most one open alert per (wheelset, kind), held by the database.

    Of fleet alerts at most one per (fleet, kind) is open. What happens to a member that was raised with its fleet alert
    is among its events, but not in the feed, where the fleet alert stands for it.

    ``save`` takes an alert with the version it was read with, stores the next version and returns it; an alert that
    has another version by now is a ``ConflictError``.
    """

    def open(self, wheelset: str, kind: AlertKind) -> Alert | None: ...
    def all_open(self, wheelset: str | None = None) -> Sequence[Alert]: ...
    def open_in_fleet(self, fleet: str) -> Sequence[Alert]: ...
    def members(self, fleet_alert_id: int) -> Sequence[Alert]: ...
    def get(self, alert_id: int) -> Alert: ...
    def page(
        self,
        *,
        fleet: str | None,
        wheelset: str | None,
        kind: AlertKind | None,
        condition: Condition | None,
        open_only: bool,
        after_id: int | None,
        limit: int,
        scope: AlertScope | None = None,
        fleet_alert_id: int | None = None,
    ) -> Sequence[Alert]: ...
    def feed(self, after_sequence: int, limit: int) -> Sequence[AlertEvent]: ...
    def events(self, alert_id: int) -> Sequence[AlertEvent]: ...
    def save(
        self,
        alert: Alert,
        events: Sequence[AlertEventKind],
        recorded_ns: int,
        actor: str = "treadwatch",
        note: str = "",
    ) -> Alert: ...


class JobRuns(Protocol):
    """The record of every run."""

    def start(self, job: str, trigger: str, started_ns: int) -> JobRun: ...
    def finish(
        self, run_id: int, outcome: str, counts: Mapping[str, int], finished_ns: int, error: str | None = None
    ) -> None: ...
    def abandon_running(self, finished_ns: int) -> int: ...
    def get(self, run_id: int) -> JobRun: ...
    def page(self, job: str | None, before_id: int | None, limit: int) -> Sequence[JobRun]: ...


class Idempotency(Protocol):
    """Answers already given to POSTs, by ``Idempotency-Key``."""

    def get(self, key: str) -> tuple[str, int, str] | None: ...
    def put(self, key: str, request_digest: str, status_code: int, body: str, recorded_ns: int) -> None: ...


class UnitOfWork(Protocol):
    """One transaction over all stores."""

    @property
    def chunks(self) -> Chunks: ...
    @property
    def registry(self) -> Registry: ...
    @property
    def tracks(self) -> Tracks: ...
    @property
    def windows(self) -> Windows: ...
    @property
    def tables(self) -> BinTables: ...
    @property
    def geometries(self) -> Geometries: ...
    @property
    def trends(self) -> Trends: ...
    @property
    def alerts(self) -> Alerts: ...
    @property
    def jobs(self) -> JobRuns: ...
    @property
    def idempotency(self) -> Idempotency: ...


class Storage(Protocol):
    """Transactions: ``write`` commits on a clean exit and rolls back on an exception; ``read`` sees one snapshot.

    ``scheduler_lock`` is held by the one scheduler of a deployment; a second gets ``AlreadyRunningError``.
    """

    def write(self) -> AbstractContextManager[UnitOfWork]: ...
    def read(self) -> AbstractContextManager[UnitOfWork]: ...
    def scheduler_lock(self, holder: str) -> AbstractContextManager[None]: ...


class Clock(Protocol):
    """What time it is, ours."""

    def now_ns(self) -> int: ...
