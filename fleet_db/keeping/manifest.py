"""What a backup holds: one small file beside it, written last, so that a backup without it never counts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sqlalchemy import Column, Connection, Integer, Table, bindparam, delete, func, insert, select, text, update

from estimation.errors import InputError
from fleet_db.atomic_files import write_atomically
from fleet_db.tables import Base

FORMAT = "treadwatch-backup-1"
PREFIX, SUFFIX = "backup-", ".json"


@dataclass(frozen=True, slots=True)
class Manifest:
    """One backup in a backup folder; recordings and windows are shared with the others of the folder."""

    name: str  # the time of the backup, which is in the names of its files
    migration: str  # of the database
    database_sha256: str
    database_bytes: int
    rows: Mapping[str, int]  # by table
    raw_files: int  # that the rows refer to
    window_files: int  # likewise
    file_bytes: int  # of what the backup is to hold
    windows_kept: bool  # whether window files are in the backup; if not, they are made again from the recordings
    missing: tuple[str, ...]  # files that the rows refer to and that were not there, or damaged
    recordings_kept: bool  # if not, their digests are in a file beside it, and their bytes in the store
    raw_store: str  # where the recordings were

    def database_file(self, folder: Path) -> Path:
        """Return where the database of this backup is."""
        return folder / f"database-{self.name}.sqlite3"


def digests_file(folder: Path, name: str) -> Path:
    """Return where the digests of the recordings are that a backup does not hold."""
    return folder / f"recordings-{name}.sha256"


def backup_name(now_ns: int) -> str:
    """Return the name of a backup of this time, in the order of time."""
    seconds, rest = divmod(now_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y%m%dT%H%M%S}.{rest // 1_000_000:03d}Z"


def write_manifest(folder: Path, manifest: Manifest) -> Path:
    """Write the manifest of a backup that is whole; return its file."""
    path = folder / f"{PREFIX}{manifest.name}{SUFFIX}"
    content = json.dumps({"format": FORMAT, **asdict(manifest)}, indent=1).encode()
    write_atomically(path, content + b"\n", durable=True)
    return path


def read_manifest(folder: Path, name: str | None = None) -> Manifest:
    """Return the manifest of a backup, of the newest where none is named; InputError: none, or a damaged one."""
    names = sorted(path.name.removeprefix(PREFIX).removesuffix(SUFFIX) for path in folder.glob(f"{PREFIX}*{SUFFIX}"))
    if not names:
        raise InputError("holds no finished backup", file=folder)
    chosen = names[-1] if name is None else name
    if chosen not in names:
        raise InputError(f"holds no backup {chosen!r}; there are {', '.join(names)}", file=folder)
    path = folder / f"{PREFIX}{chosen}{SUFFIX}"
    try:
        fields = json.loads(path.read_bytes())
        found = fields.pop("format")
        manifest = Manifest(**{**fields, "missing": tuple(fields["missing"])})
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError("is no manifest of a backup", file=path) from error
    if found != FORMAT:
        raise InputError(f"has format {found!r}; this version reads {FORMAT!r}", file=path)
    return manifest


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


BATCH = 2000


def row_counts(connection: Connection) -> dict[str, int]:
    """Return the number of rows of every table."""
    return {
        table.name: int(connection.execute(select(func.count()).select_from(table)).scalar_one())
        for table in Base.metadata.sorted_tables
    }


def copy_rows(source: Connection, target: Connection) -> dict[str, int]:
    """Make every table hold the rows of another database, and no others; return their numbers by table."""
    for table in reversed(Base.metadata.sorted_tables):
        target.execute(delete(table))
    counts = {table.name: _copy_table(source, target, table) for table in Base.metadata.sorted_tables}
    if target.dialect.name == "postgresql":
        for table in Base.metadata.sorted_tables:
            _continue_numbers(target, table)
    return counts


def _copy_table(source: Connection, target: Connection, table: Table) -> int:
    """Copy one table; references of its rows to each other are filled in when all rows are there."""
    own = [column for column in table.columns if any(key.column.table is table for key in column.foreign_keys)]
    count = 0
    later: list[dict[str, Any]] = []
    for batch in _batches(source, table):
        count += len(batch)
        later += [_reference(table, own, row) for row in batch if any(row[column.name] is not None for column in own)]
        target.execute(insert(table), [row | {column.name: None for column in own} for row in batch])
    if later:
        key = [column == _parameter(column) for column in table.primary_key]
        target.execute(update(table).where(*key), later)
    return count


def _batches(source: Connection, table: Table) -> Iterator[list[dict[str, Any]]]:
    found = source.execution_options(stream_results=True, yield_per=BATCH).execute(
        select(table).order_by(*table.primary_key)
    )
    for rows in found.mappings().partitions():
        yield [dict(row) for row in rows]


def _reference(table: Table, own: list[Column[Any]], row: Mapping[str, Any]) -> dict[str, Any]:
    return {f"key_{column.name}": row[column.name] for column in table.primary_key} | {
        column.name: row[column.name] for column in own
    }


def _parameter(column: Column[Any]) -> Any:  # noqa: ANN401 - SQLAlchemy's own expression
    return bindparam(f"key_{column.name}", type_=column.type)


def _continue_numbers(target: Connection, table: Table) -> None:
    """Let PostgreSQL number new rows after those that were copied."""
    keys = list(table.primary_key)
    if len(keys) != 1 or not isinstance(keys[0].type, Integer):
        return
    name, key = table.name, keys[0].name
    sequence = target.scalar(text("SELECT pg_get_serial_sequence(:name, :key)"), {"name": name, "key": key})
    largest = target.scalar(select(func.max(keys[0])))
    if sequence is not None and largest is not None:
        target.execute(
            text("SELECT setval(CAST(:sequence AS regclass), :last)"), {"sequence": sequence, "last": largest}
        )
