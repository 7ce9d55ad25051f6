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
    """What a window is estimated with."""

    on_file: ClassOnFile  # class of the vehicle
    windows: WindowParameters  # what turns the window into motion
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
        """Look up wheelsets, and the classes of vehicles, together; those that are not on file again when asked for."""
        missing = sorted(set(serials) - self._wheelsets.keys())
        if missing:
            self._wheelsets.update({one.serial: one for one in self.unit.registry.wheelsets_of(missing)})
        codes = sorted(set(vehicles) - self._classes.keys())
        on_file = self.unit.registry.vehicles_of(codes) if codes else {}
        by_class = {one.vehicle_class: self._of_class(one.vehicle_class) for one in on_file.values()}
        self._classes.update({code: by_class[one.vehicle_class] for code, one in on_file.items()})

    def of_vehicle(self, vehicle: str) -> ClassOnFile | Reason:
        """Return the class of a vehicle, or that it is not on file."""
        if vehicle not in self._classes:
            code = self.unit.registry.vehicle(vehicle).vehicle_class
            self._classes[vehicle] = self._of_class(code)
        return self._classes[vehicle]

    def assumed(self, vehicle: str, wheelset: str) -> Assumed | Reason:
        """Return what the windows of a wheelset on a vehicle are estimated with, or why they are not."""
        key = (vehicle, wheelset)
        if key not in self._assumed:
            self._assumed[key] = self._look_up(vehicle, wheelset)
        return self._assumed[key]

    def table_key(self, vehicle: str, wheelset: str) -> str | None:
        """Return the key of bin tables of a wheelset on a vehicle; None where the class is not on file."""
        found = self.assumed(vehicle, wheelset)
        return None if isinstance(found, Reason) else found.table_key

    def digest(self, vehicle: str, wheelset: str) -> str:
        """Return the digest of what is assumed; empty where the class is not on file."""
        found = self.assumed(vehicle, wheelset)
        return "" if isinstance(found, Reason) else found.digest

    def _of_class(self, code: str) -> ClassOnFile | Reason:
        found = self.unit.registry.vehicle_class(code)
        return class_unknown(code) if found is None else found

    def _look_up(self, vehicle: str, wheelset: str) -> Assumed | Reason:
        on_file = self.of_vehicle(vehicle)
        if isinstance(on_file, Reason):
            return on_file
        windows = self.settings.windows(on_file.vehicle_class, self.wheelset(wheelset).nominal_radius_m)
        table_key = bin_parameters(windows).key
        return Assumed(on_file, windows, table_key, f"{table_key} {on_file.digest}")


def class_unknown(code: str) -> Reason:
    """Return the reason why windows of a vehicle wait whose class is not on file."""
    return Reason(ReasonCode.CLASS_UNKNOWN, f"class {code!r} of the vehicle is not on file")


@dataclass(frozen=True, slots=True)
class Baseline:
    """The life of a profile between two reprofilings, ``[from_ns, to_ns)``."""

    number: int
    from_ns: int
    to_ns: int | None
    mileage_km: float  # of the wheelset at its begin


def baselines(wheelset: WheelsetRecord) -> list[Baseline]:
    """Return the baselines of a wheelset, oldest first; number 0 begins when it was new."""
    turned = sorted(wheelset.reprofilings, key=lambda item: item.at_ns)
    starts = [(0, 0.0), *((item.at_ns, item.mileage_km) for item in turned)]
    ends: list[int | None] = [item.at_ns for item in turned] + [None]
    return [Baseline(i, a, b, km) for i, ((a, km), b) in enumerate(zip(starts, ends, strict=True))]


ROLL_UP_VERSION = 2


