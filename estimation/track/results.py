"""What the passes of a section show besides its alignment, and the report of how it was found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from enum import StrEnum

from estimation.track.convergence import Convergence
from estimation.track.gauge.wheel_functions import contact_samples, gauge_sign, total_gauge_shifts
from estimation.track.iteration import IterationResult
from estimation.values.arrays import FloatArray
from estimation.values.json_value import JsonValue
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.track import GaugeShift, TrackFindings


@dataclass(frozen=True, slots=True)
class SectionResults:
    """Findings, and the gauge deviation (n,), m, where it is estimated from the passes."""

    findings: TrackFindings
    gauge: FloatArray | None


def findings(iterated: IterationResult, *, gauge_estimated: bool) -> SectionResults:
    """Return what the passes show; ``gauge_estimated`` where the gauge of the panel came from them.

    Args:
        gauge_estimated: Whether the gauge of the panel was estimated from the passes.
    """
    ratios = {vehicle: one.value for vehicle, one in iterated.ratios.items()}
    std = max((one.std for one in iterated.ratios.values()), default=0.0)
    gauge = iterated.panel.gauge
    if gauge is None:
        return SectionResults(TrackFindings(ratios, std, {}), None)
    panel = iterated.panel
    shifts = total_gauge_shifts(iterated.solution, panel)
    sign = gauge_sign(contact_samples(iterated.passes, iterated.solution, panel), shifts) if gauge_estimated else 1
    if sign < 0:
        shifts = {name: _turned(one) for name, one in shifts.items()}
    latest = {life.wheelset: shifts[life] for life in sorted(shifts)}  # of several lives the latest
    found = TrackFindings(ratios, std, latest)
    if not gauge_estimated:
        return SectionResults(found, None)
    return SectionResults(found, sign * gauge)


def _turned(shift: GaugeShift) -> GaugeShift:
    """Return what a gauge of the other sign does; the grid is symmetric."""
    return replace(shift, shift=shift.shift[:, ::-1])


@dataclass(frozen=True, slots=True)
class JourneyReport:
    """Windows of one vehicle on one run over the section: where they were, or why they were not used."""

    vehicle: str
    from_ns: int
    to_ns: int  # start of its last window
    passes: int
    offset_m: float
    scale_1: float
    middle_m: float
    residual_rms_m: float
    used: bool
    reason: Reason | None = None


@dataclass(frozen=True, slots=True)
class AlignmentReport:
    """How an alignment was found, in figures; stored with it.

    ``evidence`` names what was known besides the passes: the last version, a recorded alignment.
    """

    status: Status
    reason: Reason | None
    converged: bool = False  # positions and stiffness ratios; where not, ``reason`` says so, also of an estimate
    convergence: tuple[Convergence, ...] = ()  # of each quantity that is iterated
    rounds: int = 0
    residual_rms_m: float = 0.0  # of y - d - h(R) over all passes
    moved_m: float = 0.0  # by which the last round moved a position at most
    passes: int = 0
    wheelsets: int = 0
    mean_passes: float = 0.0  # per place that has any
    diversity: float = 0.0  # std of R between the passes of a place over the std of R
    covered: float = 0.0  # share of the section whose alignment is known
    alignment_std_m: float = math.nan  # median along the section
    evidence: tuple[str, ...] = ()
    journeys: tuple[JourneyReport, ...] = ()

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return all of it as JSON; a number that is none is null."""
        fields = _json(asdict(self))
        assert isinstance(fields, dict)
        return fields


def _json(value: object) -> JsonValue:
    if isinstance(value, dict):
        whole = {str(name): _json(item) for name, item in value.items()}
        if "reason" in whole:  # as the database has it: the sentence, and the code beside it
            reason = value["reason"]
            whole |= {
                "reason": reason["text"] if reason else "",
                "reason_code": str(reason["code"]) if reason else None,
            }
        return whole
    if isinstance(value, tuple | list):
        return [_json(item) for item in value]
    if isinstance(value, StrEnum):
        return str(value)
    if isinstance(value, bool | int | str) or value is None:
        return value
    assert isinstance(value, float)
    return value if math.isfinite(value) else None


def nothing(reason: Reason, evidence: tuple[str, ...] = ()) -> AlignmentReport:
    """Return the report of passes from which nothing follows, for this reason."""
    return AlignmentReport(Status.UNESTIMATED, reason, evidence=evidence)
