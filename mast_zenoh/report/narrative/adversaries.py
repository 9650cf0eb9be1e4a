"""What adversaries did in a run, and why some of it had limited effect: from measurements and the scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools
from mast_zenoh.metrics.achievement import DISPLACED_M
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.report.comparison import same_ways
from mast_zenoh.report.narrative.attribution import culprit_names, matters, reaches
from mast_zenoh.report.narrative.changes import (
    DISPLACED,
    FALSE,
    IDENTITY,
    MISSED,
    capital,
    count,
    effects,
    join_names,
    largest_change,
    plural,
    scored,
)
from mast_zenoh.runs.files import Table, are_in, rows
from mast_zenoh.runs.interposers import OF_OBJECTS, Interposer, interposers
from mast_zenoh.runs.run import Run, agent_in_key
from mast_zenoh.wiring.model import peer_of

#: Adversaries with a sentence of their own; the others share one.
_DESCRIBED = 3
#: Faults that are named.
_NAMED = 3
_PLACES = {
    "detections": "the detections of {}",
    "tracks": "the tracks of {}",
    "pose": "the position that {} reports",
    "view": "the view that {} reports",
    "status": "the status that {} reports",
    "command": "the commands to {}",
}
_OBJECTS = {
    "inserted": "inserted {} that did not exist",
    "removed": "removed {}",
    "moved": "moved {}",
    "altered": "altered {}",
}
_MESSAGES = {
    "delayed": "delayed {}",
    "dropped": "dropped {}",
    "repeated": "sent {} again",
    "corrupted": "damaged {}",
    "restamped": "changed the time of {}",
    "reframed": "changed the frame of reference of {}",
    "forged": "forged {}",
    "slandered": "changed the trust in agents that is told in {}",
}


#: Agents that are named as senders; more are counted.
_MOST_SENDERS = 3


def compromised(run: Run, *, idle: bool = False) -> str:
    """Positions of adversaries in words, without those that were measured and changed nothing; empty: none.

    idle: with these, too

    `two of four roadside sensors`, `the gossip of one of three vehicles`, `what infra_1 sends to the ego`,
    `what mobile_1 hears`, `the picture's path to ego`
    """
    hostile = [each for each in interposers(run) if not each.is_link]
    hostile = [each for each in hostile if idle or each.changed or each.effects is None]
    kinds = {agent.name: agent.kind for agent in run.files.scene.agents} if run.files.scene else {}
    everywhere = [each for each in hostile if not each.before]
    gossip = {agent for each in everywhere if changes_gossip_alone(run, each) for agent in each.agents}
    all_messages = {agent for each in everywhere if not changes_gossip_alone(run, each) for agent in each.agents}
    names = set(kinds) or set(run.files.summary.get("agents", {})) | {
        agent for each in hostile for agent in each.agents
    }
    groups = [
        (noun, {name for name in names if kinds.get(name, "static" if name.startswith("infra") else "mobile") == kind})
        for kind, noun in (("static", "roadside sensor"), ("mobile", "vehicle"))
    ]
    places = _shares(groups, all_messages)
    if alone := _shares(groups, gossip - all_messages):
        places.append(f"the gossip of {join_names(alone)}")
    places += _on_the_way(run, names, hostile)
    other_wires = [wire for each in hostile if not each.agents and not each.before for wire in each.wires]
    places += dict.fromkeys(f"the wire {wire}" for wire in other_wires)
    return " and ".join(places)


def _shares(groups: Sequence[tuple[str, set[str]]], agents: set[str]) -> list[str]:
    """How many of each kind of agent are among some: `two of four roadside sensors`; groups: (noun, all agents)."""
    shares = []
    for noun, group in groups:
        number = len(group & agents)
        if number and len(group) == 1:
            shares.append(f"the {noun}")
        elif number:
            shares.append(f"{'all' if number == len(group) else f'{count(number)} of'} {count(len(group))} {noun}s")
    return shares


def _on_the_way(run: Run, names: set[str], hostile: Sequence[Interposer]) -> list[str]:
    """What adversaries change for single subscribers: `what infra_1 sends to the ego`, `what mobile_1 hears`."""
    listeners = {peer_of(name): name for name in names}
    places = []
    for before in dict.fromkeys(before for each in hostile for before in each.before):
        senders = {agent for each in hostile if before in each.before for agent in each.agents}
        listener = listeners.get(before, before)
        to = "the ego" if listener == run.ego else listener
        if before not in listeners and not senders:
            places.append(f"the picture's path to {before}")
        elif before in listeners and senders >= names - {listener}:
            places.append(f"what {to} hears")
        elif len(senders) > _MOST_SENDERS:
            places.append(f"what {count(len(senders))} agents send to {to}")
        else:
            verb = "sends" if len(senders) == 1 else "send"
            places.append(f"what {join_names(sorted(senders))} {verb} to {to}")
    return places


def attack_description(run: Run) -> list[str]:
    """Sentences: what each adversary did, where and when; which coordinators directed it; faults of the scenario."""
    adversaries = [each for each in interposers(run) if not each.is_link]
    active = [each for each in adversaries if each.changed]
    sentences = [_sentence(run, each) for each in active[:_DESCRIBED]]
    if others := active[_DESCRIBED:]:
        names = join_names([each.name for each in others])
        if len(others) > _NAMED:
            names = f"{capital(count(len(others)))} other adversaries"
        sentences.append(f"{names} did the same kind of thing: see the table of interposers.")
    unmeasured = [each.name for each in adversaries if each.effects is None]
    idle = [each.name for each in adversaries if each.effects is not None and not each.changed]
    if idle:
        sentences.append(f"{join_names(idle)} changed nothing.")
    if unmeasured:
        sentences.append(f"What {join_names(unmeasured)} did was not measured.")
    directors = [name for name in run.files.record.get("nodes", {}) if run.role(name) == "coordinator"]
    if directors and len(adversaries) > 1:
        sentences.append(f"{join_names(directors)} directed the adversaries.")
    if not adversaries and (run.files.wiring or run.files.summary):
        sentences.append("No adversary took part in this run.")
    return sentences + _faults(run)


def _sentence(run: Run, adversary: Interposer) -> str:
    """`In the detections of infra_1, adversary_1 inserted four objects that did not exist, from t = 4.0 s to 5.9 s.`"""
    effects = adversary.effects_besides_named
    clauses = [_of_objects(adversary, name, effects[name]) for name in OF_OBJECTS if effects.get(name)]
    clauses += [
        words.format(plural(effects[name], "message")) for name, words in _MESSAGES.items() if effects.get(name)
    ]
    rest = [name for name in effects if name not in (*OF_OBJECTS, *_MESSAGES, "unsettled") and effects[name]]
    clauses += [f"{name} {plural(effects[name], 'message')}" for name in rest]
    if adversary.views:
        see = "says it sees" if len(adversary.agents) == 1 else "say they see"
        clauses.append(f"changed what {join_names(adversary.agents)} {see} in {plural(adversary.views, 'view')}")
    if adversary.commands:
        clauses.append(
            f"changed what {plural(adversary.commands, 'message')} tell{'s' * (adversary.commands == 1)} the car to do"
        )
    what, places = join_names(clauses), join_names(_places(run, adversary))
    if adversary.before and adversary.agents:
        places += f" on the way to {_listeners(run, adversary)} alone"
    return f"In {places}, {adversary.name} {what}{_when(run, adversary)}."


def changes_gossip_alone(run: Run, adversary: Interposer) -> bool:
    """Whether an adversary changed what agents say of each other, and nothing that they say of objects."""
    if run.manipulations is None:
        return False
    changed = run.manipulations["message"][run.manipulations["interposer"] == adversary.name]
    return bool(len(changed) and (changed == "gossip").all())


def _listeners(run: Run, adversary: Interposer) -> str:
    """The agents whose copy of messages alone passes through an adversary; other subscribers by their names."""
    agent_of_peer = {peer_of(agent): agent for agent in run.files.summary.get("agents", {})}
    listeners = [agent_of_peer.get(before, before) for before in adversary.before]
    return join_names(["the ego" if name == run.ego else name for name in listeners])


def altered_on_the_way(run: Run) -> set[str]:
    """The agents that do not lie, but whose messages adversaries change for single subscribers."""
    hostile = [each for each in interposers(run) if not each.is_link]
    at_source = {agent for each in hostile if not each.before for agent in each.agents}
    return {agent for each in hostile if each.before for agent in each.agents} - at_source


def _of_objects(adversary: Interposer, effect: str, rows: int) -> str:
    number, clutter = adversary.objects.get(effect, (None, False))
    if number is None:
        what = f"objects ({plural(rows, 'row')})"
    elif number:
        what = f"{count(number)} object{'' if number == 1 else 's'}{' and clutter' if clutter else ''}"
    else:
        what = "clutter"
    return _OBJECTS[effect].format(what)


def _places(run: Run, adversary: Interposer) -> list[str]:
    """The messages that an adversary changed, in words."""
    wires: Mapping[str, Mapping[str, Any]] = {wire["key"]: wire for wire in run.files.wiring.get("wires", ())}
    changed: set[str] = set()
    if run.manipulations is not None:
        changed = set(run.manipulations["wire"][run.manipulations["interposer"] == adversary.name].tolist())
    places: dict[str, None] = {}
    for key in [key for key in adversary.wires if key in changed] or adversary.wires:
        wire = wires.get(key, {})
        message = str(wire.get("message") or key.rpartition("/")[2])
        subject = str(wire.get("subject") or agent_in_key(key) or "")
        if message == "picture":
            before = f" on its way to {join_names(adversary.before)}" if adversary.before else " for all agents"
            places[f"the common picture{before}"] = None
        elif message in _PLACES and subject:
            places[_PLACES[message].format(subject)] = None
        else:
            places[f"the messages on {key}"] = None
    return list(places)


def _when(run: Run, adversary: Interposer) -> str:
    """When it changed messages, and whether it was inserted during the run; empty: not known."""
    parts = []
    if run.manipulations is not None:
        frames = run.manipulations["frame"][run.manipulations["interposer"] == adversary.name]
        frames = frames[frames >= 0]
        if len(frames):
            parts.append(period(run, int(frames.min()), int(frames.max())))
    if adversary.live is not None:
        until = f", and removed in frame {adversary.released}" if adversary.released is not None else ""
        parts.append(f"after it was inserted live in frame {adversary.live}{until}")
    return "".join(f", {part}" for part in parts)


def period(run: Run, first: int, last: int) -> str:
    """`from t = 1.5 s to 3.9 s`, of frames of the run; without its scene, `from frame 15 to 39`."""
    times = run.seconds(np.array([first, last]))
    if times is None:
        return f"in frame {first}" if first == last else f"from frame {first} to {last}"
    return f"at t = {times[0]:.1f} s" if first == last else f"from t = {times[0]:.1f} s to {times[1]:.1f} s"


def _faults(run: Run) -> list[str]:
    """A sentence about the faults of the scenario; none without faults."""
    timeline = run.files.scenario.get("timeline") if isinstance(run.files.scenario, Mapping) else None
    faults: Sequence[Mapping[str, Any]] = [each for each in timeline or () if each.get("kind") == "fault"]
    if not faults:
        return []
    named = [f"{each['label']} from t = {each['at_s']:g} s" for each in faults]
    return [f"The scenario also has {'a fault' if len(faults) == 1 else 'faults'}: {join_names(named, _NAMED)}."]


#: Lidar points with which an agent detects an object, as in `seen_by_others` of targets.parquet.
_MIN_POINTS = 5


def explanations(run: Run, reference: Run | None = None) -> dict[str, tuple[str, ...]]:
    """Reasons for limited effects on the picture or the ego, by interposer.

    Links have none.

    A reason begins with the kind of manipulation, unless it applies to everything that the interposer did. The cause
    of the largest change, which the headline names, has none.
    reference: the run that this one is compared with; None: uses the run's own measurements, and so it does where
               driven cars go another way
    """
    result = {}
    if reference is not None and not same_ways(run, reference):
        reference = None
    change = largest_change(run, reference)
    blamed = culprit_names(run, change, reference) if change is not None else []
    for each in interposers(run):
        kind = change.kind if change is not None and each.name in blamed else ""
        reasons = () if each.is_link else tuple(_reasons(run, each, kind))
        if reasons:
            result[each.name] = reasons
    return result


def _reasons(run: Run, interposer: Interposer, blamed_for: str) -> list[str]:
    """Reasons for limited effects of one interposer.

    blamed_for: the kind of the largest change if this interposer causes it, else empty
    """
    if interposer.effects is None:
        return ["what it did was not measured"]
    if not interposer.changed:
        return [_idle(run, interposer)]
    if not matters(run, interposer.name):
        return [f"no estimate depends on {' and '.join(interposer.wires)}"]
    relayed = bool(blamed_for) and reaches(run, interposer.name, PICTURE)  # what another agent heard reached the ego
    if interposer.before and not relayed and not {run.ego, peer_of(str(run.ego))} & set(interposer.before):
        listeners = _listeners(run, interposer)
        if set(interposer.wires) == {"clock"}:
            return [f"it delayed the clock of {listeners}, not of the ego"]
        path = "picture's path" if run.has_centre else "path of messages"
        return [f"it sat on the {path} to {listeners}, not to the ego"]
    if run.files.targets is None:
        return []
    targets = rows(
        run.files.targets,
        (run.files.targets["adversary"] == interposer.name) & are_in(run.files.sample, run.files.targets["frame"]),
    )
    if not len(targets["frame"]):
        if blamed_for or interposer.commands:  # what commands do is not in errors
            return []
        return [f"it changed no single object that could be false or missed: {effects(interposer)}"]
    achieved = run.files.summary.get("achieved", {}).get(interposer.name, {})
    if (targets["frame"] >= run.files.summary.get("frames", 0)).all():
        return ["what it sent is about frames that the run does not have"]
    scored_rows = scored(run, targets["frame"])
    reasons = [] if scored_rows.any() else ["everything that it did was in frames that are not scored"]
    for kinds, explain, consequences in (
        (("inserted",), _inserted, (FALSE,)),
        (("removed",), _removed, (MISSED,)),
        (("moved", "altered"), _moved, (DISPLACED, IDENTITY)),
    ):
        group = rows(targets, np.isin(targets["kind"], kinds))
        did_more = any(count for name, count in interposer.effects.items() if name not in (*kinds, "unsettled"))
        if not len(group["frame"]) or blamed_for in consequences or (blamed_for and not did_more):
            continue
        name = next(kind for kind in kinds if np.any(group["kind"] == kind))
        explanation = explain(run, group, achieved)
        others = _other_interposers(run, interposer)
        if others and explanation and "the fusion rejected" in explanation[0]:
            explanation = [f"no track followed it; {others} on the same wire may have removed it"]
        reasons += explanation if name == "removed" else [f"{name}: {reason}" for reason in explanation]
    return reasons


def _other_interposers(run: Run, interposer: Interposer) -> str:
    """Names of other interposers on its wires that changed something; empty: none."""
    names = [
        each.name
        for each in interposers(run)
        if each.name != interposer.name and each.changed and set(each.wires) & set(interposer.wires)
    ]
    return ", ".join(names)


def _idle(run: Run, interposer: Interposer) -> str:
    """Why an interposer changed nothing."""
    if interposer.failures:
        did = "it changed nothing" if interposer.failed_frames else "it crashed before it changed anything"
        return f"{did}: {interposer.failures}"
    if interposer.received == 0:
        return "no message reached it"
    start = late_start_s(run, interposer)
    if start is not None:
        return f"its attack was to begin at {start:g} s, after the end of the run at {_duration_s(run):.1f} s"
    return f"it passed all {interposer.received} messages on unchanged"


def late_start_s(run: Run, interposer: Interposer) -> float | None:
    """s, start of an attack planned for after the end of the run; None: otherwise."""
    attack = (run.node_spec(interposer.name).get("config") or {}).get("attack")
    start = attack.get("start_s") if isinstance(attack, Mapping) else None
    return float(start) if isinstance(start, (int, float)) and 0.0 < _duration_s(run) <= start else None


def _duration_s(run: Run) -> float:
    return float(run.files.summary.get("frames", 0) * run.period_s)


def _inserted(run: Run, targets: Table, achieved: Mapping[str, Any]) -> list[str]:
    """Reasons why no tracks followed inserted objects."""
    reasons = []
    if not achieved.get("inserted_share_centre") and not achieved.get("inserted_share_ego"):
        if not _judged(targets).any():
            return [f"what it inserted was out of range of every agent ({run.range_m:g} m)"]
        on_real = _on_real_objects(run, targets)
        if on_real is not None and on_real.mean() >= 0.5:
            near = f"within {run.gate_m:g} m of a real object"
            return [f"{on_real.mean():.0%} of what it inserted was {near}, and was taken for it"]
        if _only_downlink(run, targets):
            return ["the ego's fusion rejected everything that it inserted: no track followed it"]
        withheld = run.files.summary.get("integrity", {}).get("withheld", {}).get("false")
        by = "the defence withheld, or the fusion rejected," if withheld else "the fusion rejected"
        return [f"{by} everything that it inserted: no track of the picture followed it"]
    if achieved.get("inserted_share_centre") and achieved.get("inserted_share_ego") == 0.0:  # None: not measured
        reasons.append("the picture had what it inserted, but the ego did not adopt it")
    return reasons


def _removed(run: Run, targets: Table, achieved: Mapping[str, Any]) -> list[str]:
    """Reasons why objects in removed rows or dropped messages were not missed."""
    dropped = np.zeros(len(targets["frame"]), bool)
    if run.manipulations is not None:
        drops = (run.manipulations["interposer"] == targets["adversary"][0]) & (
            run.manipulations["effect"] == "dropped"
        )
        dropped = np.isin(targets["frame"], run.manipulations["frame"][drops])
    groups = (
        ("removed", ~dropped, "what it removed"),
        ("dropped", dropped, "the objects in the messages that it dropped"),
    )
    return [
        f"{name}: {reason}"
        for name, group, objects in groups
        if group.any()
        for reason in _reasons_not_missed(run, rows(targets, group), achieved, objects)
    ]


def _reasons_not_missed(run: Run, targets: Table, achieved: Mapping[str, Any], objects: str) -> list[str]:
    """Reasons why objects were not missed; objects: their description in words."""
    were = "were" if objects.startswith("the objects") else "was"
    are = "are" if were == "were" else "is"
    if achieved.get("hidden_share_centre") or achieved.get("hidden_share_ego"):
        return []
    known = targets["object"] >= 0
    if not known.any():
        return [f"{objects} {were} clutter, not part of the scene"]
    if not _judged(targets).any():
        return [f"{objects} {are} not scored: no agent sees it, or it is out of range of every agent"]
    if _only_downlink(run, targets):  # other agents' observations are in the picture, from which the object was removed
        ego_share = _seen_by_ego(run, targets)[known].mean()
        if ego_share >= 0.5:
            return [f"the ego sees {objects} itself, {_how_often(ego_share)}"]
        return [f"{objects} {were} still tracked by the ego: tracks outlive a gap"]
    others_share = _seen_by_others(run, targets)[known].mean()
    if others_share >= 0.5:
        return [f"other agents still saw {objects}, {_how_often(others_share)}"]
    missed = achieved.get("hidden_time_share_centre") or 0.0
    if missed > 0.0:
        return [f"{objects} {were} missed only {missed:.0%} of the time: tracks outlive a short gap"]
    return [f"{objects} {were} still tracked: tracks outlive a gap, or the ego sees it itself"]


def _how_often(share: float) -> str:
    """A share of the frames as words: `all the time`, `99% of the time`."""
    return "all the time" if share >= 1.0 else f"{np.floor(100.0 * share):.0f}% of the time"


def _moved(run: Run, targets: Table, achieved: Mapping[str, Any]) -> list[str]:
    """Reasons for missing displacement of objects; identity switches count as effects."""
    effects = "moved_share", "altered_share", "id_switches"
    if any(achieved.get(f"{effect}_{viewer}") for effect in effects for viewer in ("centre", "ego")):
        return []
    present = [kind for kind in ("moved", "altered") if np.any(targets["kind"] == kind)]
    manipulated = " or ".join(present)
    errors = [achieved.get(f"{kind}_error_m_{estimate}") for kind in present for estimate in ("centre", "ego")]
    known = [error for error in errors if error is not None]
    if not known:
        return [f"what it {manipulated} is not scored: no agent sees it, or it is out of range of every agent"]
    if max(known) < DISPLACED_M:
        error_text = f"{max(known):.2f} m off on average"
        return [f"the tracks of what it {manipulated} are {error_text}, which does not count as a displacement"]
    return []


def _only_downlink(run: Run, targets: Table) -> bool:
    """Whether an adversary changed only pictures in transit."""
    if run.manipulations is None or not len(targets["frame"]):
        return False
    own_effects = run.manipulations["interposer"] == targets["adversary"][0]
    return bool(np.all(run.manipulations["message"][own_effects] == "picture"))


def _judged(targets: Table) -> Bools:
    """(n,) bool: targets that are in range and evaluated in any estimate."""
    return np.asarray(targets["judged_centre"].astype(bool) | targets["judged_ego"].astype(bool))


def _seen_by_others(run: Run, targets: Table) -> Bools:
    """(n,) bool: targets seen by an agent whose report of them is unchanged.

    No adversary changes the agent's report of the target in that frame.

    `seen_by_others` excludes the agents of one adversary; this also excludes those of other adversaries that
    change the same object. Without the scene, an object changed by several adversaries counts as not seen.
    """
    seen = targets["seen_by_others"].astype(bool)
    assert run.files.targets is not None
    real = rows(
        run.files.targets,
        (run.files.targets["kind"] != "inserted") & are_in(run.files.sample, run.files.targets["frame"]),
    )
    agents = {each.name: each.agents for each in interposers(run)}
    hidden: dict[tuple[int, int], set[str]] = {}
    changed_by: dict[tuple[int, int], set[str]] = {}
    for name, number, frame in zip(real["adversary"], real["object"].tolist(), real["frame"].tolist(), strict=True):
        hidden.setdefault((number, frame), set()).update(agents.get(name, ()))
        changed_by.setdefault((number, frame), set()).add(name)
    for row, key in enumerate(zip(targets["object"].tolist(), targets["frame"].tolist(), strict=True)):
        if seen[row] and len(changed_by[key]) > 1:
            seen[row] = _sees(run, *key, hidden[key])
    return np.asarray(seen)


def _seen_by_ego(run: Run, targets: Table) -> Bools:
    """(n,) bool: targets matched by one of the ego's own tracks in their frame."""
    if run.files.objects is None:
        return np.zeros(len(targets["frame"]), bool)
    own = (run.files.objects["estimator"] == run.original("local")) & (run.files.objects["kind"] == "truth")
    own &= run.files.objects["outcome"] == "matched"
    tracked = set(zip(run.files.objects["id"][own].tolist(), run.files.objects["frame"][own].tolist(), strict=True))
    wanted = zip(targets["object"].tolist(), targets["frame"].tolist(), strict=True)
    return np.array([each in tracked for each in wanted], bool)


