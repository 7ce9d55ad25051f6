"""A profile from a file, by its suffix."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from estimation.contact.profiles import Profile, ProfileKind
from estimation.errors import ProfileError
from ingest.profiles.columns import parse_columns
from ingest.profiles.formats import FORMATS
from ingest.profiles.orientation import oriented
from ingest.profiles.points import FilePoints


def read_profile(
    path: Path | str, kind: ProfileKind, *, unit: Literal["mm", "m"] = "mm", mirror: bool = False
) -> Profile:
    """Read a wheel or rail profile, in the format of ``FORMATS`` that has its suffix, else as two columns of text.

    Parameters
    ----------
    path
        The file.
    kind
        What it holds; this decides, not the suffix.
    unit
        Of two-column files; the others are in mm or contain their unit.
    mirror
        Exchange the two sides of a rail whose shape does not show its gauge side (both reach 14 mm below the crown).

    Raises
    ------
    ProfileError
        The file cannot be read as that; the message names file, line and field.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise ProfileError(f"cannot be read: {error.strerror}", file=file) from error
    if "\x00" in text:
        raise ProfileError("is not a text file", file=file)
    profile = oriented(_parsed(text, str(file), file.suffix.lower(), unit), kind, file.stem)
    if not mirror:
        return profile
    if kind == "wheel":
        raise ProfileError("the flange shows which side of a wheel is which", file=file, field="mirror")
    return Profile(kind, profile.name, -profile.y[::-1], profile.z[::-1], -profile.slope[::-1])


def _parsed(text: str, file: str, suffix: str, unit: Literal["mm", "m"]) -> FilePoints:
    for item in FORMATS:
        if suffix in item.suffixes:
            return item.parse(text, file)
    return parse_columns(text, file, 1.0 if unit == "mm" else 1000.0)
