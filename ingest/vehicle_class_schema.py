"""Schema of a vehicle class, in the units of its file: an entry of its own file and of a registry file.

Every parameter is a number, or a table ``{ value = , std = }`` with its standard deviation in the same unit. Without
one, that of its kind holds (``default_relative_std``). The text beside the type of a key is the field of
``VehicleParameters`` or ``BogieParameters`` that it becomes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from decimal import Decimal
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from estimation.errors import InputError, NotFoundError, ParameterError
from estimation.values.fields import JsonValue
from estimation.values.units import GRAVITY, STEEL_POISSON_RATIO, STEEL_SHEAR_MODULUS
from estimation.vehicle.plausibility import check_plausible
from estimation.vehicle.vehicle_class import (
    Arrangement,
    BogieParameters,
    VehicleClass,
    VehicleParameters,
    default_relative_std,
)
from ingest.input_file import Code, InputFile, InputTable, NotNegative, Text, field_error, read_toml, refusing
from ingest.vehicle_sensor_schema import SensorsTable

WHEELS_OF_AN_AXLE = 2
LEAST, LARGEST = 1e-12, 1e12
"""Magnitudes in any unit: beyond them is no number of a vehicle, and squares and quotients overflow."""


_IMPOSSIBLE = refusing(
    lambda value: value and not LEAST <= abs(value) <= LARGEST, "{value:g} is no number of a vehicle"
)
_Number = Annotated[float, _IMPOSSIBLE]


class UncertainNumber(InputTable):
    """A number with its standard deviation in the same unit; None: that of its kind."""

    value: _Number
    std: NotNegative | None = None

    @model_validator(mode="after")
    def _check_std(self) -> Self:
        if self.std and self.value == 0.0:
            raise field_error("the standard deviation of a value of 0 cannot be used", "std")
        if self.std and self.std > abs(self.value):
            raise field_error(f"{self.std:g} is more than the value itself; it has the unit of the value", "std")
        return self

    @property
    def relative_std(self) -> float | None:
        """Standard deviation over magnitude; None where it is not on file."""
        return None if self.std is None else self.std / abs(self.value) if self.std else 0.0


class _PositiveNumber(UncertainNumber):
    value: Annotated[_Number, Field(gt=0.0)]


class _WheelLength(UncertainNumber):
    value: Annotated[float, Field(ge=100.0, le=1500.0)]  # mm


class _NotNegativeNumber(UncertainNumber):
    value: Annotated[_Number, Field(ge=0.0)]


def _with_key(value: object) -> object:
    """Return a plain number as the table that it abbreviates; what is neither is no number."""
    return value if isinstance(value, (Mapping, UncertainNumber)) else {"value": value}


AnyUncertain = Annotated[UncertainNumber, BeforeValidator(_with_key)]
PositiveUncertain = Annotated[_PositiveNumber, BeforeValidator(_with_key)]
NotNegativeUncertain = Annotated[_NotNegativeNumber, BeforeValidator(_with_key)]
WheelLength = Annotated[_WheelLength, BeforeValidator(_with_key)]


def _zero() -> _NotNegativeNumber:
    return _NotNegativeNumber(value=0.0)


class WheelsetTable(InputTable):
    """``wheelset``: one wheelset and what it carries."""

    mass_kg: Annotated[PositiveUncertain, "wheelset_mass"]
    yaw_inertia_kg_m2: Annotated[PositiveUncertain, "yaw_inertia"]
    pitch_inertia_kg_m2: Annotated[PositiveUncertain, "pitch_inertia"]
    nominal_radius_mm: Annotated[WheelLength, "nominal_radius"]
    half_contact_distance_mm: Annotated[WheelLength, "half_contact_distance"]
    suspended_mass_kg: Annotated[PositiveUncertain | None, "suspended_mass"] = None  # what it carries laterally
    axle_load_n: Annotated[PositiveUncertain | None, "load"] = None  # by default (wheelset + suspended mass) g


class PrimaryTable(InputTable):
    """``primary_suspension``: between one wheelset and the frame or mass, both axle boxes together."""

    lateral_stiffness_n_m: Annotated[PositiveUncertain, "lateral_stiffness"]
    lateral_damping_n_s_m: Annotated[NotNegativeUncertain, "lateral_damping"]
    yaw_stiffness_n_m_rad: Annotated[PositiveUncertain, "yaw_stiffness"]
    yaw_damping_n_m_s_rad: Annotated[NotNegativeUncertain, "yaw_damping"] = Field(default_factory=_zero)


class CreepTable(InputTable):
    """``creep``: the coefficients of one wheel as numbers, or what Kalker's follow from."""

    source: Literal["given", "kalker"] = Field(alias="from")
    longitudinal_n: Annotated[PositiveUncertain | None, "longitudinal_creep_coefficient"] = None
    lateral_n: Annotated[PositiveUncertain | None, "lateral_creep_coefficient"] = None
    lateral_spin_n_m: Annotated[NotNegativeUncertain | None, "lateral_spin_creep_coefficient"] = None
    spin_n_m2: Annotated[NotNegativeUncertain | None, "spin_creep_coefficient"] = None
    rail_head_radius_mm: PositiveUncertain | None = None
    wheel_transverse_radius_mm: AnyUncertain | None = None  # by default a straight cone; hollow is negative
    wheel_rolling_radius_mm: PositiveUncertain | None = None  # by default the nominal radius
    shear_modulus_pa: Annotated[float, Field(ge=1e10, le=1e12)] | None = None
    poisson_ratio: Annotated[float, Field(ge=0.0, lt=0.5)] | None = None
    relative_std: Annotated[float, Field(ge=0.0, le=1.0)] | None = None  # of all, beside what radii and load leave open

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        given = ("longitudinal_n", "lateral_n", "lateral_spin_n_m", "spin_n_m2")
        required = given[:3] if self.source == "given" else ("rail_head_radius_mm",)
        for name in required:
            if getattr(self, name) is None:
                raise field_error(f"is missing with from = {self.source!r}", name)
        for name in self.model_fields_set - {"source"}:
            if (name in given) != (self.source == "given"):
                raise field_error(f"has no effect with from = {self.source!r}", name)
        return self


