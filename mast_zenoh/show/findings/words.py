"""Says findings of runs and results of studies: the words are in templates/phrases.j2 and study_phrases.j2."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from typing import Any

from mast_zenoh.metrics.estimates import PICTURE, place_of
from mast_zenoh.metrics.study_results import plural
from mast_zenoh.runs.run import Run
from mast_zenoh.show.findings.defence import of_defence
from mast_zenoh.show.findings.finding import Finding
from mast_zenoh.show.tables import study_rows, text_table
from mast_zenoh.show.tables.text_table import whole_percent

#: Names in a sentence; more are counted.
_MOST_NAMES = 8


def said(run: Run, findings: Iterable[Finding], *, capitals: bool = True) -> list[str]:
    """Each finding in a sentence without a full stop; those of a kind without a phrase are left out.

    capitals: begin with a capital letter, but for names and after a colon
    """
    texts: list[str] = []
    for each in findings:
        phrase = _macros("phrases.j2").get(each.kind.replace(" ", "_"))
        if phrase is None or not (text := " ".join(phrase(each, run, partial(place, run, each)).split())):
            continue
        plain = not capitals or text.startswith(each.who) or (texts and texts[-1].endswith(":"))
        texts.append(run.worded(text if plain else capital(text)))
    return texts


def text(run: Run, findings: Iterable[Finding]) -> str:
    """Findings as sentences, the last one without a full stop; empty: none."""
    sentences = said(run, findings)
    return "".join(f"{each}{' ' if each.endswith(':') else '. '}" for each in sentences[:-1]) + "".join(sentences[-1:])


def defence_line(run: Run) -> str:
    """What the defence of a run did, in one sentence without a full stop; empty: it has none."""
    parts = said(run, of_defence(run), capitals=False)
    judges = sum(run.role(name) == "peer" for name in run.files.record.get("nodes", {}))
    of_ego = " of the ego's peer (the others judge for themselves)" if judges > 1 and not run.has_centre else ""
    return f"{run.defence or 'The defence'}{of_ego}: {'; '.join(parts)}" if parts else ""


def names(each: Sequence[str], most: int = _MOST_NAMES) -> str:
    """`a`, `a and b`, `a, b and c`. most: names; of more, `a, b and 3 more`"""
    shown = [*each[:most], f"{len(each) - most} more"] if len(each) > most else list(each)
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def capital(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def number(value: float, digits: int = 2) -> str:
    """The size of a number as tables print it, or with more digits if that would be zero; whole, if no digits count."""
    size = abs(value)
    whole = not digits or size == 0.0 or size >= 0.5 * 10.0**-digits
    return f"{size:.{digits}f}" if whole else f"{size:.1g}"


def place(run: Run, finding: Finding) -> str:
    """Where a change is: `in the common picture`, `in the picture of mobile_1`."""
    (agent,) = finding.who
    if finding.where != PICTURE or agent == run.ego:
        return place_of(finding.where, agent, run.ego)
    own = "pictures" in run.files.summary  # each agent has its own
    return f"in the picture of {agent}" if own else f"in the common picture in range of {agent}"


def of_study(phrase: str, **data: Any) -> list[str]:
    """The sentences of a macro of templates/study_phrases.j2; data: its arguments."""
    sentences = _macros("study_phrases.j2")[phrase](**data).split("\u00b6")
    return [" ".join(each.split()) for each in sentences if each.strip()]


def paragraph(phrase: str, **data: Any) -> str:
    """The same as one text."""
    return " ".join(of_study(phrase, **data))


#: What the macros of each template call.
_FILTERS: dict[str, dict[str, Callable[..., str]]] = {
    "phrases.j2": {"names": names, "number": number, "percent": whole_percent, "plural": plural},
    "study_phrases.j2": {
        "names": names,
        "plural": plural,
        "number": text_table.number,
        "whole_percent": whole_percent,
        "measured": text_table.measured,
        "percent": text_table.percent,
        "over_trials": study_rows.over_trials,
        "value": study_rows.value,
        "bounds": study_rows.bounds,
    },
}


@cache
def _macros(template: str) -> dict[str, Callable[..., str]]:
    """The macros of a template by name."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(  # the text is not of a page: pages escape it
        loader=PackageLoader("mast_zenoh.show"), undefined=StrictUndefined, autoescape=False
    )
    environment.filters |= _FILTERS[template]
    module: Any = environment.get_template(template).module
    return {name: getattr(module, name) for name in dir(module) if not name.startswith("_")}
