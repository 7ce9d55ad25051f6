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


class VehicleChange(RegistryChange):
    """A vehicle as it is."""

    fleet: Key = Field(examples=["demo"])
    vehicle_class: Key = Field(description="Code of its class.", examples=["coach"])
    axles: int = Field(ge=1, le=8, examples=[4])
    max_speed_m_s: float = Field(ge=0.25, le=170.0, examples=[44.4])
    axle_offsets_m: list[Annotated[float, Field(ge=-1000.0, le=1000.0)]] = Field(
        min_length=1,
        max_length=8,
        description="Distance of each axle behind the position reference.",
        examples=[[2.0, 4.5, 16.0, 18.5]],
    )


class NewVehicle(VehicleChange):
    """A vehicle that is new."""

    code: Key = Field(description="As recordings are named.", examples=["V-101"])


class WheelsetChange(RegistryChange):
    """A wheelset as it is."""

    fleet: Key = Field(examples=["demo"])
    wheel_profile: Annotated[str, Field(min_length=1, max_length=200, pattern=TEXT)] = Field(
        description="Its design profile.", examples=["P8"]
    )
    nominal_radius_mm: float = Field(ge=100.0, le=1000.0, description="Not the diameter.", examples=[460.0])


class NewWheelset(WheelsetChange):
    """A wheelset that is new."""

    serial: Key = Field(examples=["WS-0001"])


class VehicleClassFile(RegistryChange):
    """A vehicle class, as a class file describes it."""

    text: str = Field(
        max_length=MOST_TEXT,
        description="Content of a vehicle class file (TOML): `treadwatch vehicle show coach` prints one to copy from.",
        examples=['format = "treadwatch-vehicle-class-1"'],
    )


class NewSensorChange(RegistryChange):
    """The sensors of an axle were exchanged or calibrated."""

    axle: int = Field(ge=1, le=8, examples=[2])
    worked_at: Moment = Field(description="On the vehicle's clock.", examples=["2026-03-01T06:00:00Z"])
    work: Literal["swap", "calibration"] = Field(examples=["swap"])
    removed: Note = Field(default="", description="Serial number of what was taken off.", examples=["N-0815"])
    fitted: Note = Field(default="", description="Serial number of what is there since.", examples=["N-0816"])
    note: Note = Field(default="", examples=["cable chafed"])


RecordKindName = Literal[
    "mounting", "reprofiling", "measurement", "wheelset", "section", "vehicle", "vehicle_class", "sensor_change"
]


class RecordDecision(Request):
    """Which record is voided or restored, and why."""

    kind: RecordKindName = Field(description="What kind of record.", examples=["reprofiling"])
    key: Key = Field(description="Serial of the wheelset; code of the vehicle, class or section.", examples=["WS-0001"])
    at: Moment | None = Field(
        default=None,
        description="Time of a mounting (`mounted_from`), reprofiling, measurement or sensor change.",
        examples=["2026-03-01T06:00:00Z"],
    )
    reason: str = Field(
        min_length=1, max_length=2000, pattern=TEXT, description="Kept for ever.", examples=["of another wheelset"]
    )
    by: Key | None = Field(
        default=None, description="Who; read only where access control is off.", examples=["j.smith"]
    )
