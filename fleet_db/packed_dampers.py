"""What a window says of a damper as one blob: half of its symmetric sums."""

from __future__ import annotations

import numpy as np

from estimation.values.opinions import DamperSums, WindowDamper
from fleet_db.fields import fields_of, pack, unpack, value_of

VERSION = 1
WINDOW = "window_damper"


def pack_window_damper(found: WindowDamper) -> bytes:
    """Return what a window says as one blob; the products are symmetric, and half of them is kept."""
    scalars, _ = fields_of(found, without={"sums"})
    if found.sums is None:
        return pack(WINDOW, VERSION, scalars, {})
    products = found.sums.products
    rows, columns = np.tril_indices(products.shape[-1])
    scalars |= {"samples": float(found.sums.samples).hex(), "curved": found.sums.curved}
    return pack(WINDOW, VERSION, scalars, {"products": products[:, rows, columns]})


def unpack_window_damper(blob: bytes, *, where: str) -> WindowDamper:
    """Return what a window says, bit for bit.

    Args:
        blob: From ``pack_window_damper``.

    Raises:
        StorageError: The blob is damaged.
    """
    packed = unpack(blob, WINDOW, where=where)
    if not packed.arrays:
        return value_of(WindowDamper, packed.scalars, {}, sums=None)
    half = packed.arrays["products"]
    size = round((np.sqrt(8.0 * half.shape[-1] + 1.0) - 1.0) / 2.0)
    rows, columns = np.tril_indices(size)
    products = np.zeros((len(half), size, size))
    products[:, rows, columns] = half
    products[:, columns, rows] = half
    sums = DamperSums(products, float.fromhex(packed.scalars["samples"]), packed.scalars["curved"])
    return value_of(WindowDamper, packed.scalars, {}, sums=sums)
