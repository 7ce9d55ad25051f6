"""The words of the API: what a property means whose name has one meaning wherever it stands.

A property with a meaning of its own is described where it is declared; that wins over this list.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

WORDS: Mapping[str, str] = {
    "acknowledged": "Whether somebody has acknowledged it.",
    "acknowledged_at": "When it was acknowledged; null while it is not.",
    "acknowledged_by": "Who acknowledged it; null while nobody has.",
    "actor": "Who caused it: a person, a maintenance system, or `treadwatch` itself.",
    "amplitude_mm": "Amplitude of the lateral motion of the wheelset.",
    "axle": "Number of the axle on its vehicle, from 1 at the front.",
    "axle_offsets_m": "Distance of each axle behind the vehicle's reference point, from the first axle on.",
    "axles": "Number of axles.",
    "baseline": "Number of reprofilings before it: results of different baselines are not compared.",
    "axle_difference_mm": "Greatest difference of the diameters of the two wheels of an axle.",
    "bins": "The bin table.",
    "bogie_difference_mm": "Greatest difference of the diameters of any two wheels of a bogie.",
    "cut_mm": "Radius that a turning takes off at least.",
    "minimum_radius_mm": "Least radius of a wheel.",
    "vehicle_difference_mm": "Greatest difference of the diameters of any two wheels of a vehicle.",
    "cleared_at": "When the condition cleared; null while it has not.",
    "closed_at": "When it was closed; null while it is open.",
    "close_reason": "Why it was closed, as a sentence; null while it is open.",
    "close_reason_code": "Why it was closed; null while it is open.",
    "code": "Code, unique among its kind.",
    "code_version": "Version of the mathematics that computed it.",
    "condition": "What the data say now.",
    "content_digest": "Digest of the samples: the same digest is the same window.",
    "counts": "How many of what the run has handled.",
    "date_of_limit": "When the limit is reached.",
    "distance_to_limit_km": "Distance still to run until the limit is reached.",
    "display_state": "One word for a list on a screen.",
    "error": "First line of the error; null where it succeeded.",
    "event": "What happened.",
    "external_refs": "Identities that maintenance systems gave to their work on it.",
    "finished_at": "When it ended; null while it runs.",
    "first_failed_at": "When it failed first.",
    "fleet": "Code of the fleet.",
    "gauge_known": "Whether the track gauge along the section is on file.",
    "id": "Number, unique among its kind.",
    "input_digest": "Digest of everything that it was computed from.",
    "items": "The items of this page, in the order of the list.",
    "journeys": "The runs that it was found from.",
    "kind": "Which kind.",
    "last_failed_at": "When it failed last.",
    "last_seen_at": "When the data said so last.",
    "length_m": "Length of the section.",
    "max_speed_m_s": "Highest permitted speed.",
    "measured_at": "When it was measured.",
    "measured_from": "Beginning of the measurements, on the vehicle's clock.",
    "measured_to": "End of the measurements, on the vehicle's clock; not included.",
    "mileage_km": "Mileage of the wheelset since it was new.",
    "mounting": "Where it runs now; null where it is on no vehicle.",
    "mounted_from": "When the wheelset was mounted.",
    "mounted_to": "When the wheelset was taken off; null means that it still runs there.",
    "n_windows": "Number of windows behind it.",
    "name": "Name.",
    "nominal_gauge_mm": "Nominal track gauge.",
    "nominal_radius_mm": "Nominal rolling radius.",
    "note": "What the person who recorded it wrote.",
    "number": "Number of the section on the vehicle's bus.",
    "occurrence_count": "How many evaluations in a row or apart have found it.",
    "opened_at": "When the data said so for the first time.",
    "outcome": "How it ended.",
    "p10": "The 10 % quantile; null where it is beyond the horizon or unknown.",
    "p50": "The median; null where it is beyond the horizon or unknown.",
    "p90": "The 90 % quantile; null where it is beyond the horizon or unknown.",
    "parameter_key": "Digest of the parameters of its bin tables.",
    "parameters": "Settings that shaped it, each under its name.",
    "passes": "Number of passes.",
    "position": "Where it is under its vehicle; null where nothing is known of that.",
    "probability_1": "Probability that the condition holds; null where none is computed.",
    "quantity": "Which quantity.",
    "rail_inclination_1": "Inclination of the rails.",
    "rail_profile": "Name of the rail profile.",
    "reason": "Why there is no value, or what limits it, as a sentence; null where nothing does.",
    "reason_code": "The reason as a stable code; null where there is none.",
    "recorded_at": "When it was recorded, on the server's clock, in the order of commits.",
    "reprofiled_at": "When it was on the lathe.",
    "reprofilings": "Its visits to the lathe, oldest first.",
    "residual_rms_mm": "Root mean square of what the estimate leaves unexplained; null where unknown.",
    "rounds": "Rounds of the iteration.",
    "section": "Code of the track section.",
    "sensors": "The sensors of each node.",
    "serial": "Serial of the wheelset.",
    "severity": "How urgent it is.",
    "shelved_reason": "Why it is shelved; null while it is not.",
    "shelved_until": "Until when it is out of sight; null while it is not shelved.",
    "source": "Where it comes from.",
    "started_at": "When it began.",
    "state": "In which state it is.",
    "status": "Whether there is an estimate.",
    "track_section": "Code of the track section; null where none is known.",
    "trigger": "What started it.",
    "urgency": "How urgent it is, as a class.",
    "vehicle": "Code of the vehicle.",
    "vehicle_odometer_km": "Odometer of the vehicle at the time of mounting.",
    "version": "Version; each change makes the next.",
    "wheel_profile": "Name of the design profile of the wheels.",
    "wheelset": "Serial of the wheelset.",
    "work": "What was done to the sensors.",
    "worked_at": "When it was done.",
    "wheelset_mileage_km": "Mileage of the wheelset at the time of mounting.",
}
OF_SCHEMA: Mapping[str, str] = {
    "Alignment.alignment_std_mm": "Standard deviation of the alignment at each position; null where not known.",
    "Alignment.gauge_deviation_std_mm": "Standard deviation of the gauge deviation; null where not known.",
    "AlignmentSummary.points": "Number of positions.",
    "Event.alert": "The alert as it was right after.",
    "ExternalReference.ref": "The identity, as that system writes it.",
    "Geometry.conicity_by_amplitude": "Equivalent conicity at each amplitude (EN 15302).",
    "Geometry.equivalent_conicity_1": "Equivalent conicity at `equivalent_conicity_amplitude_mm`.",
    "Geometry.nonlinearity_parameter_per_mm": "Slope of the conicity against the amplitude at 3 mm (EN 15302).",
    "JobRun.duration_s": "How long it took; null while it runs.",
    "JobRun.job": "Name of the job.",
    "Journey.middle_m": "Middle of the section as the correction is counted from it; null where there is none.",
    "Problem.detail": "What went wrong this time.",
    "Problem.errors": "Each place that does not validate.",
    "Problem.type": "Stable name of the kind of problem, for programs to compare.",
    "ProblemItem.in": "Part of the request: `query`, `path`, `header` or `body`.",
    "Suspension.change": "The change against the vehicle's own past; null while too little is known.",
    "SuspensionShift.past_findings": "Findings before the change.",
    "SuspensionShift.recent_findings": "Findings since the change.",
    "Trend.limit_1": "The limit that the trend is compared with; null where there is none.",
    "Trend.points": "The points behind it.",
    "Trend.slope_1_per_1000_km": "Change per 1,000 km.",
    "Trend.slope_1_per_year": "Change per year.",
    "TrendPoints.measured_at": "When each point was measured.",
    "TrendPoints.mileage_km": "Mileage of each point; null where unknown.",
    "TrendPoints.std_1": "Standard deviation of each point.",
    "TrendPoints.value_1": "Value of each point.",
    "Window.quality": "What the gates looked at.",
    "WindowQuality.clipped_1": "Share of samples at the end of a sensor's range.",
    "WindowQuality.coverage_1": "Share of the window that has samples.",
    "WindowQuality.gaps": "Number of gaps.",
    "WindowQuality.invalid_1": "Share of samples that are marked invalid.",
    "WindowQuality.longest_gap_s": "Longest gap.",
    "WindowQuality.position_quality_1": "Share of the window whose position is known.",
    "WindowQuality.sensor_fault": "Whether a sensor reports a fault.",
    "WindowQuality.speed_max_m_s": "Highest speed.",
    "WindowQuality.speed_min_m_s": "Lowest speed.",
}


def describe_properties(schemas: Mapping[str, Any]) -> None:
    """Describe every property that is not described where it is declared and has a word here."""
    for name, schema in schemas.items():
        for field, described in schema.get("properties", {}).items():
            text = OF_SCHEMA.get(f"{name}.{field}", WORDS.get(field))
            if text is not None and "description" not in described:
                described["description"] = text


def undescribed(schemas: Mapping[str, Any]) -> list[str]:
    """Return the properties without a description, as ``Schema.property``."""
    return [
        f"{name}.{field}"
        for name, schema in schemas.items()
        for field, described in schema.get("properties", {}).items()
        if "description" not in described
    ]
