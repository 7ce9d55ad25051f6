"""Versions of what is known of wheelsets, vehicles and sections, and records that are read once in a version.

Whoever writes a base fact or a result raises its facet in the same transaction. A stage compares the sum of the
versions of the facets that it declares with the sum that it has seen (``fleet_db.stores.stage_marks``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

from sqlalchemy import ColumnElement, Connection, Insert, String, bindparam, cast, exists, func, select

from estimation.values.opinions import GEAR_DAMPERS
from estimation.values.runs import Facet, SubjectKind
from estimation.values.trend import SUSPENSION, TREND
from estimation.worklist.stored import FACETS as SHOWN
from fleet_db.rows import insert_of, table_of
from fleet_db.tables.alerts import FeedBranchRow
from fleet_db.tables.operation import ResultRow, SubjectVersionRow
from fleet_db.tables.registry import MountingRow
from fleet_db.tables.track import TrackEpochWindowRow
from fleet_db.tables.windows import WindowRow

VERSIONS, MOUNTINGS, RESULTS = table_of(SubjectVersionRow), table_of(MountingRow), table_of(ResultRow)
MEMBERS, WINDOWS = table_of(TrackEpochWindowRow), table_of(WindowRow)
OF_VEHICLES = frozenset({Facet.HUNTING, Facet.RECORDINGS, GEAR_DAMPERS.stage, SUSPENSION.stage})
"""Facets of a vehicle that its wheelsets follow."""
BESIDE = MOUNTINGS.alias("beside")
WITH_STEP = exists().where(
    RESULTS.c.stage == TREND.stage,
    RESULTS.c.subject == MOUNTINGS.c.wheelset,
    RESULTS.c.superseded_ns.is_(None),
    RESULTS.c.head.is_not(None),
)
"""The trend in force has a step: what may have caused it is looked for in the trends beside it, and in all sections."""


@dataclass(slots=True)
class Subjects:
    """The facets that a transaction raises: each once, however often it is asked for."""

    connection: Connection
    _raised: set[tuple[str, str, str]] = field(default_factory=set)  # since they were written last
    _written: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    _shown: set[str] = field(default_factory=set)

    def raised(self, kind: SubjectKind, subject: str | None, facet: str) -> None:
        """Raise the version of a facet: the stages that read it are due after this transaction; None is no section."""
        self._raised.add((str(kind), subject or "", str(facet)))
        if kind is SubjectKind.WHEELSET and subject is not None and facet in SHOWN:
            self.show(subject)

    def show(self, wheelset: str) -> None:
        """Let the row of a wheelset in the worklist be made again when this transaction ends."""
        self._shown.add(wheelset)

    def take_shown(self) -> list[str]:
        """Return the serials whose row of the worklist is to be made again, in their order; they are forgotten here."""
        taken = sorted(self._shown)
        self._shown.clear()
        return taken

    def windows(self, wheelset: str, hunting_in: str | None = None) -> None:
        """Let the windows of a wheelset, and hunting of a vehicle in which it hunts or did, have another version."""
        self.raised(SubjectKind.WHEELSET, wheelset, Facet.WINDOWS)
        if hunting_in is not None:
            self.raised(SubjectKind.VEHICLE, hunting_in, Facet.HUNTING)

    def tables(self, wheelset: str) -> None:
        """Let what the geometry of a wheelset is computed from have another version."""
        self.raised(SubjectKind.WHEELSET, wheelset, Facet.TABLES)

    def places(self, section: str | None) -> None:
        """Let windows, tables, positions or epochs of a section, None: of none, have another version."""
        self.raised(SubjectKind.SECTION, section, Facet.PLACES)

    def growth(self, facets: Collection[str], subject: tuple[SubjectKind, str] | None = None) -> int:
        """Return by how much this transaction lets the sum of versions grow, of a subject or of all."""
        grown = self._written + Counter(self._raised)
        return sum(
            count for (kind, name, facet), count in grown.items() if facet in facets and subject in {None, (kind, name)}
        )

    def wheelset_on_file(self, serial: str) -> None:
        """Something on file of a wheelset has changed: sections with its windows follow."""
        self.raised(SubjectKind.WHEELSET, serial, Facet.REGISTRY)
        self._sections(WINDOWS.c.wheelset == serial, MEMBERS.c.wheelset == serial)

    def vehicle_on_file(self, code: str) -> None:
        """Something on file of a vehicle has changed: what has ever been mounted there follows, and its sections."""
        self.raised(SubjectKind.VEHICLE, code, Facet.REGISTRY)
        for serial in self.connection.scalars(select(MOUNTINGS.c.wheelset).where(MOUNTINGS.c.vehicle == code)):
            self.raised(SubjectKind.WHEELSET, serial, Facet.REGISTRY)
        self._sections(WINDOWS.c.vehicle == code, MEMBERS.c.vehicle == code)

    def section_on_file(self, code: str) -> None:
        """Something on file of a section has changed, or its layout: the signatures of all wheelsets rest on that."""
        self.raised(SubjectKind.SECTION, code, Facet.REGISTRY)
        for serial in self.connection.scalars(select(MOUNTINGS.c.wheelset).distinct()):
            self.raised(SubjectKind.WHEELSET, serial, Facet.LAYOUTS)

    def registry(self) -> None:
        """A record of the registry has changed: what processes have read of it is outdated."""
        self.raised(SubjectKind.FLEET, "", Facet.REGISTRY)

    def flush(self) -> None:
        """Write the versions, in one order in all transactions: they wait for each other and never in a circle."""
        self._follow()
        rows = [{"kind": kind, "subject": subject, "facet": facet} for kind, subject, facet in sorted(self._raised)]
        if rows:
            self.connection.execute(_raise(self.connection.dialect.name), rows)
        self._written.update(self._raised)
        self._raised.clear()

    def _follow(self) -> None:
        """Raise what wheelsets are beside: their vehicle, the trends of the other wheelsets of it, and all rails."""
        vehicles = {subject for kind, subject, facet in self._raised if kind == "vehicle" and facet in OF_VEHICLES}
        trends = {subject for _, subject, facet in self._raised if facet == TREND.stage}
        mounted = select(MOUNTINGS.c.wheelset).where(MOUNTINGS.c.to_ns.is_(None))
        following = []
        if vehicles:
            following.append(mounted.where(MOUNTINGS.c.vehicle.in_(sorted(vehicles))))
        if trends:
            lasting = (BESIDE.c.wheelset.in_(sorted(trends)), BESIDE.c.to_ns.is_(None))
            same = (BESIDE.c.vehicle == MOUNTINGS.c.vehicle, BESIDE.c.wheelset != MOUNTINGS.c.wheelset)
            following.append(mounted.where(WITH_STEP, exists().where(*lasting, *same)))
        if any(kind == "section" and facet == Facet.REGISTRY for kind, _, facet in self._raised):
            following.append(mounted.where(WITH_STEP))
        for statement in following:
            for serial in self.connection.scalars(statement):
                self.raised(SubjectKind.WHEELSET, serial, Facet.BESIDE)

    def _sections(self, windows: ColumnElement[bool], members: ColumnElement[bool]) -> None:
        """Raise the sections that windows are on, or were when their epoch was computed."""
        on = select(func.coalesce(WINDOWS.c.track_section, "")).where(windows)
        for section in self.connection.scalars(on.union(select(MEMBERS.c.section).where(members))):
            self.raised(SubjectKind.SECTION, section, Facet.REGISTRY)


@dataclass(frozen=True, slots=True)
class Store:
    """What is stored of one subject, in one transaction."""

    connection: Connection


@dataclass(frozen=True, slots=True)
class RaisingStore(Store):
    """A store whose changes raise facets."""

    subjects: Subjects


@cache
def _raise(dialect: str) -> Insert:
    names = ("kind", "subject", "facet")
    row = {**{name: bindparam(name) for name in names}, "version": 1}
    new = insert_of(dialect, VERSIONS).values(row)
    raised: Insert = new.on_conflict_do_update(index_elements=names, set_={"version": VERSIONS.c.version + 1})
    return raised


Key = TypeVar("Key", bound=Hashable)
Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class ReadOnce:
    """Records by kind and key: a transaction that sees one snapshot reads none of them again."""

    snapshot: bool = False  # one that writes reads again each time
    together: set[str] = field(default_factory=set)  # wheelsets of which all is read together
    _records: dict[str, dict[Any, Any]] = field(default_factory=dict)

    def of(
        self, kind: str, keys: Collection[Key], read: Callable[[Collection[Key]], Mapping[Key, Record]]
    ) -> dict[Key, Record]:
        """Return records by key, of which ``read`` reads those that are missing; a key without one is left out."""
        records = self._of_kind(kind)
        missing = [key for key in dict.fromkeys(keys) if key not in records]
        if missing:
            read_now = read(missing)
            records.update((key, read_now.get(key)) for key in missing)
        return {key: records[key] for key in keys if records[key] is not None}

    def renew(self, version: str | None) -> None:
        """Let what others have changed meanwhile be seen; a transaction that writes remembers nothing."""

    def _of_kind(self, kind: str) -> dict[Any, Any]:
        """Return the records of a kind that need not be read; what is read is added to it."""
        return self._records.setdefault(kind, {}) if self.snapshot else {}

    def remember(self, kind: str, records: Mapping[Any, Any]) -> None:
        """Let records be those that this transaction has read."""
        self._records.setdefault(kind, {}).update(records)

    def known(self, kind: str, key: Hashable) -> Any:  # noqa: ANN401 - a record of this kind
        """Return a record that :meth:`of` has read; None where it has not, or there is none."""
        return self._records.get(kind, {}).get(key)

    def is_absent(self, kind: str, key: Hashable) -> bool:
        """Return whether :meth:`of` has looked for a record and found none."""
        records = self._records.get(kind, {})
        return key in records and records[key] is None

    def of_wheelset(
        self, kind: str, wheelset: str, read: Callable[[Collection[str]], Mapping[str, Record]]
    ) -> Record | None:
        """Return what :meth:`of_wheelsets` does of one; None where it has none."""
        return self.of_wheelsets(kind, [wheelset], read).get(wheelset)

    def of_wheelsets(
        self, kind: str, wheelsets: Collection[str], read: Callable[[Collection[str]], Mapping[str, Record]]
    ) -> dict[str, Record]:
        """Return what :meth:`of` does of wheelsets; one of those that are read together is read with all of them."""
        if self.snapshot and not self.together.isdisjoint(wheelsets):
            self.of(kind, sorted(self.together), read)
        return self.of(kind, wheelsets, read)

    def one(self, kind: str, key: Hashable, read: Callable[[], Record]) -> Record:
        """Return a record, which ``read`` reads, of which there may be none."""

        def known(_: Collection[Hashable]) -> Mapping[Hashable, tuple[Record]]:
            return {key: (read(),)}

        return self.of(kind, [key], known)[key][0]


BRANCHES = table_of(FeedBranchRow)
_OF_REGISTRY = (VERSIONS.c.kind == SubjectKind.FLEET.value, VERSIONS.c.subject == "")
_CHANGES = select(cast(VERSIONS.c.version, String)).where(*_OF_REGISTRY, VERSIONS.c.facet == Facet.REGISTRY.value)
_BRANCH = select(BRANCHES.c.identity).order_by(BRANCHES.c.branch_id.desc()).limit(1)
REGISTRY_VERSION = func.coalesce(_CHANGES.scalar_subquery(), "") + " " + func.coalesce(_BRANCH.scalar_subquery(), "")
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
        if of_version != version or any(len(of_kind) > MOST for of_kind in list(records.values())):
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
            self._read["now"] = self.kept.of(self.subjects.connection.scalar(select(REGISTRY_VERSION)))
        return self._read["now"].setdefault(kind, {})