class BogieTable(InputTable):
    """``bogie``: the frame and what it carries."""

    wheelbase_m: Annotated[PositiveUncertain, "wheelbase"]
    frame_mass_kg: Annotated[PositiveUncertain, "frame_mass"]
    frame_yaw_inertia_kg_m2: Annotated[PositiveUncertain, "frame_yaw_inertia"]
    body_mass_kg: Annotated[PositiveUncertain, "body_mass"]  # of the body that rests on one bogie


class SecondaryTable(InputTable):
    """``secondary_suspension``: between one bogie and the body."""

    lateral_stiffness_n_m: Annotated[NotNegativeUncertain, "secondary_lateral_stiffness"] = Field(default_factory=_zero)
    lateral_damping_n_s_m: Annotated[NotNegativeUncertain, "secondary_lateral_damping"] = Field(default_factory=_zero)
    yaw_stiffness_n_m_rad: Annotated[NotNegativeUncertain, "secondary_yaw_stiffness"] = Field(default_factory=_zero)
    yaw_damping_n_m_s_rad: Annotated[NotNegativeUncertain, "secondary_yaw_damping"] = Field(default_factory=_zero)


class VehicleClassEntry(InputTable):
    """A vehicle class; an entry of ``vehicle_classes`` of a registry file."""

    code: Code
    name: Text
    source: Text  # where the numbers come from
    arrangement: Literal["single_wheelset", "bogie"]
    wheelset: WheelsetTable
    primary_suspension: PrimaryTable
    creep: CreepTable
    bogie: BogieTable | None = None
    secondary_suspension: SecondaryTable | None = None
    sensors: SensorsTable

    @model_validator(mode="after")
    def _check_arrangement(self) -> Self:
        if self.arrangement == "bogie" and self.bogie is None:
            raise field_error("is missing with arrangement = 'bogie'", "bogie")
        for name in ("bogie", "secondary_suspension"):
            if self.arrangement == "single_wheelset" and getattr(self, name) is not None:
                raise field_error("has no effect with arrangement = 'single_wheelset'", name)
        if self.bogie is None and self.wheelset.suspended_mass_kg is None:
            raise field_error("is missing with arrangement = 'single_wheelset'", "wheelset", "suspended_mass_kg")
        place = "frame" if self.bogie else "mass"
        sensor = self.sensors.mass_lateral
        if sensor is not None and sensor.place != place:
            raise field_error(f"must be {place!r} with this arrangement", "sensors", "mass_lateral", "place")
        try:
            check_plausible(self.record())
        except ParameterError as error:
            raise field_error(error.reason, *_LOCATIONS.get(error.field or "", ())) from error
        return self

    def record(self) -> VehicleClass:
        """Return the class in SI units, its creep coefficients computed where they are not given."""
        derived = {"suspended_mass": self._suspended_mass(), "load": self._axle_load()}
        of_wheelset = {"wheelset": self.wheelset, "primary_suspension": self.primary_suspension}
        creep = self._kalker() if self.creep.source == "kalker" else _numbers({"creep": self.creep})
        numbers = {**derived, **_numbers(of_wheelset, but=derived), **creep}
        of_bogie = {"bogie": self.bogie, "secondary_suspension": self.secondary_suspension or SecondaryTable()}
        bogie_numbers = {} if self.bogie is None else _numbers(of_bogie)
        return VehicleClass(
            code=self.code,
            name=self.name,
            source=self.source,
            arrangement=Arrangement(self.arrangement),
            parameters=VehicleParameters(**{name: value for name, (value, _) in numbers.items()}),
            bogie=None
            if self.bogie is None
            else BogieParameters(**{name: v for name, (v, _) in bogie_numbers.items()}),
            sensors=self.sensors.layout(),
            relative_std={
                name: std for name, (_, std) in (numbers | bogie_numbers).items() if std != default_relative_std(name)
            },
        )

    def _suspended_mass(self) -> tuple[float, float]:
        """Return what one wheelset carries, kg, and its relative std: half of frame and body, if it is not on file."""
        if self.wheelset.suspended_mass_kg is not None or self.bogie is None:
            assert self.wheelset.suspended_mass_kg is not None
            return _number("suspended_mass", self.wheelset.suspended_mass_kg, "suspended_mass_kg")
        parts = (
            _number("frame_mass", self.bogie.frame_mass_kg, "frame_mass_kg"),
            _number("body_mass", self.bogie.body_mass_kg, "body_mass_kg"),
        )
        total = sum(value for value, _ in parts)
        return total / 2.0, math.hypot(*(value * std for value, std in parts)) / total

    def _axle_load(self) -> tuple[float, float]:
        if self.wheelset.axle_load_n is not None:
            return _number("load", self.wheelset.axle_load_n, "axle_load_n")
        suspended, std = self._suspended_mass()
        own, own_std = _number("wheelset_mass", self.wheelset.mass_kg, "mass_kg")
        return (own + suspended) * GRAVITY, math.hypot(own * own_std, suspended * std) / (own + suspended)

    def _kalker(self) -> dict[str, tuple[float, float]]:
        """Return value and relative std of Kalker's coefficients by field of ``VehicleParameters``."""
        from estimation.vehicle import kalker  # noqa: PLC0415 - only classes described by radii wait for scipy

        creep = self.creep
        assert creep.rail_head_radius_mm is not None
        load, load_std = self._axle_load()
        rolling_radius = creep.wheel_rolling_radius_mm or self.wheelset.nominal_radius_mm
        rolling, rolling_std = _number("nominal_radius", rolling_radius, "nominal_radius_mm")
        across = creep.wheel_transverse_radius_mm
        try:
            radii = kalker.ContactRadii(
                wheel_rolling_radius=rolling,
                rail_head_radius=_metres(creep.rail_head_radius_mm.value),
                wheel_load=load / WHEELS_OF_AN_AXLE,
                wheel_transverse_radius=math.inf if across is None else _metres(across.value),
                shear_modulus=creep.shear_modulus_pa or STEEL_SHEAR_MODULUS,
                poisson_ratio=STEEL_POISSON_RATIO if creep.poisson_ratio is None else creep.poisson_ratio,
            )
            values = kalker.creep_coefficients(radii)
        except ParameterError as error:
            raise field_error(error.reason, "creep", "rail_head_radius_mm") from error
        radii_std = kalker.ContactRadiiStd(
            wheel_rolling_radius=rolling_std,
            rail_head_radius=creep.rail_head_radius_mm.relative_std or 0.0,
            wheel_load=load_std,
            wheel_transverse_radius=(across.relative_std or 0.0) if across else 0.0,
        )
        rail_std = kalker.RAIL_CONDITION_STD if creep.relative_std is None else creep.relative_std
        std = kalker.creep_coefficient_std(radii, radii_std, rail_std)
        return {f"{name}_creep_coefficient": (getattr(values, name), getattr(std, name)) for name in _CREEP}


