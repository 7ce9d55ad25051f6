"""Why something is refused, unknown or ended: a stable code that programs compare, and a sentence that people read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from enum import EnumType, StrEnum
from typing import Any, Self

from estimation.values.units import SECOND_NS


class _CodesByName(EnumType):
    """What is assigned to a member is its meaning; its code is its name in lower case."""

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: Any, **rest: Any) -> _CodesByName:  # noqa: ANN401
        """Return the class."""
        for member in [key for key in namespace if key.isupper()]:
            dict.__setitem__(namespace, member, (member.lower(), namespace[member]))
        return super().__new__(cls, name, bases, namespace, **rest)


class MeaningEnum(StrEnum, metaclass=_CodesByName):
    """Codes with their ``meaning``: ``HUNTING = "The wheelset hunts."`` has the code "hunting"."""

    meaning: str

    def __new__(cls, code: str, meaning: str = "") -> Self:
        """Return the member of a code with its meaning."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.meaning = meaning
        return member


class ReasonCode(MeaningEnum):
    """Why a value is missing, restricted or not valid any more; a code never changes its ``meaning``."""

    @property
    def remedy(self) -> str:
        """What to do: what follows the first sentence of the meaning; empty where there is nothing to do."""
        return self.meaning.partition(". ")[2]

    # window
    SENSOR_FAULT = "The sensor reports a failed self-test or an emergency. Check or replace the sensor."
    TOO_FEW_SAMPLES = "Too many samples are missing. Check the bus and the recorder."
    CLIPPED = "Too many samples are at the limit of the sensor's range. Check its mounting and range."
    HUNTING = "The wheelset hunts, and drives the sensor to its limits. Check yaw dampers and wheel profiles."
    WHEEL_FLAT = "A wheel strikes once a turn, and drives the sensor to its limits. Inspect the treads of the wheelset."
    SECTION_UNKNOWN = "The vehicle is on no section of the registry. Register the section."
    POSITION_UNKNOWN = "No sample, or too few, has a position on the section. Check the position source."
    FILE_DAMAGED = "The file of the samples is missing or damaged. Receive the recording again."
    CLASS_UNKNOWN = "The class of the vehicle is not on file. Register it; the window waits for it."
    ALIGNMENT_UNKNOWN = (
        "The alignment of the section is not known yet, and the window waits. Survey it, or wait for more passes."
    )
    WAITS_FOR_ESTIMATION = (
        "The window has not been estimated yet. Run `treadwatch estimate`, or let `treadwatch schedule` run."
    )
    WAITS_FOR_POSITION = (
        "The place of the window on the section is not found yet. Let `refresh_alignment` run; more passes help it."
    )
    NOT_MOVING = "The vehicle stands, or runs too slowly."
    BOTH_DIRECTIONS = "The vehicle runs both ways along the section within the window."
    POSITION_JUMP = "The position changes by another distance than the speed makes of it. Check the position source."
    AXES_REVERSED = "The sensor axes contradict those of other nodes. Check the mounting of the node."
    SENSOR_TURNED = (
        "A sensor is turned against the axes of the vehicle, or two are exchanged. Check its mounting and its offset."
    )
    NO_USABLE_SAMPLE = "No sample is valid, on known track, fast enough and outside curves."
    CURVE_DETECTED = "A curve is detected and no layout is stored. Register the section's layout."
    IN_CURVES = "All of the window is in curves."
    INTERRUPTED = "No uninterrupted run of samples is long enough for the filters."
    TOO_FEW_USABLE = "Too few samples are left after filtering."
    OUTSIDE_BINS = "No lateral displacement is within the range of the bins. Check the scale of the sensors."
    FRAME_UNKNOWN = (
        "The yaw of the bogie frame is not known: a node has no window, or its frame sensor is dead. Check it."
    )
    MOUNTING_DIFFERS = (
        "The registry has another wheelset there by now. The window is made again once its recording can be read."
    )
    ODOMETER_IMPLAUSIBLE = (
        "The odometer contradicts speed, mounting or other windows. Where it was exchanged, register a new mounting."
    )
    PLACE_IMPLAUSIBLE = (
        "GNSS is not where the section is that the vehicle reports. Check the section's number and its coordinates."
    )
    AXLE_DISTANCE = (
        "The track reaches the axles of the bogie unlike their distance on file. Check nodes, axle offsets and class."
    )
    # position and pass
    POSITION_UNCERTAIN = (
        "The position along the section could not be confirmed. Wait for more passes, or check the position source."
    )
    PASS_TOO_SHORT = "The pass is shorter than the filters need."  # noqa: S105 - of a vehicle
    OTHER_SECTION = "The pass does not match the section. Check what the vehicle reports as section."
    MIRRORED = "Left and right are exchanged. Check the mounting record and the signs."
    SCALE_DIFFERS = "The lateral displacement has another scale. Check the sensor's unit and range."
    APART_FROM_JOURNEY = "The position of the pass does not fit the rest of its journey."
    # section
    NO_PASS = "No pass of the section can be used."  # noqa: S105 - of a vehicle
    TOO_FEW_PASSES = "No place of the section has enough passes yet."
    SINGLE_WHEELSET = "One wheelset alone cannot separate the track from its own geometry."
    PASSES_ALIKE = "The passes differ too little to separate track and wheelsets."
    STIFFNESS_OPEN = (
        "In so stiff a bogie these passes leave the track open. Survey the section, or wait for more passes."
    )
    JOURNEY_INDETERMINATE = "The journey is too short, or too few others passed there."
    JOURNEY_DISAGREES = "The journey agrees with no other."
    OFFSET_TOO_LARGE = "The position error is larger than what is searched. Check the position source."
    NO_JOURNEY_AGREES = "No journey agrees with another."
    NOT_CONVERGED = "The iteration ended before it converged."
    LOW_WEIGHT = "Some wheelsets fit no single curve and have a low weight."
    # survey
    SURVEY_CONFIRMED = "The survey agrees with what the fleet measures."
    SURVEY_NOT_ASSESSABLE = "The fleet does not know enough of the section to check the survey."
    SURVEY_UNRELATED = "The survey has nothing in common with the section. Check which it is of."
    SURVEY_UNIT = "The survey has another unit. Register it again in the right unit."
    SURVEY_MIRRORED = "The survey has left and right exchanged. Register it with the other sign."
    SURVEY_DISPLACED = "The survey is displaced along the section. Check its zero point."
    MODEL_CONTRADICTED = (
        "The passes fit the equations of their vehicles on this survey badly. Check parameters, survey and positions."
    )
    SURVEY_GAUGE_UNRELATED = "The gauge on file is not that of the section. Check which section and date it is of."
    SURVEY_GAUGE_UNIT = "The gauge on file has another scale. Register it again in the right unit."
    # creep forces and adhesion
    LOW_ADHESION = (
        "The window is on rails of so little friction that creep is not linear. It is left out of the geometry."
    )
    CREEP_TOO_SMALL = "The creep forces are too small to show the friction: there is only a lower bound."
    PROFILES_UNKNOWN = (
        "The profiles on file do not have the rolling radius difference that was measured. Check wheel and rail."
    )
    FRICTION_DIFFERS = (
        "It shows another friction than the others at the same places. Check load, yaw spring and sensors."
    )
    NO_CREEP_CURVE = "The rolling radius difference of the wheelset is not known well enough yet."
    # dampers
    DAMPER_NOT_ON_FILE = (
        "The class has no lateral damper on file, so that there is nothing to compare with. Register its damping."
    )
    SUSPENSION_UNCERTAIN = (
        "The springs or masses of the class are known too badly to judge its damper. Register them with smaller stds."
    )
    DAMPER_NOT_EXCITED = "What is above the wheelsets moves too little, or too unlike its class, to show the damper."
    # geometry
    TOO_FEW_BLOCKS = "Too few blocks of running time for an interval."
    TOO_FEW_BINS = "Too few bins around the centre have samples."
    CONICITY_OPEN = (
        "The data leave the conicity open. A survey of the section, its gauge included, or more passes narrow it down."
    )
    YAW_SPRING_DIFFERS = (
        "The wheelset yaws as on another yaw suspension. Check the vehicle's class, wheelbase and order of the nodes."
    )
    MOTION_UNEXPLAINED = (
        "The motion follows neither track nor wheels. Check the vehicle's class, the track and the sensors."
    )
    ROLLING_RADIUS_DIFFERS = "The wheelset rolls as on wheels of another radius. Check the nominal radius on file."
    ROLLING_RADIUS_OPEN = (
        "The motion does not confirm the nominal radius on file. Put its std on file, as measured or as wheels wear."
    )
    SAMPLES_PURGED = (
        "What it rests on was corrected after its samples had been purged, so that it cannot be estimated again."
    )
    AMPLITUDE_NOT_COVERED = "The wheelset has not moved as far as this amplitude."
    OFFSET_NOT_OBSERVABLE = "Band-limited signals carry no constant offset."
    NO_ZERO_CROSSING = "rL - rR has no zero in the range covered."
    DIVERGED = (
        "The filter does not follow the motion: its innovations contradict its covariance. Check class and sensors."
    )
    NOT_FINITE = "The calculation gave no finite number."
    # wear signature
    OTHER_VEHICLE_CLASS = "The library entry is of another class of vehicle, or of the other axle of a bogie."
    OTHER_PROFILES = "The library entry is of other design profiles of wheel or rail."
    SAME_WHEELSET = "The library entry is of the judged wheelset, or shares samples with it."
    JUDGED_TOGETHER = (
        "The library entry is of a wheelset that is judged by the same library, in which none of both may be."
    )
    NEWER_ENTRIES = "The library has as many newer entries of the place as it needs."
    SECTION_CHANGED = (
        "The track has changed there since, by tamping or other work. New passes make new library entries."
    )
    WHEELSET_TURNED = "The wheelset was turned between the signature and what is known of its wheels."
    LIBRARY_TOO_SMALL = (
        "The library has too few wheelsets of this class and of known conicity. Measure profiles, or survey a section."
    )
    LIBRARY_ALIKE = "The wheelsets of the library are all alike: nothing can be learned from them."
    NOT_IN_LIBRARY = "The signature is unlike everything in the library, in speed, conicity, profiles or track."
    NO_SIGNATURE = "There is no signature of the wheelset since it was last turned."
    METHODS_DISAGREE = "Signature and geometry differ by more than their intervals. Measure the profiles."
    # trend
    NO_GEOMETRY = "There is no geometry yet."
    NO_GEOMETRY_SINCE_REPROFILING = "There is no geometry since the last reprofiling."
    NO_CONICITY = "No mileage interval has an equivalent conicity."
    TOO_FEW_POINTS = "The trend has too few points since the last reprofiling."
    SPAN_TOO_SHORT = "The points of the trend span too little mileage."
    SINGLE_DATE = "All points of the trend have one date."
    AMPLITUDE_EXTRAPOLATED = (
        "The motion does not cover 3 mm: the conicity there is extrapolated with what worn wheels like it do."
    )
    AMPLITUDE_NOT_COMPARABLE = (
        "The limit is for 3 mm and the conicity there is not known: nothing is said about the limit."
    )
    OTHER_AMPLITUDE = "The trend is at another amplitude than 3 mm, which too few intervals cover."
    BEHIND_STEP = (
        "The conicity changed at once: the trend begins there and rests on few intervals. Register what happened."
    )
    INTERVALS_LEFT_OUT = "Some mileage intervals do not cover the trend's amplitude."
    BEYOND_HORIZON = "The limit is not reached within the forecast horizon."
    # alert
    TOO_FEW_WINDOWS = "Fewer windows than the rule needs."
    NO_DATA_SINCE_MOUNTING = "There are no data since the wheelset was mounted."
    NO_RECENT_DATA = "There have been no usable data for too long."
    SENSOR_FAULTY = "The sensor is faulty according to the sensor fault rule."
    IDENTITY_DOUBTFUL = "The wheelset is not the recorded one, or is mounted the other way round."
    # worklist
    LIMIT_EXCEEDED = "The conicity limit is exceeded, or probably is. Turn the wheelset, or measure its profiles."
    LIMIT_AHEAD = "The conicity limit is forecast to be reached."
    ALERT_OPEN = "An alert of the wheelset is open."
    NOT_MOUNTED = "The wheelset runs under no vehicle."
    # estimate against measurement
    CONTACT_IMPOSSIBLE = "The wheels have no contact with the rails. Check the profiles, and the rails of the section."
    PROFILE_INCOMPLETE = "The profile does not show this measure. Measure flange and tread whole."
    MEASURES_NOT_OBSERVABLE = (
        "Accelerations show how wheels roll, not how high or thick they are. Measure the profiles."
    )
    NO_ESTIMATE_NEAR = "There is no estimate of the same profile within an interval of mileage of the measurement."
    # rails
    RAILS_NOT_CONNECTED = "No wheelset runs on this section and on another, so that wheels and rails cannot be parted."
    RAILS_LEVEL_OPEN = (
        "Only differences of sections are known. Name a section whose rails are as on file, or measure profiles."
    )
    REFERENCE_WHEEL_APART = (
        "The wheel as designed is too unlike the wheels that run on the section. Wait for wheels near it there."
    )
    RAILS_INTERACT = (
        "What rails add differs from wheel to wheel there, as next to contact jumps: they cannot be parted."
    )
    TOO_FEW_WHEELSETS = "Too few wheelsets connect the section to its reference."
    CONTACT_JUMP_NEAR = "The wheel as designed is next to a contact jump there: wheels and rails cannot be parted."
    TONNAGE_UNKNOWN = "The traffic of the section is not on file. Register its `tonnage_mgt_per_year`."
    KNOWN_RAILS_DIFFER = (
        "Sections that are named as known differ in their rails. Look at them; name those that are as on file."
    )
    KNOWN_RAILS_OTHER = (
        "The section is named as known, but has other rails on file than those that all are compared with."
    )
    KNOWN_RAILS_OTHER_TIME = (
        "The section is named as known for another time than it was run on. Look at its rails again; name the date."
    )
    MEASURED_WHEELS_DIFFER = (
        "Measured profiles contradict each other, or known rails. Check which wheelset they are of; measure again."
    )
    TREND_NOT_A_LINE = "The excess of the section changes otherwise than evenly, as where rails are ground or replaced."
    TOO_FEW_PERIODS = "Too few periods of the section are known for a trend. Wait."
    RAILS_ARE_REFERENCE = (
        "The section is named as known: it is what others are compared with, and nothing is measured of its rails."
    )
    CELL_DAMAGED = (
        "A stored conicity of a wheelset on the section is damaged. It is made again from the bin tables by itself."
    )
    PROFILE_UNKNOWN = "The profile on file is none that is built in. Nothing follows from its name."
    # recording
    LOG_DAMAGED = "The recording is truncated, damaged or no log. Send it again."
    CLOCK_IMPLAUSIBLE = (
        "The vehicle's clock contradicts ours or itself. Set the wrong one; try the recording again if it was ours."
    )
    VEHICLE_UNKNOWN = "The registry does not contain the vehicle. Register it; then decode again."
    WAITS_FOR_DECODING = (
        "The recording is received and safe. The next run of `assemble_windows`, or a worker, decodes it."
    )
    WAITS_FOR_TIME = "The recording has no TIME frame and waits for the recording next to it."
    SET_ASIDE = "The recording was set aside by hand. Restore it to count it again."
    DELETED = "The recording was deleted by hand. To take it in again, say so at its ingest."
    # passing faults, and failures of the program
    WAITS_FOR_STORAGE = (
        "The disk is full, not mounted or not permitted. Mend that; what waits is tried again by itself."
    )
    WAITS_FOR_EXTRA = "An extra is not installed. Install it; what waits is tried again by itself."
    WAITS_FOR_MEMORY = "The system had no memory left. What waits is tried again by itself."
    CONFLICT = "It contradicts what is stored, or what was changed meanwhile. It is tried again by itself."
    WORKERS_ENDED = "Three worker processes ended while they worked at it. Report the log; it is tried again by itself."
    PROCESSING_FAILED = (
        "The program failed at it. It is in quarantine and tried again at growing intervals; see the log."
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
    """Return several reasons as one: the code of the first and all sentences; None where there is none."""
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


EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def utc_text(t_ns: int) -> str:
    """Return a time, ns since 1970, as people read it: in UTC, to the second where it is a whole one."""
    seconds, rest = divmod(t_ns, SECOND_NS)
    decimals = f".{rest:09d}".rstrip("0") if rest else ""
    return f"{(EPOCH + timedelta(seconds=seconds)).strftime('%Y-%m-%dT%H:%M:%S')}{decimals}Z"
