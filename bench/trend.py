"""Forecasts of wear against what happened: ``python -m bench trend [--seeds 2] [--fitters product] [--write-docs]``.

Whole railways of wheelsets are simulated (``wear_lives``): fleets of one of seven laws of wear, fleets alike and of
mixed laws that change, one as the demo, and fleets whose levels err widely, without and with measured profiles. A
fitter gets what is on file of all wheelsets of a railway at once, so it may learn of each from the others; several are
compared on the same lives. Every number is judged against the truth: level and slope at the last point, and the
distribution of the distance to the limit (``forecast_scores``).
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

import numpy as np

from bench import scores
from bench.coverage import Verdict, verdict_of
from bench.forecast_scores import COLUMNS, ForecastFigures, Happened, Prediction
from bench.report import Bench, Part, ResultTable, say
from bench.scores import Cluster, Figures, compared
from bench.wear_lives import ALIKE, DEMO, MIXED, OF_LAWS, WIDE, Life, Observed, Railway, lives
from estimation.trend.fleet import fleet_priors, own_wear
from estimation.trend.trend import refresh
from estimation.values.trend import TrendPoint, WearTrend
from estimation.values.units import DAY_NS

Fitter = Callable[[Sequence[Observed]], Sequence[Prediction | None]]
"""Returns what it forecasts of every wheelset of a railway, in their order; None where it says nothing."""


def of_trends(fit: Callable[[Sequence[Observed]], Sequence[WearTrend]]) -> Fitter:
    """Return a fitter of one that returns trends as they are stored."""
    return lambda observed: [Prediction.of(trend) for trend in fit(observed)]


def trend_points(observed: Observed) -> list[TrendPoint]:
    """Return the points of a wheelset with their standard deviations, and the part that is noise."""
    names = ("x", "days", "value", "std", "noise")
    columns = zip(*(getattr(observed, name).tolist() for name in names), strict=True)
    return [TrendPoint(km, round(days * DAY_NS), value, std, noise) for km, days, value, std, noise in columns]


def alone(observed: Sequence[Observed]) -> list[WearTrend]:
    """Return the trend of every wheelset by itself, every standard deviation taken as noise."""
    given = [[replace(point, noise=None) for point in trend_points(one)] for one in observed]
    return [refresh(points, one.limit) for points, one in zip(given, observed, strict=True)]


def in_fleets(observed: Sequence[Observed]) -> list[WearTrend]:
    """Return the trends as the stages make them: of each fleet all positions together, since each has few wheelsets."""
    trends: dict[int, WearTrend] = {}
    fleets: defaultdict[tuple[str, str], list[int]] = defaultdict(list)
    for number, one in enumerate(observed):
        fleets[one.vehicle_class, one.line].append(number)
    for numbers in fleets.values():
        said = fleet_priors([own_wear(observed[n].x, observed[n].value, observed[n].noise, 0.0) for n in numbers])
        for n, fleet in zip(numbers, said, strict=True):
            one = observed[n]
            measured = [TrendPoint(km, 0, value, std) for km, value, std in one.measured.tolist()]
            trends[n] = refresh(trend_points(one), one.limit, fleet=fleet, origin_km=0.0, measured=measured)
    return [trends[number] for number in range(len(observed))]


FITTERS: Mapping[str, Fitter] = {"product": of_trends(in_fleets), "alone": of_trends(alone)}
"""By the names that ``--fitters`` takes."""

LAW_COVER, LAW_TOLERATED = (0.74, 0.86), (0.71, 0.89)  # of 80 % intervals, in every law
LIVES_COVER, LIVES_TOLERATED = (0.77, 0.83), (0.75, 0.85)  # over alike and over mixed fleets
REACHED, REACHED_TOLERATED = 0.05, 0.02  # by p10, p50, p90, over all


@dataclass(frozen=True, slots=True)
class Reach:
    """What a row has to reach; None: for information."""

    cover: tuple[tuple[float, float], tuple[float, float]] | None = None  # right and tolerated, of 80 % intervals
    score: float | None = None  # km, IS80
    width: float | None = None  # km, from p10 to p90
    slope: float | None = None  # per 100,000 km, half width

    def __str__(self) -> str:
        """Return it as a cell."""
        parts = [] if self.cover is None else ["cover {:.0%} to {:.0%}".format(*self.cover[0])]
        parts += [] if self.score is None else [f"IS80 {self.score:,.0f} km"]
        parts += [] if self.width is None else [f"p10 to p90 {self.width:,.0f} km"]
        parts += [] if self.slope is None else [f"slope +-{self.slope:g}, held by 92 % to 98 %"]
        return ", ".join(parts).replace("%", " %").replace("  %", " %")


PER_100_000_KM = 1e5


@dataclass(slots=True)
class Row:
    """Forecasts of one fitter of one kind of railway, fleet by fleet."""

    fleets: list[list[Happened]] = field(default_factory=list)
    level: list[Cluster] = field(default_factory=list)
    slope: list[Cluster] = field(default_factory=list)  # per 100,000 km

    def add(self, fleet: Sequence[tuple[Life, Prediction | None]], rng: np.random.Generator) -> None:
        """Add what was forecast of the wheelsets of a fleet."""
        made = [(life, one) for life, one in fleet if one is not None]
        withheld = ("unestimated",) * (len(fleet) - len(made))
        self.fleets.append([Happened.of(one, life.distance_km, float(rng.random())) for life, one in made])
        level = [compared(one.level, life.level) for life, one in made]
        slope = [compared(one.slope.scaled(PER_100_000_KM), PER_100_000_KM * life.slope) for life, one in made]
        self.level.append(Cluster([one for one in level if one is not None], withheld))
        self.slope.append(Cluster([one for one in slope if one is not None], withheld))

    def verdict(self, reach: Reach) -> Verdict:
        """Return whether the reach is reached."""
        figures, slope = ForecastFigures.of(self.fleets), Figures.of(self.slope)
        verdicts = [] if reach.cover is None else [figures.cover.verdict(*reach.cover)]
        verdicts += [] if reach.score is None else [verdict_of(figures.score <= reach.score)]
        verdicts += [] if reach.width is None else [verdict_of(figures.width <= reach.width)]
        if reach.slope is not None:
            verdicts += [verdict_of(slope.half <= reach.slope), slope.cover.verdict()]
        return Verdict.all(verdicts)


LAWS_TOGETHER = "all laws"
ROWS: Mapping[str, tuple[Railway, Reach]] = {
    **{law: (railway, Reach((LAW_COVER, LAW_TOLERATED))) for law, railway in OF_LAWS.items()},
    "fleets alike": (ALIKE, Reach((LIVES_COVER, LIVES_TOLERATED), score=130_000.0)),
    "fleets mixed": (MIXED, Reach((LIVES_COVER, LIVES_TOLERATED), score=230_000.0)),
    "as the demo, limit 100,000 km ahead": (DEMO, Reach(width=50_000.0, slope=0.007)),
    **{f"wide, profiles measured: {count}": (replace(WIDE, measured=count), Reach()) for count in (0, 1, 3)},
}
SEEDS_OF_DEMO = 100  # times the seeds: its railway is one fleet, whose scale all its wheelsets share


def judged(railway: Railway, fitters: Mapping[str, Fitter], seeds: Sequence[int]) -> dict[str, Row]:
    """Return what fitters forecast of the same lives, each in a row."""
    rows = {name: Row() for name in fitters}
    for seed in seeds:
        known = lives(railway, seed)
        observed = [life.observed for life in known]
        for name, fit in fitters.items():
            rng = np.random.default_rng([seed, 80])
            pairs = zip(known, fit(observed), strict=True)
            for _, fleet in groupby(pairs, key=lambda pair: (pair[0].observed.vehicle_class, pair[0].observed.line)):
                rows[name].add(list(fleet), rng)
    return rows


HEADER = ("fitter", "wear", *COLUMNS, "reach", "met")


def tables(fitters: Mapping[str, Fitter], seeds: int, names: Sequence[str] = tuple(ROWS)) -> list[ResultTable]:
    """Return the tables of forecasts, levels and slopes of some fitters."""
    made = {}
    for name in names:
        railway, reach = ROWS[name]
        made[name] = judged(railway, fitters, range(SEEDS_OF_DEMO * seeds if railway is DEMO else seeds))
        for fitter, row in made[name].items():
            say("  ".join((fitter, name, *ForecastFigures.of(row.fleets).cells, str(row.verdict(reach)))))
    lines = [(fitter, name, *_cells(made[name][fitter], ROWS[name][1])) for fitter in fitters for name in names]
    of_laws = [name for name in names if name in OF_LAWS]
    for fitter in fitters if of_laws else ():
        together = ForecastFigures.of(fleet for name in of_laws for fleet in made[name][fitter].fleets)
        met = together.calibrated(REACHED, REACHED_TOLERATED)
        lines.append((fitter, LAWS_TOGETHER, *together.cells, "p10, p50, p90: 10, 50, 90 % +- 5", str(met)))
    return [
        ResultTable(HEADER, lines, range(2, 6), "Distance to the limit"),
        _figures("Slope at the last point, per 100,000 km", made, fitters, "slope"),
        _figures("Level at the last point", made, fitters, "level"),
    ]


def _cells(row: Row, reach: Reach) -> tuple[str, ...]:
    return (*ForecastFigures.of(row.fleets).cells, str(reach), str(row.verdict(reach)))


def _figures(
    title: str, made: Mapping[str, Mapping[str, Row]], fitters: Mapping[str, Fitter], what: str
) -> ResultTable:
    lines = [
        (fitter, name, *Figures.of(getattr(rows[fitter], what)).cells)
        for fitter in fitters
        for name, rows in made.items()
    ]
    return ResultTable(("fitter", "wear", *scores.COLUMNS), lines, range(2, 8), title)


def _parts(options: argparse.Namespace, _folder: Path) -> list[Part]:
    return [*tables({name: FITTERS[name] for name in options.fitters}, options.seeds, options.rows)]


main = Bench(
    "trend",
    "Forecasts of wear",
    __doc__ or "",
    _parts,
    {
        "seeds": (2, "railways of each kind, of 180 and 300 wheelsets"),
        "rows": (list(ROWS), "kinds of wear", list(ROWS)),
        "fitters": (list(FITTERS), "that are compared", list(FITTERS)),
    },
).run
