"""Names of wheel and rail profiles that the library of profiles knows."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.errors import ProfileError
from ingest.input_file import Text, field_error


def _rail(name: str) -> str:
    try:
        rail_profile(name)
    except ProfileError as error:
        raise field_error(error.reason) from error
    return name


def _wheel(name: str) -> str:
    try:
        wheel_profile(name)
    except ProfileError as error:
        raise field_error(error.reason) from error
    return name


RailName = Annotated[Text, AfterValidator(_rail)]


WheelName = Annotated[Text, AfterValidator(_wheel)]
