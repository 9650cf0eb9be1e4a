"""Compares two recordings: the first difference, and the number on each wire."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from mast_zenoh.errors import RunFolderError
from mast_zenoh.messagelog.reader import Recorded, read


@dataclass
class Difference:
    """The result of a comparison. Two recordings are equal if `first` is None.

    equal:          number of equal messages
    first:          the first message that differs, as (A's, B's); None on a side where it is missing
    differing:      number of messages that are in both and differ, by wire
    only_a, only_b: number of messages that are missing in the other recording, by wire
    """

    equal: int = 0
    first: tuple[Recorded | None, Recorded | None] | None = None
    differing: Counter[str] = field(default_factory=Counter)
    only_a: Counter[str] = field(default_factory=Counter)
    only_b: Counter[str] = field(default_factory=Counter)


def compare(
    a: Path,
    b: Path,
    *,
    wires: Collection[str] = ("*",),
    ignore: Collection[str] = (),
    taps: bool = False,
    before: int | None = None,
) -> Difference:
    """Compare two recordings, ordered by (frame, time, wire, publisher, sequence number).

    wires, ignore: globs of wires to compare, and of those to leave out
    taps: compare tap legs too, which only runs of equal rewrites share
    before: only frames before this one
    Raises RunFolderError if one cannot be read, or if there is nothing to compare.
    """
    difference = Difference()
    for left, right in _paired(*(_selected(path, wires, ignore, taps, before) for path in (a, b))):
        if left and right:
            if left.payload == right.payload:
                difference.equal += 1
                continue
            difference.differing[left.wire] += 1
        elif left:
            difference.only_a[left.wire] += 1
        elif right:
            difference.only_b[right.wire] += 1
        if difference.first is None:
            difference.first = left, right
    if difference.first is None and not difference.equal:
        raise RunFolderError(f"{a}, {b}: no messages to compare")
    return difference


def _selected(
    path: Path, wires: Collection[str], ignore: Collection[str], taps: bool, before: int | None
) -> Iterator[Recorded]:
    for message in read(path):
        if (before is not None and message.frame >= before) or (message.tap and not taps):
            continue
        if _matches(message.wire, wires) and not _matches(message.wire, ignore):
            yield message


def _matches(wire: str, globs: Collection[str]) -> bool:
    return any(fnmatchcase(wire, glob) for glob in globs)


def _paired(a: Iterator[Recorded], b: Iterator[Recorded]) -> Iterator[tuple[Recorded | None, Recorded | None]]:
    """Pairs of messages with the same place in the order; None if a side has none."""
    left, right = next(a, None), next(b, None)
    while left or right:
        if right is None or (left and left.order < right.order):
            yield left, None
            left = next(a, None)
        elif left is None or right.order < left.order:
            yield None, right
            right = next(b, None)
        else:
            yield left, right
            left, right = next(a, None), next(b, None)
