"""Units, and constants of physics and mathematics: each stands here and nowhere else."""

from __future__ import annotations

import math

SECOND_NS = 1_000_000_000
HOUR_NS = 3_600 * SECOND_NS
DAY_NS = 24 * HOUR_NS
YEAR_NS = 365.25 * DAY_NS  # of the Julian calendar
LATEST_NS = 2**63 - 1  # what a column of times holds
HOUR_S = 3_600.0
DAY_S = 24.0 * HOUR_S
MILLIMETRE = 1e-3  # m
IN_MM = 1e3  # mm in a metre
KM_H_IN_M_S = 3.6  # km/h in one m/s

GRAVITY = 9.81  # m/s2
STEEL_SHEAR_MODULUS = 8.2e10  # N/m2, of wheel and rail
STEEL_POISSON_RATIO = 0.28

NORMAL_95 = 1.959963984540054  # stds on both sides of the mean that hold 95 % of a normal variable
NORMAL_90 = 1.2816  # stds above the mean that hold 90 % of one
STD_PER_MAD = 1.4826  # std of a normal variable over its median absolute deviation
MAD_PER_STD = 0.6745
MEDIAN_SQUARE = 0.4549  # median of the square of a standard normal variable
MEDIAN_ERROR = 1.2533  # std of a median over that of a mean
MEDIAN_VARIANCE = math.pi / 2.0  # variance of a median over that of a mean
