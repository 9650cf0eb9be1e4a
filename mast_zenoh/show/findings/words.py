"""Says findings in terms of their run, and results of studies: templates/study_phrases.j2 has the words of these."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from mast_zenoh.metrics.estimates import PICTURE, place_of
from mast_zenoh.run_folder.finding import Finding, macros, sentence
from mast_zenoh.runs.run import Run
from mast_zenoh.show import number_text


def said(run: Run, findings: Iterable[Finding], *, capitals: bool = True) -> list[str]:
    """Each finding in a sentence without a full stop; those of a kind without a phrase are left out.

    capitals: begin with a capital letter, but for names and after a colon
    """
    texts: list[str] = []
    for each in findings:
        if not (text := sentence(each, run, partial(place, run, each))):
            continue
        plain = not capitals or text.startswith(each.who) or (texts and texts[-1].endswith(":"))
        texts.append(run.worded(text if plain else capital(text)))
    return texts


def text(run: Run, findings: Iterable[Finding]) -> str:
    """Findings as sentences, the last one without a full stop; empty: none."""
    sentences = said(run, findings)
    return "".join(f"{each}{' ' if each.endswith(':') else '. '}" for each in sentences[:-1]) + "".join(sentences[-1:])


def defence_line(run: Run, found: Iterable[Finding]) -> str:
    """What the defence of a run did, in one sentence without a full stop; found: it, empty: the run has none."""
    parts = said(run, found, capitals=False)
    judges = sum(run.role(name) == "peer" for name in run.files.record.get("nodes", {}))
    of_ego = " of the ego's peer (the others judge for themselves)" if judges > 1 and not run.has_centre else ""
    return f"{run.defence or 'The defence'}{of_ego}: {'; '.join(parts)}" if parts else ""


def capital(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def place(run: Run, finding: Finding) -> str:
    """Where a change is: `in the common picture`, `in the picture of mobile_1`."""
    (agent,) = finding.who
    if finding.where != PICTURE or agent == run.ego:
        return place_of(finding.where, agent, run.ego)
    own = "pictures" in run.files.summary  # each agent has its own
    return f"in the picture of {agent}" if own else f"in the common picture in range of {agent}"


def of_study(phrase: str, **data: Any) -> list[str]:
    """The sentences of a macro of templates/study_phrases.j2; data: its arguments."""
    every = macros(Path(__file__).parents[1] / "templates" / "study_phrases.j2", tuple(_OF_STUDIES.items()))
    sentences = every[phrase](**data).split("\u00b6")
    return [" ".join(each.split()) for each in sentences if each.strip()]


def paragraph(phrase: str, **data: Any) -> str:
    """The same as one text."""
    return " ".join(of_study(phrase, **data))


#: Filters of study_phrases.j2, besides those of phrases.j2.
_OF_STUDIES: dict[str, Callable[..., str]] = {
    "number": number_text.number,
    "measured": number_text.measured,
    "percent": number_text.percent,
    "over_trials": number_text.over_trials,
    "value": number_text.value,
    "interval": number_text.interval,
}