_CREEP = ("longitudinal", "lateral", "lateral_spin", "spin")
_TABLES: Mapping[str, type[InputTable]] = {
    "wheelset": WheelsetTable,
    "primary_suspension": PrimaryTable,
    "creep": CreepTable,
    "bogie": BogieTable,
    "secondary_suspension": SecondaryTable,
}
_LOCATIONS: Mapping[str, tuple[str, str]] = {  # table and key of a field of VehicleParameters or BogieParameters
    field: (table, key)
    for table, model in _TABLES.items()
    for key, info in model.model_fields.items()
    for field in info.metadata
    if isinstance(field, str)
}


def class_tables(*values: VehicleParameters | BogieParameters | None) -> dict[str, dict[str, JsonValue]]:
    """Return parameters as the tables of a class file have them."""
    tables: dict[str, dict[str, JsonValue]] = {}
    for field, (table, key) in _LOCATIONS.items():
        for one in values:
            if hasattr(one, field):
                value = getattr(one, field)
                tables.setdefault(table, {})[key] = round(1e3 * value, 6) if key.endswith("_mm") else value
    return tables


def _numbers(tables: Mapping[str, InputTable | None], but: Collection[str] = ()) -> dict[str, tuple[float, float]]:
    """Return value and relative std by field of the parameters that are in some tables."""
    return {
        field: _number(field, getattr(tables[table], key) or _zero(), key)
        for field, (table, key) in _LOCATIONS.items()
        if table in tables and field not in but
    }


