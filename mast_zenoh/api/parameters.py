"""Parameters of a class or function: defaults, units and docstring descriptions.

A docstring describes parameters as `name: text` or `name, name: text`, on separate lines or after a full stop or a
semicolon. A class inherits the descriptions of its bases.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

#: Units by the end of a parameter's name, longest first.
_SUFFIXES = {
    "_per_m2": "1/m²",
    "_rad_s": "rad/s",
    "_per_s": "1/s",
    "bits_per_s": "bit/s",
    "_mps2": "m/s²",
    "_mps": "m/s",
    "_deg": "°",
    "_rad": "rad",
    "_hz": "Hz",
    "_ms": "ms",
    "_mb": "MB",
    "_s": "s",
    "_m": "m",
}
#: A unit at the beginning of a description: `m, how far …`, `s of scene time`.
_LEADING = re.compile(r"(?:\([^)]*\) )?(m/s²|m/s|rad|m|s)(?=,| of scene time| until| without| for| to)")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of what a scenario can name, or a column of a message.

    kind: of a column, its dtype and shape
    default: as text, "" if it is required;  unit: "" if it has none;  choices: the valid values, if they are few
    meaning: from the docstring, "" if not described there
    """

    name: str
    default: str
    unit: str
    meaning: str
    choices: tuple[str, ...] = ()
    kind: str = ""

    @property
    def words(self) -> str:
        """The meaning, and the valid values."""
        listed = f"one of {', '.join(self.choices)}" if self.choices else ""
        return "; ".join(part for part in (self.meaning, listed) if part)


def summary(cls: type) -> str:
    """The first paragraph of a class's own docstring.

    Without its full stop and without descriptions of parameters.
    """
    text = inspect.cleandoc(vars(cls).get("__doc__") or "")
    entries = _entries(text, _names(cls))
    first = text[: entries[0].start()] if entries else text
    return first.split("\n\n")[0].replace("\n", " ").strip().rstrip(".")


def parameters_of(of: Callable[..., Any], further: Iterable[Callable[..., Any]] = ()) -> tuple[Parameter, ...]:
    """The parameters of a class or function, in the order of its signature.

    further: other functions whose docstrings describe parameters that its own does not
    """
    signature = inspect.signature(of)
    meanings: dict[str, str] = {}
    for documented in (*(of.__mro__[:-1] if isinstance(of, type) else (of,)), *further):
        text = vars(documented).get("__doc__") if isinstance(documented, type) else documented.__doc__
        meanings = described(text or "", {*_names(documented), *_names(of)} - {"self"}) | meanings
    return tuple(_parameter(signature.parameters[name], meanings.get(name, "")) for name in _names(of))


def _names(of: Callable[..., Any]) -> list[str]:
    return [name for name, each in inspect.signature(of).parameters.items() if each.kind is not each.VAR_KEYWORD]


def _parameter(parameter: inspect.Parameter, meaning: str) -> Parameter:
    choices = re.fullmatch(r"Literal\[(.*)\]", str(parameter.annotation))
    values = tuple(part.strip(" '\"") for part in choices[1].split(",")) if choices else ()
    unit = unit_of(parameter.name, meaning)
    meaning = meaning.removeprefix(f"{unit}, ") if unit else meaning
    return Parameter(parameter.name, _text(parameter.default), unit, meaning, values)


def unit_of(name: str, meaning: str) -> str:
    """The unit of a parameter, from its name's suffix or its description's beginning."""
    for suffix in sorted(_SUFFIXES, key=len, reverse=True):
        if name.endswith(suffix):
            return _SUFFIXES[suffix]
    leading = _LEADING.match(meaning)
    return leading[1] if leading else ""


def _text(default: object) -> str:
    """A default as in source code."""
    if default is inspect.Parameter.empty:
        return ""
    plain = default is None or isinstance(default, (bool, int, float, str, tuple, list, dict))
    return repr(default) if plain else f"{type(default).__name__}()"


def described(text: str, names: Iterable[str]) -> dict[str, str]:
    """Descriptions of these parameters in a docstring, by name; others are absent."""
    text = inspect.cleandoc(text)
    known = list(names)
    entries = _entries(text, known)
    meanings: dict[str, str] = {}
    ends = [*(following.start() for following in entries[1:]), len(text)]
    for match, end in zip(entries, ends[: len(entries)], strict=True):
        raw = text[match.end() : end]
        meaning = _first_part(raw, text[: match.start()])
        for name in match[2].split(", "):
            matching = [each for each in known if each.startswith(name[:-1])] if name.endswith("…") else [name]
            for each in matching:
                meanings.setdefault(each, meaning)
    return meanings


def _entries(text: str, names: Iterable[str]) -> list[re.Match[str]]:
    """Matches where a docstring begins to describe these parameters.

    Group 2 holds the names of one or several parameters.
    """
    one = "|".join([*map(re.escape, sorted(names, key=len, reverse=True)), r"\w+_…"])
    entry = re.compile(rf"(?:(?<=^)|(?<=\n)|(?<=[.;] )|(?<=[.;]\n))([ ]*)((?:{one})(?:, (?:{one}))*):\s+")
    return list(entry.finditer(text))


def _first_part(raw: str, before: str) -> str:
    """A description up to the next paragraph or sentence that is not part of it.

    Such a sentence begins on a line without more indentation.
    """
    line = before.rpartition("\n")[2]
    indent = len(line) - len(line.lstrip())
    kept: list[str] = []
    for index, part in enumerate(raw.split("\n")):
        new_sentence = part[:1].isupper() or (part.strip()[:1].isupper() and len(part) - len(part.lstrip()) <= indent)
        if index and (not part.strip() or new_sentence):
            break
        kept.append(part.strip())
    return " ".join(kept).rstrip(" .;,")
