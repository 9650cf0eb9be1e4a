"""A finding: what is worth saying about a run, as data, and its sentence: a phrase of phrases.j2 for each kind."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

from mast_zenoh.errors import plural

#: Names in a sentence; more are counted.
_MOST_NAMES = 8


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that was measured of a run and is worth saying.

    kind:  which phrase of phrases.j2 says it
    who:   the nodes, agents, cars, objects or parts of the scenario that it is about, the one that acts first
    what:  which one of its kind: an effect, an error, a state
    value: how much;  unit: of the value;  other: the same of the run `than`, or of what the phrase names beside it
    where: an estimate, wires, a key or topic, or a place in the scene
    when:  s, the first and the last moment
    cause: what explains it: measured causes by their names, or a kind of reason and then who is to blame, or what a
           program said of its failure
    than:  the name of the run that it is compared with; empty: by the run's own measurements
    parts: what it consists of, such as each effect of an attack
    """

    kind: str
    who: tuple[str, ...] = ()
    what: str = ""
    value: float | None = None
    other: float | None = None
    unit: str = ""
    where: str = ""
    when: tuple[float, float] | None = None
    cause: tuple[str, ...] = ()
    than: str = ""
    parts: tuple[Finding, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The fields that say something."""
        said = {each.name: getattr(self, each.name) for each in fields(self)}
        said["parts"] = tuple(each.to_json() for each in self.parts)
        return {name: value for name, value in said.items() if value not in ("", (), None)}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Finding:
        """From a file that was checked; what is no field of a finding is left out. `value` was `count` once."""
        content = {"value": content.get("count"), **content}
        given = {each.name: content[each.name] for each in fields(cls) if content.get(each.name) is not None}
        lists = {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
        lists["parts"] = tuple(cls.from_json(each) for each in content.get("parts") or ())
        return cls(**(given | lists))


#: The shape of a finding in a JSON file.
SHAPE: dict[str, Any] = {
    **dict.fromkeys(("kind", "what", "unit", "where", "than"), str),
    **dict.fromkeys(("value", "other"), (int, float)),
    "who": [str],
    "cause": [str],
    "when": [(int, float)],
}
SHAPE["parts"] = [SHAPE]


def check(content: Mapping[str, Any], place: str) -> None:
    """Raise ValueError, with the place, unless what has the types of `SHAPE` is a finding: with a kind and no nulls."""
    if not isinstance(content.get("kind"), str):
        raise ValueError(f"{place}.kind: found {content.get('kind')!r:.60}, expected a string")
    for name, shape in SHAPE.items():
        values = content.get(name)
        if isinstance(shape, list) and values is not None and (None in values or (name == "when" and len(values) != 2)):
            expected = "two numbers" if name == "when" else "no null in it"
            raise ValueError(f"{place}.{name}: found {values!r:.60}, expected {expected}")
    for index, part in enumerate(content.get("parts") or ()):
        check(part, f"{place}.parts[{index}]")


def notice_lines(record: Mapping[str, Any]) -> list[str]:
    """The notices of a run.json that was checked, a line each with its kind, in the words of the version that ran."""
    return [f"{each['kind']}: {each['text']}" for each in record.get("notices") or ()]


def sentence(finding: Finding, *context: Any) -> str:
    """A finding in words, without a capital letter and a full stop; by its fields if its phrase misses something.

    context: what phrases on the results of a run need: the run, and the function that says where a finding is
    """
    every = macros(Path(__file__).with_name("phrases.j2"))  # those of other macros alone begin with _
    phrase = every.get(finding.kind.replace(" ", "_"), every["notice"])
    from jinja2 import UndefinedError  # slow, so that nodes do without

    try:
        text = phrase(finding, *context)
    except (UndefinedError, TypeError):
        if context:
            raise
        text = every["notice"](finding)  # a field that the phrase needs is missing: another version wrote it
    return " ".join(text.split())


def names(each: Sequence[str], most: int = _MOST_NAMES) -> str:
    """`a`, `a and b`, `a, b and c`. most: names; of more, `a, b and 3 more`"""
    shown = [*each[:most], f"{len(each) - most} more"] if len(each) > most else list(each)
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def listed(sentences: Sequence[str], most: int) -> str:
    """`a; b; and 3 more`. most: sentences"""
    more = [f"and {len(sentences) - most} more"] if len(sentences) > most else []
    return "; ".join([*sentences[:most], *more])


def size(value: float, digits: int = 2) -> str:
    """The size of a number as tables print it, or with more digits if that would be zero; whole, if no digits count."""
    amount = abs(value)
    whole = not digits or amount == 0.0 or amount >= 0.5 * 10.0**-digits
    return f"{amount:.{digits}f}" if whole else f"{amount:.1g}"


def factor(value: float) -> str:
    """How many times more something is: with a decimal, or of great ones three digits."""
    return f"{value:.1f}" if value < 100.0 else f"{value:.3g}"


def whole_percent(share: float) -> str:
    """A share in per cent, halves rounded up: 0.125 is `13`, 0.875 is `88`; a dash for NaN."""
    return "\u2013" if math.isnan(share) else str(math.floor(100.0 * share + 0.5))


@cache
def macros(template: Path, filters: tuple[tuple[str, Callable[..., str]], ...] = ()) -> dict[str, Callable[..., str]]:
    """The macros of a template by name. filters: besides those of phrases.j2"""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(undefined=StrictUndefined, autoescape=False)  # the text is not of a page: pages escape it
    for each in (plural, names, listed, size, factor, whole_percent, sentence):
        environment.filters[each.__name__] = each
    environment.filters |= dict(filters)
    module: Any = environment.from_string(template.read_text("utf-8")).module
    return {name: getattr(module, name) for name in dir(module) if not name.startswith("_")}
