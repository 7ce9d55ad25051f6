"""What is assumed of each wheelset on each vehicle: the class on file, with the wheelset's own nominal radius."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field

from estimation.jobs.settings import EstimationSettings
from estimation.motion.integration import WindowParameters
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import bin_parameters
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, VehicleRecord, WheelsetRecord
from estimation.vehicle.vehicle_class import ClassOnFile


@dataclass(frozen=True, slots=True)
class Assumed:
    """What a window is estimated with.

    Attributes:
        on_file: Class of the vehicle.
        windows: What turns the window into motion.
        table_key: Of the bin tables that follow.
        digest: Of all that a result rests on, standard deviations included.
    """

    on_file: ClassOnFile
    windows: WindowParameters
    table_key: str
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", f"{self.table_key} {self.on_file.digest}")


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
        """Look up several wheelsets, and the classes of vehicles, together.

        Args:
            serials, vehicles: Those that are not on file are looked up again when they are asked for.
        """
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
        return Assumed(on_file, windows, bin_parameters(windows).key)


def class_unknown(code: str) -> Reason:
    """Return the reason why windows of a vehicle wait whose class is not on file."""
    return Reason(ReasonCode.CLASS_UNKNOWN, f"class {code!r} of the vehicle is not on file")


LATEST_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class VehicleLookup:
    """Looks up vehicles and mountings.

    Attributes:
        unit: Vehicles and mountings are read.
    """

    unit: UnitOfWork
    _vehicles: dict[str, VehicleRecord] = field(default_factory=dict)
    _mountings: dict[str, Sequence[Mounting]] = field(default_factory=dict)

    def vehicle(self, code: str) -> VehicleRecord:
        """Return a vehicle.

        Raises:
            NotFoundError: There is none of that code.
        """
        if code not in self._vehicles:
            self._vehicles[code] = self.unit.registry.vehicle(code)
        return self._vehicles[code]

    def with_mountings(self, vehicles: Iterable[str]) -> VehicleLookup:
        """Return the lookup with all mountings on some vehicles, to go on with in another transaction."""
        self._mountings.update({code: self.unit.registry.mountings_on(code, 0, LATEST_NS) for code in vehicles})
        return self

    def mounting_at(self, vehicle: str, axle: int, at_ns: int) -> Mounting | None:
        """Return which wheelset ran at an axle at a time; None where there was none.

        Args:
            vehicle, axle: Code, and the axle from 1.
            at_ns: ns UTC on the vehicle's clock.
        """
        if vehicle not in self._mountings:
            self._mountings[vehicle] = self.unit.registry.mountings_on(vehicle, 0, LATEST_NS)
        for one in self._mountings[vehicle]:
            if one.axle == axle and one.from_ns <= at_ns and (one.to_ns is None or at_ns < one.to_ns):
                return one
        return None
