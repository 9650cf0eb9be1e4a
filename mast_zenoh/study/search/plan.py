"""The section `search` of a study file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.study.search.objective import Objective, parse_objective
from mast_zenoh.study.search.space import Space, parse_space, with_values

#: The keys of the section.
KEYS = {
    "run": "label of the run whose parameters are searched; as it is written, it is the default",
    "parameters": "name to 'LOW..HIGH', 'LOW..HIGH log' or a list of choices",
    "objective": "the number to maximise: METRIC, ESTIMATOR/METRIC, WHO/ESTIMATOR/METRIC, or a sum of these",
    "direction": "maximise or minimise",
    "candidates": "how many choices of the parameters are tried",
    "batch": "how many are proposed at once, from the values of those before",
    "seeds": "seeds for each candidate and scene; the trials of the study have other seeds",
    "sampler": "what proposes candidates: TPE or random",
}
_REQUIRED = ("run", "parameters", "objective")
#: The values of some of them, the default first.
CHOICES = {"direction": ("maximise", "minimise"), "sampler": ("TPE", "random")}
#: Label of the configuration that a search finds.
SEARCHED = "searched"
#: Labels of candidates begin with it.
CANDIDATE = "candidate-"
#: Keys of a study that exclude a search.
_EXCLUDED = ("cells", "security")


@dataclass(frozen=True, slots=True)
class SearchPlan:
    """What is searched, for what, and with how much effort; see KEYS.

    default: the run's launch-time parameters, as they are in the study file
    """

    run: str
    default: Mapping[str, Any]
    space: Space
    objective: Objective
    maximise: bool = True
    candidates: int = 40
    batch: int = 8
    seeds: int = 3
    sampler: str = "TPE"

    def parameters(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The launch-time parameters of the run with other values of some; raises ConfigurationError."""
        return with_values(self.default, values, "search.parameters")


def parse_plan(content: Mapping[str, Any], baseline: str) -> SearchPlan:
    """The plan of a study with a search; raises ConfigurationError.

    content: what `study(...)` returned, with valid `runs`;  baseline: label of the run without the attack
    """
    section = content["search"]
    _check(isinstance(section, Mapping), f"search: found {section!r:.120}, expected a dict with {', '.join(_REQUIRED)}")
    for key in section:
        _check(key in KEYS, f"search.{key}: unknown key{nearest(str(key), KEYS)}")
    for key in _REQUIRED:
        _check(key in section, f"search.{key}: missing, expected {KEYS[key]}")
    for key in _EXCLUDED:
        _check(not content.get(key), f"search: this study has `{key}` too, expected one of them")
    _check(
        content.get("trials"), "trials: missing, expected the number of seeds on which the search's result is measured"
    )
    runs, label = content["runs"], section["run"]
    _check(label in runs, f"search.run: found {label!r}{nearest(str(label), map(str, runs))}")
    _check(not runs[label].get("grid"), f"search.run: {label!r} has a grid, expected one configuration")
    _check(label != baseline, f"search.run: {label!r} is the baseline, expected a run that attacks")
    for name in map(str, runs):
        taken = name == SEARCHED or name.startswith(CANDIDATE)
        _check(not taken, f"runs: found the label {name!r}, which is that of a search's result, expected another")
    chosen = {key: section.get(key, known[0]) for key, known in CHOICES.items()}
    for key, value in chosen.items():
        _check(value in CHOICES[key], f"search.{key}: found {value!r}{nearest(str(value), CHOICES[key])}")
    numbers = {key: section[key] for key in ("candidates", "batch", "seeds") if section.get(key) is not None}
    for key, value in numbers.items():
        _check(type(value) is int and value >= 1, f"search.{key}: found {value!r}, expected a whole number from 1")
    return SearchPlan(
        run=str(label),
        default=dict(runs[label].get("parameters", {})),
        space=parse_space(section["parameters"], "search.parameters"),
        objective=parse_objective(section["objective"], "search.objective"),
        maximise=chosen["direction"] == "maximise",
        sampler=chosen["sampler"],
        **numbers,
    )


def _check(valid: object, problem: str) -> None:
    """Raise ConfigurationError with the problem of an entry that is not valid."""
    if not valid:
        raise ConfigurationError(problem)
