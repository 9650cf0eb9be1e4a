"""The result in words: a headline and a paragraph, for one run and for several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.fault_tables import check_rows
from mast_zenoh.report.narrative import changes, phrases
from mast_zenoh.report.narrative.attack_period import attack_sentences, while_attacked
from mast_zenoh.report.narrative.attribution import cause_clause, causes, due_to_causes
from mast_zenoh.report.narrative.changes import Change
from mast_zenoh.report.narrative.circumstances import compromised, reference_status, status
from mast_zenoh.report.narrative.explanations import late_start_s
from mast_zenoh.report.narrative.phrases import amount, capital, count, join_names, more_or_less, objects, plural
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.driving import braking_by_attack, driving_differs, unattributed_braking
from mast_zenoh.report.tables.interposers import Interposer, interposers
from mast_zenoh.report.tables.scores import ScoreTable


def headline(run: RunFolder, reference: Reference | None = None) -> str:
    """A sentence without a full stop on a run's failure or else its largest change.

    reference: the run that it is compared with; None: uses its own measurements
    """
    return status(run) or result(run, reference)


def result(run: RunFolder, reference: Reference | None = None) -> str:
    """The largest change and its cause, in a sentence without a full stop.

    It begins with the reference if that failed.
    """
    unsound = reference_status(reference)
    return f"{capital(unsound)}: {_result(run, reference)}" if unsound else _result(run, reference)


def _result(run: RunFolder, reference: Reference | None) -> str:
    picture = run.summary("picture")
    if not picture:
        if run.metrics_damaged:
            return "No scores: metrics.json is damaged"
        if run.metrics:  # from a user-defined evaluator
            return "No scores: metrics.json holds none of the common picture"
        return "No scores: this run did not get as far as its evaluation"
    places, change = compromised(run), _largest(run, reference)
    start = f"{places} compromised: " if places else ""
    if change is None:
        return _unchanged(run, places, reference)
    limits = _limits(run, reference, change)
    if reference is not None:
        cause = cause_clause(run, change, reference.run)
        return capital(f"{start}{more_or_less(change, run.ego)} than {reference.name}{cause}{limits}")
    return capital(f"{start}{amount(change, run.ego)} {due_to_causes(run, [change])}{limits}")


def _limits(run: RunFolder, reference: Reference | None, change: Change) -> str:
    """The effect of a change of the picture in transit on its use; empty for others."""
    if change.estimate not in changes.IN_TRANSIT or change.agent != run.ego:
        return ""
    all_changes = changes.attributed(run) if reference is None else changes.against(run, reference.run)
    changed = {each.estimate for each in all_changes if each.weight != 0.0}
    present = [name for name in ("picture_on_arrival", "mission") if run.summary(name)]
    unchanged = [name for name in present if name not in changed | {change.estimate}]
    names = {"picture_on_arrival": "the picture on arrival", "mission": "what the ego acts on"}
    if unchanged:
        verb = "do not" if len(unchanged) > 1 else "does not"
        return f"; {join_names([names[name] for name in unchanged])} {verb} change"
    acted_on = [each for each in all_changes if each.estimate == "mission" and each.weight != 0.0]
    kinds = dict.fromkeys([change.kind, changes.FALSE, changes.MISSED, changes.IDENTITY])
    relevant = [each for kind in kinds for each in acted_on if each.kind == kind] or acted_on
    if not relevant:
        return ""
    if reference is None:
        return f"; in what the ego acts on, {join_names([amount(each, run.ego, where=False) for each in relevant])}"
    return f"; in what the ego acts on, {join_names([more_or_less(each, run.ego, where=False) for each in relevant])}"


def _largest(run: RunFolder, reference: Reference | None) -> Change | None:
    return changes.largest_change(run, reference.run if reference else None)


def _unchanged(run: RunFolder, places: str, reference: Reference | None) -> str:
    """The result if no score differs."""
    active = [each for each in interposers(run) if each.changed and not (reference and each.is_link)]
    if active:
        did = "; ".join(f"{each.name}: {phrases.effects(each)}" for each in active)
        if reference is None:  # the effects may still matter through timing or other nodes
            return f"Interposers changed messages ({did}); no error can be attributed to them without --against twin"
        return f"Interposers changed messages ({did}), but {_same_scores(run, reference.run, reference.name)}"
    if places:
        unmeasured = any(each.effects is None for each in interposers(run))
        idle = [each for each in interposers(run) if not each.is_link]
        late = all(late_start_s(run, each) is not None for each in idle)
        passed = "were to begin after the end of the run" if late else "passed every message on unchanged"
        nothing = "were not measured" if unmeasured else passed
        return capital(f"adversaries on {places} {nothing}: {_missed_sentence(run)}")
    if reference is not None:
        return capital(f"{_same_scores(run, reference.run, reference.name)}: {_missed_sentence(run)}")
    return capital(_missed_sentence(run))


def _same_scores(run: RunFolder, reference: RunFolder, name: str) -> str:
    """States that all scores equal those of another run, or that only driving differs.

    A replay of what agents sent lacks the estimates that they made of the picture.
    """
    if not driving_differs(run, reference):
        estimates = [set(each.metrics.get("agents", {}).get(run.ego or "", ())) for each in (run, reference)]
        which = "every score" if estimates[0] == estimates[1] else "every score that both runs have"
        return f"{which} equals that of {name}"
    braking = braking_by_attack(run)
    return f"only driving differs from {name}" + (f" (because of attacks, {braking})" if braking else "")


def _missed_sentence(run: RunFolder) -> str:
    def missed(estimate: str) -> float | None:
        mean = run.summary(estimate).get("fn", {}).get("mean")
        return None if mean is None else float(mean)

    alone, picture, both = missed("local"), missed("picture"), missed("mission")
    if picture is None:
        return "missed objects were not scored"
    parts = [f"the common picture misses {objects(picture)} a frame"]
    parts += [f"the ego alone {alone:.2f}"] if alone is not None else []
    parts += [f"the ego with the picture {both:.2f}"] if both is not None else []
    return ", ".join(parts)


def reading(run: RunFolder, reference: Reference | None = None) -> list[str]:
    """Sentences on one run."""
    sentences = [f"{result(run, reference)}."] if status(run) else []
    sentences += (
        [f"{capital(_missed_sentence(run))}."] if run.summary("picture") and not _is_missed(run, reference) else []
    )
    sentences += _other_changes(run, reference) + _transit(run) + _blame(run)
    sentences += attack_sentences(run, _largest(run, reference))
    more = unattributed_braking(run, reference.run, reference.name) if reference else ""
    sentences += [f"{capital(more)}."] if more else []
    sentences += _verdicts(interposers(run))
    failed = [row.name for row in check_rows(run.checks) if row.outcome == "failed"]
    if failed:
        sentences.append(f"Some checks failed: {join_names(failed)}.")
    return sentences


def _is_missed(run: RunFolder, reference: Reference | None) -> bool:
    """Whether the headline already states the missed objects."""
    return _largest(run, reference) is None and not any(each.changed for each in interposers(run))


def _other_changes(run: RunFolder, reference: Reference | None) -> list[str]:
    """The largest notable change of each kind that the headline does not name."""
    all_changes = changes.attributed(run) if reference is None else changes.against(run, reference.run)
    main = changes.largest(all_changes)
    if main is None:
        return []
    by_cause: dict[tuple[str, ...], list[Change]] = {}
    for kind in changes.KEYS:
        change = changes.largest([each for each in all_changes if each.kind == kind and each.estimate != "local"])
        if change is not None and kind != main.kind and abs(change.weight) >= phrases.NOTHING / 2:
            by_cause.setdefault(tuple(causes(run, change, reference.run if reference else None)), []).append(change)
    if reference is None:
        clauses = [
            (join_names([amount(each, run.ego) for each in group]), due_to_causes(run, group))
            for group in by_cause.values()
        ]
        return [f"{capital(text)} {why}." for text, why in clauses]
    sentences = []
    for cause, group in by_cause.items():  # the headline explains missing causes
        text = join_names([more_or_less(each, run.ego) for each in group])
        sentences.append(f"{capital(text)} than {reference.name}{f', due to {join_names(cause)}' if cause else ''}.")
    return sentences


def _transit(run: RunFolder) -> list[str]:
    """Differences of the picture between the command centre and the ego."""
    sent = run.summary("picture")
    sentences = []
    for estimate, where in (("picture_received", "as the ego receives it"), ("picture_on_arrival", "when it arrives")):
        if run.original(estimate) != estimate or not run.summary(estimate) or not sent:
            continue
        notable = [
            each for each in changes.between(run, run.summary(estimate), sent) if abs(each.weight) >= phrases.NOTHING
        ]
        if notable:
            differs = join_names([more_or_less(each, run.ego, where=False) for each in notable])
            sentences.append(f"The picture {where} has {differs} than when the command centre sent it.")
    return sentences[-1:]


def _verdicts(all_interposers: Sequence[Interposer]) -> list[str]:
    """Sentences on interposers whose reports are missing or wrong, or that failed."""
    sentences = []
    for verdict, text in (
        ("silent", "{} changed messages and reported nothing"),
        ("disagrees", "What {} reported does not match what was measured"),
        ("crashed", "{} crashed"),
    ):
        names = [each.name for each in all_interposers if each.verdict == verdict]
        if names:
            sentences.append(f"{text.format(join_names(names))}.")
    failed = [f"{each.name}'s handlers failed in {plural(each.failed_frames, 'frame')}" for each in all_interposers]
    return sentences + [
        f"{text}." for each, text in zip(all_interposers, failed, strict=True) if each.verdict == "failed"
    ]


def _blame(run: RunFolder) -> list[str]:
    """Causes of the picture's missed objects; empty without links and faults, and if nothing is withheld."""
    split = run.summary("picture").get("fn_split") or {}
    if split.get("fault") is None or split.get("attack") is None:
        return []
    parts = [f"{split['fault']:.2f} a frame are missed because of links and faults"] if run.faulted else []
    if split.get("withheld"):
        parts.append(f"{split['withheld']:.2f} a frame are missed because the command centre withheld them")
    if not parts:
        return []
    parts += [f"{split['attack']:.2f} because of attacks"] if split["attack"] > 0.0 else []
    natural = f"{split['natural']:.2f} would be missed anyway"
    return [f"Of the objects that the picture misses, {', '.join(parts)}, and {natural}."]


