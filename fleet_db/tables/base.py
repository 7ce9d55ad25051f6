"""What all tables share: names of constraints, column types, checks for enumerations."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, ClassVar

from sqlalchemy import (
    JSON,
    BigInteger,
    CheckConstraint,
    Double,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Text,
    TextClause,
)
from sqlalchemy.orm import DeclarativeBase, mapped_column

NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
    "pk": "pk_%(table_name)s",
}

# SQLite numbers rows by itself only in a column declared INTEGER, which there is 64 bits wide as well.
Serial = Annotated[int, mapped_column(BigInteger().with_variant(Integer(), "sqlite"), primary_key=True)]
Code = Annotated[str, mapped_column(String(64))]  # also a digest
Name = Annotated[str, mapped_column(Text)]
Count = Annotated[int, mapped_column(BigInteger)]
Nanoseconds = Annotated[int, mapped_column(BigInteger)]
Real = Annotated[float, mapped_column(Double)]
Packed = Annotated[bytes, mapped_column(LargeBinary)]
# The JSON type keeps the text as written (jsonb would reorder keys and rewrite numbers).
Json = Annotated[Any, mapped_column(JSON)]


class Base(DeclarativeBase):
    """Root of all tables: of each with its name, and whether SQLite is to use no number of a row twice."""

    metadata: ClassVar[MetaData] = MetaData(naming_convention=NAMING)

    def __init_subclass__(cls, *, table: str, numbered: bool = False) -> None:
        cls.__tablename__ = table
        cls.__table_args__ = (*cls.__dict__.get("__table_args__", ()), {"sqlite_autoincrement": numbered})
        super().__init_subclass__()


def one_of(column: str, values: Iterable[str]) -> CheckConstraint:
    """Return the constraint that ``column`` holds one of ``values``."""
    listed = ", ".join("'" + value.replace("'", "''") + "'" for value in values)
    return CheckConstraint(f"{column} IN ({listed})", name=f"{column}_known")


def partial_index(name: str, *columns: str, where: TextClause, unique: bool = False) -> Index:
    """Return an index of the rows that meet a condition."""
    return Index(name, *columns, unique=unique, sqlite_where=where, postgresql_where=where)
