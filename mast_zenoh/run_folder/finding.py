"""A finding: what is worth saying about a run, as data, and its sentence: a phrase of phrases.j2 for each kind."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

#: Names in a sentence; more are counted.
_MOST_NAMES = 8


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that was measured of a run and is worth saying.

    kind:  which phrase of phrases.j2 says it
    who:   the nodes, agents or cars that it is about
    what:  which one of its kind: an effect, an error, a state, a reason
    value: how much;  unit: of the value;  other: the same of the run `than`, or of what the phrase names beside it
    where: an estimate of an agent, or wires
    when:  s, the first and the last moment
    cause: the causes that were measured, or else what explains it
    than:  the name of the run that it is compared with; empty: by the run's own measurements
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

    def to_json(self) -> dict[str, Any]:
        """The fields that say something."""
        return {name: value for name, value in asdict(self).items() if value not in ("", (), None)}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Finding:
        """From a file whose shape was checked; what is no field of a finding is left out."""
        given: dict[str, Any] = {each.name: content[each.name] for each in fields(cls) if each.name in content}
        lists = {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
        return cls(**(given | lists))


#: The shape of a finding in a JSON file.
SHAPE: dict[str, Any] = {
    **dict.fromkeys(("kind", "what", "unit", "where", "than"), str),
    **dict.fromkeys(("value", "other"), (int, float)),
    "who": [str],
    "cause": [str],
    "when": [(int, float)],
}


def sentence(finding: Finding, *context: Any) -> str:
    """A finding in words, without a capital letter and a full stop; empty: no phrase says it.

    context: what phrases on the results of a run need: the run, and the function that says where a finding is
    """
    every = macros(Path(__file__).with_name("phrases.j2"))
    phrase = every.get(finding.kind.replace(" ", "_"), every["notice"])
    return " ".join(phrase(finding, *context).split())


def names(each: Sequence[str], most: int = _MOST_NAMES) -> str:
    """`a`, `a and b`, `a, b and c`. most: names; of more, `a, b and 3 more`"""
    shown = [*each[:most], f"{len(each) - most} more"] if len(each) > most else list(each)
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def listed(sentences: Sequence[str], most: int) -> str:
    """`a; b; and 3 more`. most: sentences"""
    more = [f"and {len(sentences) - most} more"] if len(sentences) > most else []
    return "; ".join([*sentences[:most], *more])


def number(value: float, digits: int = 2) -> str:
    """The size of a number as tables print it, or with more digits if that would be zero; whole, if no digits count."""
    size = abs(value)
    whole = not digits or size == 0.0 or size >= 0.5 * 10.0**-digits
    return f"{size:.{digits}f}" if whole else f"{size:.1g}"


def factor(value: float) -> str:
    """How many times more something is: with a decimal, or of great ones three digits."""
    return f"{value:.1f}" if value < 100.0 else f"{value:.3g}"


def percent(share: float) -> str:
    """A share in per cent, halves rounded up."""
    return str(math.floor(100.0 * share + 0.5))


@cache
def macros(template: Path, filters: tuple[tuple[str, Callable[..., str]], ...] = ()) -> dict[str, Callable[..., str]]:
    """The macros of a template by name. filters: besides those of phrases.j2"""
    from jinja2 import Environment, StrictUndefined

    from mast_zenoh.metrics.study_results import plural  # loads what measures: nodes that say nothing do without

    environment = Environment(undefined=StrictUndefined, autoescape=False)  # the text is not of a page: pages escape it
    for each in (plural, names, listed, number, factor, percent):
        environment.filters[each.__name__] = each
    environment.filters |= dict(filters)
    module: Any = environment.from_string(template.read_text("utf-8")).module
    return {name: getattr(module, name) for name in dir(module) if not name.startswith("_")}
