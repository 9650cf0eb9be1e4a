"""Two recordings, message by message: where they differ first, and how often on each wire."""

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
    """What comparing has found. Two recordings are equal if `first` is None.

    equal:          messages that are the same in both
    first:          the first message that is not, as (that of A, that of B); None on a side where it is missing
    differing:      messages that are in both and differ, by wire
    only_a, only_b: messages that are missing on the other side, by wire
    """

    equal: int = 0
    first: tuple[Recorded | None, Recorded | None] | None = None
    differing: Counter[str] = field(default_factory=Counter)
    only_a: Counter[str] = field(default_factory=Counter)
    only_b: Counter[str] = field(default_factory=Counter)


def compare(
    a: Path, b: Path, *, ignore: Collection[str] = (), taps: bool = False, before: int | None = None
) -> Difference:
    """Compare the bytes of the recordings of two runs, ordered by (frame, wire, publisher, sequence).

    ignore: globs of wires to leave out;  taps: compare tap legs too, which only runs of equal rewrites share
    before: only frames before this one
    Raises RunFolderError where one cannot be read, and where there is nothing to compare.
    """
    found = Difference()
    for left, right in _paired(*(_chosen(path, ignore, taps, before) for path in (a, b))):
        if left and right:
            if left.payload == right.payload:
                found.equal += 1
                continue
            found.differing[left.wire] += 1
        elif left:
            found.only_a[left.wire] += 1
        elif right:
            found.only_b[right.wire] += 1
        if found.first is None:
            found.first = left, right
    if found.first is None and not found.equal:
        raise RunFolderError(f"{a}, {b}: not one message to compare")
    return found


def _chosen(path: Path, ignore: Collection[str], taps: bool, before: int | None) -> Iterator[Recorded]:
    for message in read(path):
        if before is not None and message.frame >= before:
            continue
        if (taps or not message.tap) and not any(fnmatchcase(message.wire, glob) for glob in ignore):
            yield message


def _paired(a: Iterator[Recorded], b: Iterator[Recorded]) -> Iterator[tuple[Recorded | None, Recorded | None]]:
    """Messages of equal place in the order; those that the other side has not, alone."""
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
