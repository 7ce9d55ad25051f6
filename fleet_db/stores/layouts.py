"""Versions of the layout of track sections."""

from __future__ import annotations

import hashlib

from sqlalchemy import Connection, func, insert, select

from estimation.values.track import TrackLayout
from fleet_db.models import TrackLayoutRow
from fleet_db.packed_values import pack_layout, unpack_layout
from fleet_db.rows import table_of

LAYOUTS = table_of(TrackLayoutRow)


def find_layout(connection: Connection, section: str, version: int | None) -> TrackLayout | None:
    """Return one version of the layout of a section, or the newest; None where there is none."""
    statement = select(LAYOUTS.c.version, LAYOUTS.c.packed).where(LAYOUTS.c.section == section)
    if version is not None:
        statement = statement.where(LAYOUTS.c.version == version)
    row = connection.execute(statement.order_by(LAYOUTS.c.version.desc()).limit(1)).first()
    if row is None:
        return None
    return unpack_layout(row.packed, row.version, where=f"layout {row.version} of track section {section!r}")


def newest_version(connection: Connection, section: str) -> int | None:
    """Return the newest version of the layout of a section; None where there is none."""
    found: int | None = connection.scalar(select(func.max(LAYOUTS.c.version)).where(LAYOUTS.c.section == section))
    return found


def store_layout(connection: Connection, layout: TrackLayout) -> int:
    """Store a layout as the next version of its section, which exists, and return that.

    The content of the newest version again changes nothing and returns its version.
    """
    packed = pack_layout(layout)
    digest = hashlib.sha256(packed).hexdigest()
    newest = connection.execute(
        select(LAYOUTS.c.version, LAYOUTS.c.content_digest)
        .where(LAYOUTS.c.section == layout.section)
        .order_by(LAYOUTS.c.version.desc())
        .limit(1)
    ).first()
    if newest is not None and newest.content_digest == digest:
        return int(newest.version)
    version = 1 if newest is None else int(newest.version) + 1
    row = {"section": layout.section, "version": version, "points": len(layout.s)}
    connection.execute(insert(LAYOUTS).values(**row, content_digest=digest, packed=packed))
    return version
