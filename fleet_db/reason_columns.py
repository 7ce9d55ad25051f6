"""A reason in two columns: its sentence, and its code."""

from __future__ import annotations

from typing import Any

from estimation.values.reasons import Reason, ReasonCode


def reason_columns(reason: Reason | None) -> dict[str, str | None]:
    """Return the values of the columns ``reason`` (empty where there is none) and ``reason_code`` (then null).

    Parameters
    ----------
    reason
        What to store.
    """
    if reason is None:
        return {"reason": "", "reason_code": None}
    return {"reason": reason.text, "reason_code": reason.code.value}


def stored_reason(row: Any) -> Reason | None:  # noqa: ANN401 - a row of any table with both columns
    """Return the reason of a row; None where it has none.

    Parameters
    ----------
    row
        With the columns ``reason`` and ``reason_code``.
    """
    return None if row.reason_code is None else Reason(ReasonCode(row.reason_code), row.reason)
