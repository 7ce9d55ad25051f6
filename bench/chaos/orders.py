"""Windows of a small fleet stored in any order and in any pieces, with the jobs run in between: one final state."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from api.comparison.trial import copied, deploy, opened, receive, record
from api.settings import Settings
from bench.chaos.final_state import come_to_rest, compared_state
from bench.chaos.run import ChaosSettings
from bench.counting import run_all
from bench.report import BenchRow
from bench.small_fleets import small_fleet
from estimation.values.windows import Window

AXLES = (2.0, 4.5, 16.5)
WORN = {"A": ((0.1, 0.9), (0.9, 0.4), (0.5, 0.2)), "B": ((1.2, 1.0), (0.3, 0.1), (0.7, 0.6))}
WINDOW_S = 30


@dataclass(frozen=True, slots=True)
class _Case:
    """A deployment without windows, and the windows that it is to get, each with its mileage, by time."""

    name: str
    settings: Settings
    windows: Sequence[tuple[Window, float]]


@dataclass(frozen=True, slots=True)
class _Played:
    state: Mapping[str, str]
    epochs: int  # computed
    rest: bool


def _case(settings: ChaosSettings, *, surveyed: bool) -> _Case:
    """Return the windows of simulated recordings, and a deployment whose registry knows their fleet."""
    name = "surveyed" if surveyed else "unsurveyed"
    folder = settings.folder / name
    folder.mkdir()
    offset = 3.0 if surveyed else 20.0
    scenario = small_fleet(
        "O", WORN, AXLES, 1.55, campaigns=3, surveyed=surveyed, km_between=20_000.0, position_m=offset,
        within_m=150.0, seed=5,
    )  # fmt: skip
    recorded = record(scenario, folder / "recordings", workers=1)
    empty = deploy(scenario, folder / "empty").model_copy(update={"window_length_s": WINDOW_S})
    full = copied(empty, folder / "full")
    receive(recorded, full)
    with opened(full) as (storage, _), storage.read() as unit:
        records = [one for wheelset in unit.registry.wheelsets() for one in unit.windows.list(wheelset.serial)]
        ordered = sorted(records, key=lambda one: (one.start_ns, one.wheelset))
        windows = [(unit.windows.load(one.wheelset, one.start_ns), one.mileage_km) for one in ordered]
    return _Case(name, empty, windows)


def _play(case: _Case, folder: Path, pieces: Sequence[Sequence[tuple[Window, float]]]) -> _Played:
    """Return the state after the pieces have been stored one after the other, the jobs run after each."""
    with opened(copied(case.settings, folder)) as (storage, context):
        epochs = 0
        for piece in pieces:
            with storage.write() as unit:
                for window, mileage_km in piece:
                    unit.windows.put(window, mileage_km, context.clock.now_ns())
            epochs += run_all(context)["epochs"]
        counts, rest = come_to_rest(storage, context)
        return _Played(compared_state(storage), epochs + counts["epochs"], rest)


def _pieces(case: _Case, rng: random.Random, *, late: bool) -> list[list[tuple[Window, float]]]:
    """Return the windows in another order, cut somewhere; where ``late``, some of them come after all others."""
    order = list(case.windows)
    if late:
        held = set(rng.sample(range(len(order)), rng.randint(1, len(order) // 2)))
        order = [one for i, one in enumerate(order) if i not in held] + [order[i] for i in sorted(held)]
    else:
        rng.shuffle(order)
    cuts = sorted(rng.sample(range(1, len(order)), rng.randint(1, 4)))
    return [order[a:b] for a, b in zip([0, *cuts], [*cuts, len(order)], strict=True)]


def _by_campaign(case: _Case) -> list[list[tuple[Window, float]]]:
    pieces: list[list[tuple[Window, float]]] = []
    for window, mileage_km in case.windows:
        if not pieces or window.start_ns - pieces[-1][-1][0].start_ns > 3600 * 10**9:
            pieces.append([])
        pieces[-1].append((window, mileage_km))
    return pieces


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield how many final states there are, and how many epochs were computed for data that came in order."""
    for surveyed in (False, True):
        case = _case(settings, surveyed=surveyed)
        campaigns = _by_campaign(case)
        at_once = _play(case, settings.folder / f"{case.name}-once", [list(case.windows)])
        in_order = _play(case, settings.folder / f"{case.name}-order", campaigns)
        measured = f"{in_order.epochs} for {len(campaigns)} campaigns"
        yield BenchRow(
            f"{case.name}: epochs computed for data in order", measured, "one each", in_order.epochs <= len(campaigns)
        )
        rng = random.Random(settings.seed)  # noqa: S311 - of orders
        played = [at_once, in_order]
        for number in range(settings.size // 2):
            pieces = _pieces(case, rng, late=number % 2 == 1)
            played.append(_play(case, settings.folder / f"{case.name}-{number}", pieces))
        states = Counter(repr(sorted(one.state.items())) for one in played)
        differ = sorted({name for one in played for name in one.state if one.state[name] != at_once.state[name]})
        measured = f"{len(states)} of {len(played)} rounds" + (f"; {', '.join(differ)}" if differ else "")
        yield BenchRow(f"{case.name}: final states", measured, "1", len(states) == 1)
        at_rest = sum(one.rest for one in played)
        yield BenchRow(
            f"{case.name}: rounds whose jobs came to rest",
            f"{at_rest} of {len(played)}",
            "all",
            at_rest == len(played),
        )
