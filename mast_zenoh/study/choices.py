"""What a study file names: presets, kinds of scene, defences and adversaries, and the runs of their combinations.

Which agents of a scenario are compromised or faulty, and the scenes that have a number of agents.
"""

from __future__ import annotations

import ast
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mast_zenoh import scenes
from mast_zenoh.attacks import Attack, Coordination
from mast_zenoh.config import loading, registry
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.metrics import Metric
from mast_zenoh.scenario import choose_scene, victims_of
from mast_zenoh.scenario.reading import name_of_file
from mast_zenoh.streams import stream

#: The name of a class, FILE.py or FILE.py:CLASS; or a dict with one of these as `type`, and parameters.
Choice = str | dict[str, Any]
_EXPECTED = "expected a name, a file or a dict with `type`"

#: The adversaries of the scenarios of these names: on tracks alone, without a budget and without knowledge.
COORDINATED, UNCOORDINATED = "coordinated", "uncoordinated"

#: The command centre without a defence: the reference of all others.
UNDEFENDED = "NoIntegrity"
#: Prefix of a fault in the list of adversaries.
PREFIX = "fault:"

#: By kind of scene, the agents besides the ego: poles, cars alone, or both, 13 agents in all.
SCENE_KINDS: dict[str, dict[str, int]] = {
    "poles": dict(n_infrastructure=4, n_mobile=0),
    "cars": dict(n_infrastructure=0, n_mobile=4),
    "many": dict(n_infrastructure=8, n_mobile=4),
}
#: Up to so many agents, all but the ego stand on poles.
_POLES_ALONE = 5
_MAX_AGENTS = 29


def words(text: str | Sequence[str]) -> list[str]:
    """The words of a text with commas, or a list; empty text has none."""
    return [word.strip() for word in text.split(",") if text.strip()] if isinstance(text, str) else list(text)


def several(value: Any) -> list[Any]:
    """A list of one value or several."""
    return list(value) if isinstance(value, (list, tuple)) else [value]


def junctions(first: int, last: int) -> str:
    """The short names of generated junctions, from one to another."""
    return ",".join(f"intersection:{index}" for index in range(first, last + 1))


def with_preset(presets: Mapping[str, Mapping[str, Any]], preset: str, **arguments: Any) -> dict[str, Any]:
    """The arguments of a study, those that are None from a preset. Raises ConfigurationError for an unknown preset."""
    if preset not in presets:
        raise ConfigurationError(f"preset: found {preset!r}{nearest(preset, presets)}")
    return {**presets[preset], **{key: value for key, value in arguments.items() if value is not None}}


def parse_choices(text: str | Sequence[Choice], setting: str) -> list[Choice]:
    """Choices from names separated by commas, or from a Python list of names and dicts; files with absolute paths.

    Empty text has none. setting: its name, for errors. Raises ConfigurationError.
    """
    choices: Any = text
    if isinstance(text, str):
        try:
            literal = text.lstrip().startswith(("[", "(", "{"))
            choices = ast.literal_eval(text) if literal else text.split(",") if text.strip() else []
        except (ValueError, SyntaxError):
            raise ConfigurationError(
                f"{setting}: found {text!r}, expected names, or a list of names and dicts"
            ) from None
    choices = [choices] if isinstance(choices, Mapping) else choices
    result = []
    for choice in choices:
        name = _named(choice)
        if not isinstance(name, str) or not name.strip():
            raise ConfigurationError(f"{setting}: found {choice!r}, {_EXPECTED}")
        name = _absolute(name.strip())
        result.append(name if isinstance(choice, str) else {**choice, "type": name})
    return result


def resolve_choice(choice: Choice, base: type) -> dict[str, Any]:
    """A dict with the name of a class as `type`; its file is loaded.

    choice: text may also be that of a dict. Raises ConfigurationError.
    """
    choice = _literal(choice)
    spec = {"type": choice} if isinstance(choice, str) else dict(choice)
    return spec | {"type": loading.class_name(spec["type"], base)}


