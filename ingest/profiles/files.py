"""A profile from a file, by its suffix."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TypedDict, Unpack

from estimation.contact.profiles import Profile, ProfileKind
from estimation.contact.smoothed_profile import SmoothedProfile
from estimation.errors import ProfileError
from ingest.bounded_file import PROFILE_BYTES, read_text_within
from ingest.profiles.formats import FORMATS
from ingest.profiles.orientation import oriented
from ingest.profiles.points import FilePoints, Origin, number, points_of

_DECIMAL_COMMAS = re.compile(r"^[+-]?\d+,\d+(\s*;\s*|\s+)[+-]?\d+(,\d+)?$")


def parse_columns(text: str, file: str) -> FilePoints:
    """Return the points of a two-column file in mm; separators are commas, semicolons or blanks.

    Lines that begin with ``#`` and leading lines without any number are skipped. Further columns are ignored.

    Raises:
        ProfileError: Decimal commas, a row with fewer than two columns or with something that is not a finite number.
    """
    rows: list[tuple[int, float, float]] = []
    for line, raw in enumerate(text.lstrip("\ufeff").splitlines(), start=1):
        content = raw.split("#", maxsplit=1)[0].strip()
        if not content or (not rows and not re.match(r"^[+-]?(\d|\.\d|nan|inf)", content, re.IGNORECASE)):
            continue
        if _DECIMAL_COMMAS.match(content):
            raise ProfileError("decimal commas; write decimal points", file=file, line=line)
        cells = [cell for cell in re.split(r"[\s,;]+", content) if cell]
        if len(cells) < 2:  # noqa: PLR2004 - y and z
            raise ProfileError(f"{len(cells)} column, two are expected", file=file, line=line)
        across = number(cells[0], file=file, line=line, field="y")
        rows.append((line, across, number(cells[1], file=file, line=line, field="z")))
    return points_of(file, rows)


_SLICES = (".slcs", ".slcw")  # CONTACT's lists of cross sections
_MILLIMETRE = 1e-3


class ProfileOptions(TypedDict, total=False):
    """What a file leaves open.

    Attributes:
        mirror: Of a rail: True if its gauge side is at positive y of the file, False if at negative y; None decides
            from the shape.
        noise_std: Known noise of the instrument, m; 0 takes the points as they are; None estimates it from the points.
    """

    mirror: bool | None
    origin: Origin
    noise_std: float | None


def read_profile(path: Path | str, kind: ProfileKind, **options: Unpack[ProfileOptions]) -> Profile:
    """Read a wheel or rail profile in the format of its suffix (``FORMATS``), else as two columns of text, mm."""
    return read_measured_profile(path, kind, **options).profile


def read_measured_profile(path: Path | str, kind: ProfileKind, **options: Unpack[ProfileOptions]) -> SmoothedProfile:
    """Read a wheel or rail profile with the uncertainty of its shape; ``kind`` decides what it is, not the suffix."""
    file = Path(path)
    _refuse_lists(file)
    return measured_profile_of(
        read_text_within(file, PROFILE_BYTES, ProfileError, errors="replace"), file, kind, **options
    )


def measured_profile_of(text: str, file: Path, kind: ProfileKind, **options: Unpack[ProfileOptions]) -> SmoothedProfile:
    """Return the wheel or rail profile that the content of a file describes.

    Args:
        file: Its name, which decides the format and is in messages; the file need not exist.
    """
    mirror, noise_std = options.get("mirror"), options.get("noise_std")
    if kind == "wheel" and mirror is not None:
        raise ProfileError("the flange shows which side of a wheel is which", file=file, field="mirror")
    if noise_std is not None and not (math.isfinite(noise_std) and noise_std >= 0.0):
        raise ProfileError(f"{noise_std!r} m is no standard deviation", file=file, field="noise_std")
    _refuse_lists(file)
    if "\x00" in text:
        raise ProfileError("is not a text file; export the profile as text", file=file)
    suffix = file.suffix.lower()
    parse = next((item.parse for item in FORMATS if suffix in item.suffixes), parse_columns)
    noise = None if noise_std is None else noise_std / _MILLIMETRE
    origin = options.get("origin", Origin.AUTO)
    return oriented(parse(text, str(file)), kind, file.stem, mirror=mirror, origin=origin, noise_std=noise)


def _refuse_lists(file: Path) -> None:
    if file.suffix.lower() in _SLICES:
        raise ProfileError(
            "lists slices of a rail that varies along the track; give the profile file of one slice, as the list "
            "names it",
            file=file,
        )
