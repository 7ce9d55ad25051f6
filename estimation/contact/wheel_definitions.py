"""Wheel profiles as their standards define them. Millimetres; y to the field side from the tread datum, z down.

The tread datum is 70 mm from the flange back. Sources: EN 15302:2021 Annex I (wheels A, B, C, H, I; wheel C is the
BR P8 profile), UIC 510-2 / EN 13715 Annex C (S1002, flange height 28 mm, flange thickness 32.5 mm).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from estimation.contact.segments import Arc, Line, Polynomial, Segment

S1002_THROAT = (
    -4.320221063e3,
    -1.038384026e3,
    -1.065501873e2,
    -6.051367875,
    -2.054332446e-1,
    -4.169739389e-3,
    -4.687195829e-5,
    -2.252755540e-7,
)
S1002_TREAD = (
    0.0,
    -3.358537058e-2,
    1.565681624e-3,
    -2.810427944e-5,
    5.844240864e-8,
    -1.562379023e-8,
    5.309217349e-15,
    -5.957839843e-12,
    2.646656573e-13,
)
"""Coefficients of the S1002 between -35 and -26 mm, and from there to 32.158 mm."""


def _flange(face_end: float, centre_shift: tuple[float, float] = (0.0, 0.0), face_z: float = -93.5767) -> list[Segment]:
    """Return the S1002 flange as the EN 15302 wheels A, B, H and I print it; they differ in the last digits."""
    tip, outer = centre_shift
    return [
        Arc(-70.0, -62.7647, -49.5, 9.5193, 20.5, 1),
        Arc(-62.7647, -49.6625, -55.0, 16.0 + tip, 12.0, 1),
        Arc(-49.6625, -39.7645, -58.5583, 8.8349 + outer, 20.0, 1),
        Line(-39.7645, face_end, 0.0, face_z, -2.7475),
    ]


def _wheel_a() -> tuple[Segment, ...]:
    return (
        *_flange(-38.7372, (0.00065, 0.00066), -93.57685),
        Arc(-38.7372, -29.4591, -25.5816, 17.64215, 14.0, -1),
        Arc(-29.4591, -10.8749, -2.6594, 97.16493, 96.76055, -1),
        Arc(-10.8749, 18.4173, 18.4173, 344.50806, 345.0, -1),
        Line(18.4173, 30.0, 30.0, -0.49194, 0.0),
        Line(30.0, 60.0, 0.0, 1.50804, -0.066666),
        Line(60.0, 65.0, 0.0, 57.50808, -1.0),
    )


def _wheel_b() -> tuple[Segment, ...]:
    return (
        *_flange(-38.7879),
        Arc(-38.7879, -29.3505, -25.6322, 17.7814, 14.0, -1),
        Arc(-29.3505, -0.4787, 2.5204, 119.9745, 120.0, -1),
        Line(-0.4787, 30.0, 0.0, 0.0, -0.025),
        Line(30.0, 60.0, 0.0, 0.75, -0.05),
        Line(60.0, 65.0, 0.0, 57.75, -1.0),
    )


def _wheel_c() -> tuple[Segment, ...]:
    return (
        Line(-70.0, -69.4027, -69.40268, 21.39173, 7.11537),
        Arc(-69.4027, -59.5, -59.5, 20.00006, 10.0, 1),
        Arc(-59.5, -43.8048, -60.4941, 12.02753, 18.0, 1),
        Line(-43.8048, -41.0534, -41.05339, 11.96051, -2.47508685),
        Arc(-41.0534, -32.3621, -29.0, 16.830365, 13.0, -1),
        Arc(-32.3621, -17.587, -6.5, 100.870534, 100.0, -1),
        Arc(-17.587, 19.0, 19.0, 329.45258, 330.0, -1),
        Line(19.0, 29.0, 29.0, -0.54742374, 0.0),
        Line(29.0, 59.0, 29.0, -0.54742374, -0.1),
        Line(59.0, 65.0, 59.0, -3.54742374, -1.0),
    )


def _wheel_h() -> tuple[Segment, ...]:
    return (
        *_flange(-38.722),
        Arc(-38.722, -28.3119, -25.5663, 17.6003, 14.0, -1),
        Line(-28.3119, -10.2297, 0.0, -1.7902, -0.2),
        Line(-10.2297, 30.0, 0.0, 0.0, -0.025),
        Line(30.0, 60.0, 0.0, 1.251, -0.0667),
        Line(60.0, 65.0, 0.0, 57.249, -1.0),
    )


def _wheel_i() -> tuple[Segment, ...]:
    return (
        *_flange(-39.0486, (0.00054, 0.00055)),
        Arc(-39.0486, -29.9231, -25.8929, 18.49733, 14.0, -1),
        Arc(-29.9231, 5.0, 5.0, 119.895788082818, 120.0, -1),
        Line(5.0, 30.0, 5.0, -0.104211917182, 0.0),
        Line(30.0, 60.0, 0.0, 1.89679, -0.0667),
        Line(60.0, 65.0, 0.0, 57.89479, -1.0),
    )


def _s1002() -> tuple[Segment, ...]:
    return (
        Arc(-70.0, -62.764705882, -49.5, 9.519259302, 20.5, 1),
        Arc(-62.764705882, -49.662510381, -55.0, 16.0, 12.0, 1),
        Arc(-49.662510381, -39.764473993, -58.558326413, 8.834924130, 20.0, 1),
        Line(-39.764473993, -38.426669071, 0.0, -93.576667419, -2.747477419),
        Arc(-38.426669071, -35.0, -26.210665, 16.446, 13.0, -1),
        Polynomial(-35.0, -26.0, S1002_THROAT),
        Polynomial(-26.0, 32.15796, S1002_TREAD),
        Line(32.15796, 60.0, 0.0, 1.364323640, -0.066666667),
    )


WHEEL_DEFINITIONS: Mapping[str, Callable[[], tuple[Segment, ...]]] = MappingProxyType(
    {
        "P8": _wheel_c,
        "S1002": _s1002,
        "EN15302-A": _wheel_a,
        "EN15302-B": _wheel_b,
        "EN15302-C": _wheel_c,
        "EN15302-H": _wheel_h,
        "EN15302-I": _wheel_i,
    }
)
