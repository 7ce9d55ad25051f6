"""Codes of reasons that were stored as sentences alone, by how those sentences read."""

from __future__ import annotations

import re
from functools import cache

from estimation.values.reasons import Reason, ReasonCode

# SQL patterns in the order in which they are tried; sentences of several reasons begin with the one that decides.
FORMER_REASONS: tuple[tuple[str, str], ...] = (
    ("the sensor reports a fault%", "sensor_fault"),
    ("%of the samples are clipped%", "clipped"),
    ("%of the samples can be used%", "too_few_usable"),
    ("%of the samples, % are needed%", "too_few_samples"),
    ("the track section is not known%", "section_unknown"),
    ("the position is not known well enough%", "position_unknown"),
    ("no sample with a position on the section%", "position_unknown"),
    ("the alignment of the track section is not known%", "alignment_unknown"),
    ("the vehicle stands or crawls%", "not_moving"),
    ("the vehicle runs both ways%", "both_directions"),
    ("the position jumps%", "position_jump"),
    ("the axes point against%", "axes_reversed"),
    ("no sample can be used%", "no_usable_sample"),
    ("a curve is felt%", "curve_detected"),
    ("the window lies in curves%", "in_curves"),
    ("no uninterrupted stretch%", "interrupted"),
    ("no sample inside the bins%", "outside_bins"),
    ("its position along the section is not certain%", "position_uncertain"),
    ("%too short for wavelengths%", "pass_too_short"),
    ("not of this section%", "other_section"),
    ("the mirror image of%", "mirrored"),
    ("its lateral displacement is%", "scale_differs"),
    ("its position is % away from the rest of its journey%", "apart_from_journey"),
    ("no pass%", "no_pass"),
    ("no place with%", "too_few_passes"),
    ("one wheelset alone%", "single_wheelset"),
    ("the passes are too alike%", "passes_alike"),
    ("too short, or where too few have passed%", "journey_indeterminate"),
    ("agrees with no other%", "journey_disagrees"),
    ("% m off, % m are searched%", "offset_too_large"),
    ("no journey agrees with another%", "no_journey_agrees"),
    ("not settled after%", "not_converged"),
    ("heard little%", "low_weight"),
    ("agrees with what the fleet has felt%", "survey_confirmed"),
    ("not used: it has no more in common%", "survey_unrelated"),
    ("not used: left and right are exchanged%", "survey_mirrored"),
    ("not used: it is % times what%", "survey_unit"),
    ("not used: it lies%", "survey_displaced"),
    ("not used: it differs%", "survey_differs"),
    ("the fleet does not know enough%", "survey_not_assessable"),
    ("% blocks of data", "too_few_blocks"),
    ("too few bins around the centre%", "too_few_bins"),
    ("amplitude % is not covered%", "amplitude_not_covered"),
    ("no amplitude is covered%", "amplitude_not_covered"),
    ("band-limited signals carry no offset%", "offset_not_observable"),
    ("rL - rR has no zero%", "no_zero_crossing"),
    ("no finite number%", "not_finite"),
    ("no geometry since the last reprofiling%", "no_geometry_since_reprofiling"),
    ("no geometry yet%", "no_geometry"),
    ("no interval has an equivalent conicity%", "no_conicity"),
    ("%points since the last reprofiling%", "too_few_points"),
    ("%the points span%", "span_too_short"),
    ("all points have one date%", "single_date"),
    ("at % mm, the largest amplitude%", "other_amplitude"),
    ("%intervals do not cover it%", "intervals_left_out"),
    ("%windows, % needed%", "too_few_windows"),
    ("%points, % needed%", "too_few_points"),
    ("no data since it was mounted%", "no_data_since_mounting"),
    ("no usable data for too long%", "no_recent_data"),
    ("the sensor is faulty%", "sensor_faulty"),
    ("the wheelset is not the one on file%", "identity_doubtful"),
    ("no TIME frame in it or beside it%", "waits_for_time"),
    ("no vehicle %", "vehicle_unknown"),
)


def former_code(text: str) -> str | None:
    """Return the code of a sentence that was stored without one; None where nothing was stored.

    Parameters
    ----------
    text
        The sentence as stored.
    """
    if not text:
        return None
    return next((code for pattern, code in _patterns() if pattern.fullmatch(text)), "other")


def former_reason(text: str) -> Reason | None:
    """Return a reason that was stored as a sentence alone; None where the sentence is empty.

    Parameters
    ----------
    text
        The sentence as stored.
    """
    code = former_code(text)
    return None if code is None else Reason(ReasonCode(code), text)


@cache
def _patterns() -> list[tuple[re.Pattern[str], str]]:
    return [
        (re.compile(".*".join(map(re.escape, pattern.split("%"))), re.DOTALL), code) for pattern, code in FORMER_REASONS
    ]
