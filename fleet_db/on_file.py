"""Records of the registry that a process has read, until the registry changes."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import String, cast, func, select

from estimation.values.results import Facet
from estimation.values.runs import SubjectKind
from fleet_db.read_once import ReadOnce
from fleet_db.rows import table_of
from fleet_db.subjects import VERSIONS, Subjects
from fleet_db.tables.alerts import FeedBranchRow

BRANCHES = table_of(FeedBranchRow)
_OF_REGISTRY = (VERSIONS.c.kind == SubjectKind.FLEET.value, VERSIONS.c.subject == "")
_CHANGES = select(cast(VERSIONS.c.version, String)).where(*_OF_REGISTRY, VERSIONS.c.facet == Facet.REGISTRY.value)
_BRANCH = select(BRANCHES.c.identity).order_by(BRANCHES.c.branch_id.desc()).limit(1)
VERSION = func.coalesce(_CHANGES.scalar_subquery(), "") + " " + func.coalesce(_BRANCH.scalar_subquery(), "")
"""What is another one with each change of the registry, and after a restore."""
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

    A transaction that has changed it sees what is not committed: it neither uses nor adds to what others see.
    """

    subjects: Subjects
    kept: KeptRecords
    _read: dict[str, Records] = field(default_factory=dict)

    def renew(self, version: str | None) -> None:
        """Go on with a version of the registry that was read just now."""
        if version is not None:
            self._read["now"] = self.kept.of(version)

    def _of_kind(self, kind: str) -> dict[Any, Any]:
        if kind in LARGE:
            return ReadOnce._of_kind(self, kind)  # noqa: SLF001 - of the class that this one extends
        if self.subjects.growth([Facet.REGISTRY]):
            return {}
        if not self._read:
            self._read["now"] = self.kept.of(self.subjects.connection.scalar(select(VERSION)))
        return self._read["now"].setdefault(kind, {})
