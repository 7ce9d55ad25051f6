"""What the product says of the wheelsets of a case, by the functions that its jobs call, right or wrong on file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from bench.refusals_case import AMPLITUDES, RefusalCase
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.model_fit import check_radius, rolling_radius
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.parameters import OF_STAGES
from estimation.jobs.steps.estimated_geometry import CONTRADICTIONS
from estimation.motion.axle_distance import (
    bogie_runs_backwards,
    check_axle_distance,
    check_frame_sensors,
    turned_over,
    with_frame_yaw,
)
from estimation.motion.checks import runs_backwards
from estimation.motion.integration import Gates, SignalParameters, WindowParameters
from estimation.motion.rolling_sums import rolling_sums
from estimation.tables.bin_table import bin_parameters, cells_of_window, merge_all
from estimation.values.geometry import WheelsetGeometry
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import RollingSums
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import Arrangement, VehicleClass


class OnFile(StrEnum):
    """What is wrong on file, or of the nodes."""

    RIGHT = "right"
    RADIUS_HIGH = "radius +10 %"
    RADIUS_LOW = "radius -10 %"
    WHEELBASE = "wheelbase -30 %"
    EXCHANGED = "nodes exchanged"
    DEAD_FRAME = "frame sensor dead"
    CLASS = "bogie as single wheelset"


WITHHELD = frozenset(
    (
        *CONTRADICTIONS,
        ReasonCode.FRAME_UNKNOWN,
        ReasonCode.YAW_SPRING_DIFFERS,
        ReasonCode.MOTION_UNEXPLAINED,
        ReasonCode.ROLLING_RADIUS_DIFFERS,
    )
)
IN_BOGIES = (OnFile.WHEELBASE, OnFile.EXCHANGED, OnFile.DEAD_FRAME, OnFile.CLASS)


@dataclass(frozen=True, slots=True)
class Judged:
    """What is said of one wheelset."""

    published: bool
    code: str  # why not, or what is in doubt; empty where nothing is
    errors: tuple[float, ...]  # of the conicity where it is published
    covered: tuple[bool, ...]
    values: tuple[float | None, ...] = ()  # of the conicity, over all amplitudes
    radius: tuple[float, float, float] | None = None  # error, std and bound of the std of that by the motion, relative

    @property
    def withheld(self) -> bool:
        """Whether nothing is published for what the data contradict; too little of them is no contradiction."""
        return not self.published and self.code in WITHHELD

    @property
    def doubted(self) -> bool:
        """Whether a number is published with a doubt beside it."""
        return self.published and bool(self.code)


def judged(case: RefusalCase, on_file: OnFile) -> tuple[Judged, ...]:
    """Return what is said of each wheelset of a case."""
    vehicle_class = registered(case.vehicle_class, on_file)
    nodes = _measured(case.windows, on_file)
    offsets = _offsets(case, vehicle_class)
    return tuple(_judged(case, vehicle_class, axle, nodes, offsets) for axle in range(len(nodes)))


def registered(vehicle_class: VehicleClass, on_file: OnFile) -> VehicleClass:
    """Return a class as it is on file."""
    factor = {OnFile.RADIUS_HIGH: 1.1, OnFile.RADIUS_LOW: 0.9}.get(on_file, 1.0)
    radius = factor * vehicle_class.parameters.nominal_radius
    changed = replace(vehicle_class, parameters=replace(vehicle_class.parameters, nominal_radius=radius))
    bogie = vehicle_class.bogie
    if bogie is not None and on_file is OnFile.WHEELBASE:
        return replace(changed, bogie=replace(bogie, wheelbase=0.7 * bogie.wheelbase))
    if on_file is OnFile.CLASS:
        return replace(changed, arrangement=Arrangement.SINGLE_WHEELSET, bogie=None, relative_std={})
    return changed


def _measured(windows: Sequence[Sequence[Window]], on_file: OnFile) -> list[list[Window]]:
    """Return what arrives of the nodes."""
    found = [list(of_axle) for of_axle in windows]
    if on_file is OnFile.EXCHANGED:
        names = ("lateral_acceleration", "yaw_acceleration", "roll_acceleration", "mass_lateral_acceleration")
        pairs = list(zip(*windows, strict=True))
        found = [
            [replace(pair[axle], **{name: getattr(pair[1 - axle], name) for name in names}) for pair in pairs]
            for axle in (0, 1)
        ]
    if on_file is OnFile.DEAD_FRAME:
        found[0] = [replace(one, mass_lateral_acceleration=np.zeros(len(one.valid))) for one in found[0]]
    return found


def _offsets(case: RefusalCase, vehicle_class: VehicleClass) -> tuple[float, ...]:
    if vehicle_class.bogie is None:
        return case.offsets
    return case.offsets[0], case.offsets[0] + vehicle_class.bogie.wheelbase


def _judged(
    case: RefusalCase,
    vehicle_class: VehicleClass,
    axle: int,
    nodes: Sequence[Sequence[Window]],
    offsets: Sequence[float],
) -> Judged:
    parameters = WindowParameters.of(vehicle_class, None, SignalParameters(), Gates())
    pairs = [(own, None if vehicle_class.bogie is None else nodes[1 - axle][k]) for k, own in enumerate(nodes[axle])]
    behind = offsets[axle]
    ahead = 0.0 if vehicle_class.bogie is None else offsets[1 - axle] - behind
    windows = [_loaded(own, other, ahead, behind) for own, other in pairs]
    tables = [one if isinstance(one, Reason) else cells_of_window(one, case.track, parameters) for one in windows]
    refused = Counter(one.code for one in tables if isinstance(one, Reason))
    against = sum(count for code, count in refused.items() if code in CONTRADICTIONS)
    good = [one for one in tables if not isinstance(one, Reason)]
    if not good or against > OF_STAGES.most_share * (against + len(good)):
        return Judged(published=False, code=str(refused.most_common(1)[0][0]), errors=(), covered=())
    bins = bin_parameters(parameters)
    uncertainty = ParameterUncertainty.of(vehicle_class).on([case.track])
    geometry = estimate_geometry(merge_all(good, bins), bins, GeometryParameters(uncertainty=uncertainty))
    if geometry.status is not Status.MODEL_MISMATCH:
        radius, std = vehicle_class.parameters.nominal_radius, vehicle_class.std_of("nominal_radius")
        used = [one for one in windows if not isinstance(one, Reason)]
        sums = [part for own in used for part in rolling_sums(own, vehicle_class, parameters.signals)]
        geometry = geometry.against(check_radius(sums, radius, std))
        return replace(_verdict(geometry, case, axle), radius=_radius(sums, case))
    return _verdict(geometry, case, axle)


def _radius(sums: Sequence[RollingSums], case: RefusalCase) -> tuple[float, float, float] | None:
    """Return error, std and bound of the std of the radius that the motion has, over the true one."""
    found, true = rolling_radius(sums), case.vehicle_class.parameters.nominal_radius
    return None if found is None else (found.value / true - 1.0, found.std / true, found.bound / true)


def _loaded(own: Window, other: Window | None, ahead: float, behind: float) -> Window | Reason:
    """Return a window as the jobs load it."""
    if other is None:
        return turned_over(own, behind) if runs_backwards(own) else own
    backwards = bogie_runs_backwards(own, other, ahead)
    reason = check_axle_distance(own, other, -ahead if backwards else ahead) or check_frame_sensors(own, other)
    if reason is not None:
        return reason
    framed = with_frame_yaw(own, other, ahead)
    return turned_over(framed, behind) if backwards else framed


def _verdict(geometry: WheelsetGeometry, case: RefusalCase, axle: int) -> Judged:
    errors, covered, values = [], [], []
    for amplitude, true in zip(AMPLITUDES, case.conicity[axle], strict=True):
        one = geometry.conicity[int(np.argmin(np.abs(geometry.amplitude - amplitude)))]
        values.append(one.value)
        if one.value is not None and one.low is not None and one.high is not None:
            errors.append(float(one.value - true))
            covered.append(bool(one.low <= true <= one.high))
    reason = geometry.reason or (geometry.equivalent_conicity.reason if not errors else None)
    return Judged(
        bool(errors), "" if reason is None else str(reason.code), tuple(errors), tuple(covered), tuple(values)
    )
