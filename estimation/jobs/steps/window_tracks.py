"""On which alignment and layout the windows of a batch are estimated, as one transaction sees them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.storage import UnitOfWork
from estimation.values.track import AlignmentRecord, TrackAlignment, TrackLayout
from estimation.values.windows import WindowKey, WindowRecord


@dataclass(frozen=True, slots=True)
class TrackLookup:
    """Looks up sections; each version of an alignment is read once.

    Attributes:
        unit: Sections are read.
        versions: By window, on which versions those of epochs are estimated.
    """

    unit: UnitOfWork
    versions: Mapping[WindowKey, int | None]
    _in_force: dict[str, AlignmentRecord | None] = field(default_factory=dict)
    _alignments: dict[tuple[str, int], TrackAlignment | None] = field(default_factory=dict)
    _layouts: dict[str, TrackLayout | None] = field(default_factory=dict)

    def in_force(self, record: WindowRecord) -> AlignmentRecord | None:
        """Return which alignment of a window's section is in force; None where none is, or the section is not known."""
        section = record.track_section
        if section is None:
            return None
        if section not in self._in_force:
            self._in_force[section] = self.unit.tracks.in_force(section)
        return self._in_force[section]

    def alignment(self, record: WindowRecord) -> TrackAlignment | None:
        """Return the alignment that a window is estimated on; None where there is none."""
        now, section = self.in_force(record), record.track_section
        version = self.versions.get(record.key, None if now is None else now.version)
        if section is None or version is None:
            return None
        if (section, version) not in self._alignments:
            self._alignments[section, version] = self.unit.tracks.alignment(section, version)
        return self._alignments[section, version]

    def layout(self, record: WindowRecord) -> TrackLayout | None:
        """Return the layout of a window's section; None where there is none."""
        section = record.track_section
        if section is None:
            return None
        if section not in self._layouts:
            self._layouts[section] = self.unit.tracks.layout(section)
        return self._layouts[section]


def tracks_of_batch(unit: UnitOfWork, records: Sequence[WindowRecord]) -> TrackLookup:
    """Return the look-up of the sections of some windows."""
    return TrackLookup(unit, unit.epochs.alignment_versions([record.key for record in records]))
