"""What adversaries did in a run, and why some of it had limited effect: from measurements and the scenario."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools
from mast_zenoh.metrics.achievement import DISPLACED_M
from mast_zenoh.metrics.assignment import Places, nearest, occurs
from mast_zenoh.metrics.estimates import LOCAL, MISSION, PICTURE
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.runs.files import Table, are_in, rows
from mast_zenoh.runs.interposers import BAD, OF_OBJECTS, WITH_COLUMN, Interposer, hostile, interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.show.comparison import Reference, of_errors
from mast_zenoh.show.findings.causes import changed_for_nothing, culprit_names, matters, reaches
from mast_zenoh.show.findings.changes import DISPLACED, FALSE, IDENTITY, MISSED, largest_change, scored
from mast_zenoh.wiring.model import peer_of

#: m, on the ground, from a false object to the middle of the points of which it is made.
_GATE_M = 3.0
#: Lidar points with which an agent detects an object, as in `seen_by_others` of targets.parquet.
_MIN_POINTS = 5


def positions(run: Run) -> list[Finding]:
    """Where the adversaries are, and whether they changed anything; none if the run has none."""
    adversaries, what = hostile(run), "compromised"
    who = tuple(each.name for each in adversaries)
    if not any(each.changed for each in adversaries):
        late = {*who} <= _late_starts_s(run).keys()
        unmeasured = any(each.effects is None for each in adversaries)
        what = "unmeasured" if unmeasured else "late" if late else "idle"
    acting = [each for each in adversaries if what != "compromised" or each.changed or each.effects is None]
    places = _places(run, acting)
    return [Finding("adversaries", who, what, parts=tuple(places))] if places else []


def _places(run: Run, adversaries: Sequence[Interposer]) -> list[Finding]:
    """How many agents of each kind they are on, the paths to single subscribers from agents, and other wires."""
    kinds = {agent.name: agent.kind for agent in run.files.scene.agents} if run.files.scene else {}
    compromised = {agent for each in adversaries if not each.before for agent in each.agents}
    names = set(kinds) or {*run.files.summary.get("agents", {}), *compromised}
    places = []
    for kind in ("static", "mobile"):
        group = {each for each in names if kinds.get(each, "static" if each.startswith("infra") else "mobile") == kind}
        if number := len(group & compromised):
            places.append(Finding("place", what=kind, value=number, other=len(group), unit="agents"))
    for before in dict.fromkeys(before for each in adversaries for before in each.before):
        senders = {agent for each in adversaries if before in each.before for agent in each.agents}
        places.append(Finding("place", tuple(sorted(senders)), "path", where=_listeners(run, [before])[0]))
    wires = [wire for each in adversaries if not each.agents and not each.before for wire in each.wires]
    return places + [Finding("place", what="wire", where=wire) for wire in dict.fromkeys(wires)]


def _listeners(run: Run, before: Sequence[str]) -> tuple[str, ...]:
    """The agents whose copy of messages alone passes through an adversary; other subscribers by their names."""
    agent_of_peer = {peer_of(agent): agent for agent in run.agents}
    return tuple(agent_of_peer.get(each, each) for each in before)


def altered_on_the_way(run: Run) -> set[str]:
    """The agents that do not lie, but whose messages adversaries change for single subscribers."""
    at_source = {agent for each in hostile(run) if not each.before for agent in each.agents}
    return {agent for each in hostile(run) if each.before for agent in each.agents} - at_source


def attacks(run: Run) -> list[Finding]:
    """What each adversary, and each link with a bad verdict, did, where and when, and who directed them."""
    result = []
    for each in interposers(run):
        if each.is_link and each.verdict not in BAD:
            continue
        when = None
        if run.manipulations is not None:
            frames = run.manipulations["frame"][run.manipulations["interposer"] == each.name]
            when = period(run, int(frames.min()), int(frames.max())) if len(frames) else None
        changed = None if each.effects is None else each.changed
        described = (each.name,), each.description, changed, None, "", each.place, when
        result.append(Finding("attack", *described, parts=effects(each)))
        result += made_of_points(run, each)
        if each.verdict in BAD:
            result.append(Finding("verdict", (each.name,), each.verdict, each.failed_frames))
    directors = tuple(name for name in run.files.record.get("nodes", {}) if run.role(name) == "coordinator")
    if directors and len(hostile(run)) > 1:
        result.append(Finding("verdict", directors, "directed"))
    if not hostile(run) and (run.files.wiring or run.files.summary):
        result.append(Finding("adversaries", what="none"))
    return result


def effects(interposer: Interposer) -> tuple[Finding, ...]:
    """Measured effects: how many messages, or rows and, as `other`, their objects; `who`: clutter, if some are that."""
    counts, parts = interposer.effects_besides_named, []
    for effect in dict.fromkeys((*WITH_COLUMN, *counts)):
        if not counts.get(effect) or effect == "unsettled":
            continue
        number, clutter = interposer.objects.get(effect, (0, False))
        who, unit = ("clutter",) * clutter, "rows" if effect in OF_OBJECTS else "messages"
        parts.append(Finding("effect", who, effect, counts[effect], number or None, unit))
    parts += [Finding("effect", what=of, value=n, unit="points") for of, n in interposer.points.items()]
    named = interposer.reframed.items()
    return (*parts, *(Finding("effect", what="changed", value=number, unit=f"{of}s") for of, number in named))


def made_of_points(run: Run, interposer: Interposer) -> list[Finding]:
    """Of how many points in a scan the false objects are made that an interposer showed, by estimate."""
    table, objects = run.manipulations, run.files.objects
    if table is None or objects is None or not interposer.points.get("inserted"):
        return []
    inserted = (table["interposer"] == interposer.name) & (table["effect"] == "inserted") & (table["points"] > 0)
    shown, result = Places.of_rows(table, inserted, "after_"), []
    for estimator in (PICTURE, MISSION):
        false = (objects["estimator"] == estimator) & (objects["agent"] == run.ego) & (objects["cause"] == "inserted")
        false &= scored(run, objects["frame"])
        false &= np.array([interposer.name in by.split("+") for by in objects["by"].tolist()], bool)
        tracks = Places.of_rows(objects, false)
        row, _ = nearest(tracks, shown, _GATE_M)
        made = table["points"][inserted][row[row >= 0]]
        if len(made):
            frames = len(np.unique(tracks.group[row >= 0]))
            who = interposer.name, *interposer.agents[:1]
            value = round(float(made.mean()))
            result.append(Finding("made_of", who, value=value, other=frames, unit="points", where=estimator))
    return result


def period(run: Run, first: int, last: int) -> tuple[float, float]:
    """The times of two frames, s."""
    start, end = run.times(np.array([first, last]))
    return round(float(start), 3), round(float(end), 3)


def limits(run: Run, reference: Reference | None = None) -> list[Finding]:
    """Reasons for limited effects of adversaries on the picture or the ego, and for links on which nothing depends.

    `what` is the kind of manipulation, unless the reason applies to everything that the adversary did; the reason is
    `cause`. What causes the largest change, which the headline names, has none.
    reference: the run that it is compared with; None: by the run's own measurements
    """
    over = of_errors(run, reference)
    change = largest_change(run, over)
    blamed = culprit_names(run, change, over) if change is not None else []
    idle = [each for each in interposers(run) if each.is_link and each.changed and not matters(run, each.name)]
    return [
        reason
        for each in (*hostile(run), *idle)
        for reason in _reasons(run, each, change.kind if change is not None and each.name in blamed else "")
    ]


def _reasons(run: Run, interposer: Interposer, blamed_for: str) -> Iterator[Finding]:
    """Reasons for limited effects of one interposer.

    blamed_for: the kind of the largest change if this interposer causes it, else empty
    """
    limited = partial(Finding, "limited", (interposer.name,))
    start, listeners = _late_starts_s(run).get(interposer.name), {*interposer.before}
    estimates = run.files.summary.get("agents", {}).get(run.ego, (PICTURE,))
    used, idle = matters(run, interposer.name), changed_for_nothing(run, interposer.name)
    if used and idle:
        yield limited(where=" and ".join(idle), cause=("no estimate",))
    if interposer.effects is None:
        yield limited(cause=("unmeasured",))
    elif not interposer.changed and interposer.failures:
        yield limited(cause=("failed", interposer.failures))
    elif not interposer.changed and start is not None:
        yield limited(value=start, unit="s", cause=("late",))
    elif not interposer.changed:
        known = tuple(each for each in run.notices if each.who == (interposer.name,) and each.cause[:1] == ("scans",))
        yield limited(value=interposer.received, cause=("idle",), parts=known)
    elif not used:
        yield limited(where=" and ".join(interposer.wires), cause=("no estimate",))
    elif not blamed_for and not any(reaches(run, interposer.name, estimate) for estimate in estimates):
        yield limited(where=" and ".join(interposer.wires), cause=("not the ego",))
    elif (listeners and not listeners & {run.ego, peer_of(str(run.ego))}) and not (
        blamed_for and reaches(run, interposer.name, PICTURE)  # what another agent heard reached the ego
    ):
        yield limited(cause=("elsewhere", *_listeners(run, interposer.before)))
    elif run.files.targets is not None:
        own = run.files.targets["adversary"] == interposer.name
        targets = rows(run.files.targets, own & are_in(run.files.sample, run.files.targets["frame"]))
        if len(targets["frame"]):
            yield from _reasons_of_targets(run, interposer, targets, blamed_for)
        elif not blamed_for and "command" not in interposer.reframed:  # what commands do is not in errors
            yield limited(cause=("no object",), parts=effects(interposer))


#: The kinds of manipulations with a common reason, and the errors that they cause.
_CONSEQUENCES = {("inserted",): (FALSE,), ("removed",): (MISSED,), ("moved", "altered"): (DISPLACED, IDENTITY)}


def _reasons_of_targets(run: Run, interposer: Interposer, targets: Table, blamed_for: str) -> Iterator[Finding]:
    """Reasons for limited effects on the objects that an interposer manipulated."""
    achieved, who = run.files.summary.get("achieved", {}).get(interposer.name, {}), (interposer.name,)
    if not scored(run, targets["frame"]).any():
        yield Finding("limited", who, cause=("unscored",))
    for (kinds, consequences), explain in zip(_CONSEQUENCES.items(), (_inserted, _removed, _moved), strict=True):
        group = rows(targets, np.isin(targets["kind"], kinds))
        did_more = any(n for name, n in (interposer.effects or {}).items() if name not in (*kinds, "unsettled"))
        if not len(group["frame"]) or blamed_for in consequences or (blamed_for and not did_more):
            continue
        if (reason := explain(run, group, achieved)) is not None:
            what = " or ".join(kind for kind in kinds if np.any(group["kind"] == kind))
            where = "points" if reason[0] == "rejected" and interposer.points else ""
            yield Finding("limited", who, what, reason[1], where=where, cause=(reason[0],))


def _late_starts_s(run: Run) -> dict[str, float | None]:
    """s, the starts of attacks planned for after the end of the run, by adversary, as its launcher found them."""
    return {
        each.who[0]: each.value for each in run.notices if each.kind == "idle" and each.who and each.cause == ("late",)
    }


def _inserted(run: Run, targets: Table, achieved: Mapping[str, Any]) -> tuple[str, float | None] | None:
    """Why no tracks followed inserted objects, and the share of them for which it holds; None: tracks did."""
    if achieved.get("inserted_share_centre"):
        return ("not adopted", None) if achieved.get("inserted_share_ego") == 0.0 else None  # None: not measured
    if achieved.get("inserted_share_ego"):
        return None
    on_real = _on_real_objects(run, targets)
    if not _judged(targets).any():
        return "not scored", None
    return ("on real objects", on_real) if on_real >= 0.5 else ("rejected", None)


def _removed(run: Run, targets: Table, achieved: Mapping[str, Any]) -> tuple[str, float | None] | None:
    """Why objects in removed rows or dropped messages were not missed, and the share of them; None: they were."""
    if achieved.get("hidden_share_centre") or achieved.get("hidden_share_ego"):
        return None
    known = targets["object"] >= 0
    if not known.any() or not _judged(targets).any():
        return "not scored", None
    # Other agents' observations are in the picture; from a picture in transit to the ego, the object is gone.
    downlink = _only_downlink(run, targets)
    seen = float((_seen_by_ego if downlink else _seen_by_others)(run, targets)[known].mean())
    if seen >= 0.5:
        return "seen by the ego" if downlink else "seen by others", seen
    return "tracked", achieved.get("hidden_time_share_ego" if downlink else "hidden_time_share_centre") or 0.0


def _moved(run: Run, targets: Table, achieved: Mapping[str, Any]) -> tuple[str, float | None] | None:
    """Why objects are not displaced, and by how much, m; None: they are. Identity switches count as effects."""
    effects = "moved_share", "altered_share", "id_switches"
    if any(achieved.get(f"{effect}_{viewer}") for effect in effects for viewer in ("centre", "ego")):
        return None
    present = [kind for kind in ("moved", "altered") if np.any(targets["kind"] == kind)]
    errors = [achieved.get(f"{kind}_error_m_{viewer}") for kind in present for viewer in ("centre", "ego")]
    largest = max((error for error in errors if error is not None), default=None)
    if largest is None:
        return "not scored", None
    return ("too little", largest) if largest < DISPLACED_M else None


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
    """(n,) bool: targets seen by an agent whose report of them no adversary changes in that frame.

    `seen_by_others` excludes the agents of one adversary; this also excludes those of other adversaries that
    change the same object. Without the scene, an object changed by several adversaries counts as not seen.
    """
    seen, table = np.array(targets["seen_by_others"], bool), run.files.targets
    assert table is not None
    real = rows(table, (table["kind"] != "inserted") & are_in(run.files.sample, table["frame"]))
    agents = {each.name: each.agents for each in interposers(run)}
    changed_by: dict[tuple[int, int], set[str]] = {}
    for name, number, frame in zip(real["adversary"], real["object"].tolist(), real["frame"].tolist(), strict=True):
        changed_by.setdefault((number, frame), set()).add(name)
    for row, key in enumerate(zip(targets["object"].tolist(), targets["frame"].tolist(), strict=True)):
        if seen[row] and len(changed_by[key]) > 1:
            seen[row] = _sees(run, *key, {agent for name in changed_by[key] for agent in agents.get(name, ())})
    return seen


def _sees(run: Run, number: int, frame: int, excluded: set[str]) -> bool:
    """Whether an agent not in `excluded` sees an object in a frame of the scene."""
    scene = run.files.scene
    if scene is None or not 0 <= frame < len(scene):
        return False
    columns = [index for index, agent in enumerate(scene.agent_names) if agent not in excluded]
    rows_of_object = int(scene.truth_start[frame]) + np.flatnonzero(scene.truth_at(frame).id == number)
    return bool((scene.points[rows_of_object][:, columns] >= _MIN_POINTS).any())


def _seen_by_ego(run: Run, targets: Table) -> Bools:
    """(n,) bool: targets matched by one of the ego's own tracks in their frame."""
    objects = run.files.objects
    if objects is None:
        return np.zeros(len(targets["frame"]), bool)
    own = (objects["estimator"] == run.original(LOCAL)) & (objects["kind"] == "truth")
    own &= objects["outcome"] == "matched"
    return occurs((targets["object"], targets["frame"]), (objects["id"][own], objects["frame"][own]))


def _on_real_objects(run: Run, targets: Table) -> float:
    """The share of targets within the gate of a true object; 0: no truth."""
    objects = run.files.objects
    if objects is None:
        return 0.0
    truth = Places.of_rows(objects, (objects["kind"] == "truth") & (objects["estimator"] == PICTURE))
    return float((nearest(Places.of_rows(targets), truth, run.gate_m)[0] >= 0).mean())
