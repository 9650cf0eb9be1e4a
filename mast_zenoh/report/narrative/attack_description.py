"""What the attack on a run was, plainly: from measured effects and the scenario, not from reports of adversaries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mast_zenoh.report.narrative.phrases import capital, count, join_names, plural
from mast_zenoh.report.runfolder import RunFolder, agent_of
from mast_zenoh.report.tables.interposers import OF_OBJECTS, Interposer, interposers

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
}


def attack_description(run: RunFolder) -> list[str]:
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
    directors = [name for name in run.run.get("nodes", {}) if run.role(name) == "coordinator"]
    if directors and len(adversaries) > 1:
        sentences.append(f"{join_names(directors)} directed the adversaries.")
    if not adversaries and (run.wiring or run.metrics):
        sentences.append("No adversary took part in this run.")
    return sentences + _faults(run)


def _sentence(run: RunFolder, adversary: Interposer) -> str:
    """`In the detections of infra_1, adversary_1 inserted four objects that did not exist, from t = 4.0 s to 5.9 s.`"""
    effects = adversary.effects or {}
    clauses = [_of_objects(adversary, name, effects[name]) for name in OF_OBJECTS if effects.get(name)]
    clauses += [
        words.format(plural(effects[name], "message")) for name, words in _MESSAGES.items() if effects.get(name)
    ]
    rest = [name for name in effects if name not in (*OF_OBJECTS, *_MESSAGES, "unsettled") and effects[name]]
    clauses += [f"{name} {plural(effects[name], 'message')}" for name in rest]
    what = join_names(clauses)
    return f"In {join_names(_places(run, adversary))}, {adversary.name} {what}{_when(run, adversary)}."


def _of_objects(adversary: Interposer, effect: str, rows: int) -> str:
    number, clutter = adversary.objects.get(effect, (None, False))
    if number is None:
        what = f"objects ({plural(rows, 'row')})"
    elif number:
        what = f"{count(number)} object{'' if number == 1 else 's'}{' and clutter' if clutter else ''}"
    else:
        what = "clutter"
    return _OBJECTS[effect].format(what)


def _places(run: RunFolder, adversary: Interposer) -> list[str]:
    """The messages that an adversary changed, in words."""
    wires: Mapping[str, Mapping[str, Any]] = {wire["key"]: wire for wire in run.wiring.get("wires", ())}
    changed: set[str] = set()
    if run.attacks is not None and "wire" in run.attacks:
        changed = set(run.attacks["wire"][run.attacks["interposer"] == adversary.name].tolist())
    places: dict[str, None] = {}
    for key in [key for key in adversary.wires if key in changed] or adversary.wires:
        wire = wires.get(key, {})
        message = str(wire.get("message") or key.rpartition("/")[2])
        subject = str(wire.get("subject") or agent_of(key) or "")
        if message == "picture":
            before = f" on its way to {join_names(adversary.before)}" if adversary.before else " for all agents"
            places[f"the common picture{before}"] = None
        elif message in _PLACES and subject:
            places[_PLACES[message].format(subject)] = None
        else:
            places[f"the messages on {key}"] = None
    return list(places)


def _when(run: RunFolder, adversary: Interposer) -> str:
    """When it changed messages, and whether it was inserted during the run; empty: not known."""
    parts = []
    if run.attacks is not None:
        frames = run.attacks["frame"][run.attacks["interposer"] == adversary.name]
        frames = frames[frames >= 0]
        if len(frames):
            parts.append(_period(run, int(frames.min()), int(frames.max())))
    if adversary.live is not None:
        until = f", and removed in frame {adversary.released}" if adversary.released is not None else ""
        parts.append(f"after it was inserted live in frame {adversary.live}{until}")
    return "".join(f", {part}" for part in parts)


def _period(run: RunFolder, first: int, last: int) -> str:
    times = run.seconds(np.array([first, last]))
    if times is None:
        return f"in frame {first}" if first == last else f"from frame {first} to {last}"
    return f"at t = {times[0]:.1f} s" if first == last else f"from t = {times[0]:.1f} s to {times[1]:.1f} s"


def _faults(run: RunFolder) -> list[str]:
    """A sentence about the faults of the scenario; none without faults."""
    timeline = run.scenario.get("timeline") if isinstance(run.scenario, Mapping) else None
    faults: Sequence[Mapping[str, Any]] = [each for each in timeline or () if each.get("kind") == "fault"]
    if not faults:
        return []
    named = [f"{each['label']} from t = {each['at_s']:g} s" for each in faults[:_NAMED]]
    named += [f"{len(faults) - _NAMED} more"] * (len(faults) > _NAMED)
    return [f"The scenario also has {'a fault' if len(faults) == 1 else 'faults'}: {join_names(named)}."]
