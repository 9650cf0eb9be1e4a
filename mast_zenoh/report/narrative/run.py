"""The result of a run in words: a headline and a paragraph, for one run and for several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mast_zenoh.metrics.estimates import ESTIMATES, IN_TRANSIT, LOCAL, MAIN, MISSION, PICTURE, RECEIVED
from mast_zenoh.report.comparison import Reference, same_ways
from mast_zenoh.report.narrative.adversaries import altered_on_the_way, compromised, late_start_s, period
from mast_zenoh.report.narrative.attribution import cause_clause, causes, due_to_causes, other_differences
from mast_zenoh.report.narrative.changes import (
    BOX_ERRORS,
    DISPLACED,
    FALSE,
    IDENTITY,
    KEYS,
    MISSED,
    NOTHING,
    Change,
    against,
    amount,
    attributed,
    between,
    capital,
    count,
    effects,
    join_names,
    largest,
    largest_change,
    objects,
    plural,
    scored,
)
from mast_zenoh.report.narrative.consequences import consequence, drives, worst
from mast_zenoh.report.tables.of_run import braking_by_attack, check_rows, driving_differs, unattributed_braking
from mast_zenoh.report.tables.scores import ScoreTable
from mast_zenoh.run_folder.recording import churn
from mast_zenoh.runs.files import Table, rows
from mast_zenoh.runs.interposers import Interposer, failures_of, interposers, n_failed_frames
from mast_zenoh.runs.run import Run

#: How a run that did not end well failed, by its status.
_FAILED = {
    "killed": "The run was cut off: its launcher ended before it could record the outcome",
    "running": "The run is still in progress, or was cut off: its outcome is not known",
}
_ENDS = {
    "running": "has not ended",
    "killed": "was cut off",
    "interrupted": "was interrupted",
    "ok": "was measured from part of its recording",
}


def status(run: Run) -> str:
    """How a run failed, in a sentence without a full stop; empty: it did not."""
    failed = {name: failures_of(node) for name, node in run.files.record.get("nodes", {}).items()}
    if names := [f"{name} failed in {plural(n_failed_frames(each), 'frame')}" for name, each in failed.items() if each]:
        return f"Handlers of {join_names(names)}: the numbers may be wrong"
    if lost := run.lost:
        return f"{churn.sentence(lost)}: from then on it is not the run that the scenario describes"
    state, partial = run.files.record.get("status", "ok"), _partly_recorded(run)
    if state == "ok":
        return capital(partial)
    why = str(run.files.record.get("message") or "read the numbers with that in mind").partition("\n")[0]
    text = _FAILED.get(state, f"The run did not end well ({state}): {why}")
    return f"{text}; {partial}" if partial else text


def _partly_recorded(run: Run) -> str:
    """A note if the numbers come from an incomplete recording; else empty."""
    recording = run.files.summary.get("recording")
    if not recording:
        return ""
    if not recording["frames"]:
        return "the recording from which it was measured holds no frame"
    last = f"frame {recording['frames'] - 1} of {recording['played_frames']}"
    return f"the recording from which it was measured ends at {last}, so the numbers are of these frames alone"


def reference_status(reference: Reference | None) -> str:
    """`compared with unattacked, which failed`; empty: no reference, or it ended well."""
    if reference is None or not status(reference.run):
        return ""
    return f"compared with {reference.name}, which {_ENDS.get(str(reference.run.files.record.get('status')), 'failed')}"


#: Agents that the sentence names.
_MOST_NAMES = 8


def defence_sentence(run: Run) -> str:
    """Which agents the defence suspended, when, and what it withheld, as measured; empty: the run has no defence."""
    measured: dict[str, Any] = run.files.summary.get("integrity", {})
    if not measured or run.defence == "NoIntegrity":
        return ""
    agents: dict[str, Any] = measured["agents"]
    suspended = [name for name, agent in agents.items() if agent["suspensions"]]
    watched = {name: agent for name, agent in agents.items() if agent["observed_s"] is not None}
    missed = [name for name, agent in watched.items() if agent["suspended_after_s"] is None]
    agents_suspended = f"suspended {count(len(suspended))} agent{'s' if len(suspended) > 1 else ''}"
    did = [agents_suspended if suspended else "set no agent's state to suspended"]
    did += [join_names([f"{name} ({_when(agents[name])})" for name in suspended], _MOST_NAMES)] if suspended else []
    did += _doubts(agents) + _needless_corrections(agents)
    on_the_way = altered_on_the_way(run)
    lied, altered = ([name for name in missed if (name in on_the_way) == way] for way in (False, True))
    ego_hears = f"what the ego hears of {join_names(altered, _MOST_NAMES)} is altered on the way"
    although = [f"{join_names(lied, _MOST_NAMES)} lied"] * bool(lied) + [ego_hears] * bool(altered)
    did += [f"although {join_names(although)}"] if although else []
    text = ", ".join(did)
    if "withheld" in measured:
        false, true = measured["withheld"]["false"], measured["withheld"]["true"]
        what = f"{false:.2f} false and {true:.2f} true objects a frame" if false or true else "nothing"
        text += f"{',' if len(did) > 1 else ''} and withheld {what}{_missed_for_it(run, true)}"
    judges = sum(run.role(name) == "peer" for name in run.files.record.get("nodes", {}))
    of_ego = " of the ego's peer (the others judge for themselves)" if judges > 1 and not run.has_centre else ""
    return f"{run.defence or 'The defence'}{of_ego} {text}."


def _missed_for_it(run: Run, withheld: float) -> str:
    """How many objects the ego's picture misses because of the defence, if that is not the number of withheld ones.

    It misses objects that only suspended agents report, too, and none that are out of its range.
    """
    missed = (run.scores_of(PICTURE).get("fn_split") or {}).get("withheld")
    if missed is None or f"{missed:.2f}" == f"{withheld:.2f}":
        return ""
    suspended = any(agent["suspensions"] for agent in run.files.summary["integrity"]["agents"].values())
    also = " and because only suspended agents report them" if suspended else ""
    return f"; in its range, the ego misses {missed:.2f} for this{also}"


def _doubts(agents: dict[str, Any]) -> list[str]:
    """About which agents the defence was undecided: for a time, and to the end of the run."""
    doubted = {name: agent["undecided"][-1]["until_s"] for name, agent in agents.items() if agent.get("undecided")}
    for_a_time = [name for name, until_s in doubted.items() if until_s is not None]
    to_the_end = [name for name, until_s in doubted.items() if until_s is None]
    parts = [f"for a time about {join_names(for_a_time, _MOST_NAMES)}"] * bool(for_a_time)
    parts += [f"to the end about {join_names(to_the_end, _MOST_NAMES)}"] * bool(to_the_end)
    return [f"was undecided {' and '.join(parts)}"] * bool(parts)


def _needless_corrections(agents: dict[str, Any]) -> list[str]:
    """Which honest agents without a fault the defence took for faulty, and for how long."""
    seconds = {name: agent.get("seconds", {}).get("honest", {}).get("faulty", 0.0) for name, agent in agents.items()}
    named = [f"{name} ({duration:.1f} s)" for name, duration in seconds.items() if duration]
    return [f"corrected without a fault {join_names(named, _MOST_NAMES)}"] * bool(named)


def _when(agent: dict[str, Any]) -> str:
    """When an agent was suspended: `0.5 s after its first lie and while honest`."""
    delay_s = agent["suspended_after_s"]
    if agent["lied"] and agent["observed_s"] is None:
        return "already suspended before its first lie"
    lying = [] if delay_s is None else [f"{delay_s:.1f} s after its first lie"]
    conducts = dict.fromkeys(each["conduct"] for each in agent["suspensions"])
    return " and ".join([*lying, *(f"while {conduct}" for conduct in conducts if not lying or conduct != "lying")])


def attack_sentences(run: Run, change: Change | None) -> list[str]:
    """When adversaries changed messages, the scores in that period, and needless braking by a rule.

    Not the latter where the ego is driven: the rule is not its driver.
    change: the headline's change; its kind and estimate select the scores
    """
    if run.manipulations is None or run.attack_frames is None:
        return []
    active = [each.description for each in interposers(run) if each.changed and not each.is_link]
    if not active:  # metrics.json is damaged
        active = sorted(set(run.manipulations["interposer"].tolist()))
    scores = _scores(run, change)
    during = f"; while {'it' if len(active) == 1 else 'they'} did, {scores}" if scores else ""
    sentences = [f"{join_names(active)} changed messages {period(run, *run.attack_frames)}{during}."]
    sentences += [f"{capital(each)}." for each in _box_errors(run)]
    attacked, total = _attacked_frames(run)
    if total and 2 * attacked < total:
        sentences.append(f"{attacked} of the {total} scored frames {'is' if attacked == 1 else 'are'} attacked.")
    braking = "" if run.ego in drives(run) else braking_by_attack(run)
    return sentences + ([f"Because of attacks, {braking}."] if braking else [])


def _attacked_frames(run: Run) -> tuple[int, int]:
    """Numbers of scored frames with an adversary's change, and of all; 0: not known."""
    if run.manipulations is None or run.scored_frames is None:
        return 0, 0
    frames = np.unique(run.manipulations["frame"])
    return int(scored(run, frames).sum()), run.scored_frames[1] - run.scored_frames[0] + 1


