"""Phrases of report sentences: numbers, changes and causes in words."""

from __future__ import annotations

from collections.abc import Sequence

from mast_zenoh.report.narrative.changes import DISPLACED, IDENTITY, Change
from mast_zenoh.report.tables.interposers import EFFECTS, OF_OBJECTS, Interposer

_NUMBERS = ["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]
#: Objects per frame; smaller differences are not notable beside a larger one.
NOTHING = 0.05

_WHERE = {
    "local": "in what the ego sees alone",
    "received": "in the ego's tracks as they are received",
    "picture": "in the common picture",
    "picture_received": "in the picture that the ego receives",
    "picture_on_arrival": "in the picture when it reaches the ego",
    "mission": "for the ego with the picture",
}

OWNERS = {
    "local": "the ego alone has",
    "picture": "the picture has",
    "picture_received": "the picture that the ego receives has",
    "picture_on_arrival": "the picture that the ego holds has",
    "mission": "the ego with the picture has",
}


def count(number: int) -> str:
    """A small number as a word."""
    return _NUMBERS[number] if 0 <= number < len(_NUMBERS) else str(number)


def join_names(names: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def capital(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def objects(number: float, kind: str = "") -> str:
    """`9.40 false objects`; `no false object` for none at all."""
    noun = f"{kind} object".strip()
    if number == 0.0:
        return f"no {noun}"
    return f"{small(number)} {noun}s"


def small(number: float) -> str:
    """A positive number as tables print it, with two decimals, or with more if that would be zero."""
    if number >= 0.005:
        return f"{number:.2f}"
    return f"{number:.2g}" if number >= 0.0005 else "less than 0.001"


def place(change: Change, ego: str | None) -> str:
    """The estimate of a change, as a phrase."""
    text = _WHERE.get(change.estimate, f"in {change.estimate}")
    return (
        text if change.agent == ego else text.replace("the ego's", f"{change.agent}'s").replace("the ego", change.agent)
    )


def amount(change: Change, ego: str | None, *, where: bool = True) -> str:
    """The amount of a change: `5.50 false objects a frame in the common picture`."""
    at = f" {place(change, ego)}" if where else ""
    size = abs(change.amount)
    if change.kind == DISPLACED:
        return f"an RMSE that is at least {size:.2f} m larger{at}"
    if change.kind == IDENTITY:
        return f"{size:.0f} identity switch{'' if round(size) == 1 else 'es'}{at}"
    return f"{objects(size, change.kind)} a frame{at}"


def more_or_less(change: Change, ego: str | None, *, where: bool = True) -> str:
    """A difference: `5.50 more false objects a frame in the common picture`."""
    at = f" {place(change, ego)}" if where else ""
    size, rises = abs(change.amount), change.amount > 0
    if change.kind == DISPLACED:
        return f"{small(size)} m {'more' if rises else 'less'} RMSE{at}"
    word = "more" if rises else "fewer"
    if change.kind == IDENTITY:
        return f"{size:.0f} {word} identity switch{'' if round(size) == 1 else 'es'}{at}"
    noun = objects(size, change.kind)
    number, _, suffix = noun.partition(f" {change.kind}")
    return f"{number} {word} {change.kind}{suffix} a frame{at}"


def plural(number: int, noun: str) -> str:
    """`1 frame`, `20 frames`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def effects(interposer: Interposer) -> str:
    """Measured effects: `478 rows of 6 objects inserted, 8 messages dropped`."""
    counts = interposer.effects or {}
    ordered = [name for name in (*EFFECTS, *counts) if name in counts and name != "unsettled"]
    return ", ".join(_effect(interposer, name, counts[name]) for name in dict.fromkeys(ordered)) or "nothing"


def _effect(interposer: Interposer, effect: str, number: int) -> str:
    if effect not in OF_OBJECTS:
        return f"{plural(number, 'message')} {effect}"
    object_count, clutter = interposer.objects.get(effect, (0, False))
    parts = [plural(object_count, "object")] * bool(object_count) + ["clutter"] * clutter
    return f"{plural(number, 'row')} of {' and of '.join(parts) or 'objects'} {effect}"
