"""Records of the registry that a process has read, until the registry changes."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Hashable, MutableMapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Connection, select

from estimation.values.results import Facet
from estimation.values.runs import SubjectKind
from fleet_db.read_once import ReadOnce
from fleet_db.rows import table_of
from fleet_db.subjects import VERSIONS
from fleet_db.tables.alerts import FeedBranchRow

BRANCHES = table_of(FeedBranchRow)
MOST = 20_000
"""Records of a kind that are kept."""
LARGE = ("measured profiles",)
"""Kinds that are kept for a transaction only."""
Records = dict[str, dict[Any, Any]]


@dataclass(slots=True)
class KeptRecords:
    """Records by kind and key, of one version of the registry; shared by the threads of a process."""

    _kept: tuple[Hashable, Records] = (None, {})

    def of(self, version: Hashable) -> Records:
        """Return the records of a version, to be looked up and added to."""
        of_version, records = self._kept
        if of_version != version or any(len(of_kind) > MOST for of_kind in records.values()):
            self._kept = (version, records := {})
        return records


@dataclass(frozen=True, slots=True, kw_only=True)
class OnFile(ReadOnce):
    """Records of the registry: while it does not change, no transaction reads again what another one has read.

    A transaction that writes may see what is not committed, and adds nothing to what others see.
    """

    connection: Connection
    kept: KeptRecords
    _read: dict[str, Records] = field(default_factory=dict)

    def renew(self) -> None:
        """Look at the version of the registry again."""
        self._read.clear()

    def _of_kind(self, kind: str) -> MutableMapping[Any, Any]:
        if kind in LARGE:
            return ReadOnce._of_kind(self, kind)  # noqa: SLF001 - of the class that this one extends
        if not self._read:
            self._read["now"] = self.kept.of(_version(self.connection))
        records: dict[Any, Any] = self._read["now"].setdefault(kind, {})
        return records if self.snapshot else ChainMap({}, records)


def _version(connection: Connection) -> Hashable:
    """Return what is another one with each change of the registry, and after a restore."""
    of_registry = (VERSIONS.c.kind == SubjectKind.FLEET.value, VERSIONS.c.subject == "")
    changes = select(VERSIONS.c.version).where(*of_registry, VERSIONS.c.facet == Facet.REGISTRY.value)
    branch = select(BRANCHES.c.identity).order_by(BRANCHES.c.branch_id.desc()).limit(1)
    return tuple(connection.execute(select(changes.scalar_subquery(), branch.scalar_subquery())).one())