def _number(field: str, number: UncertainNumber, key: str) -> tuple[float, float]:
    """Return value in SI and relative std of the number at ``key``; ``field`` names the default std."""
    relative = number.relative_std
    value = _metres(number.value) if key.endswith("_mm") else number.value
    return value, default_relative_std(field) if relative is None else relative


def _metres(millimetres: float) -> float:
    """Return the number nearest to the decimal one in m: 745.2 mm is 0.7452 m, not 0.7452000000000001 m."""
    return float(Decimal(repr(millimetres)).scaleb(-3))


FORMAT = "treadwatch-vehicle-class-1"
_SHIPPED = resources.files(__package__) / "vehicle_classes"


class VehicleClassFile(VehicleClassEntry):
    """The whole file."""

    format: Literal["treadwatch-vehicle-class-1"]


def read_vehicle_class(path: Path, error_type: type[InputError] = InputError) -> VehicleClass:
    """Return the class of a file."""
    return parse_vehicle_class(read_toml(path, error_type))


def parse_vehicle_class(file: InputFile) -> VehicleClass:
    """Return the class of a file that was read."""
    return file.parse(VehicleClassFile).record()


def shipped_classes() -> tuple[str, ...]:
    """Return the codes of the classes that the package ships, sorted."""
    return tuple(sorted(item.name.removesuffix(".toml") for item in _SHIPPED.iterdir() if item.name.endswith(".toml")))


def shipped_path(code: str) -> Path:
    """Return the file of a class that the package ships."""
    if code not in shipped_classes():
        raise NotFoundError("shipped vehicle class", code)
    return Path(str(_SHIPPED / f"{code}.toml"))


@cache
def class_of_package(code: str) -> VehicleClass | None:
    """Return a class that the package ships; None where it ships none of this code."""
    return shipped_class(code) if code in shipped_classes() else None


def shipped_class(code: str) -> VehicleClass:
    """Return a class that the package ships."""
    return read_vehicle_class(shipped_path(code))