def measured_by(metrics: Sequence[Choice], content: Mapping[str, Any]) -> dict[str, Any]:
    """The `evaluator` of a scenario with a user's metrics, too; {}: without any. content: of the scenario"""
    if not metrics:
        return {}
    evaluator = content.get("evaluator", {})
    own = [resolve_choice(each, Metric) for each in parse_choices(metrics, "metrics")]
    return {"evaluator": evaluator | {"metrics": [*evaluator.get("metrics", ()), *own]}}


def adversary_base(choice: Choice) -> type:
    """Coordination if the adversaries of a choice are directed by a coordinator, otherwise Attack."""
    choice = _literal(choice)
    text = choice if isinstance(choice, str) else str(choice["type"])
    if ".py" in text:
        file, _, name = text.partition(":")
        classes = loading.concrete([loading.module(Path(file))], Coordination)
        return Coordination if any(name in ("", cls.__name__) for cls in classes) else Attack
    if text in registry.known_types(Attack):  # ours: no plugin needs to be loaded
        return Attack
    return Coordination if text in registry.known_types(Coordination, text) else Attack


def has_budget(choice: Choice) -> bool:
    """Whether an adversary has a parameter `budget` that the choice leaves open."""
    if isinstance(choice, str) and (choice in (COORDINATED, UNCOORDINATED) or choice.startswith(PREFIX)):
        return False
    base = adversary_base(choice)
    spec = resolve_choice(choice, base)
    known = registry.known_types(base, spec["type"]).get(spec["type"])
    return known is not None and "budget" not in spec and "budget" in registry.parameters_of(known)


def short_name(choice: Choice) -> str:
    """A short name for tables: the class, and parameters if there are any."""
    text = choice if isinstance(choice, str) else str(choice["type"])
    if text.startswith(PREFIX):
        return text
    file, _, name = text.partition(":")
    name = name or (Path(file).stem if file.endswith(".py") else file)
    parameters = {} if isinstance(choice, str) else {key: value for key, value in choice.items() if key != "type"}
    return name_of_file(" ".join([name, *(f"{key}={value}" for key, value in parameters.items())]))


def _literal(choice: Choice) -> Choice:
    """A choice whose text is that of a dict, as a dict. Raises ConfigurationError where it names no class."""
    literal: Choice | None = choice
    if isinstance(choice, str) and choice.startswith("{"):
        try:
            literal = ast.literal_eval(choice)
        except (ValueError, SyntaxError):
            literal = None
    if literal is None or not isinstance(_named(literal), (str, type)):
        raise ConfigurationError(f"found {choice!r}, {_EXPECTED}")
    return literal


def _named(choice: object) -> object:
    """What a choice names, a name or a class; None: nothing."""
    return choice if isinstance(choice, str) else choice.get("type") if isinstance(choice, Mapping) else None


def _absolute(text: str) -> str:
    file, colon, name = text.partition(":")
    return f"{Path(file).resolve()}{colon}{name}" if file.endswith(".py") else text


