"""Windows of running time, without their samples; and, by their reasons, why nothing is estimated of a wheelset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

from pydantic import Field

from api.schemas.common import Derived, finite, why, without_folders
from api.times import Timestamp, to_rfc3339
from estimation.errors import DamagedError, NotFoundError
from estimation.track.update import NOT_USED
from estimation.values import windows as values
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.registry import WheelsetRecord
from estimation.values.runs import TRIED_AGAIN, JobRun, Quarantined, QuarantineState, SubjectKind
from estimation.values.windows import WindowKey, WindowRecord, WindowsOfReason, WindowState, WithoutEstimate, remedies
from estimation.worklist.row import (
    ALIGNMENT,
    ESTIMATION,
    GEOMETRIES,
    SectionFacts,
    no_alignment,
    no_geometry_yet,
    tried_again,
    waits_for,
)
from fleet_db.records import ChunkState
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.window_counts import COUNTED, CountedWindows, newest_by_reason, pending_by_place


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
    def made(cls, value: WindowsOfReason, **more: Any) -> Self:  # noqa: ANN401 - as of every derived class
        """Return the representation of windows of one reason."""
        code = code_of(value.reason)
        explained = {"meaning": code and code.meaning, "what_to_do": (code and code.remedy) or None}
        return super().made(value, **explained, **more)


class UnestimatedBecause(Derived, of=WithoutEstimate, without=("reason",)):
    """Why nothing is estimated of a wheelset now."""

    windows: int = Field(description="Windows that are counted: the newest since the last reprofiling, at most 1,000.")
    pending: int = Field(description="Those of them that wait.")
    refused: int = Field(description="Those of them that are refused.")
    estimated: int = Field(description="Those of them that have a bin table.")
    what_to_do: str | None = Field(description="Null where there is nothing to do but to wait.")


def unestimated_because(without: WithoutEstimate | None) -> UnestimatedBecause | None:
    """Return the representation of why nothing is estimated; None where something is."""
    if without is None:
        return None
    counts = {state.value: without.count(state) for state in WindowState}
    return UnestimatedBecause.made(without, windows=without.counted, **counts, what_to_do=without.what_to_do or None)


OF_SECTION = {ReasonCode.ALIGNMENT_UNKNOWN, ReasonCode.WAITS_FOR_POSITION}
"""Codes whose sentence names a section and what it lacks."""

SHOWN = 3  # reasons that the sentence on a wheelset names


@dataclass(slots=True)
class WindowReasons:
    """Reads in one transaction what windows wait for or were refused for; what several share is read once."""

    unit: SqlUnitOfWork
    _sections: dict[str, SectionFacts] = field(default_factory=dict)
    _classes: dict[str, Reason | None] = field(default_factory=dict)
    _runs: dict[str, JobRun | None] = field(default_factory=dict)

    def of_records(self, records: Iterable[WindowRecord]) -> dict[WindowKey, Reason | None]:
        """Return why each window waits or was refused; None where it is estimated."""
        records = list(records)
        waiting = [record.key for record in records if record.state is WindowState.PENDING]
        positions = self.unit.tracks.positions(waiting) if waiting else {}
        reasons: dict[WindowKey, Reason | None] = {}
        for record in records:
            position = positions.get(record.key)
            placed = position is not None and position.content_digest == record.content_digest
            of_record = (record.state, record.reason, record.track_section, record.vehicle, record.key)
            reasons[record.key] = self._reason(*of_record, placed=placed)
        return reasons

    def without_estimate(self, serial: str, of_geometry: Reason | None = None, most: int = COUNTED) -> WithoutEstimate:
        """Return why nothing is estimated of a wheelset; ``of_geometry`` is why that holds no number."""
        record = self.unit.registry.wheelset(serial)
        since_ns = max((reprofiling.at_ns for reprofiling in record.reprofilings), default=None)
        counted = list(newest_by_reason(self.unit.connection, serial, since_ns, most))
        if not counted:
            reason, what_to_do = self._without_windows(record)
            why = of_geometry or Reason(ReasonCode.NO_GEOMETRY, reason)
            return WithoutEstimate(why, what_to_do, (), None, self._last_ns(serial))
        merged = self._merged(serial, counted, of_geometry)
        return WithoutEstimate(
            reason=of_geometry or Reason(ReasonCode.NO_GEOMETRY, _sentence(merged)),
            what_to_do=remedies([windows.reason for windows in merged[:SHOWN]]),
            windows=tuple(merged),
            from_ns=min(windows.first_ns for windows in counted),
            last_ns=max(windows.newest_end_ns for windows in counted),
        )

    def waiting(self, *, vehicles: Sequence[str] | None = None, wheelset: str | None = None) -> list[WindowsOfReason]:
        """Return the windows that wait, by what they wait for, the most frequent first."""
        counted = pending_by_place(self.unit.connection, vehicles=vehicles, wheelset=wheelset)
        return self._merged(wheelset or "", counted, None)

    def _merged(
        self, serial: str, counted: Iterable[CountedWindows], of_geometry: Reason | None
    ) -> list[WindowsOfReason]:
        by_reason = []
        for windows in counted:
            of_windows = (windows.state, windows.reason, windows.section, windows.vehicle)
            reason = self._reason(*of_windows, (serial, windows.newest_start_ns), placed=windows.placed)
            if windows.state is WindowState.ESTIMATED:
                failed = self._failed(SubjectKind.WHEELSET, serial, GEOMETRIES)
                reason = of_geometry or no_geometry_yet(self._last_run(GEOMETRIES), failed)
            by_reason.append(WindowsOfReason(windows.state, reason, windows.windows, windows.newest_end_ns))
        return together(by_reason)

    def _reason(
        self,
        state: WindowState,
        stored: Reason | None,
        section: str | None,
        vehicle: str,
        key: WindowKey,
        *,
        placed: bool,
    ) -> Reason | None:
        if state is WindowState.PENDING:
            facts = None if section is None else self._section(section)
            if vehicle not in self._classes:
                self._classes[vehicle] = self._look_up_class(vehicle)
            return waits_for(facts, self._classes[vehicle], self._last_run(ESTIMATION), placed=placed)
        if stored is None or state is WindowState.ESTIMATED:
            return stored
        if stored.code is ReasonCode.ALIGNMENT_UNKNOWN and section is not None and not self._section(section).aligned:
            return no_alignment(self._section(section))
        if stored.code in TRIED_AGAIN:
            serial, start_ns = key
            return tried_again(stored, self._failed(SubjectKind.WINDOW, f"{serial}@{start_ns}", ESTIMATION))
        return stored

    def _section(self, code: str) -> SectionFacts:
        if code not in self._sections:
            report = self.unit.tracks.report(code)
            said = {} if report is None else report.report
            refused = str(said.get("recording")).startswith(NOT_USED)
            self._sections[code] = SectionFacts(
                code=code,
                in_force=self.unit.tracks.in_force(code),
                looked_at=report is not None,
                found=None if report is None else report.reason,
                survey=Reason(ReasonCode(str(said["recording_code"])), str(said["recording"])) if refused else None,
                failed=self._failed(SubjectKind.SECTION, code, ALIGNMENT),
            )
        return self._sections[code]

    def _look_up_class(self, vehicle: str) -> Reason | None:
        try:
            code = self.unit.registry.vehicle(vehicle).vehicle_class
            is_on_file = self.unit.registry.vehicle_class(code) is not None
        except (DamagedError, NotFoundError):  # it is of another fleet, of which nothing is said
            return None
        return None if is_on_file else Reason(ReasonCode.CLASS_UNKNOWN, f"class {code!r} of {vehicle} is not on file")

    def _last_run(self, job: str) -> JobRun | None:
        if job not in self._runs:
            self._runs[job] = next(iter(self.unit.jobs.page(job, None, 1)), None)
        return self._runs[job]

    def _failed(self, kind: SubjectKind, key: str, stage: str) -> Quarantined | None:
        item = self.unit.quarantine.get(kind, key, stage)
        if item is None or item.state is not QuarantineState.HELD:
            return None
        return replace(item, error=without_folders(item.error))

    def _last_ns(self, serial: str) -> int | None:
        latest = self.unit.windows.latest(serial)
        return None if latest is None else latest.start_ns + latest.length_ns

    def _without_windows(self, record: WheelsetRecord) -> tuple[str, str]:
        mounting = record.mounting
        if self._last_ns(record.serial) is not None:
            return "no window has been received since the last reprofiling", "Check the vehicle and its receiver."
        if mounting is None:
            return "it runs under no vehicle, and no window of it has been received", "Register its mounting."
        newest = self.unit.chunks.newest_of_vehicle(mounting.vehicle)
        if newest is None:
            return f"no recording of {mounting.vehicle} has been received", "Check the vehicle and its receiver."
        if newest.reason is not None and newest.state is not ChunkState.DECODED:
            why = f"the newest recording of {mounting.vehicle} is {newest.state.value}: "
            return why + without_folders(newest.reason.text), newest.reason.code.remedy
        return (
            f"the recordings of {mounting.vehicle} hold no window of axle {mounting.axle} since it was mounted there",
            "Check the sensor node of the axle, and since when the wheelset is mounted. Standing is no window.",
        )


def together(counted: Iterable[WindowsOfReason]) -> list[WindowsOfReason]:
    """Return windows of one state and code, and of one section where that is what they lack, as one; most first."""
    by_reason: dict[object, WindowsOfReason] = {}
    for windows in counted:
        reason = windows.reason
        section = reason.text if reason is not None and reason.code in OF_SECTION else None
        same = (windows.state, code_of(reason), section)
        before = by_reason.get(same, replace(windows, windows=0))
        newest = windows if windows.newest_ns > before.newest_ns else before
        by_reason[same] = replace(newest, windows=before.windows + windows.windows)
    return sorted(by_reason.values(), key=lambda windows: (-windows.windows, -windows.newest_ns))


_DOES = {WindowState.PENDING: "wait", WindowState.REFUSED: "are refused", WindowState.ESTIMATED: "are estimated"}


def _sentence(counted: list[WindowsOfReason]) -> str:
    total = sum(windows.windows for windows in counted)
    if len(counted) == 1:
        return f"its newest {total} windows {_DOES[counted[0].state]}: {counted[0].reason}"
    parts = [f"{windows.windows} {_DOES[windows.state]}: {windows.reason}" for windows in counted[:SHOWN]]
    more = sum(windows.windows for windows in counted[SHOWN:])
    parts += [f"{more} for other reasons"] if more else []
    return f"of the newest {total} windows " + "; ".join(parts)