def _scores(run: Run, change: Change | None) -> str:
    """The ego's score during the attack, of the kind of error that increased, or else that attacks cause."""
    kind, estimate = _aim(run), PICTURE
    if change is not None and change.agent == run.ego and change.estimate != RECEIVED and change.weight > 0.0:
        kind, estimate = change.kind, change.estimate
    counts = (
        _counts_during_attack(run, estimate, run) if run.files.summary else None
    )  # without metrics, the scored frames are not known
    if counts is None:
        return ""
    if kind in (FALSE, MISSED):
        text = f"{objects(float(counts[KEYS[kind]].mean()), kind)} a frame"
    elif kind == IDENTITY:
        switches = int(counts["id_switches"].sum())
        text = f"{switches or 'no'} identity switch{'' if switches == 1 else 'es'}"
    else:
        matched = counts["tp"].astype(np.float64)
        squared = np.nan_to_num(counts["rmse_m"].astype(np.float64)) ** 2
        if kind != DISPLACED or not matched.sum():
            return ""
        text = f"an RMSE of {float(np.sqrt((squared * matched).sum() / matched.sum())):.2f} m"
    own_picture = estimate == PICTURE and "pictures" in run.files.summary
    return f"{'the picture of the ego' if own_picture else ESTIMATES[estimate].subject} has {text}"


