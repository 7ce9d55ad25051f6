"""Numbers of the estimation of a bogie."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BogieFitParameters:
    """How the curves of both wheelsets and the springs of a bogie are found together."""

    # grid and band of the equations
    grid_step: float = 0.25  # m, of the means along the track: a tenth of the shortest wave
    segment_m: float = 512.0  # of the Fourier transforms, half overlapping
    longest_wave: float = 130.0  # m: four waves in a segment; longer ones are drift of the yaw sensors
    shortest_wave: float = 4.0  # m: surveys by chord show no shorter ones
    trend_order: int = 3  # of the polynomial in distance that is taken from every segment
    # displacement by which a curve is looked up
    carried_wave: float = 35.0  # m: longer waves of y - d are the simulation's
    placed_from: int = 2  # round from which runs are placed where the simulation follows best
    most_shift: float = 0.5  # m, in a round
    least_slope: float = 1e-12  # sum of squares of the slope of y, so that a bogie that stands still is where it is
    shift_std: float = 0.1  # m, of where all runs are together: what is not in the model delays the simulation
    # curves
    node_step: float = 0.25e-3  # m
    reach: float = 7.0e-3  # m
    bend_std: float = 0.05e-3  # m, second difference of R from node to node beforehand: a jump has 0.1 mm
    first_bend_std: float = 0.003e-3  # m, the same in the first round, in which curves are nearly straight
    start_conicity: float = 0.15  # of the first simulation
    # simulation
    farthest: float = 20e-3  # m, of y - d: a bogie that hunts so far has other curves
    most_rolled: float = 0.3  # of y - d, by the roll of the contact, that the rate of the roll follows: no jump
    flat_conicity: float = 1e-6  # of the linear model, to which the curves are added
    warm_up_m: float = 400.0  # before a run, over which the bogie forgets that it started in the middle
    speed_step: float = 0.1  # m/s, of the tables of the linear model
    # rounds
    rounds: int = 5
    rounds_again: int = 2  # from the curves of an earlier fit
    fewest_groups: int = 4  # of the jackknife
    halvings: int = 4  # of a change after which the simulation derails
    scale_rounds: int = 3  # of the power of each segment beside the spectrum
    inner_rounds: int = 2  # of whitening, with the same simulation
    least_share: float = 0.5  # of a parameter on file, that the simulation follows
    blend: float = 0.75  # of what a round changes
    least_likeness: float = 0.9  # correlation of the simulated with the measured y - d
    # noise
    noise_bands: int = 24  # of the wavenumbers, over each of which the covariance of the equations is one
    # beforehand
    inverse_friction: float = 3.3  # 1/mu, as ``geometry.uncertainty`` has it
    friction_doubt: float = 1.0  # std of 1/mu as found: 3.3 are found as 1.9 to 2.8
    stiffness_doubt: float = (
        0.06  # of k_psi/f11: creep that saturates is taken for softer creep, 1 found as 1.03 to 1.14
    )
    law_doubt: float = 0.15  # of what saturation takes: laws of creep differ by as much halfway to the bound
    most_inverse_friction: float = 8.0  # that is followed
    inverse_friction_std: float = 1.2  # rails have 2 to 6; the linear law 0
    most_saturation: float = 0.9  # of the bound of a wheel's creep force, as far as the law is followed
    held: float = 1e-3  # of what is known of bends, by which curves stay where nothing else is known of them
    # which bogies
    usual_wave: float = 15.0  # m, of wheelsets that steer: for how much of a moment takes rolling
    usual_speed: float = 20.0  # m/s
    least_spring_share: float = 0.8  # of the yaw spring in spring and rolling: coaches have 0.93, soft bogies 0.36
    groups: int = 16  # of the jackknife
    # test of the springs: what is found of k_psi/f11 against the stds of the class, over the std of both
    doubted_spring_stds: float = 2.0  # right ones have at most 1.1, with creep after Polach on dry rails 2.8 to 3.6
    certain_spring_stds: float = 4.0
    spring_share: float = 0.2  # of a conicity, per share by which the springs differ: with that creep 5 % for 0.39
    # published
    least_bend_share: float = 1e-6  # of the largest variance of the curves by their bends: less is left out
    least_visited: float = 40.0  # m run at a node


BOGIE = BogieFitParameters()


@dataclass(frozen=True, slots=True)
class BogieTrackParameters:
    """How the alignment of a section is found from the bogies that run over it."""

    start_rounds: int = 4  # with straight curves, of d alone
    start_share: float = 0.3  # of y, over which bogies are simulated first
    # m, of curves as they bend from round to round: straight at first, for a jump in the wrong place derails
    bend_stds: tuple[float, ...] = tuple(1e-6 * bend for bend in (3, 3, 5, 8, 12, 18, 26, 36, 50, 50, 50, 50, 50))
    held: float = 0.15  # of what is known of parameters: a spring that is off moves the curves, and d hardly
    response_floor: float = 0.02  # of the square of responses, summed over runs: waves that move no bogie
    wave_std: float = 1.3e-3  # m, of a wave of d beforehand: more than tracks have
    fewest_runs: int = 4  # of a place
    std_factor: float = 1.5  # of what errors of the equations make of d: 0.06 to 0.08 mm for 0.04 to 0.05
    own_std: float = 0.1e-3  # m, besides: d has errors in common with the runs that it is found from
    scale_std: float = 0.025  # of y - d: conicities of a fleet are 2 to 4 % off together, with creep linear or not
    most_moved: float = 0.08e-3  # m, rms by which the last round changes d
    most_std: float = 0.15e-3  # m, of the waves of the motion, on which a bogie is estimated as one
    mean_runs: float = 8.0  # of a place, before a solution is tried: it takes minutes
    most_runs: int = 120  # 6 MB each


BOGIE_TRACK = BogieTrackParameters()
