"""What is worth saying about a run: findings, from its measurements, in one order; `words` says them.

words        their sentences; those of studies are from templates/study_phrases.j2
results      how the run ended, the largest changes of its scores;  changes, causes, differences  what these are due to
adversaries  what they did, and why it had limited effect
cars         what happened to driven cars;  defence  what a defence did, and the agents' own pictures
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.run_folder import finite, write_json
from mast_zenoh.run_folder.finding import Finding, names
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import Reference, of_errors
from mast_zenoh.show.findings import adversaries, cars, defence, results
from mast_zenoh.show.findings.changes import largest_change
from mast_zenoh.show.findings.words import said, text


def found_in(run: Run, reference: Reference | None = None) -> dict[str, list[Finding]]:
    """Everything that is worth saying about a run, by what it is about, in the order in which page and terminal say it.

    headline: how it failed, or else its outcome;  details: the outcome of one that failed, then the other results
    attacks, cars, defence, periods, pictures: what these did, were or lasted;  limits: why attacks had limited effect
    notices: what its launcher noted

    reference: the run that it is compared with, such as its unattacked twin; None: by its own measurements
    """
    failed, told = results.status(run), outcome(run, reference)
    return {
        "headline": failed or told,
        "details": [*(told if failed else []), *[each for each in _details(run, reference) if each not in told]],
        "attacks": adversaries.attacks(run),
        "cars": cars.of_cars(run, reference),
        "limits": adversaries.limits(run, reference),
        "defence": defence.of_defence(run),
        "periods": defence.periods(run),
        "pictures": defence.of_pictures(run),
        "notices": run.notices,
    }


def findings(run: Run, reference: Reference | None = None) -> list[Finding]:
    """The same, as one list."""
    return [each for part in found_in(run, reference).values() for each in part]


def write(run: Run, found: Mapping[str, Sequence[Finding]]) -> None:
    """Write `findings.json` into a run's folder: each finding's fields, and `text`, how the page says it.

    found: all findings of the run; notices have their words from run.json, as it may be of another version
    """
    texts = [each["text"] for each in run.files.record.get("notices") or ()]
    every = [(each, " ".join(said(run, [each]))) for name, part in found.items() if name != "notices" for each in part]
    every += zip(found["notices"], texts, strict=True)
    write_json(run.path / "findings.json", finite([asdict(each) | {"text": words} for each, words in every]))


def headline(run: Run, reference: Reference | None = None) -> str:
    """How a run failed, or else its outcome, in sentences; the last one without a full stop."""
    return text(run, results.status(run) or outcome(run, reference))


def outcome(run: Run, reference: Reference | None = None) -> list[Finding]:
    """What happened to driven cars, and the largest change and its cause; after the reference if that failed."""
    lost = results.lost_in_real_time(run)
    return [*results.unsound(reference), *lost, *cars.worst(run, reference), *results.of_scores(run, reference)]


def _details(run: Run, reference: Reference | None) -> list[Finding]:
    """What there is to say of the scores besides the outcome, which may have said some of it."""
    failed = tuple(str(each["name"]) for each in run.files.checks.get("checks", ()) if not each["ok"])
    return [
        *results.missed(run),
        *results.other_changes(run, reference),
        *results.during(run, of_errors(run, reference)),
        *results.braking(run),
        *results.faults(run),
        *[Finding("verdict", failed, "checks")] * bool(failed),
    ]


def of_compared(runs: Mapping[str, Run], reference: Reference) -> tuple[str, list[str]]:
    """The outcome of the run that an attack or a fault harmed most, and sentences on each run, over the reference."""
    others = {label: run for label, run in runs.items() if run is not reference.run}
    sentences = {label: text(run, outcome(run, reference)) for label, run in others.items() if run.scores_of(PICTURE)}
    harm = {label: _harm(others[label], reference) for label in sentences}
    worst = max(harm, key=lambda label: harm[label], default="")
    title = f"{worst}: {sentences[worst]}" if worst and any(harm[worst]) else f"{len(runs)} runs compared"
    if failed := [label for label, run in runs.items() if results.status(run)]:
        title = f"{names(failed)} did not end well: the numbers may be wrong"
    first = [f"{reference.name}: {each}." for each in said(reference.run, results.missed(reference.run))]
    for label, sentence in sentences.items():
        lasts = text(others[label], results.during(others[label], of_errors(others[label], reference)))
        first.append(f"{label}: {'. '.join(filter(None, [sentence, lasts]))}.")
    return title, first


def _harm(run: Run, reference: Reference) -> tuple[float, ...]:
    """Collisions, needless brakes, m of way that are lost, and the weight of the largest change."""
    counts, over = cars.counts(run, reference), of_errors(run, reference)
    events = [sum(each.value or 0.0 for each in counts if each.what == what) for what in ("hits", "needless")]
    lost_m = sum(each.other - (each.value or 0.0) for each in counts if each.what == "way" and each.other is not None)
    change = None if over is None else largest_change(run, over)
    return (*events, lost_m, 0.0 if change is None else max(0.0, change.weight))