def _aim(run: Run) -> str:
    """The kind of error that adversaries cause: MISSED if they hid objects and inserted none, else FALSE."""
    done = {effect for each in interposers(run) if not each.is_link for effect, n in (each.effects or {}).items() if n}
    return MISSED if done & {"removed", "dropped"} and "inserted" not in done else FALSE


def while_attacked(run: Run, column: str, baseline: Run | None = None, *, estimate: str = "picture") -> float | None:
    """Mean per frame of the ego's estimate over the scored frames of the attack.

    column: `fn`, `fp` or `tp`; with `baseline`, less the mean of the baseline's estimate over the same frames
    """
    counts = _counts_during_attack(run, estimate, run)
    if counts is None:
        return None
    mean = float(counts[column].mean())
    if baseline is None:
        return mean
    baseline_counts = _counts_during_attack(baseline, estimate, run)
    return None if baseline_counts is None else mean - float(baseline_counts[column].mean())


def _counts_during_attack(run: Run, estimate: str, attacked: Run) -> Table | None:
    """Counts of a run in the scored frames of an attack; None: no such frames.

    attacked: the run whose first and last change define the attack
    """
    counts = run.counts_of(estimate) or run.counts_of(run.original(estimate))
    if counts is None or attacked.attack_frames is None:
        return None
    first, last = attacked.attack_frames
    in_attack = (counts["frame"] >= first) & (counts["frame"] <= last) & scored(attacked, counts["frame"])
    return rows(counts, in_attack) if in_attack.any() else None


def headline(run: Run, reference: Reference | None = None) -> str:
    """A sentence without a full stop on a run's failure or else its largest change.

    reference: the run that it is compared with; None: uses its own measurements
    """
    return status(run) or result(run, reference)


def result(run: Run, reference: Reference | None = None) -> str:
    """The largest change and its cause, in a sentence without a full stop; after the reference if that failed.

    Nodes lost in real time come first, as `status` does not tell them. With drivers, what happened to their cars
    follows. Each is a sentence of its own.
    """
    unsound = reference_status(reference)
    lost = [] if run.lost else [churn.sentence(run.files.record.get("churn") or ())]
    text = run.worded(". ".join(filter(None, [*lost, consequence(run, reference), _result(run, reference)])))
    return f"{capital(unsound)}: {text}" if unsound else text


