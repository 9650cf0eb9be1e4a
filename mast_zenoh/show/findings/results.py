"""How a run ended, and the largest changes of its scores and their causes."""

from __future__ import annotations

import numpy as np

from mast_zenoh.metrics.estimates import ESTIMATES, IN_TRANSIT, LOCAL, MISSION, PICTURE, RECEIVED
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.run_folder.recording import churn
from mast_zenoh.runs.files import Table, rows
from mast_zenoh.runs.interposers import failures_of, hostile, interposers, n_failed_frames
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import Reference, of_errors
from mast_zenoh.show.findings import changes
from mast_zenoh.show.findings.adversaries import period, positions
from mast_zenoh.show.findings.cars import drives
from mast_zenoh.show.findings.causes import causes, matters
from mast_zenoh.show.findings.changes import DISPLACED, ERRORS, FALSE, IDENTITY, MISSED, NOTHING, Change, scored
from mast_zenoh.show.findings.differences import attacking_nodes, other_differences


def status(run: Run) -> list[Finding]:
    """How a run failed, and what of it was not recorded; none: it is what its scenario describes."""
    record, recording = run.files.record, run.files.summary.get("recording")
    failed = {name: failures_of(node) for name, node in record.get("nodes", {}).items()}
    if any(failed.values()):
        return [Finding("ended", (name,), "handlers", n_failed_frames(each)) for name, each in failed.items() if each]
    if run.lost:
        return [_lost(run, "lost")]
    state, why = str(record.get("status", "ok")), str(record.get("message") or "read the numbers with that in mind")
    result = [Finding("ended", what=state, cause=(why.partition("\n")[0],))] * (state != "ok")
    if recording:
        result.append(Finding("ended", what="partial", value=recording["frames"], other=recording["played_frames"]))
    return result


def lost_in_real_time(run: Run) -> list[Finding]:
    """The nodes that were lost in a run in real time, which goes on without them."""
    return [_lost(run, "lost in real time")] * bool(run.files.record.get("churn") and not run.lost)


def _lost(run: Run, what: str) -> Finding:
    events = run.files.record.get("churn") or ()
    return Finding("ended", tuple(dict.fromkeys(e["node"] for e in events)), what, parts=churn.events(events))


def unsound(reference: Reference | None) -> list[Finding]:
    """That the run that this one is compared with did not end well; none: it did."""
    if reference is None or not status(reference.run):
        return []
    return [Finding("reference", what=str(reference.run.files.record.get("status")), than=reference.name)]


def of_scores(run: Run, reference: Reference | None = None) -> list[Finding]:
    """Where adversaries are, the largest change of a score and its cause; or why no score changes, or is known.

    reference: the run that it is compared with; None: uses its own measurements
    """
    if not run.scores_of(PICTURE):
        own = "own" if run.files.summary else "not evaluated"  # from a user-defined evaluator
        return [Finding("no scores", what="damaged" if run.metrics_damaged else own)]
    over = of_errors(run, reference)
    change = changes.largest_change(run, over)
    result = positions(run)
    if change is None:
        result += _unchanged(run, over, compared=reference is not None)
    else:
        if change.estimate == RECEIVED or (change.agent != run.ego and "pictures" in run.files.summary):
            result += _same_errors(run, PICTURE, over)
        result += [_finding(run, change, over), *_used(run, change, over)]
        if over is not None and (differences := other_differences(run, over.run)):
            also = "also " if attacking_nodes(run) - attacking_nodes(over.run) else ""
            result.append(Finding("unattributed", what=f"{also}differ", cause=differences))
        elif over is not None and change.amount > 0.0 and not causes(run, change, over):
            result.append(Finding("unattributed", what="no cause"))
    if reference is not None and over is None:
        result.append(Finding("unattributed", what="way", cause=other_differences(run, reference.run)))
    return result


def _finding(run: Run, change: Change, over: Reference | None) -> Finding:
    who, what, unit, where = (change.agent,), change.kind, ERRORS[change.kind].unit, change.estimate
    reasons, than = causes(run, change, over), "" if over is None else over.name
    return Finding("change", who, what, change.amount, None, unit, where, None, reasons, than)


def _same_errors(run: Run, estimate: str, over: Reference | None) -> list[Finding]:
    """That the errors of an estimate are those of the reference, or that none is due to attacks, if there were some."""
    if over is None and not hostile(run):
        return []
    judge, than = (run.defence,) if run.defence and over is None else (), "" if over is None else over.name
    return [Finding("unchanged", (run.ego or "",), "errors", where=estimate, cause=judge, than=than)]


def _used(run: Run, change: Change, over: Reference | None) -> list[Finding]:
    """What of a change of the picture in transit is in what the ego makes of it; none for other changes."""
    if change.estimate not in IN_TRANSIT or change.agent != run.ego:
        return []
    of_mission = [each for each in changes.changes(run, over) if each.estimate == MISSION and each.weight != 0.0]
    if not of_mission:
        return _same_errors(run, MISSION, over) if run.scores_of(MISSION) else []
    kinds = (change.kind, FALSE, MISSED, IDENTITY)
    relevant = [each for kind in dict.fromkeys(kinds) for each in of_mission if each.kind == kind] or of_mission
    return [_finding(run, each, over) for each in relevant]


