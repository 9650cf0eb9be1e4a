"""The result of a run in words: a headline and a paragraph, for one run and for several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mast_zenoh.messagelog import churn
from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.narrative.adversaries import late_start_s
from mast_zenoh.report.narrative.attribution import cause_clause, causes, due_to_causes
from mast_zenoh.report.narrative.changes import (
    DISPLACED,
    FALSE,
    IDENTITY,
    IN_TRANSIT,
    KEYS,
    MISSED,
    NOTHING,
    OWNERS,
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
    more_or_less,
    objects,
    plural,
    scored,
)
from mast_zenoh.report.tables.of_run import braking_by_attack, check_rows, driving_differs, unattributed_braking
from mast_zenoh.report.tables.scores import ScoreTable
from mast_zenoh.viewer.interposers import Interposer, failures_of, frames_of, interposers
from mast_zenoh.viewer.run import RunRecord, Table, rows


def compromised(run: RunRecord) -> str:
    """Positions of adversaries in words; empty: none.

    `two of four roadside sensors`, `the picture's path to ego`
    """
    hostile = [each for each in interposers(run) if not each.is_link]
    kinds = {agent.name: agent.kind for agent in run.recording.agents} if run.recording else {}
    compromised_agents = {agent for each in hostile for agent in each.agents}
    names = set(kinds) or set(run.metrics.get("agents", {})) | compromised_agents
    places = []
    for kind, noun in (("static", "roadside sensor"), ("mobile", "vehicle")):
        group = {name for name in names if kinds.get(name, "static" if name.startswith("infra") else "mobile") == kind}
        number = len(group & compromised_agents)
        if number and len(group) == 1:
            places.append(f"the {noun}")
        elif number:
            places.append(f"{'all' if number == len(group) else f'{count(number)} of'} {count(len(group))} {noun}s")
    places += dict.fromkeys(f"the picture's path to {agent}" for each in hostile for agent in each.before)
    other_wires = [wire for each in hostile if not each.agents and not each.before for wire in each.wires]
    places += dict.fromkeys(f"the wire {wire}" for wire in other_wires)
    return " and ".join(places)


def status(run: RunRecord) -> str:
    """How a run failed, in a sentence without a full stop; empty: it did not."""
    failed = {name: failures_of(node) for name, node in run.run.get("nodes", {}).items() if failures_of(node)}
    if failed:
        names = [f"{name} failed in {plural(frames_of(entries), 'frame')}" for name, entries in failed.items()]
        return f"Handlers of {join_names(names)}: the numbers may be wrong"
    if lost := run.lost:
        return f"{churn.sentence(lost)}: from then on it is not the run that the scenario describes"
    state, partial = run.run.get("status", "ok"), _partly_recorded(run)
    if state == "ok":
        return capital(partial)
    text = f"The run did not end well ({state}): read the numbers with that in mind"
    if state == "killed":
        text = "The run was cut off: its launcher ended before it could record the outcome"
    elif state == "running":
        text = "The run is still in progress, or was cut off: its outcome is not known"
    return f"{text}; {partial}" if partial else text


def _partly_recorded(run: RunRecord) -> str:
    """A note if the numbers come from an incomplete recording; else empty."""
    recording = run.metrics.get("recording")
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
    state = reference.run.run.get("status")
    ends = {
        "running": "has not ended",
        "killed": "was cut off",
        "interrupted": "was interrupted",
        "ok": "was measured from part of its recording",
    }
    return f"compared with {reference.name}, which {ends.get(str(state), 'failed')}"


#: Agents that the sentence names.
_MOST_NAMES = 8


def defence_sentence(run: RunRecord) -> str:
    """Which agents the defence suspended, when, and what it withheld, as measured; empty: the run has no defence."""
    measured: dict[str, Any] = run.metrics.get("integrity", {})
    if not measured or run.defence == "NoIntegrity":
        return ""
    agents: dict[str, Any] = measured["agents"]
    suspended = [name for name, agent in agents.items() if agent["suspensions"]]
    missed = [name for name, agent in agents.items() if agent["lied"] and agent["suspended_after_s"] is None]
    did = [f"suspended {count(len(suspended))} agent{'s' if len(suspended) > 1 else ''}"]
    did += [_names([f"{name} ({_when(agents[name])})" for name in suspended])] if suspended else []
    did += [f"although {_names(missed)} lied"] if missed else []
    text = ", ".join(did)
    if "withheld" in measured:
        false, true = measured["withheld"]["false"], measured["withheld"]["true"]
        what = f"{false:.2f} false and {true:.2f} true objects a frame" if false or true else "nothing"
        text += f"{',' if len(did) > 1 else ''} and withheld {what}"
    return f"{run.defence or 'The defence'} {text}."


def _names(names: list[str]) -> str:
    """All names, or the first of many and the number of the others."""
    others = len(names) - _MOST_NAMES
    return join_names([*names[:_MOST_NAMES], f"{others} more"] if others > 0 else names)


def _when(agent: dict[str, Any]) -> str:
    """When an agent was suspended: `0.5 s after its first lie and while honest`."""
    delay_s = agent["suspended_after_s"]
    lying = [] if delay_s is None else [f"{delay_s:.1f} s after its first lie"]
    conducts = dict.fromkeys(each["conduct"] for each in agent["suspensions"])
    return " and ".join([*lying, *(f"while {conduct}" for conduct in conducts if not lying or conduct != "lying")])


def attack_sentences(run: RunRecord, change: Change | None) -> list[str]:
    """When adversaries changed messages, the scores in that period, needless braking.

    change: the headline's change; its kind and estimate select the scores
    """
    if run.attacks is None or run.attack_frames is None:
        return []
    first, last = run.attack_frames
    times = run.seconds(np.array(run.attack_frames))
    start, end = (
        (f"frame {first}", f"frame {last}") if times is None else (f"t = {times[0]:.1f} s", f"{times[1]:.1f} s")
    )
    active = [each.description for each in interposers(run) if each.changed and not each.is_link]
    if not active:  # metrics.json is damaged
        active = sorted(set(run.attacks["interposer"].tolist()))
    when = f"from {start} to {end}" if first != last else f"{'in' if times is None else 'at'} {start}"
    did = f"while {'it' if len(active) == 1 else 'they'} did"
    scores = _scores(run, change)
    sentences = [f"{join_names(active)} changed messages {when}{f'; {did}, {scores}' if scores else ''}."]
    attacked, total = _attacked_frames(run)
    if total and 2 * attacked < total:
        sentences.append(f"{attacked} of the {total} scored frames {'is' if attacked == 1 else 'are'} attacked.")
    braking = braking_by_attack(run)
    return sentences + ([f"Because of attacks, {braking}."] if braking else [])


def _attacked_frames(run: RunRecord) -> tuple[int, int]:
    """Numbers of scored frames with an adversary's change, and of all; 0: not known."""
    if run.attacks is None or run.scored_frames is None:
        return 0, 0
    frames = np.unique(run.attacks["frame"])
    return int(scored(run, frames).sum()), run.scored_frames[1] - run.scored_frames[0] + 1


