"""Wheelsets whose samples are in the same entries belong together: what is learned of one is learned of the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from estimation.values.signatures import LibraryEntry

FOLDS = 6
ALONE = 12  # families, up to which each of them is a fold of its own


def families(groups: Iterable[frozenset[str]]) -> list[frozenset[str]]:
    """Return groups of wheelsets that share no data with each other, in the order of their first serials."""
    member: dict[str, set[str]] = {}
    for group in set(groups):
        joined = set(group).union(*(member[name] for name in group if name in member))
        member.update(dict.fromkeys(joined, joined))
    return sorted({frozenset(names) for names in member.values()}, key=min)


def folds(entries: Sequence[LibraryEntry]) -> list[frozenset[str]]:
    """Return wheelsets that are left out together, none of whose data are in entries of others.

    In a small library each family is a fold. In a larger one there are six, each with all kinds of conicity.
    """
    known: dict[str, list[float]] = {}
    for entry in entries:
        known.setdefault(entry.wheelset, []).append(entry.conicity)
    found = families(sharers(entry) for entry in entries)
    if len(found) <= ALONE:
        return found
    mean = {name: sum(values) / len(values) for name, values in known.items()}
    ordered = sorted(found, key=lambda names: (min(mean[name] for name in names if name in mean), min(names)))
    return [frozenset().union(*ordered[first::FOLDS]) for first in range(FOLDS)]


def sharers(entry: LibraryEntry) -> frozenset[str]:
    """Return the wheelsets whose samples are in an entry."""
    return frozenset(entry.shares_data) | {entry.wheelset}
