"""What is assumed of a wheelset: its class, profile and identity; and where its windows belong."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field

from estimation.alerts.rules.sensor_data import MOUNTED
from estimation.jobs.settings import EstimationSettings
from estimation.motion.integration import WindowParameters
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import bin_parameters
from estimation.values.alerts import Alert
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.roll_up import Member, RollUp, RollUpKey, Side, TabledWindow
from estimation.values.trend import AFTER, IDENTITY, TREND, IdentityChange, baseline_part, latest_identity_change
from estimation.values.windows import PassedOver
from estimation.vehicle.vehicle_class import ClassOnFile


@dataclass(frozen=True, slots=True)
class Assumed:
    """Inputs of the estimate of a window."""

    on_file: ClassOnFile  # class of the vehicle
    window_parameters: WindowParameters  # of the step from window to motion
    table_key: str  # of the bin tables that follow
    digest: str  # of all that a result rests on, standard deviations included


@dataclass(frozen=True, slots=True)
class ClassLookup:
    """Classes of vehicles as one transaction sees them; each is looked up once."""

    unit: UnitOfWork
    settings: EstimationSettings
    _classes: dict[str, ClassOnFile | Reason] = field(default_factory=dict)
    _assumed: dict[tuple[str, str], Assumed | Reason] = field(default_factory=dict)
    _wheelsets: dict[str, WheelsetRecord] = field(default_factory=dict)

    def wheelset(self, serial: str) -> WheelsetRecord:
        """Return a wheelset."""
        if serial not in self._wheelsets:
            self._wheelsets[serial] = self.unit.registry.wheelset(serial)
        return self._wheelsets[serial]

    def look_up(self, serials: Sequence[str], vehicles: Collection[str] = ()) -> None:
        """Load wheelsets and classes together. Those not on file are looked up again when asked for."""
        missing = sorted(set(serials) - self._wheelsets.keys())
        if missing:
            self._wheelsets.update({record.serial: record for record in self.unit.registry.wheelsets_of(missing)})
        codes = sorted(set(vehicles) - self._classes.keys())
        on_file = self.unit.registry.vehicles_of(codes) if codes else {}
        by_class = {record.vehicle_class: self._of_class(record.vehicle_class) for record in on_file.values()}
        self._classes.update({code: by_class[record.vehicle_class] for code, record in on_file.items()})

    def of_vehicle(self, vehicle: str) -> ClassOnFile | Reason:
        """Return the class of a vehicle, or the reason that it is not on file."""
        if vehicle not in self._classes:
            code = self.unit.registry.vehicle(vehicle).vehicle_class
            self._classes[vehicle] = self._of_class(code)
        return self._classes[vehicle]

    def assumed(self, vehicle: str, wheelset: str) -> Assumed | Reason:
        """Return the inputs of estimates of a wheelset on a vehicle, or why it is not estimated."""
        key = (vehicle, wheelset)
        if key not in self._assumed:
            self._assumed[key] = self._look_up(vehicle, wheelset)
        return self._assumed[key]

    def table_key(self, vehicle: str, wheelset: str) -> str | None:
        """Return the key of bin tables of a wheelset on a vehicle; None where the class is not on file."""
        assumed = self.assumed(vehicle, wheelset)
        return None if isinstance(assumed, Reason) else assumed.table_key

    def digest(self, vehicle: str, wheelset: str) -> str:
        """Return the digest of what is assumed; empty where the class is not on file."""
        assumed = self.assumed(vehicle, wheelset)
        return "" if isinstance(assumed, Reason) else assumed.digest

    def _of_class(self, code: str) -> ClassOnFile | Reason:
        on_file = self.unit.registry.vehicle_class(code)
        return class_unknown(code) if on_file is None else on_file

    def _look_up(self, vehicle: str, wheelset: str) -> Assumed | Reason:
        on_file = self.of_vehicle(vehicle)
        if isinstance(on_file, Reason):
            return on_file
        window_parameters = self.settings.windows(on_file.vehicle_class, self.wheelset(wheelset).nominal_radius_m)
        table_key = bin_parameters(window_parameters).key
        return Assumed(on_file, window_parameters, table_key, f"{table_key} {on_file.digest}")


def class_unknown(code: str) -> Reason:
    """Return the reason for windows that wait because the class of their vehicle is not on file."""
    return Reason(ReasonCode.CLASS_UNKNOWN, f"class {code!r} of the vehicle is not on file")


@dataclass(frozen=True, slots=True)
class Baseline:
    """The life of a profile, from new or a reprofiling to the next one: ``[from_ns, to_ns)``."""

    number: int
    from_ns: int
    to_ns: int | None
    mileage_km: float  # of the wheelset at its begin


def baselines(wheelset: WheelsetRecord) -> list[Baseline]:
    """Return the baselines of a wheelset, oldest first; number 0 begins when it was new."""
    reprofilings = sorted(wheelset.reprofilings, key=lambda item: item.at_ns)
    starts = [(0, 0.0), *((item.at_ns, item.mileage_km) for item in reprofilings)]
    ends: list[int | None] = [item.at_ns for item in reprofilings] + [None]
    lives = enumerate(zip(starts, ends, strict=True))
    return [Baseline(number, from_ns, to_ns, mileage_km) for number, ((from_ns, mileage_km), to_ns) in lives]


ROLL_UP_VERSION = 2


@dataclass(frozen=True, slots=True)
class Membership:
    """Rules that assign the windows of one wheelset to roll-ups, each with a weight."""

    wheelset: str
    baselines: Sequence[Baseline]
    change: IdentityChange | None
    reversed_mountings: Sequence[Mounting]
    interval_km: float
    half_life_km: float
    classes: ClassLookup

    @property
    def digest(self) -> str:
        """Digest of all but the classes of vehicles."""
        inputs = [
            ROLL_UP_VERSION,
            [asdict(baseline) for baseline in self.baselines],
            None if self.change is None else asdict(self.change),
            [(mounting.from_ns, mounting.to_ns) for mounting in self.reversed_mountings],
            self.interval_km,
            self.half_life_km,
        ]
        return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()

    def baseline_of(self, start_ns: int) -> Baseline:
        """Return the baseline of a time."""
        return next(baseline for baseline in reversed(self.baselines) if baseline.from_ns <= start_ns)

    def assumed(self, roll_up: RollUp) -> Assumed | None:
        """Return the inputs of estimates of a roll-up; None where its class has changed."""
        assumed = self.classes.assumed(roll_up.vehicles[-1], self.wheelset)
        if not isinstance(assumed, Assumed) or assumed.table_key != roll_up.key.table_key:
            return None
        return assumed if assumed.on_file.vehicle_class.code == roll_up.key.vehicle_class else None

    def table_key_and_class(self, vehicle: str) -> str:
        """Return the key of the tables on a vehicle and the code of its class; empty where that is not on file."""
        assumed = self.classes.assumed(vehicle, self.wheelset)
        return f"{assumed.table_key} {assumed.on_file.vehicle_class.code}" if isinstance(assumed, Assumed) else ""

    def key_of(self, window: TabledWindow, mileage_km: float) -> RollUpKey | None:
        """Return the roll-up of a window; None where it belongs to none.

        A table of other parameters must be made again. Data recorded while the wheelset was being exchanged belong to
        neither side.
        """
        record = window.record
        assumed, side = self.classes.assumed(record.vehicle, self.wheelset), self._side(record.start_ns)
        if not isinstance(assumed, Assumed) or assumed.table_key != window.parameter_key or side is None:
            return None
        baseline = self.baseline_of(record.start_ns)
        interval = int((mileage_km - baseline.mileage_km) // self.interval_km)
        return RollUpKey(baseline.number, interval, side, assumed.table_key, assumed.on_file.vehicle_class.code)

    def member(self, window: TabledWindow, mileage_km: float, key: RollUpKey) -> Member:
        """Return a window as part of its roll-up."""
        record, at_ns = window.record, window.record.start_ns
        table_text = f"{window.parameter_key} {window.content_digest}"
        if any(mounting.covers(at_ns) for mounting in self.reversed_mountings):
            table_text = f"{table_text} reversed"
        weight = float(0.5 ** ((self.end_km(key) - mileage_km) / self.half_life_km))
        line = f"{at_ns} {record.content_digest} {table_text} {window.track_version} {mileage_km!r} {weight!r}"
        return Member(window, mileage_km, hashlib.sha256(line.encode()).hexdigest(), weight)

    def of_its_baseline(self, roll_up: RollUp) -> bool:
        """Whether all windows of a roll-up are of the baseline, and on the side, that its key names."""
        placed = self._baseline_and_side(roll_up)
        return placed is not None and (placed[0].number, placed[1]) == (roll_up.key.baseline, roll_up.key.side)

    def place_of(self, roll_up: RollUp) -> tuple[int, int, Side] | None:
        """Return the present baseline, interval and side of a roll-up; None where its time is of several."""
        baseline_and_side = self._baseline_and_side(roll_up)
        if baseline_and_side is None:
            return None
        baseline, side = baseline_and_side
        return baseline.number, int((roll_up.mean_km - baseline.mileage_km) // self.interval_km), side

    def _baseline_and_side(self, roll_up: RollUp) -> tuple[Baseline, Side] | None:
        first, last = roll_up.first_ns, roll_up.last_ns
        baseline, side = self.baseline_of(first), self._side(first)
        if side is None or (self.baseline_of(last), self._side(last)) != (baseline, side):
            return None
        return baseline, side

    def end_km(self, key: RollUpKey) -> float:
        """Return the mileage at which an interval ends."""
        baseline = self.baselines[min(key.baseline, len(self.baselines) - 1)]
        return baseline.mileage_km + (key.interval + 1) * self.interval_km

    def weight(self, key: RollUpKey, at_km: float) -> float:
        """Return the weight, at ``at_km``, of what was recorded at the end of an interval."""
        return float(0.5 ** ((at_km - self.end_km(key)) / self.half_life_km))

    def _side(self, start_ns: int) -> Side | None:
        if self.change is None:
            return Side.WHOLE
        if start_ns < self.change.before_ns:
            return Side.BEFORE
        return Side.AFTER if start_ns >= self.change.after_ns else None


def membership(unit: UnitOfWork, serial: str, classes: ClassLookup) -> Membership:
    """Return the present rules for the windows of a wheelset."""
    wheelset = classes.wheelset(serial)
    return Membership(
        serial,
        baselines(wheelset),
        last_break(unit, wheelset),
        [mounting for mounting in unit.registry.mountings(serial) if mounting.reversed],
        classes.settings.interval_km,
        classes.settings.half_life_km,
        classes,
    )


CONTRADICTED = Reason(
    ReasonCode.SAMPLES_PURGED, "class, mounting, mileage or reprofilings have changed since the samples were purged"
)


@dataclass(slots=True)
class PassedOverWindows:
    """The passed-over windows of one wheelset; read once."""

    unit: UnitOfWork
    rules: Membership
    _windows: Sequence[tuple[int, PassedOver]] | None = field(default=None, init=False)

    def counts(self, roll_ups: Sequence[RollUp]) -> Mapping[str, int]:
        """Return how many windows of the time of some roll-ups stay as they are, by what would have changed them."""
        if self._windows is None:
            self._windows = self.unit.windows.passed_over(self.rules.wheelset)
        if not self._windows:
            return {}
        spans = [(roll_up.first_ns, roll_up.last_ns) for roll_up in roll_ups]
        counts = Counter(
            cause.value for start_ns, cause in self._windows if any(first <= start_ns <= last for first, last in spans)
        )
        return dict(sorted(counts.items()))

    def contradicted(self, roll_up: RollUp) -> bool:
        """Whether the stored roll-up is wrong by now: its windows were of another class, place or mileage."""
        counts = self.counts([roll_up])
        other_class = PassedOver.CLASS_CHANGED in counts and self.rules.assumed(roll_up) is None
        return other_class or PassedOver.RECORD_CHANGED in counts or not self.rules.of_its_baseline(roll_up)


def identity_change(unit: UnitOfWork, serial: str) -> IdentityChange | None:
    """Return the last identity change of a wheelset that is on record, from its alerts of this kind.

    A change is ignored if the wheelset has since been registered elsewhere: later data are of another wheelset.
    """
    return identity_changes(unit, [serial]).get(serial)


def identity_changes(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, IdentityChange]:
    """Return the last identity change of each of some wheelsets that has one on record, by serial."""
    alerts: dict[str, list[Alert]] = {}
    for alert in unit.alerts.of_kind(IDENTITY, serials):
        alerts.setdefault(str(alert.wheelset), []).append(alert)
    mountings = unit.registry.mountings_of(list(alerts)) if alerts else {}
    changes = {
        serial: latest_identity_change([alert for alert in raised if _still_there(alert, mountings.get(serial, ()))])
        for serial, raised in alerts.items()
    }
    return {serial: change for serial, change in changes.items() if change is not None}


def with_identity_alerts(unit: UnitOfWork) -> frozenset[str]:
    """Return the wheelsets with an identity alert, open or closed: all others have had no identity change."""
    return unit.alerts.wheelsets_of_kind(IDENTITY)


def _still_there(alert: Alert, mountings: Sequence[Mounting]) -> bool:
    """Whether a wheelset was mounted after a change where the alert says; its way round may have been corrected."""
    mounted_at, after_ns = alert.evidence.get(MOUNTED), alert.evidence.get(AFTER)
    if not isinstance(mounted_at, dict) or not isinstance(after_ns, int):
        return True
    mounting_key = [mounted_at.get(name) for name in ("vehicle", "axle", "from_ns")]
    mountings_there = [m for m in mountings if [m.vehicle, m.axle, m.from_ns] == mounting_key]
    return any(mounting.to_ns is None or mounting.to_ns > after_ns for mounting in mountings_there)


def last_break(unit: UnitOfWork, wheelset: WheelsetRecord) -> IdentityChange | None:
    """Return the last break, an identity change or a step of the trend; data are not merged across it."""
    identity = identity_change(unit, wheelset.serial)
    changes = [identity, _step(unit, wheelset)]
    return max((change for change in changes if change is not None), key=lambda change: change.after_ns, default=None)


def _step(unit: UnitOfWork, wheelset: WheelsetRecord) -> IdentityChange | None:
    """Return the newest step of the present profile as a change; None where there is none."""
    trend = unit.results.latest_head(TREND, wheelset.serial)
    if trend is None or trend.part != baseline_part(len(wheelset.reprofilings)) or not isinstance(trend.head, list):
        return None
    before_ns, after_ns = trend.head
    assert isinstance(before_ns, int)
    assert isinstance(after_ns, int)
    return IdentityChange(before_ns, after_ns)
