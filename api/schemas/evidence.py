"""What led to an alert, typed by its kind: models and readers are derived from the evidence of its rule.

A property is null where it does not apply, is not known, or was not stored. An alert is answered for good: nothing here
raises, whatever is stored.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import partial, reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args, get_origin

from pydantic import BaseModel, create_model
from pydantic import Field as Described

from api.schemas.common import MODELS, Derived, Href, Representation, Uncertain, fields_of
from api.schemas.trend import DateForecast, DistanceForecast, forecast_of
from api.times import Timestamp, to_rfc3339
from estimation.alerts.decision import DELAYS
from estimation.alerts.life_cycle import Delays
from estimation.alerts.rule_book import ALERT_RULES, FleetAlertEvidence
from estimation.alerts.rules import running_gear
from estimation.values.alerts import Alert, AlertScope
from estimation.values.fields import JsonValue
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import SECOND_NS

SAFE = 2**53  # beyond it a reader of JSON may round an integer
Stored = Mapping[str, JsonValue]
Read = Callable[[JsonValue], Any]


def _number(value: JsonValue) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def _count(value: JsonValue) -> int | None:
    number = _number(value)
    return None if number is None or abs(number) >= SAFE else int(number)


def _moment(value: JsonValue) -> str | None:
    if isinstance(value, float):
        value = round(value / SECOND_NS) * SECOND_NS if math.isfinite(value) else None
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 2**63:
        return None
    return to_rfc3339(value)


def _part(value: JsonValue) -> Stored:
    return value if isinstance(value, Mapping) else {}


def _one_of(members: Sequence[Any], value: JsonValue) -> Any:  # noqa: ANN401 - of the members' type
    return next((member for member in members if member == value), None)


def _listed(read: Read, value: JsonValue) -> list[Any]:
    items = value if isinstance(value, list) else []
    return [item for item in map(read, items) if item is not None]


def _counts(value: JsonValue) -> dict[str, int]:
    return {name: n for name, item in _part(value).items() if (n := _count(item)) is not None}


def _estimate(value: JsonValue) -> Uncertain | None:
    if not isinstance(value, Mapping):
        return None
    ends = [_number(end) for end in _listed(lambda end: end, value.get("interval_95"))]
    low, high = ends if len(ends) == 2 else (None, None)  # noqa: PLR2004 - an interval has two ends
    return Uncertain(
        value=_number(value.get("value")),
        std=_number(value.get("std")),
        interval_95=None if low is None or high is None else (low, high),
        n_windows=_number(value.get("n_windows")) or 0.0,
        status=_one_of(list(Status), value.get("status")) or Status.INVALID,
        reason=_text(value.get("reason")),
        reason_code=_one_of(list(ReasonCode), value.get("reason_code")),
    )


def _text(value: JsonValue) -> str | None:
    return value if isinstance(value, str) else None


_SIMPLE: Mapping[object, tuple[Any, Read]] = {
    Estimate: (Uncertain, _estimate),
    float: (float, _number),
    int: (int, _count),
    str: (str, _text),
    bool: (bool, lambda value: value if isinstance(value, bool) else None),
}


def _served(hint: Any, key: str) -> tuple[Any, Read]:  # noqa: ANN401 - a type
    """Return the type that a field is served as, and what reads it; None where another thing is stored."""
    origin, parts = get_origin(hint), get_args(hint)
    served: tuple[Any, Read]
    if hint is Forecast and key.endswith("_ns"):
        served = DateForecast, lambda value: forecast_of(DateForecast, _moment, _part(value), None)
    elif hint is Forecast:
        served = DistanceForecast, lambda value: forecast_of(DistanceForecast, _number, _part(value), None)
    elif key.endswith("_ns"):
        served = Timestamp, _moment
    elif origin is tuple:
        kind, read = _served(parts[0], key)
        served = list[kind], partial(_listed, read)  # type: ignore[valid-type]  # a type all the same
    elif origin is Literal:
        served = hint, partial(_one_of, parts)
    elif origin is not None:
        served = dict[str, int], _counts
    elif is_dataclass(hint) and hint is not Estimate:
        shape = Shape.of(cast("type", hint), nested=True)
        served = shape.model, shape.read
    else:
        served = _SIMPLE[hint] if hint in _SIMPLE else (hint, partial(_one_of, list(hint)))
    return served


class Stretch(Derived, of=running_gear.Stretch):
    """A stretch of a track section."""


@dataclass(frozen=True, slots=True)
class Shape:
    """How a described class is served: its model, what reads each field under which key, and what must be stored."""

    model: type[BaseModel]
    readers: Mapping[str, tuple[str, Read]]
    required: frozenset[str]

    @staticmethod
    def of(described: type, *, nested: bool = False, **more: Any) -> Shape:  # noqa: ANN401 - fields of the model
        """Return the shape of a class; a nested one is there with its fields, or it is not."""
        types: dict[str, Any] = {}
        readers: dict[str, tuple[str, Read]] = {}
        required = set()
        defaults = {field.name: field.default for field in fields(cast("Any", described))}
        for field in fields_of(described):
            if field.hint is Reason:
                types |= {"unknown_because": (str | None, field.words), "unknown_because_code": _CODE}
                readers |= {"unknown_because": ("unknown_because", _text)}
                readers |= {"unknown_because_code": ("unknown_because_code", partial(_one_of, list(ReasonCode)))}
                continue
            kind, read = _served(field.hint, field.key)
            is_there = get_origin(kind) in {list, dict} or field.hint is Forecast
            has_default = defaults[field.key] is not MISSING and not field.nullable
            if nested and not field.nullable:
                required.add(field.name)
            if has_default and not is_there:
                read = partial(_or_default, read, defaults[field.key])
            is_never_null = is_there or has_default or field.name in required
            types[field.name] = (kind if is_never_null else kind | None, field.words)
            readers[field.name] = field.key, read
        doc = (described.__doc__ or "").split("\n", maxsplit=1)[0]
        made = partial(create_model, described.__name__, __base__=Representation, __doc__=doc)
        model = MODELS[described] if described in MODELS else made(**more, **types)
        return Shape(model, readers, frozenset(required))

    def read(self, value: JsonValue, **more: Any) -> BaseModel | None:  # noqa: ANN401 - fields of the model
        """Return what is stored; None where something required is missing."""
        stored = _part(value)
        values = {name: read(stored.get(key)) for name, (key, read) in self.readers.items()}
        if any(values[name] is None for name in self.required):
            return None
        because, code = values.get("unknown_because"), values.get("unknown_because_code")
        if because is not None and code is not None:
            # a forecast that is not known has the reason of its rule
            because_of_rule = {"reason": because, "reason_code": code}
            for name, item in values.items():
                if isinstance(item, DateForecast | DistanceForecast) and item.reason is not None:
                    values[name] = item.model_copy(update=because_of_rule)
        return self.model(**values, **more)


_CODE = (ReasonCode | None, Described(description="The same as a code."))


def _or_default(read: Read, default: object, value: JsonValue) -> object:
    item = read(value)
    return default if item is None else item


_DELAYS = Shape.of(Delays)


def _shape(kind: str, described: type, **more: Any) -> Shape:  # noqa: ANN401 - fields of the model
    delays = (_DELAYS.model | None, Described(description="The delays that it was raised with."))
    return Shape.of(described, kind=(Literal[kind], ...), delays=delays, **more)


_MEMBERS = (Href, Described(description="Where all of its members are listed."))
_SHAPES = {rule.kind: _shape(rule.kind, rule.evidence) for rule in ALERT_RULES if rule.evidence is not None}
_FLEET = _shape("fleet_alert", FleetAlertEvidence, members=_MEMBERS)


class OtherEvidence(Representation):
    """Evidence of a kind of its own: of a rule that has no class of evidence, or is gone."""

    kind: Literal["other"]
    numbers: dict[str, float | None] = Described(
        description="Numbers, each under its name; nested names are joined by a point."
    )
    texts: dict[str, str] = Described(description="Words, each under its name.")
    times: dict[str, Timestamp] = Described(description="Times, each under its name.")
    delays: _DELAYS.model | None = Described(description="The delays that it was raised with.")  # type: ignore[name-defined]  # made above


if TYPE_CHECKING:
    AnyEvidence = BaseModel
else:
    AnyEvidence = Annotated[
        reduce(or_, (shape.model for shape in [*_SHAPES.values(), _FLEET]), OtherEvidence),
        Described(discriminator="kind"),
    ]


def evidence_of(alert: Alert) -> BaseModel:
    """Return the evidence of an alert."""
    stored = alert.evidence
    delays = _DELAYS.read(stored[DELAYS]) if _part(stored.get(DELAYS)) else None
    if alert.scope is AlertScope.FLEET:
        members = f"/v1/alerts?fleet_alert={alert.alert_id}"
        return _found(_FLEET.read(dict(stored), kind="fleet_alert", delays=delays, members=members))
    if alert.kind in _SHAPES:
        return _found(_SHAPES[alert.kind].read(dict(stored), kind=alert.kind, delays=delays))
    return _other(stored, delays)


def _found(evidence: BaseModel | None) -> BaseModel:
    assert evidence is not None  # nothing is required of it
    return evidence


def _other(stored: Stored, delays: BaseModel | None) -> OtherEvidence:
    numbers: dict[str, float | None] = {}
    texts: dict[str, str] = {}
    times: dict[str, str] = {}
    for name, value in _leaves({key: value for key, value in stored.items() if key != DELAYS}):
        moment = _moment(value) if name.endswith("_ns") else None
        if moment is not None:
            times[f"{name.removesuffix('_ns')}_at"] = moment
        elif isinstance(value, (bool, str)):
            texts[name] = str(value)
        elif not name.endswith("_ns"):
            numbers[name] = _number(value)
    return OtherEvidence(kind="other", numbers=numbers, texts=texts, times=times, delays=delays)


def _leaves(value: JsonValue, name: str = "") -> Iterator[tuple[str, JsonValue]]:
    if isinstance(value, Mapping):
        inner = [(str(key), item) for key, item in value.items()]
    elif isinstance(value, list):
        inner = [(str(index), item) for index, item in enumerate(value)]
    else:
        yield name, value
        return
    for key, item in inner:
        yield from _leaves(item, f"{name}.{key}" if name else key)
