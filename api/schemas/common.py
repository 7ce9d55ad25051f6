"""What every representation is made of: numbers with their uncertainty, links, pages, and assets of the registry."""

from __future__ import annotations

import inspect
import math
import re
import types
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar, Union, cast, get_args, get_origin, get_type_hints
from urllib.parse import quote

import numpy as np
import pydantic
from pydantic import BaseModel, ConfigDict, Field

from api.times import Timestamp, times_to_rfc3339, to_rfc3339
from estimation.contact.profiles import MeasuredProfiles
from estimation.values.arrays import FloatArray
from estimation.values.fields import Served
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.registry import SPEED_IN_FILES, FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from estimation.values.runs import AnyResult

NOT_FINITE = Reason(ReasonCode.NOT_FINITE, "the calculation gave no finite number")
ItemT = TypeVar("ItemT")
Href = Annotated[str, Field(examples=["/v1/wheelsets/WS-0001"])]
Links = Annotated[dict[str, Href], Field(description="Paths of related resources, by relation.")]


class Representation(BaseModel):
    """A value that goes out; fields are never added at run time."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)


class Body(BaseModel):
    """A body that comes in; unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Page(Representation, Generic[ItemT]):
    """One page of a list; ``next_cursor`` and ``next`` are null on the last."""

    items: list[ItemT]
    next_cursor: str | None = Field(description="Hand it back as `cursor`, with the same filter.")
    next: str | None = Field(description="The path of the next page; the same as Link rel=next.")


_CONICITY: dict[str, pydantic.JsonValue] = {
    "value": 0.182,
    "std": 0.006,
    "interval_95": [0.17, 0.194],
    "n_windows": 12.0,
}
_CONICITY |= {"status": "estimated", "reason": None, "reason_code": None}


class Uncertain(Representation):
    """A number with its uncertainty; null means unknown, and `reason` and `reason_code` explain why."""

    value: float | None = Field(description="The value; null means unknown.")
    std: float | None = Field(description="Standard deviation; null where the value is unknown.")
    interval_95: tuple[float, float] | None = Field(description="95 % interval; null where the value is unknown.")
    n_windows: float = Field(description="Effective number of windows behind the value.")
    status: Status
    reason: str | None
    reason_code: ReasonCode | None

    model_config = ConfigDict(json_schema_extra={"examples": [_CONICITY]})


def finite(value: float | None, scale: float = 1.0) -> float | None:
    """Return ``value * scale``; None where that is no finite number, for JSON has no others."""
    if value is None:
        return None
    scaled = float(value) * scale
    return scaled if math.isfinite(scaled) else None


def finite_list(values: Sequence[float] | FloatArray, scale: float = 1.0) -> list[float | None]:
    """Return every value as :func:`finite` does."""
    with np.errstate(over="ignore"):  # beyond all floats is no finite number
        scaled = np.asarray(values, np.float64) * scale
    listed: list[float | None] = scaled.tolist()
    for place in np.flatnonzero(~np.isfinite(scaled)):
        listed[place] = None
    return listed


def why(reason: Reason | None) -> dict[str, Any]:
    """Return a reason as two fields, its sentence and its code; both null without one."""
    return {"reason": text_of(reason), "reason_code": code_of(reason)}


def uncertain(estimate: Estimate, scale: float = 1.0) -> Uncertain:
    """Return an estimate in the unit that ``scale`` turns it into; unknown where a part of it is no finite number."""
    value, std = finite(estimate.value, scale), finite(estimate.std, scale)
    low, high = finite(estimate.low, scale), finite(estimate.high, scale)
    status, reason, interval = estimate.status, estimate.reason, None
    if value is None or std is None or low is None or high is None:
        value, std, reason = None, None, reason or NOT_FINITE
        status = Status.INVALID if status is Status.ESTIMATED else status
    else:
        interval = (min(low, high), max(low, high))
    count = finite(estimate.count) or 0.0
    return Uncertain(value=value, std=std, interval_95=interval, n_windows=count, status=status, **why(reason))


_FOLDERS = re.compile(r"(?<![\w:/.])/(?:[^\s/:'\"]+/)+")


def without_folders(message: str) -> str:
    """Return a message without the folders of the machine."""
    return _FOLDERS.sub("", message)


def segment(text: str) -> str:
    """Return a key as one segment of a path."""
    return quote(text, safe="")


PLAIN = Served()
MEASURED = {"from_ns": "measured_from", "to_ns": "measured_to"}


