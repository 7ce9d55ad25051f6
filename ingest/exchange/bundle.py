"""An exchange as one file of the raw store: description, table, and what the registry contained when it came in.

A zip file without compression and with fixed times: the same exchange gives the same bytes on every machine.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import zipfile
from dataclasses import asdict
from pathlib import Path

from estimation.errors import ExchangeError
from ingest.exchange.description import ExchangeFile, read_description
from ingest.exchange.run import ExchangeRun, RegistryFacts, exchange_run
from ingest.exchange.table import PARQUET, SUFFIXES, read_table
from ingest.exchange.table_process import read_table_apart
from ingest.input_file import InputTable, read_json

SUFFIX = ".exchange"
DESCRIPTION, TABLE, FACTS = "exchange.toml", "table", "registry.json"
TIMESTAMP = (1980, 1, 1, 0, 0, 0)
LARGEST_BYTES = 4 << 30


class _Facts(InputTable):
    section_number: int
    axle_offset_m: float
    measures_gravity: bool


def read_run(file: ExchangeFile, table: Path, facts: RegistryFacts) -> ExchangeRun:
    """Return the run of an exchange."""
    names = [column.column for _, column in file.columns]
    read = read_table_apart if table.suffix.lower() == PARQUET else read_table
    return exchange_run(file, read(table, file.csv, names), facts)


def write_bundle(path: Path, description: Path, table: Path, facts: RegistryFacts) -> None:
    """Write an exchange as one file."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as bundle:
        _add(bundle, DESCRIPTION, description)
        _add(bundle, TABLE + table.suffix.lower(), table)
        bundle.writestr(zipfile.ZipInfo(FACTS, TIMESTAMP), json.dumps(asdict(facts), sort_keys=True))


def _add(bundle: zipfile.ZipFile, name: str, path: Path) -> None:
    with path.open("rb") as source, bundle.open(zipfile.ZipInfo(name, TIMESTAMP), "w", force_zip64=True) as target:
        shutil.copyfileobj(source, target, 1 << 20)


def read_bundle(path: Path) -> tuple[ExchangeFile, ExchangeRun, RegistryFacts]:
    """Return description, run and facts of a stored exchange."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-exchange-") as name:
        folder = Path(name)
        table = _unpack(path, folder)
        file, _ = read_description(folder / DESCRIPTION)
        stored = read_json(folder / FACTS, ExchangeError).parse(_Facts)
        facts = RegistryFacts(stored.section_number, stored.axle_offset_m, stored.measures_gravity)
        return file, read_run(file, table, facts), facts


def _unpack(path: Path, folder: Path) -> Path:
    try:
        with zipfile.ZipFile(path) as bundle:
            names = {item.filename: item for item in bundle.infolist()}
            tables = [name for name in names if name in {TABLE + suffix for suffix in SUFFIXES}]
            if len(tables) != 1 or set(names) != {DESCRIPTION, FACTS, tables[0]}:
                raise ExchangeError("is no stored exchange", file=path)
            if sum(item.file_size for item in names.values()) > LARGEST_BYTES:
                raise ExchangeError("is too large", file=path)
            bundle.extractall(folder)
    except (OSError, zipfile.BadZipFile, EOFError) as error:
        raise ExchangeError(f"is no stored exchange: {error}", file=path) from error
    return folder / tables[0]