def sensors_of(agents: int) -> dict[str, int]:
    """The parameters of a generated junction with this number of agents, the ego included.

    Poles, and above five agents cars, too: 8 and 4 for 13 agents, 12 and 8 for 21. Raises ConfigurationError for a
    number of agents that a junction cannot have.
    """
    if type(agents) is not int or not 2 <= agents <= _MAX_AGENTS:
        raise ConfigurationError(f"agents: found {agents!r}, expected whole numbers from 2 to {_MAX_AGENTS}")
    cars = max(0, (agents - _POLES_ALONE) // 2)
    return {"n_infrastructure": agents - 1 - cars, "n_mobile": cars}


def scenes_of_kinds(kinds: str | Sequence[str], scene: str) -> list[dict[str, Any]]:
    """The launch-time parameters of a scene of each kind. Raises ConfigurationError for an unknown kind, or none."""
    names = words(kinds)
    for name in names:
        if name not in SCENE_KINDS:
            expected = ", ".join(SCENE_KINDS)
            hint = nearest(str(name), SCENE_KINDS)
            hint = hint if "did you mean" in hint else ""  # otherwise it lists what is expected once more
            raise ConfigurationError(f"kinds: unknown kind {name!r}: expected one of {expected}{hint}")
    if not names:
        raise ConfigurationError(f"kinds: found none, expected one or more of {', '.join(SCENE_KINDS)}")
    return [{"scene": scene} | SCENE_KINDS[name] for name in names]


def matrix_study(
    *,
    defences: str | Sequence[Choice],
    adversaries: str | Sequence[Choice],
    counts: int | Sequence[int],
    placements: str | Sequence[str],
    budgets: float | Sequence[float | None],
    parameters: Mapping[str, Any],
) -> dict[str, Any]:
    """The keys `runs` and `baseline` of a study of every defence against every adversary.

    defences, adversaries: as for `parse_choices`; no adversaries for runs without an attack alone
    counts: numbers of adversaries; 0 stands for one run per defence without an attack, and is always included
    budgets: of each adversary that has one;  parameters: of the scenario, for all runs
    The factors of each run: defence, attack ("" without adversaries, or a fault: then faulty agents take their places),
    n_adversaries, placement, budget, lies per second of each adversary (None: the attack's own, or it has none), and
    attack_start_s. Raises ConfigurationError.
    """
    choices, adversaries = parse_choices(defences, "defences"), parse_choices(adversaries, "adversaries")
    for placement in words(placements):
        if placement not in PLACEMENTS:
            raise ConfigurationError(f"placements: found {placement!r}{nearest(placement, PLACEMENTS)}")
    for count in several(counts):
        if type(count) is not int or count < 0:
            raise ConfigurationError(f"counts: found {count!r}, expected whole numbers, 0 or more, such as [1, 2]")
    if UNDEFENDED not in choices:  # the reference of all others
        choices = [UNDEFENDED, *choices]
    numbers = sorted({*several(counts)} - {0})
    runs: dict[str, Any] = {}
    for defence in choices:
        alone = {"defence": short_name(defence), "attack": "", "n_adversaries": 0, "placement": "", "budget": None}
        alone["attack_start_s"] = parameters.get("attack_start_s")
        cells = [(f"{alone['defence']} alone", alone, {"n_adversaries": 0})]
        for attack in adversaries:
            own_budgets = several(budgets) if has_budget(attack) else [None]
            for count, placement, budget in itertools.product(numbers, words(placements), own_budgets):
                label = f"{alone['defence']} {short_name(attack).replace(':', ' ')} {count} {placement}"
                label += "" if budget is None else f" budget {budget:g}"
                place = {"n_adversaries": count, "placement": placement, "budget": budget}
                cells.append((label, alone | place | {"attack": short_name(attack)}, _attacked(attack, place)))
        for label, factors, own in cells:
            if label in runs:
                raise ConfigurationError(f"two configurations are called {label!r}: expected each choice once")
            every = {**parameters, "defence": defence, **own}
            runs[label] = {"scenario": "defence_cell", "parameters": every, "factors": factors}
    return {"runs": runs, "baseline": f"{UNDEFENDED} alone"}


def _attacked(attack: Choice, place: dict[str, Any]) -> dict[str, Any]:
    """The parameters of a scenario with adversaries, or with faulty agents in their places."""
    if isinstance(attack, str) and attack.startswith(PREFIX):
        fault = attack.removeprefix(PREFIX)
        check_fault(fault)
        count, placement = place["n_adversaries"], place["placement"]
        return {"n_adversaries": 0, "fault": fault, "n_faulty": count, "placement": placement}
    return {"n_adversaries": place["n_adversaries"], "attack": attack, **place}


#: By name, an entry of a scenario's `faults`, without its time and its targets.
FAULTS: dict[str, dict[str, Any]] = {
    "pose": {"type": "Impair", "rule": {"type": "PoseError", "bias_m": (0.7, 0.4), "bias_yaw_rad": 0.01}},
    "delay": {"type": "Delay", "mean_s": 0.2, "jitter_s": 0.05},
    "skew": {"type": "Impair", "rule": {"type": "ClockSkew", "offset_s": 0.1}},
    "loss": {"type": "BurstLoss", "good_to_bad": 0.1, "bad_to_good": 0.3},
    "blind": {"type": "BlindSector", "azimuth_min_deg": -20.0, "azimuth_max_deg": 20.0},
    "ghosts": {"type": "GhostDetections", "frame": "sensor", "places": [(25.0, 4.0, 0.75), (35.0, -6.0, 0.75)]},
}

#: poles: static agents first, as in the other scenarios; random: by the seed; worst: those that cover the most objects.
PLACEMENTS = ("poles", "random", "worst")
#: Lidar returns from which an agent sees an object.
MIN_RETURNS = 5


def check_fault(name: str) -> None:
    """Raise ConfigurationError for an unknown fault."""
    if name not in FAULTS:
        raise ConfigurationError(f"fault: found {name!r}{nearest(name, FAULTS)}")


def faults_of(name: str | None, agents: Sequence[str], at_s: float) -> list[dict[str, Any]]:
    """The `faults` of a scenario in which agents have the fault from a time, s, on; None, or no agents: none."""
    if name is None or not agents:
        return []
    check_fault(name)
    return [FAULTS[name] | {"at": at_s, "nodes": list(agents)}]


def place(
    scene: str | Mapping[str, Any], count: int, placement: str = "poles", seed: int = 0, frames: int | None = None
) -> tuple[str, ...]:
    """The names of `count` agents to compromise, never the ego.

    placement: one of PLACEMENTS;  seed, frames: of the run. With the same seed, fewer agents are always among more.
    Raises ConfigurationError for an unknown placement, or if the scene has too few agents.
    """
    if placement not in PLACEMENTS:
        raise ConfigurationError(f"placement: found {placement!r}{nearest(str(placement), PLACEMENTS)}")
    poles = victims_of(scene, count)
    if placement == "poles" or count == 0:  # without recording the scene
        return poles
    spec = choose_scene(scene)
    built = registry.build(spec, scenes.Scene, "scene")
    if placement == "random":
        names = scenes.prepare(built, 0, 1, json.dumps(spec, sort_keys=True)).agent_names[1:]
        order = stream(seed, "placement").permutation(len(names))
    else:
        recording = scenes.prepare(built, seed, frames, json.dumps(spec, sort_keys=True))
        names = recording.agent_names[1:]
        order = by_coverage(recording.points[:, 1:])
    return _chosen(names, order, count)


def by_coverage(points: NDArray[np.int32]) -> NDArray[np.int64]:
    """(a,) agents from the one that covers the most objects to the one that covers the fewest; ties in their order.

    points: (n, a) lidar returns of n objects, over all frames, at a agents
    """
    covered = (np.asarray(points) >= MIN_RETURNS).sum(axis=0)
    return np.argsort(-covered, kind="stable").astype(np.int64)


def _chosen(names: Sequence[str], order: NDArray[Any], count: int) -> tuple[str, ...]:
    return tuple(names[index] for index in order[:count].tolist())


def honest_majority(points: ArrayLike, malicious: ArrayLike) -> float:
    """Share of objects that more honest agents see than malicious ones, of those that any agent sees; NaN: none.

    points:    (n, a) lidar returns of n objects, over all frames, at a agents
    malicious: (a,) bool
    """
    sees = np.asarray(points) >= MIN_RETURNS
    lying = np.asarray(malicious, bool)
    seen = sees[sees.any(axis=1)]
    if not len(seen):
        return float("nan")
    return float((seen[:, ~lying].sum(axis=1) > seen[:, lying].sum(axis=1)).mean())