@dataclass(frozen=True, slots=True)
class FieldOf:
    """One field or property of a value: its type without None, whether it may be None, and how it is served."""

    key: str
    hint: Any
    nullable: bool
    served: Served

    @property
    def name(self) -> str:
        """Under which it is served."""
        if self.served.name:
            return self.served.name
        if self.key in MEASURED:
            return MEASURED[self.key]
        return f"{self.key.removesuffix('_ns')}_at" if self.key.endswith("_ns") else self.key

    @property
    def words(self) -> Any:  # noqa: ANN401 - what pydantic takes for a field
        """What the document of the API says of it."""
        examples = None if self.served.example is None else [self.served.example]
        return Field(description=self.served.text or None, examples=examples)


@cache
def fields_of(kind: type) -> tuple[FieldOf, ...]:
    """Return the fields of a dataclass, in their order."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(_field_of(field.name, hints[field.name]) for field in fields(cast("Any", kind)))


def _field_of(key: str, hint: Any) -> FieldOf:  # noqa: ANN401 - a type
    served, nullable = PLAIN, False
    while get_origin(hint) in {Annotated, Union, types.UnionType}:
        if get_origin(hint) is Annotated:
            hint, *metadata = get_args(hint)
            served = next((item for item in metadata if isinstance(item, Served)), served)
        else:
            (hint,) = (part for part in get_args(hint) if part is not types.NoneType)
            nullable = True
    return FieldOf(key, hint, nullable, served)


Convert = Callable[[Any], Any] | None  # None where a value is served as it is


def served_type(field: FieldOf) -> tuple[Any, Convert]:
    """Return the type that a field is served as, and what makes it of the value; both without None."""
    hint, scale = field.hint, field.served.scale
    origin, parts = get_origin(hint), get_args(hint)
    if origin is np.ndarray:
        if field.key.endswith("_ns"):
            return list[Timestamp], times_to_rfc3339
        return list[float | None], partial(finite_list, scale=scale)
    if origin is frozenset:
        return list[parts[0]], sorted  # type: ignore[valid-type]  # as the value declares it
    if origin is tuple:
        kind, convert = served_type(_field_of("", parts[0]))
        return list[kind], list if convert is None else lambda items: [convert(item) for item in items]  # type: ignore[valid-type]  # a type all the same
    if origin is not None and issubclass(origin, Mapping):
        of = parts[1] if isinstance(parts[1], type) else pydantic.JsonValue
        return dict[parts[0], of], dict  # type: ignore[valid-type]  # as the value declares it
    return _single(hint, field)


def _single(hint: Any, field: FieldOf) -> tuple[Any, Convert]:  # noqa: ANN401 - a type
    if hint is Estimate:
        return Uncertain, partial(uncertain, scale=field.served.scale)
    if field.key.endswith("_ns") and hint is int:
        return Timestamp, to_rfc3339
    if hint is float:
        if field.nullable or not field.served.finite:
            return float, partial(finite, scale=field.served.scale)
        scale = field.served.scale
        return float, lambda number: number * scale
    if hint in MODELS:
        return MODELS[hint], MODELS[hint].made
    return hint, None


MODELS: dict[type, type[Derived]] = {}  # the model of each value that has one


def _path(template: str, value: object) -> str:
    return re.sub(r"{(\w+)}", lambda field: segment(str(getattr(value, field[1]))), template)


class Derived(Representation):
    """A representation of a value, whose own class describes its fields.

    Class arguments: ``of`` is the class of the value, ``without`` its fields that are not served, ``also`` properties,
    ``columns`` the names of the fields as the columns of a table have them, where that is not the order of the class;
    ``links`` the paths of related resources, with the names of the value's fields in braces.
    """

    paths: ClassVar[Mapping[str, str]] = {}
    makers: ClassVar[Mapping[str, tuple[str, Convert]]] = {}

    def __init_subclass__(
        cls,
        of: type | None = None,
        without: Collection[str] = (),
        also: Collection[str] = (),
        columns: str = "",
        links: Mapping[str, str] = {},
        **kwargs: Any,  # noqa: ANN401 - as pydantic takes them
    ) -> None:
        """Add the fields of the value before pydantic collects them."""
        super().__init_subclass__(**kwargs)
        if of is None:
            return
        annotated, derived, makers = inspect.get_annotations(cls), {}, dict(cls.makers)
        properties = {name: get_type_hints(getattr(of, name).fget, include_extras=True)["return"] for name in also}
        for field in (*fields_of(of), *(_field_of(name, hint) for name, hint in properties.items())):
            if field.key in without:
                continue
            kind, convert = (str, text_of) if field.hint is Reason else served_type(field)
            makers[field.name] = field.key, convert
            if field.name in annotated and hasattr(cls, field.name):
                continue
            is_nullable = field.nullable or not field.served.finite or field.hint is Reason
            derived[field.name] = kind | None if is_nullable else kind
            setattr(cls, field.name, field.words)
            if field.hint is Reason:
                derived[f"{field.name}_code"] = ReasonCode | None
                makers[f"{field.name}_code"] = field.key, code_of
                if field.name != "reason":
                    setattr(cls, f"{field.name}_code", Field(description="Its code."))
        cls.paths = links or cls.paths
        places, named = columns.split(), derived | annotated | ({"links": Links} if links else {})
        cls.__annotations__ = {name: named[name] for name in sorted(named, key=places.index)} if places else named
        cls.makers = makers
        MODELS.setdefault(of, cls)

    @classmethod
    def parts(cls, value: Any, without: Collection[str] = ()) -> dict[str, Any]:  # noqa: ANN401 - of the value's class
        """Return the fields that a value fills in."""
        filled = {}
        for name, (key, convert) in cls.makers.items():
            if name not in without:
                item = getattr(value, key)
                filled[name] = item if convert is None or item is None else convert(item)
        if cls.paths and "links" not in without:
            filled["links"] = {name: _path(template, value) for name, template in cls.paths.items()}
        return filled

    @classmethod
    def made(cls, value: Any, **more: Any) -> Self:  # noqa: ANN401 - of the value's class; fields of the model
        """Return the representation of a value, with the fields that are not its own; those win."""
        return cls(**cls.parts(value, more), **more)


def provenance(result: AnyResult) -> dict[str, Any]:
    """Return what is served of where a result comes from."""
    return {
        "code_version": result.numerics,
        "input_digest": result.made_from,
        "recorded_at": to_rfc3339(result.recorded_ns),
    }


class Fleet(
    Derived,
    of=FleetRecord,
    links={
        "self": "/v1/fleets/{code}",
        "vehicles": "/v1/vehicles?fleet={code}",
        "wheelsets": "/v1/wheelsets?fleet={code}",
        "alerts": "/v1/alerts?fleet={code}",
    },
):
    """Who operates what."""


class Vehicle(
    Derived,
    of=VehicleRecord,
    without=("max_speed_m_s",),
    links={
        "self": "/v1/vehicles/{code}",
        "fleet": "/v1/fleets/{fleet}",
        "vehicle_class": "/v1/vehicle-classes/{vehicle_class}",
        "wheelsets": "/v1/wheelsets?vehicle={code}",
        "suspension": "/v1/vehicles/{code}/suspension",
    },
):
    """A vehicle and what its alert rules depend on."""

    max_speed_km_h: float = Field(description="Highest permitted speed.", examples=[160.0])

    @classmethod
    def made(cls, value: VehicleRecord, **more: Any) -> Self:  # noqa: ANN401 - fields of the model
        """Return the representation of a vehicle, its speed to the last bit as the registry file had it."""
        return super().made(value, max_speed_km_h=SPEED_IN_FILES.write(value.max_speed_m_s), **more)


class MountingPeriod(Derived, of=Mounting):
    """Where a wheelset ran, `[mounted_from, mounted_to)`; null `mounted_to` means until now."""


class ReprofilingRecord(Derived, of=Reprofiling):
    """A visit to the lathe; every later window belongs to a new baseline."""


class MeasuredProfilesRecord(
    Derived, of=MeasuredProfiles, columns="wheelset measured_at mileage_km left right std_mm links"
):
    """A measurement of the profiles of both wheels; `left` is the wheelset's own left wheel."""

    left: str = Field(description="Name of the profile.", examples=["WS-0001-left"])
    right: str = Field(description="Name of the profile.", examples=["WS-0001-right"])
    links: Links