def _result(run: Run, reference: Reference | None) -> str:
    if not run.scores_of("picture"):
        why = "this run did not get as far as its evaluation"
        if run.metrics_damaged:
            why = "metrics.json is damaged"
        elif run.files.summary:  # from a user-defined evaluator
            why = "metrics.json holds none of the common picture"
        return f"No scores: {why}"
    elsewhere = _changed_way(run, reference)
    reference = _reference_of_errors(run, reference)
    places, change = compromised(run), _largest(run, reference)
    if change is None:
        return _unchanged(run, reference, elsewhere)
    what = amount(run, change, more=reference is not None)
    if reference is not None:
        what += f" than {reference.name}{cause_clause(run, change, reference.run)}"
    else:
        what += f" {due_to_causes(run, [change])}{elsewhere}"
    if change.estimate == RECEIVED or (change.agent != run.ego and "pictures" in run.files.summary):
        what = f"{_picture_unchanged(run, reference)}; {what}"
    if start := f"{places} compromised" if places else _idle(run):
        what = f"{start}: {what}"
    return capital(what + _limits(run, reference, change))


def _reference_of_errors(run: Run, reference: Reference | None) -> Reference | None:
    """The run over which errors are attributed; None where driven cars go another way: by its own measurements."""
    return reference if reference is None or same_ways(run, reference.run) else None


def _changed_way(run: Run, reference: Reference | None) -> str:
    """Where other differences of errors come from if driven cars go another way than in the reference; else empty."""
    if reference is None or same_ways(run, reference.run):
        return ""
    others = ["the changed way", *other_differences(run, reference.run)]
    return f"; what else differs in errors comes from {join_names(others, _MOST_NAMES)}"


def _picture_unchanged(run: Run, reference: Reference | None) -> str:
    """States that the picture that the ego uses is unchanged, and what the defence did about the tracks."""
    if reference is not None:
        return f"the common picture scores as in {reference.name}"
    judged = f"after {run.defence}, " if run.defence else ""
    return f"{judged}no error in the common picture is due to attacks"


def _changes(run: Run, reference: Reference | None) -> list[Change]:
    """The changes for the ego, over a reference or by the run's own measurements."""
    return attributed(run) if reference is None else against(run, reference.run)


def _limits(run: Run, reference: Reference | None, change: Change) -> str:
    """The effect of a change of the picture in transit on its use; empty for others."""
    if change.estimate not in IN_TRANSIT or change.agent != run.ego:
        return ""
    all_changes = _changes(run, reference)
    changed = {each.estimate for each in all_changes if each.weight != 0.0}
    present = [name for name in ("picture_on_arrival", "mission") if run.scores_of(name)]
    unchanged = [name for name in present if name not in changed | {change.estimate}]
    if unchanged:
        nouns, several = join_names([ESTIMATES[name].noun for name in unchanged]), len(unchanged) > 1
        if drives(run):  # what a driver brakes for may differ although errors are as many
            no_more = f"{nouns} {'have' if several else 'has'} no more errors"
            return f"; {no_more}" if reference is not None else f"; no such errors in {nouns}"
        return f"; {nouns} {'do' if several else 'does'} not change"
    acted_on = [each for each in all_changes if each.estimate == "mission" and each.weight != 0.0]
    kinds = dict.fromkeys([change.kind, FALSE, MISSED, IDENTITY])
    relevant = [each for kind in kinds for each in acted_on if each.kind == kind] or acted_on
    if not relevant:
        return ""
    amounts = [amount(run, each, where=False, more=reference is not None) for each in relevant]
    return f"; in what the ego acts on, {join_names(amounts)}"


def _largest(run: Run, reference: Reference | None) -> Change | None:
    return largest_change(run, reference.run if reference else None)


def _idle(run: Run) -> str:
    """Where adversaries are, if no change by them was measured, and why; empty: there are none."""
    adversaries = [each for each in interposers(run) if not each.is_link]
    if not (places := compromised(run, idle=True)):
        return ""
    late = all(late_start_s(run, each) is not None for each in adversaries)
    passed = "were to begin after the end of the run" if late else "passed every message on unchanged"
    unmeasured = any(each.effects is None for each in adversaries)
    return f"adversaries on {places} {'were not measured' if unmeasured else passed}"


