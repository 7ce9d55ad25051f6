"""Why something is refused, unknown or ended: a stable code that programs compare, and a sentence that people read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self


class ReasonCode(StrEnum):
    """Why a value is missing, restricted or no longer valid; stored and served beside its sentence.

    A code never changes its meaning. ``meaning`` is what the code stands for, and what to do where that is known.
    """

    meaning: str

    def __new__(cls, code: str, meaning: str = "") -> Self:
        """Return the member of a code with its meaning."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.meaning = meaning
        return member

    @property
    def remedy(self) -> str:
        """What to do: what follows the first sentence of the meaning; empty where there is nothing to do."""
        return self.meaning.partition(". ")[2]

    # window
    SENSOR_FAULT = "sensor_fault", "The sensor reports a failed self-test or an emergency. Check or replace the sensor."
    TOO_FEW_SAMPLES = "too_few_samples", "Too many samples are missing. Check the bus and the recorder."
    CLIPPED = "clipped", "Too many samples are at the limit of the sensor's range. Check its mounting and range."
    HUNTING = (
        "hunting",
        "The wheelset hunts, and drives the sensor to its limits. Check yaw dampers and wheel profiles.",
    )
    WHEEL_FLAT = (
        "wheel_flat",
        "A wheel strikes once a turn, and drives the sensor to its limits. Inspect the treads of the wheelset.",
    )
    SECTION_UNKNOWN = "section_unknown", "The vehicle is on no section of the registry. Register the section."
    POSITION_UNKNOWN = (
        "position_unknown",
        "No sample, or too few, has a position on the section. Check the position source.",
    )
    FILE_DAMAGED = "file_damaged", "The file of the samples is missing or damaged. Receive the recording again."
    CLASS_UNKNOWN = "class_unknown", "The class of the vehicle is not on file. Register it; the window waits for it."
    ALIGNMENT_UNKNOWN = (
        "alignment_unknown",
        "The alignment of the section is not known yet, and the window waits. Survey it, or wait for more passes.",
    )
    WAITS_FOR_ESTIMATION = (
        "waits_for_estimation",
        "The window has not been estimated yet. Run `treadwatch estimate`, or let `treadwatch schedule` run.",
    )
    WAITS_FOR_POSITION = (
        "waits_for_position",
        "The place of the window on the section is not found yet. Let `refresh_alignment` run; more passes help it.",
    )
    NOT_MOVING = "not_moving", "The vehicle stands, or runs too slowly."
    BOTH_DIRECTIONS = "both_directions", "The vehicle runs both ways along the section within the window."
    POSITION_JUMP = (
        "position_jump",
        "The position changes by another distance than the speed makes of it. Check the position source.",
    )
    AXES_REVERSED = "axes_reversed", "The sensor axes contradict those of other nodes. Check the mounting of the node."
    SENSOR_TURNED = (
        "sensor_turned",
        "A sensor is turned against the axes of the vehicle, or two are exchanged. Check its mounting and its offset.",
    )
    NO_USABLE_SAMPLE = "no_usable_sample", "No sample is valid, on known track, fast enough and outside curves."
    CURVE_DETECTED = "curve_detected", "A curve is detected and no layout is stored. Register the section's layout."
    IN_CURVES = "in_curves", "All of the window is in curves."
    INTERRUPTED = "interrupted", "No uninterrupted run of samples is long enough for the filters."
    TOO_FEW_USABLE = "too_few_usable", "Too few samples are left after filtering."
    OUTSIDE_BINS = (
        "outside_bins",
        "No lateral displacement is within the range of the bins. Check the scale of the sensors.",
    )
    FRAME_UNKNOWN = (
        "frame_unknown",
        "The yaw of the bogie frame is not known: a node has no window, or its frame sensor is dead. Check it.",
    )
    MOUNTING_DIFFERS = (
        "mounting_differs",
        "The registry has another wheelset there by now. The window is made again once its recording can be read.",
    )
    ODOMETER_IMPLAUSIBLE = (
        "odometer_implausible",
        "The odometer contradicts speed, mounting or other windows. Where it was exchanged, register a new mounting.",
    )
    PLACE_IMPLAUSIBLE = (
        "place_implausible",
        "GNSS is not where the section is that the vehicle reports. Check the section's number and its coordinates.",
    )
    AXLE_DISTANCE = (
        "axle_distance",
        "The track reaches the axles of the bogie unlike their distance on file. Check nodes, axle offsets and class.",
    )
    # position and pass
    POSITION_UNCERTAIN = (
        "position_uncertain",
        "The position along the section could not be confirmed. Wait for more passes, or check the position source.",
    )
    PASS_TOO_SHORT = "pass_too_short", "The pass is shorter than the filters need."
    OTHER_SECTION = "other_section", "The pass does not match the section. Check what the vehicle reports as section."
    MIRRORED = "mirrored", "Left and right are exchanged. Check the mounting record and the signs."
    SCALE_DIFFERS = "scale_differs", "The lateral displacement has another scale. Check the sensor's unit and range."
    APART_FROM_JOURNEY = "apart_from_journey", "The position of the pass does not fit the rest of its journey."
    # section
    NO_PASS = "no_pass", "No pass of the section can be used."
    TOO_FEW_PASSES = "too_few_passes", "No place of the section has enough passes yet."
    SINGLE_WHEELSET = "single_wheelset", "One wheelset alone cannot separate the track from its own geometry."
    PASSES_ALIKE = "passes_alike", "The passes differ too little to separate track and wheelsets."
    STIFFNESS_OPEN = (
        "stiffness_open",
        "In so stiff a bogie the passes cannot separate track and wheelsets. Survey the section.",
    )
    JOURNEY_INDETERMINATE = "journey_indeterminate", "The journey is too short, or too few others passed there."
    JOURNEY_DISAGREES = "journey_disagrees", "The journey agrees with no other."
    OFFSET_TOO_LARGE = (
        "offset_too_large",
        "The position error is larger than what is searched. Check the position source.",
    )
    NO_JOURNEY_AGREES = "no_journey_agrees", "No journey agrees with another."
    NOT_CONVERGED = "not_converged", "The iteration ended before it converged."
    LOW_WEIGHT = "low_weight", "Some wheelsets fit no single curve and have a low weight."
    # survey
    SURVEY_CONFIRMED = "survey_confirmed", "The survey agrees with what the fleet measures."
    SURVEY_NOT_ASSESSABLE = (
        "survey_not_assessable",
        "The fleet does not know enough of the section to check the survey.",
    )
    SURVEY_UNRELATED = "survey_unrelated", "The survey has nothing in common with the section. Check which it is of."
    SURVEY_UNIT = "survey_unit", "The survey has another unit. Register it again in the right unit."
    SURVEY_MIRRORED = "survey_mirrored", "The survey has left and right exchanged. Register it with the other sign."
    SURVEY_DISPLACED = "survey_displaced", "The survey is displaced along the section. Check its zero point."
    MODEL_CONTRADICTED = (
        "model_contradicted",
        "The passes fit the equations of their vehicles on this survey badly. Check parameters, survey and positions.",
    )
    SURVEY_GAUGE_UNRELATED = (
        "survey_gauge_unrelated",
        "The gauge on file is not that of the section. Check which section and date it is of.",
    )
    SURVEY_GAUGE_UNIT = "survey_gauge_unit", "The gauge on file has another scale. Register it again in the right unit."
    # creep forces and adhesion
    LOW_ADHESION = (
        "low_adhesion",
        "The window is on rails of so little friction that creep is not linear. It is left out of the geometry.",
    )
    CREEP_TOO_SMALL = (
        "creep_too_small",
        "The creep forces are too small to show the friction: there is only a lower bound.",
    )
    PROFILES_UNKNOWN = (
        "profiles_unknown",
        "The profiles on file do not have the rolling radius difference that was measured. Check wheel and rail.",
    )
    FRICTION_DIFFERS = (
        "friction_differs",
        "It shows another friction than the others at the same places. Check load, yaw spring and sensors.",
    )
    NO_CREEP_CURVE = "no_creep_curve", "The rolling radius difference of the wheelset is not known well enough yet."
    # dampers
    DAMPER_NOT_ON_FILE = (
        "damper_not_on_file",
        "The class has no lateral damper on file, so that there is nothing to compare with. Register its damping.",
    )
    SUSPENSION_UNCERTAIN = (
        "suspension_uncertain",
        "The springs or masses of the class are known too badly to judge its damper. Register them with smaller stds.",
    )
    DAMPER_NOT_EXCITED = (
        "damper_not_excited",
        "What is above the wheelsets moves too little, or too unlike its class, to show the damper.",
    )
    # geometry
    TOO_FEW_BLOCKS = "too_few_blocks", "Too few blocks of running time for an interval."
    TOO_FEW_BINS = "too_few_bins", "Too few bins around the centre have samples."
    CONICITY_OPEN = (
        "conicity_open",
        "The data leave the conicity open. A survey of the section, its gauge included, or more passes narrow it down.",
    )
    YAW_SPRING_DIFFERS = (
        "yaw_spring_differs",
        "The wheelset yaws as on another yaw suspension. Check the vehicle's class, wheelbase and order of the nodes.",
    )
    MOTION_UNEXPLAINED = (
        "motion_unexplained",
        "The motion follows neither track nor wheels. Check the vehicle's class, the track and the sensors.",
    )
    ROLLING_RADIUS_DIFFERS = (
        "rolling_radius_differs",
        "The wheelset rolls as on wheels of another radius. Check the nominal radius on file.",
    )
    ROLLING_RADIUS_OPEN = (
        "rolling_radius_open",
        "The motion does not confirm the nominal radius on file. Put its std on file, as measured or as wheels wear.",
    )
    SAMPLES_PURGED = (
        "samples_purged",
        "What it rests on was corrected after its samples had been purged, so that it cannot be estimated again.",
    )
    AMPLITUDE_NOT_COVERED = "amplitude_not_covered", "The wheelset has not moved as far as this amplitude."
    OFFSET_NOT_OBSERVABLE = "offset_not_observable", "Band-limited signals carry no constant offset."
    NO_ZERO_CROSSING = "no_zero_crossing", "rL - rR has no zero in the range covered."
    DIVERGED = (
        "diverged",
        "The filter does not follow the motion: its innovations contradict its covariance. Check class and sensors.",
    )
    NOT_FINITE = "not_finite", "The calculation gave no finite number."
    # wear signature
    OTHER_VEHICLE_CLASS = (
        "other_vehicle_class",
        "The library entry is of another class of vehicle, or of the other axle of a bogie.",
    )
    OTHER_PROFILES = (
        "other_profiles",
        "The library entry is of other design profiles of wheel or rail.",
    )
    SAME_WHEELSET = (
        "same_wheelset",
        "The library entry is of the judged wheelset, or shares samples with it.",
    )
    JUDGED_TOGETHER = (
        "judged_together",
        "The library entry is of a wheelset that is judged by the same library, in which none of both may be.",
    )
    NEWER_ENTRIES = "newer_entries", "The library has as many newer entries of the place as it needs."
    SECTION_CHANGED = (
        "section_changed",
        "The track has changed there since, by tamping or other work. New passes make new library entries.",
    )
    WHEELSET_TURNED = (
        "wheelset_turned",
        "The wheelset was turned between the signature and what is known of its wheels.",
    )
    LIBRARY_TOO_SMALL = (
        "library_too_small",
        "The library has too few wheelsets of this class and of known conicity. Measure profiles, or survey a section.",
    )
    LIBRARY_ALIKE = "library_alike", "The wheelsets of the library are all alike: nothing can be learned from them."
    NOT_IN_LIBRARY = (
        "not_in_library",
        "The signature is unlike everything in the library, in speed, conicity, profiles or track.",
    )
    NO_SIGNATURE = "no_signature", "There is no signature of the wheelset since it was last turned."
    METHODS_DISAGREE = (
        "methods_disagree",
        "Signature and geometry differ by more than their intervals. Measure the profiles.",
    )
    # trend
    NO_GEOMETRY = "no_geometry", "There is no geometry yet."
    NO_GEOMETRY_SINCE_REPROFILING = "no_geometry_since_reprofiling", "There is no geometry since the last reprofiling."
    NO_CONICITY = "no_conicity", "No mileage interval has an equivalent conicity."
    TOO_FEW_POINTS = "too_few_points", "The trend has too few points since the last reprofiling."
    SPAN_TOO_SHORT = "span_too_short", "The points of the trend span too little mileage."
    SINGLE_DATE = "single_date", "All points of the trend have one date."
    AMPLITUDE_EXTRAPOLATED = (
        "amplitude_extrapolated",
        "The motion does not cover 3 mm: the conicity there is extrapolated with what worn wheels like it do.",
    )
    AMPLITUDE_NOT_COMPARABLE = (
        "amplitude_not_comparable",
        "The limit is for 3 mm and the conicity there is not known: nothing is said about the limit.",
    )
    OTHER_AMPLITUDE = "other_amplitude", "The trend is at another amplitude than 3 mm, which too few intervals cover."
    BEHIND_STEP = (
        "behind_step",
        "The conicity changed at once: the trend begins there and rests on few intervals. Register what happened.",
    )
    INTERVALS_LEFT_OUT = "intervals_left_out", "Some mileage intervals do not cover the trend's amplitude."
    BEYOND_HORIZON = "beyond_horizon", "The limit is not reached within the forecast horizon."
    # alert
    TOO_FEW_WINDOWS = "too_few_windows", "Fewer windows than the rule needs."
    NO_DATA_SINCE_MOUNTING = "no_data_since_mounting", "There are no data since the wheelset was mounted."
    NO_RECENT_DATA = "no_recent_data", "There have been no usable data for too long."
    SENSOR_FAULTY = "sensor_faulty", "The sensor is faulty according to the sensor fault rule."
    IDENTITY_DOUBTFUL = "identity_doubtful", "The wheelset is not the recorded one, or is mounted the other way round."
    # worklist
    LIMIT_EXCEEDED = "limit_exceeded", "The conicity limit is exceeded. Turn the wheelset, or measure its profiles."
    LIMIT_AHEAD = "limit_ahead", "The conicity limit is forecast to be reached."
    ALERT_OPEN = "alert_open", "An alert of the wheelset is open."
    NOT_MOUNTED = "not_mounted", "The wheelset runs under no vehicle."
    # estimate against measurement
    CONTACT_IMPOSSIBLE = (
        "contact_impossible",
        "The wheels have no contact with the rails. Check the profiles, and the rails of the section.",
    )
    PROFILE_INCOMPLETE = "profile_incomplete", "The profile does not show this measure. Measure flange and tread whole."
    MEASURES_NOT_OBSERVABLE = (
        "measures_not_observable",
        "Accelerations show how wheels roll, not how high or thick they are. Measure the profiles.",
    )
    NO_ESTIMATE_NEAR = (
        "no_estimate_near",
        "There is no estimate of the same profile within an interval of mileage of the measurement.",
    )
    # rails
    RAILS_NOT_CONNECTED = (
        "rails_not_connected",
        "No wheelset runs on this section and on another, so that wheels and rails cannot be parted.",
    )
    RAILS_LEVEL_OPEN = (
        "rails_level_open",
        "Only differences of sections are known. Name a section whose rails are as on file, or measure profiles.",
    )
    REFERENCE_WHEEL_APART = (
        "reference_wheel_apart",
        "The wheel as designed is too unlike the wheels that run on the section. Wait for wheels near it there.",
    )
    RAILS_INTERACT = (
        "rails_interact",
        "What rails add differs from wheel to wheel there, as next to contact jumps: they cannot be parted.",
    )
    TOO_FEW_WHEELSETS = "too_few_wheelsets", "Too few wheelsets connect the section to its reference."
    CONTACT_JUMP_NEAR = (
        "contact_jump_near",
        "The wheel as designed is next to a contact jump there: wheels and rails cannot be parted.",
    )
    TONNAGE_UNKNOWN = (
        "tonnage_unknown",
        "The traffic of the section is not on file. Register its `tonnage_mgt_per_year`.",
    )
    KNOWN_RAILS_DIFFER = (
        "known_rails_differ",
        "Sections that are named as known differ in their rails. Look at them; name those that are as on file.",
    )
    KNOWN_RAILS_OTHER = (
        "known_rails_other",
        "The section is named as known, but has other rails on file than those that all are compared with.",
    )
    KNOWN_RAILS_OTHER_TIME = (
        "known_rails_other_time",
        "The section is named as known for another time than it was run on. Look at its rails again; name the date.",
    )
    MEASURED_WHEELS_DIFFER = (
        "measured_wheels_differ",
        "Measured profiles contradict each other, or known rails. Check which wheelset they are of; measure again.",
    )
    TREND_NOT_A_LINE = (
        "trend_not_a_line",
        "The excess of the section changes otherwise than evenly, as where rails are ground or replaced.",
    )
    TOO_FEW_PERIODS = "too_few_periods", "Too few periods of the section are known for a trend. Wait."
    RAILS_ARE_REFERENCE = (
        "rails_are_reference",
        "The section is named as known: it is what others are compared with, and nothing is measured of its rails.",
    )
    CELL_DAMAGED = (
        "cell_damaged",
        "A stored conicity of a wheelset on the section is damaged. It is made again from the bin tables by itself.",
    )
    PROFILE_UNKNOWN = "profile_unknown", "The profile on file is none that is built in. Nothing follows from its name."
    # recording
    LOG_DAMAGED = "log_damaged", "The recording is truncated, damaged or no log. Send it again."
    CLOCK_IMPLAUSIBLE = (
        "clock_implausible",
        "The vehicle's clock contradicts ours or itself. Set the wrong one; try the recording again if it was ours.",
    )
    VEHICLE_UNKNOWN = "vehicle_unknown", "The registry does not contain the vehicle. Register it; then decode again."
    WAITS_FOR_DECODING = (
        "waits_for_decoding",
        "The recording is received and safe. The next run of `assemble_windows`, or a worker, decodes it.",
    )
    WAITS_FOR_TIME = "waits_for_time", "The recording has no TIME frame and waits for the recording next to it."
    SET_ASIDE = "set_aside", "The recording was set aside by hand. Restore it to count it again."
    DELETED = "deleted", "The recording was deleted by hand. To take it in again, say so at its ingest."
    # passing faults, and failures of the program
    WAITS_FOR_STORAGE = (
        "waits_for_storage",
        "The disk is full, not mounted or not permitted. Mend that; what waits is tried again by itself.",
    )
    WAITS_FOR_EXTRA = "waits_for_extra", "An extra is not installed. Install it; what waits is tried again by itself."
    WAITS_FOR_MEMORY = "waits_for_memory", "The system had no memory left. What waits is tried again by itself."
    CONFLICT = "conflict", "It contradicts what is stored, or what was changed meanwhile. It is tried again by itself."
    WORKERS_ENDED = (
        "workers_ended",
        "Three worker processes ended while they worked at it. Report the log; it is tried again by itself.",
    )
    PROCESSING_FAILED = (
        "processing_failed",
        "The program failed at it. It is in quarantine and tried again at growing intervals; see the log.",
    )


@dataclass(frozen=True, slots=True)
class Reason:
    """A code and its sentence with the facts. The code decides; the sentence is for people and may be reworded."""

    code: ReasonCode
    text: str

    def __str__(self) -> str:
        """Return the sentence."""
        return self.text


def combined(reasons: Sequence[Reason | None]) -> Reason | None:
    """Return several reasons as one: the code of the first and all sentences; None where there is none.

    Args:
        reasons: The most important one first.
    """
    given = [reason for reason in reasons if reason is not None]
    return replace(given[0], text="; ".join(reason.text for reason in given)) if given else None


def prefixed(text: str, reason: Reason) -> Reason:
    """Return ``reason`` with ``text`` in front of its sentence."""
    return replace(reason, text=f"{text}{reason.text}")


def text_of(reason: Reason | None) -> str | None:
    """Return the sentence; None where there is no reason."""
    return None if reason is None else reason.text


def code_of(reason: Reason | None) -> ReasonCode | None:
    """Return the code; None where there is no reason."""
    return None if reason is None else reason.code
