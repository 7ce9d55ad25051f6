"""A stored fleet for the API's tests: irregular, with unknown numbers where a mistake could publish them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.contact.profiles import MeasuredProfiles, Profile
from estimation.storage import Storage
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, Severity
from estimation.values.geometry import BinStatus, BinValues, Centre, CentreOrigin, GeometryRecord, WheelsetGeometry
from estimation.values.opinions import (
    GearDamper,
    RailKey,
    RailPart,
    RailsFinding,
    RailsReference,
    RailTrend,
    WheelKey,
    WheelPart,
    WheelsFinding,
)
from estimation.values.quantities import Estimate, Forecast, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, Reprofiling, WheelsetRecord
from estimation.values.runs import Quarantined, QuarantineState, Result, SubjectKind
from estimation.values.signatures import (
    Basis,
    ConicitySource,
    Disagreement,
    SignatureAnswer,
    SignatureFinding,
    StateProbability,
    UsedEntry,
)
from estimation.values.track import TrackReport
from estimation.values.trend import SuspensionFinding, TrendRecord, WearTrend
from estimation.values.windows import Window, WindowQuality
from tests.believed_now import with_ahead

SECOND = 1_000_000_000
DAY = 86_400 * SECOND
START = 1_750_000_000 * SECOND
RECORDED = START + 40 * DAY + 123_456_789


def not_covered(text: str) -> Reason:
    return Reason(ReasonCode.AMPLITUDE_NOT_COVERED, text)


WHEELSETS = [f"WS-{number:03d}" for number in range(25)]
WINDOWS = 30
LENGTH = 30 * SECOND
NO_DATA_YET = "WS-024"


def wheelset(number: int) -> WheelsetRecord:
    """Return a wheelset; the first 12 are mounted, the first has been on the lathe twice."""
    serial, fleet = WHEELSETS[number], "alpha" if number % 2 == 0 else "=beta"
    mounting = None
    if number < 12:
        mounting = Mounting(serial, f"V-{number // 4}", number % 4 + 1, START + number, None, 100.5, 200.25)
    turned = (Reprofiling(serial, START + 5 * DAY, 5000.5, "first"), Reprofiling(serial, START + 9 * DAY, 9000.0))
    return WheelsetRecord(serial, fleet, "P8", 0.4375, mounting, turned if number == 0 else ())


def measured(at_ns: int) -> MeasuredProfiles:
    """Return a measurement of the first wheelset."""
    y = np.linspace(-0.07, 0.06, 8)
    left, right = (Profile("wheel", name, y, -y / 20.0, np.full(8, -0.05)) for name in ("left", "=right"))
    return MeasuredProfiles(WHEELSETS[0], at_ns, 5000.5, left, right, 0.125e-3)


def quarantined() -> list[Quarantined]:
    """Return what failed: keys with slashes, messages with folders, two stages of one wheelset."""
    failed = Quarantined(
        kind=SubjectKind.WHEELSET,
        key=WHEELSETS[0],
        stage="refresh_geometry",
        code=ReasonCode.PROCESSING_FAILED,
        error="ValueError: no",
        inputs="1",
        first_ns=RECORDED,
        last_ns=RECORDED + DAY,
        due_ns=RECORDED + DAY + 240 * SECOND,
        attempts=2,
    )
    window_key = f"{WHEELSETS[0]}@{window(3).start_ns}"
    waits = replace(failed, stage="ingest", code=ReasonCode.WAITS_FOR_STORAGE)
    return [
        failed,
        replace(failed, stage="refresh_trends", state=QuarantineState.RESOLVED),
        replace(failed, kind=SubjectKind.WINDOW, key=window_key, stage="estimate_windows"),
        replace(failed, kind=SubjectKind.WINDOW, key=f"{WHEELSETS[1]}@7", stage="estimate_windows"),
        replace(failed, kind=SubjectKind.SECTION, key="A/B", stage="refresh_alignment"),
        replace(failed, kind=SubjectKind.VEHICLE, key="V-0", stage="assemble_windows", code=ReasonCode.CONFLICT),
        replace(waits, kind=SubjectKind.RECORDING, key="ab" * 32, error="/data/raw/ab/cd.blf: No space left on device"),
    ]


def window(index: int, serial: str = WHEELSETS[0]) -> Window:
    """Return a short window."""
    samples = 16
    counts = np.arange(samples) - 5.0
    return Window(
        wheelset=serial,
        vehicle="V-0",
        axle=1,
        start_ns=START - START % LENGTH + index * LENGTH,
        length_ns=LENGTH,
        sample_interval_s=0.004,
        lateral_acceleration=counts * 0.01,
        yaw_acceleration=counts * 0.02,
        roll_acceleration=counts * 0.03,
        mass_lateral_acceleration=counts * 0.04 + index * 0.04,
        speed=np.full(samples, 17.5),
        distance=np.linspace(10.0, 11.0, samples),
        valid=np.ones(samples, bool),
        resolution=(0.01, 0.02, 0.03, 0.04),
        track_section="S-1",
        odometer_m=1e6 + index * 500.0,
        quality=WindowQuality(0.98, 0.1, 1, 0.0, 0.02, 17.0, 18.0, 0.9, sensor_fault=False),
    )


def estimate(value: float) -> Estimate:
    """Return an estimate around a value."""
    return Estimate(value, 0.01, value - 0.02, value + 0.025, 7.5, Status.ESTIMATED)


def geometry(conicity: float = 0.1875) -> WheelsetGeometry:
    """Return a geometry with a bin that a contact jump crosses and one without data."""
    status = (BinStatus.TOO_FEW, BinStatus.ESTIMATED, BinStatus.CONTACT_JUMP, BinStatus.ESTIMATED)
    known = np.array([False, True, False, True])

    def values(scale: float) -> BinValues:
        rows = np.array([1.0, -2.0, 3.0, 4.5]) * scale
        return BinValues(np.where(known, rows, np.nan), np.where(known, np.abs(rows) / 100.0, np.nan), status)

    return WheelsetGeometry(
        bin_edges=np.array([-4.0, -2.0, 0.0, 2.0, 4.0]) * 1e-3,
        samples=np.array([3.0, 5000.5, 4000.0, 6000.0]),
        rolling_radius_sum=values(0.4),
        rolling_radius_difference=values(1e-3),
        contact_angle_sum=values(0.05),
        contact_angle_difference=values(0.01),
        amplitude=np.array([1.0, 2.0, 3.0]) * 1e-3,
        conicity=(estimate(0.125), estimate(conicity), Estimate.unknown(not_covered("not covered"), 2.0)),
        reported_amplitude=2e-3,
        equivalent_conicity=estimate(conicity),
        nonlinearity=Estimate.unknown(not_covered("4 mm is not covered")),
        zero_crossing=estimate(-0.25e-3),
        windows=30,
        parameter_key="p" * 16,
        status=Status.ESTIMATED,
        centre=Centre(0.125e-3, 0.25e-3, CentreOrigin.MEAN_RUNNING_POSITION),
    )


def geometry_record(recorded_ns: int, conicity: float) -> GeometryRecord:
    """Return the current geometry of the first wheelset as recorded then."""
    return GeometryRecord(
        wheelset=WHEELSETS[0],
        baseline=2,
        interval=None,
        mileage_km=9500.5,
        from_ns=START,
        to_ns=START + 30 * LENGTH,
        geometry=geometry(conicity),
        input_digest=f"{recorded_ns:064x}",
        track_versions={"S-1": (1,)},
        parameters={"half_life_km": 10000.0},
        code_version="0.1.0+test",
        recorded_ns=recorded_ns,
    )


def signature_record() -> Result[SignatureFinding]:
    """Return what the signatures of the first wheelset show: another conicity than its geometry."""
    used = (
        UsedEntry(WHEELSETS[2], "S-1", 0.28125, 0.5, ConicitySource.MEASURED_PROFILES),
        UsedEntry(WHEELSETS[1], "S-1", 0.3125, 0.25, ConicitySource.GEOMETRY),
    )
    states = (StateProbability(0.0, 0.25, 0.125), StateProbability(0.25, float("inf"), 0.875))
    answer = SignatureAnswer(WHEELSETS[0], estimate(0.3125), Basis.OTHER_PLACES, states, used, 12, 3, 0.5)
    apart = Reason(ReasonCode.METHODS_DISAGREE, "their intervals are apart")
    found = SignatureFinding(
        answer=answer,
        baseline=2,
        signatures=9,
        from_ns=START,
        to_ns=START + LENGTH,
        left_out={"same_wheelset": 4},
        geometry=estimate(0.25),
        disagreement=Disagreement(0.0625, 0.0125, disagrees=True, reason=apart),
    )
    return Result(WHEELSETS[0], "5" * 64, "0.1.0+test", RECORDED, found)


def trend_record(recorded_ns: int, last: float) -> TrendRecord:
    """Return the trend of the first wheelset as recorded then; its limit is beyond the horizon at p90."""
    values = np.array([0.125, 0.15, last])
    trend = WearTrend(
        quantity="equivalent_conicity",
        mileage_km=np.array([9000.0, 10000.0, 11000.5]),
        measured_ns=np.array([START, START + DAY, START + 2 * DAY]),
        value=values,
        std=np.array([0.01, 0.011, np.nan]),
        noise=np.array([0.004, 0.005, np.nan]),
        slope_per_1000_km=estimate(0.02),
        slope_per_year=Estimate.unknown(Reason(ReasonCode.SINGLE_DATE, "dates too close")),
        fitted=estimate(last),
        limit=0.4,
        distance_to_limit_km=Forecast(8000.0, 11000.0, None),
        date_of_limit_ns=Forecast(float(START + 100 * DAY), float(START + 150 * DAY), None),
        probability_over_limit=0.0,
        status=Status.ESTIMATED,
    )
    return TrendRecord(WHEELSETS[0], 2, with_ahead(trend), f"{recorded_ns + 1:064x}", "0.1.0+test", recorded_ns)


def alert(serial: str, kind: str = "conicity_limit", fleet: str = "alpha") -> Alert:
    """Return an active alert, not yet stored."""
    return Alert(
        alert_id=0,
        fleet=fleet,
        wheelset=serial,
        kind=kind,
        severity=Severity.WARNING,
        condition=Condition.ACTIVE,
        opened_ns=START + DAY,
        last_seen_ns=START + 2 * DAY,
        occurrence_count=3,
        probability=0.975,
        evidence={"equivalent_conicity": {"value": 0.41, "std": 0.01}, "windows": [1, 2]},
        action="reprofile",
        raise_limit=0.4,
        clear_limit=0.38,
    )


def raised(storage: Storage, serial: str, kind: str = "conicity_limit", fleet: str = "alpha") -> Alert:
    """Store an alert and return it with its number."""
    with storage.write() as unit:
        open_one = next((one for one in unit.alerts.all_open(serial) if one.kind == kind), None)
        if open_one is not None:
            closed = replace(open_one, closed_ns=RECORDED, close_reason=CloseReason.REPROFILED)
            unit.alerts.save(closed, [AlertEventKind.CLOSED], RECORDED)
        return unit.alerts.save(alert(serial, kind, fleet), [AlertEventKind.RAISED], RECORDED)


def track_report(section: str, version: int | None, status: Status) -> TrackReport:
    """Return what a run of the alignment job found, with numbers that are none."""
    journey = {
        "vehicle": "V-1",
        "from_ns": START,
        "to_ns": START + DAY,
        "passes": 4,
        "offset_m": -12.5,
        "scale_1": 5e-4,
        "middle_m": 2500.0,
        "residual_rms_m": 0.125e-3,
        "used": True,
        "reason": "",
    }
    stranger = journey | {"vehicle": "V-2", "residual_rms_m": None, "used": False}
    stranger |= {"reason": "agrees with no other", "reason_code": "journey_disagrees"}
    report = {
        "passes": 4,
        "wheelsets": 4,
        "mean_passes": 2.5,
        "diversity": 0.25,
        "covered": 0.75,
        "converged": version is not None,
        "rounds": 4,
        "moved_m": None,
        "residual_rms_m": 0.1e-3,
        "alignment_std_m": None,
        "evidence": ["fleet version 2"] if version else [],
        "recording": None,
        "refused_windows": {"the sensor reports a fault": 2},
        "refused_windows_by_code": {"sensor_fault": 2},
        "journeys": [journey, stranger],
    }
    reason = None if version else Reason(ReasonCode.PASSES_ALIKE, "the passes are too alike")
    made = version is not None
    return TrackReport(section, version, made, status, reason, 10, "d" * 64, "0.1.0+test", report, RECORDED + 9)


def suspension_finding(vehicle: str, day: int, ratio: float) -> SuspensionFinding:
    """Return what the passes of a day show."""
    return SuspensionFinding(
        vehicle=vehicle,
        section="S-1",
        from_ns=START + day * DAY,
        to_ns=START + (day + 1) * DAY,
        ratio=ratio,
        ratio_std=0.03125,
        assumed=0.336,
        code_version="0.1.0+test",
        recorded_ns=RECORDED + day,
    )


RAILS_KNOWN = Estimate(0.0625, 0.0125, 0.0375, 0.0875, 24.0, Status.ESTIMATED)
RAILS_OPEN = Estimate.unknown(Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "not covered"), 24.0)
RAILS_AMPLITUDES = (1e-3, 3e-3)


def section_rails() -> Result[RailsFinding]:
    """Return worn rails of S-1."""
    both, held = (RAILS_KNOWN, RAILS_OPEN), RailsReference.KNOWN_RAILS
    period = RailPart(RailKey("S-1", 110), held, both, both, both, 4, 24, START, START + DAY)
    found = RailsFinding(
        amplitude=RAILS_AMPLITUDES,
        reference_wheel_profile="P8",
        periods=(period,),
        trend=RailTrend(RAILS_KNOWN, 1e-3, 3),
        limit=0.05,
        exceeded=True,
        reported_amplitude=1e-3,
    )
    return Result("S-1", "d" * 64, "test", RECORDED, found)


def wheelset_rails() -> Result[WheelsFinding]:
    """Return the wheels of the first wheelset without the rails of S-1."""
    own = WheelKey(WHEELSETS[0], 0, 3)
    part = WheelPart(own, RailsReference.KNOWN_RAILS, (RAILS_KNOWN, RAILS_OPEN), ("S-1",), 24, START, START + DAY)
    differs = Reason(ReasonCode.MEASURED_WHEELS_DIFFER, "measured, as S-9, but the conicity differs by 0.080")
    found = WheelsFinding(RAILS_AMPLITUDES, part, differs)
    return Result(WHEELSETS[0], "d" * 64, "test", RECORDED, found)


def gear_dampers() -> list[GearDamper]:
    """Return the dampers of the first vehicle: a weak one, and one that its windows do not show."""
    vehicle = suspension_findings()[0].vehicle
    few = Estimate.unknown(Reason(ReasonCode.TOO_FEW_WINDOWS, "2 windows show the suspension, 4 are needed"), 2.0)
    weak = with_interval(0.31, 0.02, 0.02, 9, 9.0)
    to_ns = suspension_findings()[0].to_ns
    return [
        GearDamper(vehicle, 1, weak, 0.99, weak.high is not None, 9, 1, 0, to_ns - 10**12, to_ns, 1000.0, 1010.5),
        GearDamper(vehicle, 3, few, None, None, 2, 0, 3, to_ns - 10**12, to_ns, 1000.0, 1010.5),
    ]


def suspension_findings() -> list[SuspensionFinding]:
    """Return those of 8 days, of a vehicle whose spring softens and of another."""
    ratios = [("V-0", day, 1.0 if day < 5 else 0.5) for day in range(8)] + [("V-1", day, 1.0) for day in range(8)]
    return [suspension_finding(vehicle, day, ratio) for vehicle, day, ratio in ratios]
