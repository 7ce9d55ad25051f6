"""Records of the registry as they are entered, changed, voided and restored."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from api.parameters import CODE
from api.schemas.common import Representation, Request
from api.schemas.registry import MountingPeriod
from api.times import Moment
from ingest.bounded_file import MEBIBYTE

TEXT = r"^[^\x00-\x08\x0b-\x1f\x7f]*$"
MOST_KM = 1e8
MOST_TEXT = MEBIBYTE  # of one file; a request has at most as much

Confirmable = Literal["odometer_backwards", "odometer_jump", "unknown_profile", "unusual_gauge", "unusual_radius"]
Key = Annotated[str, Field(pattern=CODE)]
Note = Annotated[str, Field(max_length=2000, pattern=TEXT)]
Kilometres = Annotated[float, Field(ge=0.0, le=MOST_KM)]


class RegistryChange(Request):
    """What every change of the registry may say."""

    why: Note = Field(default="", description="Kept with the record in its history.", examples=["work order 4711"])
    by: Key | None = Field(
        default=None, description="Who; read only where access control is off.", examples=["j.smith"]
    )
    confirm: list[Confirmable] = Field(
        default=[], description="Doubts of a refusal that are unfounded: it is so all the same.", examples=[[]]
    )


class NewMounting(RegistryChange):
    """A wheelset is mounted."""

    vehicle: Key = Field(examples=["V-101"])
    axle: int = Field(ge=1, le=8, examples=[2])
    mounted_from: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])
    vehicle_odometer_km: Kilometres = Field(description="Of the vehicle then.", examples=[812300.0])
    wheelset_mileage_km: Kilometres = Field(description="Of the wheelset since new, then.", examples=[151200.0])
    reversed: bool = Field(default=False, description="The left wheel runs on the right-hand side.")


class Dismounting(RegistryChange):
    """A wheelset is taken off its vehicle."""

    dismounted_at: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])


class Exchange(RegistryChange):
    """A wheelset is taken off and another takes its place, in one step."""

    exchanged_at: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])
    fitted: Key = Field(description="Serial of the wheelset that takes the place.", examples=["WS-0002"])
    vehicle_odometer_km: Kilometres = Field(description="Of the vehicle then.", examples=[812300.0])
    fitted_mileage_km: Kilometres = Field(description="Of the fitted wheelset since new.", examples=[0.0])
    reversed: bool = Field(default=False, description="The left wheel of the fitted one runs on the right-hand side.")


class ExchangeRecord(Representation):
    """The mounting that has ended, and the one that has begun."""

    removed: MountingPeriod
    fitted: MountingPeriod


class NewReprofiling(RegistryChange):
    """A visit to the lathe, as it is reported."""

    reprofiled_at: Moment = Field(examples=["2026-03-01T06:00:00Z"])
    mileage_km: Kilometres = Field(description="Of the wheelset since new.", examples=[151200.0])
    note: str = Field(default="", max_length=2000, pattern=r"^[^\x00]*$", examples=["Depot North, lathe 2"])


class ProfileFile(Request):
    """A file of a profile gauge, as text."""

    file_name: str = Field(
        min_length=1,
        max_length=255,
        pattern=r"^[^\x00-\x1f\x7f/\\]+$",
        description="Its suffix decides the format: MiniProf `.whl`, `.mpt`, SIMPACK `.prw`; others are two columns.",
        examples=["WS-0001-left.whl"],
    )
    text: str = Field(
        max_length=MOST_TEXT, description="Content of the file.", examples=["ColumnDef=X,Y\n\n-60.0 20.0"]
    )


class NewMeasuredProfiles(RegistryChange):
    """The profiles of both wheels, as a gauge measured them."""

    measured_at: Moment = Field(examples=["2026-03-01T06:00:00Z"])
    mileage_km: Kilometres = Field(description="Of the wheelset since new.", examples=[151200.0])
    left: ProfileFile = Field(description="Of the wheelset's own left wheel, also where it runs reversed.")
    right: ProfileFile
    std_mm: float = Field(
        default=0.1,
        gt=0.0,
        le=10.0,
        description="Std of the lateral displacement that follows from them at a rolling radius difference.",
        examples=[0.1],
    )