def _unchanged(run: Run, reference: Reference | None, elsewhere: str) -> str:
    """The result if no score differs.

    elsewhere: where differences come from if driven cars go another way, see `_changed_way`; or empty
    """
    active = [each for each in interposers(run) if each.changed and not (reference and each.is_link)]
    if active:
        did = "; ".join(f"{each.name}: {effects(each)}" for each in active)
        if elsewhere:
            return f"Interposers changed messages ({did}); no error is attributed to them{elsewhere}"
        if reference is None:  # the effects may still matter through timing or other nodes
            unknown = "no error can be attributed to them without --against twin"
            return "; ".join([f"Interposers changed messages ({did}); {unknown}", *_box_errors(run)])
        return f"Interposers changed messages ({did}), but {_same_scores(run, reference.run, reference.name)}"
    if idle := _idle(run):
        return capital(f"{idle}: {_missed_sentence(run)}{elsewhere}")
    if reference is not None:
        return capital(f"{_same_scores(run, reference.run, reference.name)}: {_missed_sentence(run)}")
    return capital(f"{_missed_sentence(run)}{elsewhere}")


def _box_errors(run: Run) -> list[str]:
    """The errors of matched boxes if adversaries altered any, which no cause of errors accounts for."""
    altered = any((each.effects or {}).get("altered") for each in interposers(run) if not each.is_link)
    means = {kind: (run.scores_of(PICTURE).get(error.key) or {}).get("mean") for kind, error in BOX_ERRORS.items()}
    of = [(kind, BOX_ERRORS[kind], mean) for kind, mean in means.items() if mean is not None]
    texts = [f"{mean:.{error.digits}f}{error.unit} in {kind}" for kind, error, mean in of]
    return [f"matched objects of {ESTIMATES[PICTURE].noun} are off by {join_names(texts)}"] * bool(altered and texts)


def _same_scores(run: Run, reference: Run, name: str) -> str:
    """States that all scores equal those of another run, or that only driving differs.

    A replay of what agents sent lacks the estimates that they made of the picture.
    """
    if not driving_differs(run, reference):
        estimates = [set(each.files.summary.get("agents", {}).get(run.ego or "", ())) for each in (run, reference)]
        which = "every score" if estimates[0] == estimates[1] else "every score that both runs have"
        return f"{which} equals that of {name}"
    if run.ego in drives(run):
        return f"of the scores, only braking by the rule of docs/metrics.md differs from {name}"
    braking = braking_by_attack(run)
    return f"only driving differs from {name}" + (f" (because of attacks, {braking})" if braking else "")


def _missed_sentence(run: Run) -> str:
    missed = {name: run.scores_of(name).get("fn", {}).get("mean") for name in MAIN}
    if missed[PICTURE] is None:
        return "missed objects were not scored"
    others = [f"{ESTIMATES[name].subject} {missed[name]:.2f}" for name in (LOCAL, MISSION) if missed[name] is not None]
    return ", ".join([f"the common picture misses {objects(missed[PICTURE])} a frame", *others])


def reading(run: Run, reference: Reference | None = None) -> list[str]:
    """Sentences on one run."""
    sentences = [f"{result(run, reference)}."] if status(run) else []
    reference = _reference_of_errors(run, reference)
    if run.scores_of("picture") and not _is_missed(run, reference):
        sentences.append(f"{capital(_missed_sentence(run))}.")
    sentences += _other_changes(run, reference) + _transit(run) + _blame(run)
    sentences += attack_sentences(run, _largest(run, reference))
    more = unattributed_braking(run, reference.run, reference.name) if reference else ""
    if more and run.ego not in drives(run):
        sentences.append(f"{capital(more)}.")
    sentences += _verdicts(interposers(run))
    failed = [row.name for row in check_rows(run.files.checks) if row.outcome == "failed"]
    return sentences + ([f"Some checks failed: {join_names(failed)}."] if failed else [])


def _is_missed(run: Run, reference: Reference | None) -> bool:
    """Whether the headline already states the missed objects."""
    return _largest(run, reference) is None and not any(each.changed for each in interposers(run))


def _other_changes(run: Run, reference: Reference | None) -> list[str]:
    """The largest notable change of each kind that the headline does not name."""
    all_changes = _changes(run, reference)
    main = largest(all_changes)
    if main is None:
        return []
    by_cause: dict[tuple[str, ...], list[Change]] = {}
    for kind in KEYS:
        change = largest([each for each in all_changes if each.kind == kind and each.estimate != "local"])
        if change is not None and kind != main.kind and abs(change.weight) >= NOTHING / 2:
            by_cause.setdefault(tuple(causes(run, change, reference.run if reference else None)), []).append(change)
    sentences = []
    for cause, group in by_cause.items():
        text = capital(join_names([amount(run, each, more=reference is not None) for each in group]))
        if reference is None:
            sentences.append(f"{text} {due_to_causes(run, group)}.")
        else:  # the headline explains missing causes
            sentences.append(f"{text} than {reference.name}{f', due to {join_names(cause)}' if cause else ''}.")
    return sentences