def _unchanged(run: Run, over: Reference | None, *, compared: bool) -> list[Finding]:
    """What is known if no score differs; compared: with another run, in which driven cars may go another way."""
    changed = [each for each in interposers(run) if each.changed]
    adversaries = tuple(each.name for each in changed if not each.is_link and (over or matters(run, each.name)))
    links = tuple(each.name for each in changed if each.is_link and not over and matters(run, each.name))
    active, result = adversaries or links, []
    if over is not None:
        estimates = [each.files.summary.get("agents", {}).get(run.ego or "", {}) for each in (run, over.run)]
        same = "scores" if estimates[0].keys() == estimates[1].keys() else "shared scores"
        apart = tuple(name for name, own in estimates[0].items() if own != estimates[1].get(name, own))
        here, there = (each.files.summary.get("driving", {}).get(run.ego or "", {}) for each in (run, over.run))
        what = "driving" if any(here[name] != there[name] for name in here.keys() & there) else same
        own = tuple(name for name in apart if name not in ESTIMATES)
        result.append(Finding("unchanged", active, what, cause=own, than=over.name))
        result += braking(run) if what == "driving" else []
    elif active:
        result.append(Finding("unattributed", active, "way alone" if compared or not adversaries else "alone"))
    return result if active else [*result, *missed(run)]


def braking(run: Run) -> list[Finding]:
    """How often attacks make the ego brake wrongly, by the rule of corridor objects; none where a driver drives it."""
    mission = run.files.summary.get("driving", {}).get(run.ego or "", {}).get(MISSION, {})
    shares = {what: mission.get(f"{what}_brake_share_attack") for what in ("needless", "missed")}
    own = run.ego not in drives(run)
    return [Finding("braking", (run.ego or "",), what, share) for what, share in shares.items() if share and own]


def faults(run: Run) -> list[Finding]:
    """The faults of the scenario and their beginnings."""
    planned = [each for each in run.timeline if each["kind"] == "fault"]
    parts = tuple(Finding("fault", (str(each["label"]),), when=(each["at_s"],) * 2) for each in planned)
    return [Finding("faults", parts=parts)] * bool(parts)


def missed(run: Run) -> list[Finding]:
    """How many objects the picture misses, and the ego alone."""
    picture, alone = (run.scores_of(name).get("fn", {}).get("mean") for name in (PICTURE, LOCAL))
    return [Finding("missed", value=picture, other=alone, unit="objects a frame")] * (picture is not None)


def other_changes(run: Run, reference: Reference | None) -> list[Finding]:
    """The largest notable change of each kind that is not the largest of all."""
    over = of_errors(run, reference)
    all_changes = changes.changes(run, over)
    main, result = changes.largest(all_changes), []
    for kind in ERRORS if main is not None else ():
        change = changes.largest([each for each in all_changes if each.kind == kind and each.estimate != LOCAL])
        if change is not None and main is not None and kind != main.kind and abs(change.weight) >= NOTHING:
            result.append(_finding(run, change, over))
    return result


def during(run: Run, reference: Reference | None = None) -> list[Finding]:
    """The ego's score while adversaries change messages, of the kind of error that increased, or else that they cause.

    Beside that of the reference in the same frames. None if no scored frame is attacked, or no estimate depends on it.
    """
    change = changes.largest_change(run, of_errors(run, reference))
    done = {effect for each in hostile(run) for effect, number in (each.effects or {}).items() if number}
    kind, estimate = MISSED if done & {"removed", "dropped"} and "inserted" not in done else FALSE, PICTURE
    if change is not None and change.agent == run.ego and change.estimate != RECEIVED and change.weight > 0.0:
        kind, estimate = change.kind, change.estimate
    value = score_during(run, run, kind, estimate)
    if value is None or run.attack_frames is None or run.manipulations is None:
        return []
    if not any(matters(run, each.name) for each in hostile(run) if each.changed):
        return []
    before = None if reference is None else score_during(reference.run, run, kind, estimate)
    attacked, share = int(scored(run, np.unique(run.manipulations["frame"])).sum()), list[Finding]()
    if run.scored_frames:
        of_frames = run.scored_frames[1] - run.scored_frames[0] + 1
        share.append(Finding("attacked frames", value=attacked, other=of_frames, unit="frames"))
    who, when = (run.ego or "",), period(run, *run.attack_frames)
    unit, than = ERRORS[kind].unit, reference.name if reference is not None and before is not None else ""
    return [Finding("during", who, kind, value, before, unit, estimate, when, (), than, tuple(share))]


def score_during(run: Run, attacked: Run, kind: str, estimate: str) -> float | None:
    """A score of the ego over the scored frames of an attack; None: there are none, or no such score by frame.

    attacked: the run whose first and last change define the attack
    """
    counts = run.counts_of(estimate) or run.counts_of(run.original(estimate))
    if counts is None or attacked.attack_frames is None or ERRORS[kind].key not in counts:
        return None
    first, last = attacked.attack_frames
    chosen: Table = rows(
        counts, (counts["frame"] >= first) & (counts["frame"] <= last) & scored(attacked, counts["frame"])
    )
    score, matched = np.nan_to_num(chosen[ERRORS[kind].key].astype(np.float64)), chosen["tp"].astype(np.float64)
    if not len(score) or (kind == DISPLACED and not matched.sum()):
        return None
    if kind == DISPLACED:
        return float(np.sqrt((score**2 * matched).sum() / matched.sum()))
    return float(score.sum() if kind == IDENTITY else score.mean())
