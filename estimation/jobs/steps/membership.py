"""Which roll-up a window of a wheelset belongs to."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from estimation.jobs.steps.baselines import Baseline, baselines
from estimation.jobs.steps.trend_steps import last_change
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.storage import UnitOfWork
from estimation.values.registry import Mounting
from estimation.values.roll_up import Member, RollUp, RollUpKey, Side, TabledWindow
from estimation.values.trend import IdentityChange

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
        """Return the baseline of a time.

        Args:
            start_ns: From 0.
        """
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
        if any(m.from_ns <= at_ns and (m.to_ns is None or at_ns < m.to_ns) for m in self.turned):
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

    def _side(self, start_ns: int) -> Side | None:
        if self.change is None:
            return Side.WHOLE
        if start_ns < self.change.before_ns:
            return Side.BEFORE
        return Side.AFTER if start_ns >= self.change.after_ns else None


def membership(unit: UnitOfWork, serial: str, classes: ClassLookup) -> Membership:
    """Return the rules for the windows of a wheelset as they are now.

    Args:
        classes: Of the same transaction.
    """
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