def _transit(run: Run) -> list[str]:
    """Differences of the picture between the command centre and the ego."""
    sent = run.scores_of("picture")
    sentences = []
    for estimate, where in (("picture_received", "as the ego receives it"), ("picture_on_arrival", "when it arrives")):
        if run.original(estimate) != estimate or not run.scores_of(estimate) or not sent:
            continue
        notable = [each for each in between(run, run.scores_of(estimate), sent) if abs(each.weight) >= NOTHING]
        if notable:
            differs = join_names([amount(run, each, where=False, more=True) for each in notable])
            sentences.append(f"The picture {where} has {differs} than when the command centre sent it.")
    return sentences[-1:]


_VERDICTS = {
    "silent": "{} changed messages and reported nothing.",
    "disagrees": "What {} reported does not match what was measured.",
    "crashed": "{} crashed.",
}


def _verdicts(all_interposers: Sequence[Interposer]) -> list[str]:
    """Sentences on interposers whose reports are missing or wrong, or that failed."""
    names = {verdict: [each.name for each in all_interposers if each.verdict == verdict] for verdict in _VERDICTS}
    return [text.format(join_names(names[verdict])) for verdict, text in _VERDICTS.items() if names[verdict]] + [
        f"{each.name}'s handlers failed in {plural(each.failed_frames, 'frame')}."
        for each in all_interposers
        if each.verdict == "failed"
    ]


def _blame(run: Run) -> list[str]:
    """Causes of the picture's missed objects; empty without links and faults, and if nothing is withheld."""
    split = run.scores_of("picture").get("fn_split") or {}
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


def study_headline(runs: Mapping[str, Run], table: ScoreTable) -> str:
    """A sentence without a full stop on the largest change over the reference."""
    failed = [label for label, run in runs.items() if status(run)]
    if failed:
        return capital(f"{join_names(failed)} did not end well: the numbers may be wrong")
    reference = runs.get(table.reference or "")
    if reference is None:
        return f"{capital(count(len(runs)))} runs compared"
    others = {label: run for label, run in runs.items() if run is not reference}
    happened = worst(others, Reference(reference, table.reference or ""))
    start = f"{happened}. " * bool(happened)
    changes = {label: largest_change(run, reference) for label, run in others.items() if same_ways(run, reference)}
    known = [(label, change) for label, change in changes.items() if change is not None]
    if not known:
        return f"{start}{capital(count(len(runs)))} runs compared"
    label, change = max(known, key=lambda item: abs(item[1].weight))
    places = compromised(runs[label])
    where = f"{places} compromised ({label})" if places else label
    return start + capital(f"{where}: {amount(runs[label], change, more=True)} than {table.reference}")


def study_reading(runs: Mapping[str, Run], table: ScoreTable) -> list[str]:
    """Sentences on several runs."""
    name = table.reference or ""
    reference = runs.get(name)
    if reference is None:
        return []
    sentences = [f"In run {name}, {_missed_sentence(reference)}."] if reference.scores_of("picture") else []
    for label, run in runs.items():
        if run is reference or not run.scores_of("picture"):
            continue
        places, change = compromised(run), largest_change(run, reference)
        where = f" ({places} compromised)" if places else ""
        if not same_ways(run, reference):
            sentences.append(f"Run {label}: {result(run, Reference(reference, name))}.")
            continue
        if change is None:
            sentences.append(f"Run {label}{where}: {_same_scores(run, reference, name)}.")
            continue
        lasts = ""
        if change.kind in (FALSE, MISSED):
            during = while_attacked(run, KEYS[change.kind], reference, estimate=change.estimate)
            if during is not None:
                lasts = f" ({during:+.2f} while the attack lasts)".replace("-", "\u2212")
        what = amount(run, change, more=True)
        sentences.append(f"In run {label}{where}, {what}{lasts}{cause_clause(run, change, reference)}.")
    if len(runs) > 1 and reference.scores_of("local"):
        own = {str([run.scores_of("local").get(key) for key in ("fn", "fp", "tp")]) for run in runs.values()}
        same = "score the same in every run" if len(own) == 1 else "do not score the same in every run: see the table"
        sentences.append(f"The ego's own tracks {same}.")
    return sentences
