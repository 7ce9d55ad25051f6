"""Which bins are published: just inside of every limit and just outside, from tables whose solution is known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from oracles.moments import collect
from scipy import stats

from estimation.geometry.estimate import GeometryParameters, _displacement_noise, _Replicates, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.geometry import COMBINATIONS, BinStatus, BinTable, WheelsetGeometry
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode, code_of
from estimation.vehicle.regressors import YAW_TARGETS

PARAMETERS = BinParameters(width=0.25e-3, reach=1.5e-3, groups=6)
CENTRE = 0.5 * (PARAMETERS.edges[:-1] + PARAMETERS.edges[1:])
BINS, GROUPS = len(CENTRE), PARAMETERS.groups
MIDDLE = BINS // 2
ODD = MIDDLE + 3  # the bin that is made different
VEHICLE = PARAMETERS.vehicle
PER_METRE = VEHICLE.half_contact_distance * VEHICLE.longitudinal_creep_coefficient / VEHICLE.nominal_radius
CERTAIN = GeometryParameters(uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0)))
CONE = 0.1
RISE = 2 * CONE * PARAMETERS.width


def every(value: float) -> FloatArray:
    return np.full(BINS, value)


@dataclass
class Wheelset:
    """What a table is made of, per bin; the derivatives by the first uncertain parameter of both equations."""

    R: FloatArray = field(default_factory=lambda: 2 * CONE * CENTRE)
    rise: FloatArray = field(default_factory=lambda: every(RISE))
    noise: FloatArray = field(default_factory=lambda: every(0.0))  # rms of the yaw equation as R, m
    by_group: FloatArray = field(default_factory=lambda: np.zeros(GROUPS))  # added to R, m
    samples: FloatArray = field(default_factory=lambda: np.full((GROUPS, BINS), 30))
    S: float = 0.9
    A: float = 0.05
    D: float = 0.02
    S_by_creep: float = 0.0
    D_by_creep: float = 0.0
    A_by_creep: float = 0.0
    R_by_creep: float = 0.0

    def table(self, parameters: BinParameters = PARAMETERS) -> BinTable:
        """Return the statistics of samples that give exactly this."""
        cells = [[self._cell(g, b) for b in range(BINS)] for g in range(GROUPS)]
        return BinTable(
            parameter_key=parameters.key,
            edges=parameters.edges,
            weight=self.samples.astype(float),
            lateral=np.array([[cell[0] for cell in row] for row in cells]),
            yaw=np.array([[cell[1] for cell in row] for row in cells]),
            samples=int(self.samples.sum()),
            windows=7,
        )

    def _cell(self, g: int, b: int) -> tuple[FloatArray, FloatArray]:
        n = int(self.samples[g, b])
        u, i = np.linspace(-0.45, 0.45, n), np.arange(n)
        x1, x2 = np.sin(2.0 * i) * 1e3, np.full(n, 50.0)
        lateral = np.column_stack([x1, x1 * u, x2, x2 * u])
        z1 = np.zeros((n, 7))
        z1[:, 0], z1[:, 1] = self.S * x1 + self.D * x2, self.S_by_creep * x1 + self.D_by_creep * x2
        a, c = 4.0 * np.sin(3.0 * i + 1.0), np.full(n, -PER_METRE)
        yaw = np.column_stack([a, c, c * u, c * u * u])
        z2 = np.zeros((n, len(YAW_TARGETS)))
        z2[:, 0] = self.A * a + c * (self.R[b] + self.by_group[g] + self.rise[b] * u) + self._noise(yaw, b)
        z2[:, 1] = self.A_by_creep * a + c * self.R_by_creep
        one = np.zeros(n, dtype=np.int64)
        return collect(lateral, z1, one, 1).packed[0], collect(yaw, z2, one, 1).packed[0]

    def _noise(self, features: FloatArray, b: int) -> FloatArray:
        """Return noise that no regressor explains, of the wanted residual of the bin."""
        n = len(features)
        if n == 0 or self.noise[b] == 0.0:
            return np.zeros(n)
        wild = np.sin(5.0 * np.arange(n) ** 2)
        wild -= features @ np.linalg.lstsq(features, wild, rcond=None)[0]
        groups = np.count_nonzero(self.samples[:, b])
        squares = self.noise[b] ** 2 * (self.samples[:, b].sum() - 4) / groups
        return wild * np.sqrt(squares / (wild @ wild)) * PER_METRE


def found(wheelset: Wheelset, parameters: GeometryParameters = CERTAIN) -> WheelsetGeometry:
    return estimate_geometry(wheelset.table(), PARAMETERS, parameters)


def statuses(geometry: WheelsetGeometry, b: int = ODD) -> set[BinStatus]:
    return {getattr(geometry, name).status[b] for name in COMBINATIONS}


def odd(usual: float, other: float) -> FloatArray:
    """Return a value per bin of which one is another."""
    values = every(usual)
    values[ODD] = other
    return values


def test_a_table_gives_what_it_was_made_of() -> None:
    geometry = found(Wheelset())
    assert all(statuses(geometry, b) == {BinStatus.ESTIMATED} for b in range(BINS))
    np.testing.assert_allclose(geometry.rolling_radius_difference.value, 2 * CONE * CENTRE, atol=1e-10)
    for name, true in (
        ("rolling_radius_sum", 0.9),
        ("contact_angle_sum", 0.05),
        ("contact_angle_difference", 0.02),
    ):
        np.testing.assert_allclose(getattr(geometry, name).value, true, rtol=1e-6)
        np.testing.assert_allclose(getattr(geometry, name).std, 0.0, atol=1e-7)
    np.testing.assert_array_equal(geometry.samples, 180.0)
    assert geometry.equivalent_conicity.value == pytest.approx(CONE, rel=1e-3)
    assert geometry.equivalent_conicity.count == geometry.windows == 7
    assert (geometry.status, geometry.reason) == (Status.ESTIMATED, None)
    assert geometry.reported_amplitude == pytest.approx(1.5e-3)
    assert geometry.zero_crossing.value == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("last", "status"), [(20, BinStatus.ESTIMATED), (19, BinStatus.TOO_FEW)])
def test_a_bin_needs_a_hundred_samples(last: int, status: BinStatus) -> None:
    samples = np.full((GROUPS, BINS), 30)
    samples[:, ODD] = [20, 20, 20, 20, last, 0]
    geometry = found(Wheelset(samples=samples))
    assert statuses(geometry) == {status}
    assert np.isnan(geometry.rolling_radius_difference.value[ODD]) == (status is BinStatus.TOO_FEW)
    assert np.isnan(geometry.rolling_radius_difference.std[ODD]) == (status is BinStatus.TOO_FEW)
    reach = CENTRE[ODD] - 0.125e-3 if status is BinStatus.TOO_FEW else 1.625e-3
    assert geometry.reported_amplitude == pytest.approx(np.floor(reach / 0.25e-3 + 1e-6) * 0.25e-3)


@pytest.mark.parametrize(("groups", "status"), [(4, BinStatus.ESTIMATED), (3, BinStatus.TOO_FEW)])
def test_a_bin_needs_samples_of_four_groups(groups: int, status: BinStatus) -> None:
    samples = np.full((GROUPS, BINS), 50)
    samples[groups:, ODD] = 0
    assert statuses(found(Wheelset(samples=samples))) == {status}


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("rise", "status"), [(0.149e-3, BinStatus.ESTIMATED), (0.151e-3, BinStatus.CONTACT_JUMP)])
def test_a_step_of_the_radius_difference_inside_a_bin_is_a_contact_jump(
    rise: float, status: BinStatus, sign: float
) -> None:
    geometry = found(Wheelset(rise=odd(RISE, sign * rise)))
    assert statuses(geometry) == {status}
    assert np.isnan(geometry.rolling_radius_difference.value[ODD]) == (status is BinStatus.CONTACT_JUMP)
    assert geometry.reported_amplitude == pytest.approx(1.5e-3)  # the conicity goes on across it
    assert statuses(geometry, ODD - 1) == {BinStatus.ESTIMATED}


@pytest.mark.parametrize(("times", "status"), [(3.95, BinStatus.ESTIMATED), (4.05, BinStatus.CONTACT_JUMP)])
def test_a_residual_of_four_times_the_median_is_a_contact_jump(times: float, status: BinStatus) -> None:
    assert statuses(found(Wheelset(noise=odd(0.02e-3, times * 0.02e-3)))) == {status}


@pytest.mark.parametrize(
    ("residual", "status"), [(0.0099e-3, BinStatus.ESTIMATED), (0.0101e-3, BinStatus.CONTACT_JUMP)]
)
def test_a_residual_below_ten_micrometres_is_no_contact_jump(residual: float, status: BinStatus) -> None:
    assert statuses(found(Wheelset(noise=odd(0.001e-3, residual)))) == {status}


def test_bins_with_too_few_samples_have_no_part_in_the_median_and_are_no_jumps() -> None:
    samples = np.full((GROUPS, BINS), 30)
    few = np.arange(BINS) < MIDDLE - 1
    samples[:, few] = 10
    noise = odd(0.02e-3, 0.09e-3)
    noise[few] = 1e-3
    rise = every(RISE)
    rise[few] = 1e-3
    geometry = found(Wheelset(samples=samples, noise=noise, rise=rise))
    assert statuses(geometry) == {BinStatus.CONTACT_JUMP}
    assert all(statuses(geometry, int(b)) == {BinStatus.TOO_FEW} for b in np.flatnonzero(few))
    nothing = found(Wheelset(samples=np.full((GROUPS, BINS), 10)))
    assert all(statuses(nothing, b) == {BinStatus.TOO_FEW} for b in range(BINS))
    assert code_of(nothing.reason) is ReasonCode.TOO_FEW_BINS


UNCERTAIN = replace(CERTAIN, uncertainty=ParameterUncertainty(creep=0.1, stiffness=0.0, mass=0.0))


@pytest.mark.parametrize(
    ("name", "derivative", "half_of_prior", "widening"),
    [
        ("rolling_radius_sum", "S_by_creep", 1.0e-3, 1.0),
        ("rolling_radius_difference", "R_by_creep", 1.0e-3, 1.0),
        ("contact_angle_sum", "A_by_creep", 0.075, 1.0),
        ("contact_angle_difference", "D_by_creep", 0.075, 1.0 / (1.0 - 0.1252191)),
    ],
)
@pytest.mark.parametrize(("share", "status"), [(0.99, BinStatus.ESTIMATED), (1.01, BinStatus.UNOBSERVABLE)])
def test_a_number_is_published_below_half_of_what_is_known_beforehand(
    name: str, derivative: str, half_of_prior: float, widening: float, share: float, status: BinStatus
) -> None:
    """Creep coefficients that are known to a tenth, the factor of D therefore to an eighth."""
    wheelset = replace(Wheelset(D=0.0), **{derivative: share * half_of_prior / widening / 0.1})
    geometry = found(wheelset, UNCERTAIN)
    values = getattr(geometry, name)
    assert values.status[MIDDLE] is status
    assert np.isnan(values.value[MIDDLE]) == (status is BinStatus.UNOBSERVABLE)
    if status is BinStatus.ESTIMATED:
        np.testing.assert_allclose(values.std, share * half_of_prior, rtol=1e-6)
    others = {getattr(geometry, other).status[MIDDLE] for other in COMBINATIONS if other != name}
    assert others == {BinStatus.ESTIMATED}


@pytest.mark.parametrize(("load", "of_factor"), [(12263.0, 0.12538), (90742.5, 0.21765)])
def test_the_angle_difference_is_as_uncertain_as_the_factor_it_is_divided_by(load: float, of_factor: float) -> None:
    """The factor is f23/r0 - W/2; creep is known to 10 %, masses and load to 2.5 %, as standard deviations."""
    bins = replace(PARAMETERS, vehicle=replace(VEHICLE, load=load))
    geometry = estimate_geometry(Wheelset().table(bins), bins, replace(CERTAIN, uncertainty=ParameterUncertainty()))
    found = geometry.contact_angle_difference
    np.testing.assert_allclose(found.value, 0.02, rtol=1e-6)
    np.testing.assert_allclose(found.std, 0.02 * of_factor / (1 - of_factor), rtol=1e-3)


@pytest.mark.parametrize(("load", "status"), [(76.5e3, BinStatus.UNOBSERVABLE), (77.0e3, BinStatus.ESTIMATED)])
def test_no_angle_difference_is_published_where_its_factor_is_unknown_by_two_fifths(
    load: float, status: BinStatus
) -> None:
    bins = replace(PARAMETERS, vehicle=replace(VEHICLE, load=load))
    geometry = estimate_geometry(Wheelset().table(bins), bins, replace(CERTAIN, uncertainty=ParameterUncertainty()))
    assert set(geometry.contact_angle_difference.status) == {status}
    assert set(geometry.rolling_radius_difference.status) == {BinStatus.ESTIMATED}


def test_the_std_of_a_bin_is_that_of_its_groups_with_students_t() -> None:
    by_group = 1e-5 * np.array([1.0, -2.0, 0.5, 3.0, -1.0, 0.0])
    geometry = found(Wheelset(by_group=by_group))
    standard_error = by_group.std(ddof=1) / np.sqrt(GROUPS)
    widened = standard_error * stats.t.ppf(0.975, GROUPS - 1) / stats.norm.ppf(0.975)
    # the differences between the groups are a residual too, of which a displacement error is made
    assert geometry.rolling_radius_difference.std[MIDDLE] == pytest.approx(widened, rel=0.02)
    both = found(Wheelset(by_group=by_group, R_by_creep=2e-4), UNCERTAIN)
    assert both.rolling_radius_difference.std[MIDDLE] == pytest.approx(np.hypot(widened, 2e-5), rel=0.02)


def test_band_limited_motion_adds_scale_and_origin_of_the_displacement() -> None:
    limited = replace(PARAMETERS, band_limited=True)
    unknown = replace(CERTAIN.uncertainty, displacement=0.004, jump_position_std=0.0)
    for uncertainty, scale in ((CERTAIN.uncertainty, 0.003), (unknown, 0.005)):
        geometry = estimate_geometry(Wheelset().table(limited), limited, replace(CERTAIN, uncertainty=uncertainty))
        expected = 2 * CONE * np.hypot(scale * np.abs(CENTRE), 5e-6)
        np.testing.assert_allclose(geometry.rolling_radius_difference.std, expected, rtol=1e-3)
        assert code_of(geometry.zero_crossing.reason) is ReasonCode.OFFSET_NOT_OBSERVABLE
    jumps = replace(
        CERTAIN, uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0), jump_position_std=0.2e-3)
    )
    geometry = found(Wheelset(), jumps)
    np.testing.assert_allclose(geometry.rolling_radius_difference.std, 2 * CONE * 0.25 * 0.2e-3, rtol=1e-3)


def test_bins_of_a_conicity_that_is_open_are_published() -> None:
    """A displacement known to 70 %: R to 0.6 mm at the last bin, the conicity of 0.28 to more than 0.1."""
    unknown = replace(CERTAIN, uncertainty=replace(CERTAIN.uncertainty, displacement=0.7))
    geometry = found(Wheelset(R=0.56 * CENTRE, rise=every(0.56 * PARAMETERS.width)), unknown)
    assert code_of(geometry.reason) is code_of(geometry.equivalent_conicity.reason) is ReasonCode.CONICITY_OPEN
    assert (geometry.status, geometry.reported_amplitude) == (Status.UNESTIMATED, 3e-3)
    assert all(statuses(geometry, b) == {BinStatus.ESTIMATED} for b in range(BINS))
    np.testing.assert_allclose(geometry.rolling_radius_difference.value, 0.56 * CENTRE, atol=1e-10)


def test_the_yaw_uncertainty_reaches_the_conicity() -> None:
    """R off by 0.1 x 2e-4 m throughout moves the zero, and leaves the conicity of a cone as it is."""
    geometry = found(Wheelset(R_by_creep=2e-4), UNCERTAIN)
    assert geometry.zero_crossing.std == pytest.approx(0.1 * 2e-4 / (2 * CONE), rel=1e-3)
    assert geometry.equivalent_conicity.std == pytest.approx(0.0, abs=1e-6)


def noise_of(
    residual: FloatArray, slope: FloatArray, out: BoolArray, expected: float = 0.0, of_sensors: float = 0.0
) -> float:
    """Return the error of y - d of bins with these residuals, m, and slopes of R; of_sensors is a variance, m2."""
    yaw = np.zeros((1, BINS, 4, 7))
    yaw[0, :, 2, 0] = slope * PARAMETERS.width
    yaw[0, :, 1, YAW_TARGETS.index("noise")] = of_sensors
    found = _Replicates(np.zeros((1, BINS, 4, 7)), yaw, residual, every(6.0), np.zeros((BINS, 3, 0)))
    return _displacement_noise(found, out, PARAMETERS, expected, GeometryParameters())


@pytest.mark.parametrize(("expected", "found"), [(3e-5, 5e-5 / np.sqrt(2.0)), (4e-5, 4e-5), (9e-5, 5e-5)])
def test_the_noise_of_the_displacement_is_up_to_all_of_the_residual_where_that_much_is_expected(
    expected: float, found: float
) -> None:
    nothing = np.zeros(BINS, dtype=bool)
    assert noise_of(every(1e-5), every(0.2), nothing, expected) == pytest.approx(found)


@pytest.mark.parametrize(("share", "hidden"), [(0.49, False), (0.51, True)])
def test_the_noise_of_sensors_hides_that_of_the_displacement_from_half_of_the_residual(
    share: float, *, hidden: bool
) -> None:
    nothing, left = np.zeros(BINS, dtype=bool), 5e-5 * np.sqrt(1.0 - share)
    found = noise_of(every(1e-5), every(0.2), nothing, 9e-5, share * 1e-10)
    assert found == pytest.approx(9e-5 if hidden else left)


def test_the_noise_of_the_displacement_is_the_lower_quartile_in_the_steeper_half() -> None:
    slope = 0.05 + 0.02 * np.arange(BINS) * np.where(np.arange(BINS) % 2, -1.0, 1.0)
    residual = 1e-5 * (1.0 + np.sin(np.arange(BINS)) ** 2)
    steep = sorted(range(BINS), key=lambda b: -abs(slope[b]))[: (BINS + 1) // 2]
    expected = np.percentile([residual[b] / abs(slope[b]) for b in steep], 25.0) / np.sqrt(2.0)
    nothing = np.zeros(BINS, dtype=bool)
    assert noise_of(residual, slope, nothing) == pytest.approx(expected)


@pytest.mark.parametrize(("left", "known"), [(5, True), (4, False)])
def test_the_noise_of_the_displacement_needs_five_bins(left: int, *, known: bool) -> None:
    out = np.arange(BINS) >= left
    residual, slope = odd(1e-5, 1e-3), every(0.2)
    noise = noise_of(residual, slope, out)
    assert noise == (pytest.approx(1e-5 / 0.2 / np.sqrt(2.0)) if known else 0.0)
    broken = residual.copy()
    broken[left:] = np.nan
    nothing = np.zeros(BINS, dtype=bool)
    assert noise_of(broken, slope, nothing) == noise
    slope[left:] = np.nan
    assert noise_of(residual, slope, nothing) == noise


def test_a_table_of_other_parameters_is_refused() -> None:
    with pytest.raises(ValueError, match="expected"):
        estimate_geometry(Wheelset().table(), replace(PARAMETERS, band_limited=True), CERTAIN)
