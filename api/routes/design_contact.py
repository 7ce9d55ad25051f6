"""Contact geometry that follows from known profiles: of the design, or of a measurement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from fastapi import APIRouter, Response
from pydantic import Field

from api.answers import answer_payload, table_payload
from api.asking import AskedDep, Serial
from api.contract import TABLE, Accepted
from api.problems import described
from api.schemas.common import Derived, Links, Representation, finite, finite_list, segment, uncertain
from api.schemas.geometry import ConicityAtAmplitude
from api.services import Services
from estimation.accuracy.wheel_contact import RailShare, WheelContact, WheelPair
from estimation.contact.profiles import wheel_profile
from estimation.errors import ProfileError
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.measured_wheelsets import ComparisonReader
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from estimation.values.units import IN_MM
from fleet_db.storage import SqlUnitOfWork

SHOWN = 8e-3  # m of lateral displacement
DECIMALS = 6  # of millimetres: a nanometre


class Rails(Derived, of=RailShare):
    """Rails as they are laid on some of the track."""


class ContactCurve(Representation):
    """Rolling radii over the lateral displacement, column by column; null where both wheels have no contact."""

    lateral_displacement_mm: list[float | None] = Field(
        description="Of the wheelset's middle from the track centre, positive to the left."
    )
    rolling_radius_sum_mm: list[float | None] = Field(description="rL + rR.")
    rolling_radius_difference_mm: list[float | None] = Field(description="rL - rR.")
    rolling_radius_difference_std_mm: list[float | None] = Field(
        description="Standard deviation of rL - rR that follows from that of the measurement; 0 for a drawing."
    )


class ProfileContact(Representation):
    """What two wheel profiles give on the rails that the wheelset runs on; it does not roll, as in EN 15302."""

    status: Status
    reason: str | None
    reason_code: ReasonCode | None
    rails: list[Rails] = Field(description="Kinds of rails that it runs on; empty where there is no contact geometry.")
    curve: ContactCurve | None = Field(description="Null where there is no contact geometry.")
    zero_crossing_mm: float | None = Field(
        description="Lateral displacement at which both rolling radii are equal; null where there is none."
    )
    conicity_by_amplitude: list[ConicityAtAmplitude] = Field(
        description="Equivalent conicity at each amplitude (EN 15302); `n_windows` is 0: no running is behind it."
    )


class DesignContact(Representation):
    """Contact geometry of the wheelset's design profile: what it was when new, or last reprofiled."""

    wheelset: str = Field(examples=["WS-0001"])
    wheel_profile: str = Field(examples=["S1002"])
    nominal_radius_mm: float = Field(examples=[460.0])
    contact: ProfileContact = Field(description="On the rails that the current estimate is of.")
    links: Links


def profile_contact(contact: WheelContact | Reason) -> ProfileContact:
    """Return the representation of a contact geometry, or of why there is none."""
    if isinstance(contact, Reason):
        return ProfileContact(
            status=Status.UNESTIMATED,
            reason=contact.text,
            reason_code=contact.code,
            rails=[],
            curve=None,
            zero_crossing_mm=None,
            conicity_by_amplitude=[],
        )
    return ProfileContact(
        status=Status.ESTIMATED,
        reason=None,
        reason_code=None,
        rails=[Rails.made(share) for share in contact.rails],
        curve=_curve(contact),
        zero_crossing_mm=finite(contact.zero_crossing, IN_MM),
        conicity_by_amplitude=[
            ConicityAtAmplitude(amplitude_mm=round(float(a) * IN_MM, 3), equivalent_conicity_1=uncertain(conicity))
            for a, conicity in zip(contact.amplitude, contact.conicity, strict=True)
        ],
    )


def table(contact: ProfileContact) -> tuple[Sequence[str], list[Sequence[object]]]:
    """Return the curve as a header and rows."""
    header = list(ContactCurve.model_fields)
    if contact.curve is None:
        return header, []
    return header, list(zip(*(getattr(contact.curve, name) for name in header), strict=True))


def _curve(contact: WheelContact) -> ContactCurve:
    shown = np.abs(contact.displacement) <= SHOWN + 1e-9

    def column(values: np.ndarray) -> list[float | None]:
        return finite_list(np.round(values[shown] * IN_MM, DECIMALS) + 0.0)

    return ContactCurve(
        lateral_displacement_mm=column(contact.displacement),
        rolling_radius_sum_mm=column(contact.radius_sum),
        rolling_radius_difference_mm=column(contact.radius_difference),
        rolling_radius_difference_std_mm=column(contact.radius_difference_std),
    )


router = APIRouter(prefix="/v1", tags=["accuracy"])


@router.get("/wheelsets/{serial}/contact", response_model=DesignContact, responses={**described(404), **TABLE})
def get_design_contact(asked: AskedDep, accepted: Accepted, serial: Serial) -> Response:
    """Return rolling radii and conicity of the wheelset's design profile; as `text/csv`, the curve alone."""
    with asked.read() as unit:
        wheelset = unit.registry.wheelset(serial)
        rails = comparison_reader(asked.services, unit).rails(serial, unit.geometries.current(serial))
        design = _design(asked.services, wheelset, rails)
    path = f"/v1/wheelsets/{segment(wheelset.serial)}"
    body = DesignContact(
        wheelset=wheelset.serial,
        wheel_profile=wheelset.wheel_profile,
        nominal_radius_mm=wheelset.nominal_radius_m * IN_MM,
        contact=profile_contact(design),
        links={"self": f"{path}/contact", "wheelset": path, "geometry": f"{path}/geometry"},
    )
    return answer_payload(asked.request, table_payload(body, accepted, lambda shown: table(shown.contact)), accepted)


def _design(services: Services, wheelset: WheelsetRecord, rails: Sequence[RailShare]) -> WheelContact | Reason:
    try:
        design = wheel_profile(wheelset.wheel_profile)
    except ProfileError as error:
        return Reason(ReasonCode.CONTACT_IMPOSSIBLE, str(error))
    return services.contacts.contact(WheelPair(design, design, wheelset.nominal_radius_m), rails)


def comparison_reader(services: Services, unit: SqlUnitOfWork) -> ComparisonReader:
    """Return what compares measurements with the estimates of their dates."""
    return ComparisonReader(unit, services.contacts.contact, EstimationSettings().interval_km)