class Wheelset(Derived, of=WheelsetRecord):
    """A wheelset by serial: where it runs now, and its visits to the lathe."""

    serial: str
    links: Links


def measured_profiles(record: MeasuredProfiles) -> MeasuredProfilesRecord:
    """Return the representation of a measurement of both wheels."""
    path = f"/v1/wheelsets/{segment(record.wheelset)}"
    return MeasuredProfilesRecord.made(
        record,
        left=record.left.name,
        right=record.right.name,
        links={
            "wheelset": path,
            "comparison": f"{path}/measured-profiles/{segment(to_rfc3339(record.at_ns))}/comparison",
        },
    )


_OF_WHEELSET = (
    *("geometry", "trend", "contact", "windows", "mountings", "reprofilings", "measured-profiles", "intervals"),
    *("data-quality", "state", "creep-forces"),
)


def wheelset(record: WheelsetRecord) -> Wheelset:
    """Return the representation of a wheelset, with paths to everything known of it."""
    path = f"/v1/wheelsets/{segment(record.serial)}"
    links = {"self": path, "fleet": f"/v1/fleets/{segment(record.fleet)}"}
    links |= {name.replace("-", "_"): f"{path}/{name}" for name in _OF_WHEELSET}
    links["alerts"] = f"/v1/alerts?wheelset={segment(record.serial)}"
    if record.mounting is not None:
        links["vehicle"] = f"/v1/vehicles/{segment(record.mounting.vehicle)}"
    return Wheelset.made(record, links=links)
