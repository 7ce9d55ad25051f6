"""Creep forces and friction as blobs: values by their own fields, sums of friction as arrays."""

from __future__ import annotations

from estimation.values.opinions import FrictionSums, SectionAdhesion, WindowAdhesion
from fleet_db.fields import fields_of, pack, unpack, value_of

VERSION = 1
WINDOW, SECTION = "window_adhesion", "section_adhesion"


def pack_window_adhesion(found: WindowAdhesion) -> bytes:
    """Return the creep of a window as one blob."""
    scalars, _ = fields_of(found, without={"sums"})
    arrays = {} if found.sums is None else fields_of(found.sums)[1]
    return pack(WINDOW, VERSION, scalars, arrays)


def unpack_window_adhesion(blob: bytes, *, where: str) -> WindowAdhesion:
    """Return the creep of a window, bit for bit.

    Raises:
        StorageError: The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, WINDOW, where=where)
    sums = value_of(FrictionSums, {}, packed.arrays) if packed.arrays else None
    return value_of(WindowAdhesion, packed.scalars, {}, sums=sums)


def pack_section_adhesion(found: SectionAdhesion) -> bytes:
    """Return the friction of a section as one blob."""
    return pack(SECTION, VERSION, *fields_of(found))


def unpack_section_adhesion(blob: bytes, *, where: str) -> SectionAdhesion:
    """Return the friction of a section, bit for bit.

    Raises:
        StorageError: The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, SECTION, where=where)
    return value_of(SectionAdhesion, packed.scalars, packed.arrays)