def study_headline(runs: Mapping[str, RunFolder], table: ScoreTable) -> str:
    """A sentence without a full stop on the largest change over the reference."""
    failed = [label for label, run in runs.items() if status(run)]
    if failed:
        return capital(f"{join_names(failed)} did not end well: the numbers may be wrong")
    largest_changes = _changes(runs, table)
    if not largest_changes:
        return f"{capital(count(len(runs)))} runs compared"
    label, change = max(largest_changes.items(), key=lambda item: abs(item[1].weight))
    places = compromised(runs[label])
    start = f"{places} compromised ({label}): " if places else f"{label}: "
    return capital(f"{start}{more_or_less(change, runs[label].ego)} than {table.reference}")


def _changes(runs: Mapping[str, RunFolder], table: ScoreTable) -> dict[str, Change]:
    """The largest change of each run over the reference, without unchanged runs."""
    if table.reference is None:
        return {}
    others = {label: run for label, run in runs.items() if label != table.reference}
    largest_changes = {label: changes.largest_change(run, runs[table.reference]) for label, run in others.items()}
    return {label: change for label, change in largest_changes.items() if change is not None}


def study_reading(runs: Mapping[str, RunFolder], table: ScoreTable) -> list[str]:
    """Sentences on several runs."""
    sentences = []
    reference = runs.get(table.reference or "")
    if reference is not None and reference.summary("picture"):
        sentences.append(f"In run {table.reference}, {_missed_sentence(reference)}.")
    for label, run in runs.items():
        if run is reference or reference is None or not run.summary("picture"):
            continue
        places, change = compromised(run), changes.largest_change(run, reference)
        where = f" ({places} compromised)" if places else ""
        if change is None:
            sentences.append(f"Run {label}{where}: {_same_scores(run, reference, table.reference or '')}.")
            continue
        during = while_attacked(run, changes.KEYS[change.kind], reference, estimate=change.estimate)
        lasts = f" ({during:+.2f} while the attack lasts)".replace("-", "\u2212") if _counts(change, during) else ""
        sentences.append(
            f"In run {label}{where}, {more_or_less(change, run.ego)}{lasts}{cause_clause(run, change, reference)}."
        )
    if reference is not None and len(runs) > 1 and reference.summary("local"):
        own = {str([run.summary("local").get(key) for key in ("fn", "fp", "tp")]) for run in runs.values()}
        sentences.append(
            "The ego's own tracks score the same in every run."
            if len(own) == 1
            else "The ego's own tracks do not score the same in every run: see the table."
        )
    return sentences


def _counts(change: Change, during: float | None) -> bool:
    return during is not None and change.kind in (changes.FALSE, changes.MISSED)
