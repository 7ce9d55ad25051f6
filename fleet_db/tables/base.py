"""What all tables share: names of constraints, column types, checks for enumerations."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from inspect import get_annotations
from types import NoneType
from typing import Annotated, Any, ClassVar, cast, get_args, get_origin

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    Double,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    TextClause,
)
from sqlalchemy.schema import SchemaItem

from estimation.values.reasons import Reason
from fleet_db.fields import hints_of

NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
    "pk": "pk_%(table_name)s",
}


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """What a column has beside name and nullability: type and constraints, and options of ``Column``."""

    parts: tuple[Any, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)


def column(*parts: Any, **options: Any) -> Any:  # noqa: ANN401 - those of ``Column``; it stands for a value of its type
    """Return what a column has that its annotation does not say."""
    return Described(parts, options)


# SQLite numbers rows by itself only in a column declared INTEGER, which there is 64 bits wide as well.
Serial = Annotated[int, column(BigInteger().with_variant(Integer(), "sqlite"), primary_key=True)]
Code = Annotated[str, column(String(64))]  # also a digest
Name = Annotated[str, column(Text)]
Count = Annotated[int, column(BigInteger)]
Nanoseconds = Annotated[int, column(BigInteger)]
Real = Annotated[float, column(Double)]
Packed = Annotated[bytes, column(LargeBinary)]
# The JSON type keeps the text as written (jsonb would reorder keys and rewrite numbers).
Json = Annotated[Any, column(JSON)]
PLAIN = {int: Integer, bool: Boolean}
OF_FIELDS: Mapping[Any, Any] = {str: Text, int: BigInteger, float: Double, bool: Boolean}
"""Types of columns that are fields of a value; what is none of these is JSON."""


class Base:
    """Root of all tables: of each with its name, and whether SQLite is to use no number of a row twice.

    An annotation is a column. A mapper of SQLAlchemy would map rows to objects that nothing here needs, at every start.
    Where ``of`` names the class whose values the rows hold, each of its fields but those in ``without`` is a column,
    and only one of another type or with a key is annotated.
    """

    metadata: ClassVar[MetaData] = MetaData(naming_convention=NAMING)
    table: ClassVar[Table]
    constraints: ClassVar[tuple[SchemaItem, ...]] = ()

    def __init_subclass__(
        cls, *, table: str, numbered: bool = False, of: type | None = None, without: Iterable[str] = ()
    ) -> None:
        annotated = get_annotations(cls)
        fields = {} if of is None else dict(hints_of(cast("Hashable", of)))
        items: list[SchemaItem] = []
        for name, hint in (fields | annotated).items():
            if name in annotated:
                items.append(_column(cls, name, hint))
            elif name not in without:
                items += _columns_of_field(name, hint)
        cls.table = Table(table, Base.metadata, *items, *cls.constraints, sqlite_autoincrement=numbered)


def _columns_of_field(name: str, hint: Any) -> Iterator[SchemaItem]:  # noqa: ANN401 - a type
    nullable = NoneType in get_args(hint)
    kind = next(part for part in get_args(hint) if part is not NoneType) if nullable else hint
    if kind is Reason:
        yield Column("reason", Text, nullable=False)
        yield Column("reason_code", String(64), nullable=True)
    elif isinstance(kind, type) and issubclass(kind, Enum):
        yield Column(name, String(16), nullable=nullable)
        yield one_of(name, (str(member.value) for member in kind))
    else:
        yield Column(name, OF_FIELDS.get(get_origin(kind) or kind, JSON), nullable=nullable)


def _column(row: type[Base], name: str, annotation: Any) -> Column[Any]:  # noqa: ANN401 - a type
    nullable = NoneType in get_args(annotation)
    kind = get_args(annotation)[0] if nullable else annotation
    (shared,) = getattr(kind, "__metadata__", [Described()])
    described = row.__dict__.get(name, Described())
    parts = (*shared.parts, *described.parts) or [PLAIN[kind]]
    return Column(name, *parts, **{"nullable": nullable, **shared.options, **described.options})


def one_of(column: str, values: Iterable[str]) -> CheckConstraint:
    """Return the constraint that ``column`` holds one of ``values``."""
    listed = ", ".join("'" + value.replace("'", "''") + "'" for value in values)
    return CheckConstraint(f"{column} IN ({listed})", name=f"{column}_known")


def partial_index(name: str, *columns: str, where: TextClause, unique: bool = False) -> Index:
    """Return an index of the rows that meet a condition."""
    return Index(name, *columns, unique=unique, sqlite_where=where, postgresql_where=where)