@dataclass(frozen=True, slots=True)
class Membership:
    """What says to which roll-up the windows of one wheelset belong, and with what weight."""

    wheelset: str
    baselines: Sequence[Baseline]
    change: IdentityChange | None
    turned: Sequence[Mounting]  # those in which it was mounted the other way round
    interval_km: float
    half_life_km: float
    classes: ClassLookup

    @property
    def digest(self) -> str:
        """Digest of all but the classes of vehicles."""
        inputs = [
            ROLL_UP_VERSION,
            [asdict(one) for one in self.baselines],
            None if self.change is None else asdict(self.change),
            [(one.from_ns, one.to_ns) for one in self.turned],
            self.interval_km,
            self.half_life_km,
        ]
        return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()

    def baseline_of(self, start_ns: int) -> Baseline:
        """Return the baseline of a time."""
        return next(one for one in reversed(self.baselines) if one.from_ns <= start_ns)

    def assumed(self, roll_up: RollUp) -> Assumed | None:
        """Return what the windows of a roll-up are estimated with; None where its class is another by now."""
        found = self.classes.assumed(roll_up.vehicles[-1], self.wheelset)
        if not isinstance(found, Assumed) or found.table_key != roll_up.key.table_key:
            return None
        return found if found.on_file.vehicle_class.code == roll_up.key.vehicle_class else None

    def class_of(self, vehicle: str) -> str:
        """Return the key of the tables on a vehicle and the code of its class; empty where that is not on file."""
        found = self.classes.assumed(vehicle, self.wheelset)
        return f"{found.table_key} {found.on_file.vehicle_class.code}" if isinstance(found, Assumed) else ""

    def key_of(self, window: TabledWindow, mileage_km: float) -> RollUpKey | None:
        """Return the roll-up of a window; None where it belongs to none.

        A table of other parameters waits to be made again, and what was recorded while a wheelset was exchanged is of
        neither.
        """
        record = window.record
        found, side = self.classes.assumed(record.vehicle, self.wheelset), self._side(record.start_ns)
        if not isinstance(found, Assumed) or found.table_key != window.parameter_key or side is None:
            return None
        baseline = self.baseline_of(record.start_ns)
        interval = int((mileage_km - baseline.mileage_km) // self.interval_km)
        return RollUpKey(baseline.number, interval, side, found.table_key, found.on_file.vehicle_class.code)

    def member(self, window: TabledWindow, mileage_km: float, key: RollUpKey) -> Member:
        """Return a window as part of its roll-up."""
        record, at_ns = window.record, window.record.start_ns
        table = f"{window.parameter_key} {window.content_digest}"
        if any(mounting.covers(at_ns) for mounting in self.turned):
            table = f"{table} reversed"
        weight = float(0.5 ** ((self.end_km(key) - mileage_km) / self.half_life_km))
        line = f"{at_ns} {record.content_digest} {table} {window.track_version} {mileage_km!r} {weight!r}"
        return Member(window, mileage_km, hashlib.sha256(line.encode()).hexdigest(), weight)

    def of_its_baseline(self, roll_up: RollUp) -> bool:
        """Whether the time of a roll-up is of the baseline, and on the side of its last change, of its key."""
        found = self._span(roll_up)
        return found is not None and (found[0].number, found[1]) == (roll_up.key.baseline, roll_up.key.side)

    def place_of(self, roll_up: RollUp) -> tuple[int, int, Side] | None:
        """Return baseline, interval and side of a roll-up as they are now; None where its time is of several."""
        found = self._span(roll_up)
        if found is None:
            return None
        baseline, side = found
        return baseline.number, int((roll_up.mean_km - baseline.mileage_km) // self.interval_km), side

    def _span(self, roll_up: RollUp) -> tuple[Baseline, Side] | None:
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
        """Return the weight with forgetting that the end of an interval has at a mileage."""
        return float(0.5 ** ((at_km - self.end_km(key)) / self.half_life_km))

    def _side(self, start_ns: int) -> Side | None:
        if self.change is None:
            return Side.WHOLE
        if start_ns < self.change.before_ns:
            return Side.BEFORE
        return Side.AFTER if start_ns >= self.change.after_ns else None


def membership(unit: UnitOfWork, serial: str, classes: ClassLookup) -> Membership:
    """Return the rules for the windows of a wheelset as they are now."""
    wheelset = classes.wheelset(serial)
    return Membership(
        serial,
        baselines(wheelset),
        last_change(unit, wheelset),
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
    """Looks at the windows of one wheelset, as one transaction sees them."""

    unit: UnitOfWork
    rules: Membership
    _windows: Sequence[tuple[int, PassedOver]] | None = field(default=None, init=False)

    def counts(self, roll_ups: Sequence[RollUp]) -> Mapping[str, int]:
        """Return how many windows of the time of some roll-ups stay as they are, by what would have changed them."""
        if self._windows is None:
            self._windows = self.unit.windows.passed_over(self.rules.wheelset)
        if not self._windows:
            return {}
        spans = [(one.first_ns, one.last_ns) for one in roll_ups]
        found = Counter(
            what.value for start_ns, what in self._windows if any(first <= start_ns <= last for first, last in spans)
        )
        return dict(sorted(found.items()))

    def contradicted(self, roll_up: RollUp) -> bool:
        """Whether what is stored of a roll-up is wrong by now: its windows were of another class, place or mileage."""
        counts = self.counts([roll_up])
        other_class = PassedOver.CLASS_CHANGED in counts and self.rules.assumed(roll_up) is None
        return other_class or PassedOver.RECORD_CHANGED in counts or not self.rules.of_its_baseline(roll_up)


def identity_change(unit: UnitOfWork, serial: str) -> IdentityChange | None:
    """Return the last identity change of a wheelset that is on record, from its alerts of this kind.

    One that was found in another place than the registry has for the wheelset now is none: what was recorded after it
    is another wheelset's by now.
    """
    return identity_changes(unit, [serial]).get(serial)


def identity_changes(unit: UnitOfWork, serials: Sequence[str]) -> Mapping[str, IdentityChange]:
    """Return the last identity change of each of some wheelsets that has one on record, by serial."""
    alerts: dict[str, list[Alert]] = {}
    for alert in unit.alerts.of_kind(IDENTITY, serials):
        alerts.setdefault(str(alert.wheelset), []).append(alert)
    mountings = unit.registry.mountings_of(list(alerts)) if alerts else {}
    changes = {
        serial: latest_identity_change([one for one in own if _still_there(one, mountings.get(serial, ()))])
        for serial, own in alerts.items()
    }
    return {serial: change for serial, change in changes.items() if change is not None}


def suspected(unit: UnitOfWork) -> frozenset[str]:
    """Return the wheelsets with an identity alert, open or closed: all others have had no identity change."""
    return unit.alerts.wheelsets_of_kind(IDENTITY)


def _still_there(alert: Alert, mountings: Sequence[Mounting]) -> bool:
    """Whether a wheelset was mounted after a change where the alert says; its way round may have been corrected."""
    place, after_ns = alert.evidence.get(MOUNTED), alert.evidence.get(AFTER)
    if not isinstance(place, dict) or not isinstance(after_ns, int):
        return True
    at = [place.get(name) for name in ("vehicle", "axle", "from_ns")]
    same = [one for one in mountings if [one.vehicle, one.axle, one.from_ns] == at]
    return any(one.to_ns is None or one.to_ns > after_ns for one in same)


def last_change(unit: UnitOfWork, wheelset: WheelsetRecord) -> IdentityChange | None:
    """Return the last change that data of a wheelset are not merged across: of its identity, or a step of its trend."""
    identity = identity_change(unit, wheelset.serial)
    changes = [identity, _step(unit, wheelset)]
    return max((one for one in changes if one is not None), key=lambda one: one.after_ns, default=None)


def _step(unit: UnitOfWork, wheelset: WheelsetRecord) -> IdentityChange | None:
    """Return the newest step of the present profile as a change; None where there is none."""
    trend = unit.results.latest_head(TREND, wheelset.serial)
    if trend is None or trend.part != baseline_part(len(wheelset.reprofilings)) or not isinstance(trend.head, list):
        return None
    before_ns, after_ns = trend.head
    assert isinstance(before_ns, int)
    assert isinstance(after_ns, int)
    return IdentityChange(before_ns, after_ns)
