"""Pieces of the sentences of a report: numbers, changes and causes as words."""

from __future__ import annotations

from collections.abc import Sequence

from mast_zenoh.report.changes import CULPRIT, DISPLACED, IDENTITY, Change
from mast_zenoh.report.interposers import EFFECTS, Interposer, interposers
from mast_zenoh.report.runfolder import RunFolder

_NUMBERS = ["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]
#: Differences per frame smaller than this are called small, objects.
NOTHING = 0.05
#: More adversaries than these are counted, not named.
_MOST_NAMED = 3

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


def listed(names: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def capital(text: str) -> str:
    """With a capital first letter."""
    return text[:1].upper() + text[1:]


def objects(number: float, kind: str = "") -> str:
    """`9.4 false objects`; `no false object` for none at all."""
    noun = f"{kind} object".strip()
    if number == 0.0:
        return f"no {noun}"
    text = small(number)
    return f"{text} {noun}{'' if text == '1.0' else 's'}"


def small(number: float) -> str:
    """A positive number with one digit, or as many as it takes to see it."""
    if number >= NOTHING:
        return f"{number:.1f}"
    return f"{number:.2g}" if number >= 0.0005 else "less than 0.001"


def place(change: Change, ego: str | None) -> str:
    """In which estimate a change is."""
    text = _WHERE.get(change.estimate, f"in {change.estimate}")
    return (
        text if change.agent == ego else text.replace("the ego's", f"{change.agent}'s").replace("the ego", change.agent)
    )


def amount(change: Change, ego: str | None) -> str:
    """What is due to a cause: `5.5 false objects a frame in the common picture`."""
    where, size = place(change, ego), abs(change.amount)
    if change.kind == DISPLACED:
        return f"an RMSE that is at least {size:.2f} m larger {where}"
    if change.kind == IDENTITY:
        return f"{size:.0f} identity switch{'' if round(size) == 1 else 'es'} {where}"
    return f"{objects(size, change.kind)} a frame {where}"


def more_or_less(change: Change, ego: str | None, *, where: bool = True) -> str:
    """A difference: `5.5 more false objects a frame in the common picture`."""
    at = f" {place(change, ego)}" if where else ""
    size, rises = abs(change.amount), change.amount > 0
    if change.kind == DISPLACED:
        return f"{f'{size:.2f}' if size >= 0.005 else small(size)} m {'more' if rises else 'less'} RMSE{at}"
    word = "more" if rises else "fewer"
    if change.kind == IDENTITY:
        return f"{size:.0f} {word} identity switch{'' if round(size) == 1 else 'es'}{at}"
    noun = objects(size, change.kind)
    number, _, rest = noun.partition(f" {change.kind}")
    return f"{number} {word} {change.kind}{rest} a frame{at}"


def due(run: RunFolder, change: Change) -> str:
    """`are due to adversary_1 and adversary_2`: of a change by the run's own measurements."""
    verb = "is" if change.kind == DISPLACED or amount(change, run.ego).startswith(("1 ", "1.0 ", "no ")) else "are"
    return f"{verb} due to {listed(causes(run, change))}"


def caused(run: RunFolder, change: Change) -> str:
    """`, due to adversary_1`: of a change over another run; says so where no cause was measured."""
    found = causes(run, change)
    return f", due to {listed(found)}" if found else ", by no measured cause"


def causes(run: RunFolder, change: Change) -> list[str]:
    """The adversaries, links and faults that a change is due to by measurement; may be empty."""
    found = []
    if change.is_attack:
        known = {each.name: each for each in interposers(run)}
        culprits = culprit_names(run, change)
        names = [known[name].description if name in known else name for name in culprits] or ["adversaries"]
        found += names if len(names) <= _MOST_NAMED else [f"{count(len(names))} adversaries"]
    if change.is_fault or (change.kind == DISPLACED and not found):
        found += faults(run, any_effect=change.kind == DISPLACED and not change.is_fault)
    return found


def culprit_names(run: RunFolder, change: Change) -> list[str]:
    """The adversaries that a change is due to by measurement, those with the most rows first; may be empty."""
    if not change.is_attack:
        return []
    total = sum(change.by.values())
    main = [name for name, rows in change.by.most_common() if rows >= CULPRIT * total]
    return main or [each.name for each in interposers(run) if each.changed and not each.is_link]


def faults(run: RunFolder, *, any_effect: bool = False) -> list[str]:
    """What links and faults there are, in words; any_effect: only if links did anything by measurement."""
    acting = [each for each in interposers(run) if each.is_link and each.changed]
    planned = [str(each["label"]) for each in run.timeline if each["kind"] != "attack"]
    if any_effect and not acting:
        return []
    if planned:
        return ["links and faults" if len(planned) > _MOST_NAMED else listed(planned)]
    return ["links" if len(acting) > _MOST_NAMED else listed([each.name for each in acting]) or "links and faults"]


def effects(interposer: Interposer) -> str:
    """`478 inserted, 235 removed`: what an interposer did by measurement."""
    known = interposer.effects or {}
    ordered = [name for name in (*EFFECTS, *known) if name in known and name != "unsettled"]
    return ", ".join(f"{known[name]} {name}" for name in dict.fromkeys(ordered)) or "nothing"
