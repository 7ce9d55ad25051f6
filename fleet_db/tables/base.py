"""What all tables share: names of constraints, column types, checks for enumerations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from inspect import get_annotations
from types import NoneType
from typing import Annotated, Any, ClassVar, get_args

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


class Base:
    """Root of all tables: of each with its name, and whether SQLite is to use no number of a row twice.

    An annotation is a column. A mapper of SQLAlchemy would map rows to objects that nothing here needs, at every start.
    """

    metadata: ClassVar[MetaData] = MetaData(naming_convention=NAMING)
    table: ClassVar[Table]
    constraints: ClassVar[tuple[SchemaItem, ...]] = ()

    def __init_subclass__(cls, *, table: str, numbered: bool = False) -> None:
        columns = [_column(cls, name, annotation) for name, annotation in get_annotations(cls).items()]
        cls.table = Table(table, Base.metadata, *columns, *cls.constraints, sqlite_autoincrement=numbered)


def _column(row: type[Base], name: str, annotation: Any) -> Column[Any]:  # noqa: ANN401 - a type
    nullable = NoneType in get_args(annotation)
    kind = get_args(annotation)[0] if nullable else annotation
    (shared,) = getattr(kind, "__metadata__", [Described()])
    own = row.__dict__.get(name, Described())
    parts = (*shared.parts, *own.parts) or [PLAIN[kind]]
    return Column(name, *parts, **{"nullable": nullable, **shared.options, **own.options})


def one_of(column: str, values: Iterable[str]) -> CheckConstraint:
    """Return the constraint that ``column`` holds one of ``values``."""
    listed = ", ".join("'" + value.replace("'", "''") + "'" for value in values)
    return CheckConstraint(f"{column} IN ({listed})", name=f"{column}_known")


def partial_index(name: str, *columns: str, where: TextClause, unique: bool = False) -> Index:
    """Return an index of the rows that meet a condition."""
    return Index(name, *columns, unique=unique, sqlite_where=where, postgresql_where=where)