def _sees(run: Run, number: int, frame: int, excluded: set[str]) -> bool:
    """Whether an agent not in `excluded` sees an object in a frame of the scene."""
    scene = run.files.scene
    if scene is None or not 0 <= frame < len(scene):
        return False
    columns = [column for column, agent in enumerate(scene.agent_names) if agent not in excluded]
    start = int(scene.truth_start[frame])
    rows_of_object = start + np.flatnonzero(scene.truth_at(frame).id == number)
    return bool((scene.points[rows_of_object][:, columns] >= _MIN_POINTS).any())


def _on_real_objects(run: Run, targets: Table) -> Bools | None:
    """(n,) bool: targets within the gate of a true object; None: no truth."""
    if run.files.objects is None:
        return None
    truth = rows(
        run.files.objects,
        (run.files.objects["kind"] == "truth") & (run.files.objects["estimator"] == "picture"),
    )
    result = np.zeros(len(targets["frame"]), bool)
    of_frame = np.argsort(truth["frame"], kind="stable")
    for frame in np.unique(targets["frame"]):
        first, last = np.searchsorted(truth["frame"], [frame, frame + 1], sorter=of_frame)
        there, here = of_frame[first:last], np.flatnonzero(targets["frame"] == frame)
        distance = np.hypot(
            _column(targets, "x")[here, None] - _column(truth, "x")[there],
            _column(targets, "y")[here, None] - _column(truth, "y")[there],
        )
        result[here] = (distance <= run.gate_m).any(axis=1)
    return result


def _column(table: Table, name: str) -> NDArray[np.float64]:
    return np.asarray(table[name], np.float64)
