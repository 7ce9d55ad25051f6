"""How a field of a frozen value is served outside: the value's own class is the only description of it."""

from __future__ import annotations

from dataclasses import dataclass

MM = 1e3


@dataclass(frozen=True, slots=True)
class Served:
    """Name, unit and words of a field, as metadata of its type.

    Attributes:
        text: What it says, for the reader of the API.
        name: Where it is served under another name than its own; ``from_ns`` and ``to_ns`` are served as the times
            ``measured_from`` and ``measured_to``, another ``x_ns`` as ``x_at``.
        scale: From the unit that the value has into the one that the name says.
        example: For the document of the API.
        finite: Whether the number always is; where it need not be, null is served in place of NaN and infinity.
    """

    text: str = ""
    name: str = ""
    scale: float = 1.0
    example: object = None
    finite: bool = True
