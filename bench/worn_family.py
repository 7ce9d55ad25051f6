"""Write the table of conicities of worn design pairs: ``python -m bench.worn_family``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from estimation.contact import worn_family
from estimation.contact.worn_family import PAIRS, TABLE, UNIT, conicities_of


def main() -> None:
    """Compute every pair and write the table beside its module."""
    parts = []
    for index, pair in enumerate(PAIRS):
        rows = np.round(conicities_of(pair) / UNIT)
        parts.append(np.column_stack([np.full(len(rows), index), rows]))
    np.save(Path(worn_family.__file__).with_name(TABLE), np.concatenate(parts).astype(np.uint16))


if __name__ == "__main__":
    main()
