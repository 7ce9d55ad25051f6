"""The parts of the chaos run, in their order."""

from __future__ import annotations

from collections.abc import Iterator

from bench.chaos.part import ChaosPart, ChaosSettings
from bench.report import BenchRow


def parts() -> tuple[ChaosPart, ...]:
    """Return all parts; each imports what it needs when it runs."""
    return (
        ChaosPart("kills", "ingest, estimate, schedule and serve killed while recordings come in", 500, 4, _kills),
        ChaosPart("ingests", "two to eight ingests of one vehicle at once, on both databases", 100, 2, _ingests),
        ChaosPart("outages", "the database away for 1 s to 5 min, disks that are full", 8, 1, _outages),
        ChaosPart("clock", "the clock of the server 400 days ahead or an hour behind for a while", 4, 1, _clock),
        ChaosPart("live", "a live receiver is killed, its database away for up to 5 min, its disk full", 100, 1, _live),
        ChaosPart("connections", "clients that open connections and do not use them", 1000, 300, _connections),
        ChaosPart("mutations", "log files are damaged, so many of each format, and read", 100_000, 40, _mutations),
        ChaosPart("workers", "many workers are killed, stopped, cut off from the database", 60, 3, _workers),
        ChaosPart(
            "behind", "chunks that nobody decodes, a bus without its database, for up to an hour", 60, 1, _behind
        ),
        ChaosPart("orders", "windows in any order and in pieces, half of the rounds with late ones", 200, 2, _orders),
        ChaosPart("registry", "mistakes in the registry, made at random and corrected", 50, 2, _registry),
    )


def _kills(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.kills import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _ingests(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.ingests import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _outages(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.outages import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _clock(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.clock import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _live(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.live import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _connections(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.connections import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _mutations(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.mutations import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _orders(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.orders import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _registry(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.registry import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _workers(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.workers import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)


def _behind(settings: ChaosSettings) -> Iterator[BenchRow]:
    from bench.chaos.behind import rows  # noqa: PLC0415 - only when it runs

    return rows(settings)