def _scores(run: RunRecord, change: Change | None) -> str:
    """The ego's score during the attack, of the change's kind or else false objects."""
    is_ego = change is not None and change.agent == run.ego
    kind, estimate = (change.kind, change.estimate) if change is not None and is_ego else (FALSE, "picture")
    counts = (
        _counts_during_attack(run, estimate, run) if run.metrics else None
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
    return f"{OWNERS.get(estimate, f'{estimate} has')} {text}"


def while_attacked(
    run: RunRecord, column: str, baseline: RunRecord | None = None, *, estimate: str = "picture"
) -> float | None:
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


def _counts_during_attack(run: RunRecord, estimate: str, attacked: RunRecord) -> Table | None:
    """Counts of a run in the scored frames of an attack; None: no such frames.

    attacked: the run whose first and last change define the attack
    """
    counts = run.counts_of(estimate) or run.counts_of(run.original(estimate))
    if counts is None or attacked.attack_frames is None:
        return None
    first, last = attacked.attack_frames
    in_attack = (counts["frame"] >= first) & (counts["frame"] <= last) & scored(attacked, counts["frame"])
    return rows(counts, in_attack) if in_attack.any() else None


def headline(run: RunRecord, reference: Reference | None = None) -> str:
    """A sentence without a full stop on a run's failure or else its largest change.

    reference: the run that it is compared with; None: uses its own measurements
    """
    return status(run) or result(run, reference)


def result(run: RunRecord, reference: Reference | None = None) -> str:
    """The largest change and its cause, in a sentence without a full stop.

    It begins with the reference if that failed.
    """
    unsound = reference_status(reference)
    return f"{capital(unsound)}: {_result(run, reference)}" if unsound else _result(run, reference)


def _result(run: RunRecord, reference: Reference | None) -> str:
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


def _limits(run: RunRecord, reference: Reference | None, change: Change) -> str:
    """The effect of a change of the picture in transit on its use; empty for others."""
    if change.estimate not in IN_TRANSIT or change.agent != run.ego:
        return ""
    all_changes = attributed(run) if reference is None else against(run, reference.run)
    changed = {each.estimate for each in all_changes if each.weight != 0.0}
    present = [name for name in ("picture_on_arrival", "mission") if run.summary(name)]
    unchanged = [name for name in present if name not in changed | {change.estimate}]
    names = {"picture_on_arrival": "the picture on arrival", "mission": "what the ego acts on"}
    if unchanged:
        verb = "do not" if len(unchanged) > 1 else "does not"
        return f"; {join_names([names[name] for name in unchanged])} {verb} change"
    acted_on = [each for each in all_changes if each.estimate == "mission" and each.weight != 0.0]
    kinds = dict.fromkeys([change.kind, FALSE, MISSED, IDENTITY])
    relevant = [each for kind in kinds for each in acted_on if each.kind == kind] or acted_on
    if not relevant:
        return ""
    if reference is None:
        return f"; in what the ego acts on, {join_names([amount(each, run.ego, where=False) for each in relevant])}"
    return f"; in what the ego acts on, {join_names([more_or_less(each, run.ego, where=False) for each in relevant])}"


def _largest(run: RunRecord, reference: Reference | None) -> Change | None:
    return largest_change(run, reference.run if reference else None)


def _unchanged(run: RunRecord, places: str, reference: Reference | None) -> str:
    """The result if no score differs."""
    active = [each for each in interposers(run) if each.changed and not (reference and each.is_link)]
    if active:
        did = "; ".join(f"{each.name}: {effects(each)}" for each in active)
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


def _same_scores(run: RunRecord, reference: RunRecord, name: str) -> str:
    """States that all scores equal those of another run, or that only driving differs.

    A replay of what agents sent lacks the estimates that they made of the picture.
    """
    if not driving_differs(run, reference):
        estimates = [set(each.metrics.get("agents", {}).get(run.ego or "", ())) for each in (run, reference)]
        which = "every score" if estimates[0] == estimates[1] else "every score that both runs have"
        return f"{which} equals that of {name}"
    braking = braking_by_attack(run)
    return f"only driving differs from {name}" + (f" (because of attacks, {braking})" if braking else "")


def _missed_sentence(run: RunRecord) -> str:
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


def reading(run: RunRecord, reference: Reference | None = None) -> list[str]:
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


def _is_missed(run: RunRecord, reference: Reference | None) -> bool:
    """Whether the headline already states the missed objects."""
    return _largest(run, reference) is None and not any(each.changed for each in interposers(run))


def _other_changes(run: RunRecord, reference: Reference | None) -> list[str]:
    """The largest notable change of each kind that the headline does not name."""
    all_changes = attributed(run) if reference is None else against(run, reference.run)
    main = largest(all_changes)
    if main is None:
        return []
    by_cause: dict[tuple[str, ...], list[Change]] = {}
    for kind in KEYS:
        change = largest([each for each in all_changes if each.kind == kind and each.estimate != "local"])
        if change is not None and kind != main.kind and abs(change.weight) >= NOTHING / 2:
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


def _transit(run: RunRecord) -> list[str]:
    """Differences of the picture between the command centre and the ego."""
    sent = run.summary("picture")
    sentences = []
    for estimate, where in (("picture_received", "as the ego receives it"), ("picture_on_arrival", "when it arrives")):
        if run.original(estimate) != estimate or not run.summary(estimate) or not sent:
            continue
        notable = [each for each in between(run, run.summary(estimate), sent) if abs(each.weight) >= NOTHING]
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


def _blame(run: RunRecord) -> list[str]:
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


def study_headline(runs: Mapping[str, RunRecord], table: ScoreTable) -> str:
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


def _changes(runs: Mapping[str, RunRecord], table: ScoreTable) -> dict[str, Change]:
    """The largest change of each run over the reference, without unchanged runs."""
    if table.reference is None:
        return {}
    others = {label: run for label, run in runs.items() if label != table.reference}
    largest_changes = {label: largest_change(run, runs[table.reference]) for label, run in others.items()}
    return {label: change for label, change in largest_changes.items() if change is not None}


def study_reading(runs: Mapping[str, RunRecord], table: ScoreTable) -> list[str]:
    """Sentences on several runs."""
    sentences = []
    reference = runs.get(table.reference or "")
    if reference is not None and reference.summary("picture"):
        sentences.append(f"In run {table.reference}, {_missed_sentence(reference)}.")
    for label, run in runs.items():
        if run is reference or reference is None or not run.summary("picture"):
            continue
        places, change = compromised(run), largest_change(run, reference)
        where = f" ({places} compromised)" if places else ""
        if change is None:
            sentences.append(f"Run {label}{where}: {_same_scores(run, reference, table.reference or '')}.")
            continue
        during = while_attacked(run, KEYS[change.kind], reference, estimate=change.estimate)
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
    return during is not None and change.kind in (FALSE, MISSED)
