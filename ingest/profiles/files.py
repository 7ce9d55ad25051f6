"""A profile from a file, by its suffix."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np

from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import Profile, ProfileKind
from estimation.contact.smoothed_profile import SmoothedProfile
from estimation.errors import ProfileError
from estimation.values.units import MILLIMETRE
from ingest.input_file import PROFILE_BYTES, read_text_within
from ingest.profiles.formats import FORMATS
from ingest.profiles.orientation import oriented
from ingest.profiles.points import FilePoints, Origin, number, points_of
from ingest.profiles.stored import SUFFIX, read_stored_profile

_DECIMAL_COMMAS = re.compile(r"^[+-]?\d+,\d+(\s*;\s*|\s+)[+-]?\d+(,\d+)?$")


def parse_columns(text: str, file: str) -> FilePoints:
    """Return the points of a two-column file in mm; separators are commas, semicolons or blanks.

    Lines that begin with ``#`` and leading lines without any number are skipped. Further columns are ignored.
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


class ProfileOptions(TypedDict, total=False):
    """What a file leaves open; None: the shape and the points show it."""

    mirror: bool | None  # of a rail: whether its gauge side is at positive y of the file
    origin: Origin
    noise_std: float | None  # of the instrument, m; 0 takes the points as they are


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

    The name of the file decides the format and is in messages; it need not exist.
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
    noise = None if noise_std is None else noise_std / MILLIMETRE
    origin = options.get("origin", Origin.AUTO)
    points = parse(text, str(file))
    try:
        return oriented(points, kind, file.stem, mirror=mirror, origin=origin, noise_std=noise)
    except ProfileError as error:
        raise ProfileError(error.reason, file=file, line=error.line, field=error.field) from error


def _refuse_lists(file: Path) -> None:
    if file.suffix.lower() in _SLICES:
        raise ProfileError(
            "lists slices of a rail that varies along the track; give the profile file of one slice, as the list "
            "names it",
            file=file,
        )


FLANGE_END = -0.045  # m from the tread datum: contact in flanging comes 2 mm nearer to the tip at most
TREAD_END = 0.030  # m: contact at 12 mm of gauge widening and 10 mm of displacement stays within
MIN_FLANGE_HEIGHT = 0.015  # m below the tread


def read_wheel_profile(path: Path) -> Profile:
    """Return the wheel profile in a file: in a format of ``read_profile``, or one of an exported registry."""
    if path.suffix.lower() == SUFFIX:
        return _whole(read_stored_profile(path), path)
    return wheel_profile_of(read_text_within(path, PROFILE_BYTES, ProfileError, errors="replace"), path)


def wheel_profile_of(text: str, file: Path) -> Profile:
    """Return the wheel profile that the content of a file describes."""
    try:
        return _whole(measured_profile_of(text, file, "wheel").profile, file)
    except ProfileError as error:
        if _is_rail(text, file):
            raise ProfileError("is the profile of a rail; that of a wheel is needed", file=file) from error
        raise


def _is_rail(text: str, file: Path) -> bool:
    try:
        measured_profile_of(text, file, "rail")
    except ProfileError:
        return False
    return True


def _whole(profile: Profile, path: Path) -> Profile:
    first, last = float(profile.y[0]), float(profile.y[-1])
    if first > FLANGE_END or last < TREAD_END:
        raise ProfileError(
            f"reaches from {first * 1e3:+.1f} to {last * 1e3:+.1f} mm from the tread datum; flange and tread from "
            f"{FLANGE_END * 1e3:+.0f} to {TREAD_END * 1e3:+.0f} mm are needed",
            file=path,
            field="y",
        )
    tip = int(np.argmax(profile.z))
    if not -PROFILES.tread_datum <= profile.y[tip] <= FLANGE_END or profile.z[tip] < MIN_FLANGE_HEIGHT:
        raise ProfileError(
            f"no flange: its tip is expected between {-PROFILES.tread_datum * 1e3:+.0f} and"
            f" {FLANGE_END * 1e3:+.0f} mm from the tread datum, {MIN_FLANGE_HEIGHT * 1e3:.0f} mm high or more",
            file=path,
            field="z",
        )
    return profile
