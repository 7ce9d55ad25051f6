"""What a contact geometry is of, and the one number that is compared with a limit: for every form it is written in."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.alerts.rules.conicity_limit import ANY_CLASS, ConicityLimitRule
from estimation.contact.geometry import WheelsetOnTrack
from estimation.trend.extrapolation import LIMIT_AMPLITUDE


@dataclass(frozen=True, slots=True)
class ContactSummary:
    """Wheel, rail, gauge, and the equivalent conicity at 3 mm beside the shipped limit.

    Args:
        inclination: Of the rails, as it was written.
        conicity, std: Equivalent conicity at 3 mm and its standard deviation; None where the contact gives none.
        limit: Of the equivalent conicity at 3 mm, by the shipped rules, which the operator confirms; None where there
            is none.
    """

    wheel_left: str
    wheel_right: str
    rail: str
    inclination: str
    gauge_mm: float
    method: str
    conicity: float | None
    std: float | None
    speed_km_h: float
    limit: float | None

    @property
    def title(self) -> str:
        """Return it in one line."""
        wheels = self.wheel_left if self.wheel_left == self.wheel_right else f"{self.wheel_left} / {self.wheel_right}"
        return f"{wheels} on {self.rail} {self.inclination}, gauge {self.gauge_mm:g} mm, {self.method}"

    @property
    def verdict(self) -> str:
        """Return the conicity at 3 mm beside the limit."""
        value = "unknown" if self.conicity is None else f"{self.conicity:.3f}"
        if self.limit is None:
            return f"at 3 mm: {value}; no limit at {self.speed_km_h:g} km/h"
        return f"at 3 mm: {value}; limit {self.limit:.3f} at {self.speed_km_h:g} km/h"

    def columns(self) -> dict[str, str | float | None]:
        """Return it as columns that are the same in every row of a table."""
        return {
            "wheel_left": self.wheel_left,
            "wheel_right": self.wheel_right,
            "rail": self.rail,
            "inclination": self.inclination,
            "gauge_mm": self.gauge_mm,
            "method": self.method,
            "equivalent_conicity_at_3_mm_1": self.conicity,
            "equivalent_conicity_at_3_mm_std_1": self.std,
            "limit_1": self.limit,
            "limit_speed_km_h": self.speed_km_h,
        }


def contact_summary(
    wheelset: WheelsetOnTrack,
    inclination: str,
    method: str,
    at_limit_amplitude: tuple[float | None, float | None],
    speed_km_h: float,
) -> ContactSummary:
    """Return what a contact geometry is of.

    Args:
        inclination: Of the rails, as it was written.
        at_limit_amplitude: Equivalent conicity at 3 mm and its standard deviation; None where the contact gives none.
    """
    return ContactSummary(
        wheel_left=wheelset.left_wheel.name,
        wheel_right=wheelset.right_wheel.name,
        rail=wheelset.left_rail.name,
        inclination=inclination,
        gauge_mm=round(wheelset.gauge * 1e3, 6),
        method=method,
        conicity=at_limit_amplitude[0],
        std=at_limit_amplitude[1],
        speed_km_h=speed_km_h,
        limit=ConicityLimitRule().limit_at(ANY_CLASS, speed_km_h),
    )


AMPLITUDE_MM = LIMIT_AMPLITUDE * 1e3
