"""The weighted sum of bin tables, in the order given."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from estimation.values.geometry import BinTable


def weighted_sum(tables: Iterable[tuple[float, BinTable]]) -> BinTable:
    """Return the sum of tables times their weights; samples and windows are counted without weights.

    Args:
        tables: Weight and table, at least one; all of the same parameters.

    Raises:
        ValueError: The tables were made with different parameters.
    """
    total: BinTable | None = None
    for weight, table in tables:
        if total is None:
            total = replace(table, weight=weight * table.weight, lateral=weight * table.lateral, yaw=weight * table.yaw)
            continue
        if table.parameter_key != total.parameter_key:
            raise ValueError(f"bin tables of parameters {total.parameter_key} and {table.parameter_key} do not merge")
        total = replace(
            total,
            weight=total.weight + weight * table.weight,
            lateral=total.lateral + weight * table.lateral,
            yaw=total.yaw + weight * table.yaw,
            samples=total.samples + table.samples,
            windows=total.windows + table.windows,
        )
    if total is None:
        raise ValueError("no table to sum")
    return total
