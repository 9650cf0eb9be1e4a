"""Study files: validates what `study(...)` returns and expands its grids."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh.config import loading
from mast_zenoh.config.settings import from_values, split
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.mesh.security.levels import LEVELS
from mast_zenoh.metrics.measures import MEASURES
from mast_zenoh.scenario.reading import checked_name, name_of_file
from mast_zenoh.study import numbers
from mast_zenoh.study.defences.kinds import Factors, Kind, name_of_kind

if TYPE_CHECKING:
    from mast_zenoh.study.search.plan import SearchPlan

#: The keys of a study, and of one of its `runs`.
KEYS = {
    "name": "name of the study",
    "runs": "label to dict(scenario=…, parameters=…, grid=…, factors=…)",
    "baseline": "label of the run that the others are paired with; by default `baseline`, or else the first",
    "scenes": "short names, or dicts of launch-time parameters; by default the scenarios' own",
    "trials": "seeds for each configuration and scene; without it, every configuration is run once, with a report",
    "seed": "the first seed",
    "frames": "frames of each run, None for all",
    "runtime": "mesh or inproc",
    "kind": "what is measured of each trial, and the tables and figures: a subclass of Kind (docs/how-to-studies.md)",
    "per_trial": "launch-time parameters that get each trial's seed and frames: dict(seed=…, frames=…)",
    "search": "parameters of a run that are searched for the greatest harm (docs/how-to-studies.md)",
    "driven": "dict(scenario=…, parameters=…, frames=…) with drivers: run after single runs, and its unattacked twin",
    "security": "security levels at which the `attempts` are made",
    "attempts": "attacks by somebody without a role in the run: a list of Attempt (docs/explanation-security.md)",
}
PER_TRIAL = ("seed", "frames")
#: The label of the run with drivers, and its folder.
DRIVEN = "driven"
RUN_KEYS = {
    "scenario": "a file next to the study, or the name of a shipped scenario",
    "parameters": "launch-time parameters of the scenario, as for --set: dotted keys, too",
    "grid": "parameter to list of values: a configuration for each combination, and a column of the results for each",
    "factors": "names and values by which the `kind` tells configurations apart; those of the grid are among them",
}
RUNTIMES = ("mesh", "inproc")
#: Columns of results.parquet, frames.parquet and table.csv: no parameter of a grid may have one of these names.
RESULT_COLUMNS = {
    *numbers.COLUMNS,
    *("frame", "agent", "scored", *(name for name, measure in MEASURES.items() if measure.axis)),
    *("mean", "std_over_frames", "mean_over_trials", "low", "high", "scenes_low", "scenes_high", "p", "p_holm"),
    *("zero_share", "zero_low", "zero_high"),
    *("scenes", "seeds", "seeds_left_out"),
}
#: The key of the study file that replaces such a parameter.
_SUGGESTIONS = {"scene": "; list scenes under `scenes`", "seed": "; set the number of seeds under `trials`"}


@dataclass(frozen=True)
class Configuration:
    """One scenario under one choice of launch-time parameters.

    label:    unique: the run's label and the values of its grid: "uncoordinated-2"
    run:      label of the run in the study file
    scenario: file, or name of a shipped scenario
    settings: KEY=VALUE, as for `mast run --set`
    point:    this configuration's values of the grid's parameters
    factors:  these, and those that the study file names: what its kind tells configurations apart by
    """

    label: str
    run: str
    scenario: str
    settings: tuple[str, ...]
    point: tuple[tuple[str, Any], ...]
    factors: Factors = field(default_factory=Factors)


@dataclass(frozen=True)
class Attempt:
    """An attack on a run by somebody without a role in it, an outsider.

    name:  its name in the table
    act:   the function that makes it: act(attacked_run, attempt) returns an Outcome, see `study.attacked_run`
    wire:  the key of the messages that it forges, without the run's prefix; "": none. No two attempts share one, as
           messages are counted by key
    shows: what it presents: "nothing", a certificate of its own authority ("foreign"), an "expired" one, or that of the
           node of this name
    lures: the node whose connection to the router passes through the outsider; "": none
    """

    name: str
    act: Callable[[Any, Attempt], Any]
    wire: str = ""
    shows: str = "nothing"
    lures: str = ""


@dataclass(frozen=True)
class DrivenRun:
    """The run with drivers after the others. frames: at most, None: the study's"""

    configuration: Configuration
    frames: int | None


@dataclass(frozen=True)
class StudyScene:
    """A scene of the study: its label, and the settings that choose it."""

    label: str
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """A validated study file with its parameters set; trials: None if not set.

    kind: what is measured of each trial, and the tables and figures of its own; None: none
    per_trial: names of launch-time parameters that get the `seed` and the `frames` of each trial
    driven: the run with drivers after single runs; None: none
    search: what parameters are searched; the trials are then of seeds that the search does not use. None: no search
    """

    path: Path
    name: str
    configurations: tuple[Configuration, ...]
    baseline: str
    scenes: tuple[StudyScene, ...]
    trials: int | None
    seed: int
    frames: int | None
    runtime: str | None
    security: tuple[str, ...] = ()
    attempts: tuple[Attempt, ...] = ()
    kind: type[Kind] | None = None
    per_trial: Mapping[str, str] = field(default_factory=dict)
    search: SearchPlan | None = None
    driven: DrivenRun | None = None

    @property
    def evaluation(self) -> str:
        """The name of the kind by which each trial is evaluated; "": none, all is made of the stored outcomes."""
        return name_of_kind(self.kind) if self.kind and self.kind.evaluate is not Kind.evaluate else ""

    @property
    def kind_files(self) -> tuple[str, ...]:
        """The user's file of the kind, if it evaluates trials: whatever is in it may be called from `evaluate`."""
        file = self.evaluation.rpartition(":")[0]
        return (file,) if file.endswith(".py") else ()

    @property
    def has_own_kind(self) -> bool:
        """Whether its kind is a user's, and not one of this package."""
        return self.kind is not None and not self.kind.__module__.startswith("mast_zenoh.")

    def new_kind(self, seeds: Sequence[int]) -> Kind:
        """What takes the measures of its trials with these seeds."""
        assert self.kind is not None
        return self.kind(self.factors, [scene.label for scene in self.scenes], seeds)

    @property
    def factors(self) -> dict[str, Factors]:
        """By label of configuration, its factors."""
        return {each.label: each.factors for each in self.configurations}

    def chosen(self, **options: Any) -> Study:
        """The study with another seed, number of frames, runtime or number of trials: those that are not None."""
        return replace(self, **{name: value for name, value in options.items() if value is not None})

    def trial_settings(self, seed: int, frames: int | None) -> tuple[str, ...]:
        """The settings of a trial that depend on its seed and its frames."""
        values = {"seed": seed, "frames": frames}
        return tuple(f"{parameter}={values[name]}" for name, parameter in self.per_trial.items())


def load(name: str, settings: Sequence[str] = ()) -> Study:
    """Load a study from a file or by its name, with `--set` settings.

    Raises ConfigurationError, which names the file, the key, the value found and the value expected.
    """
    path, function = loading.function("studies", name, "study")
    return _call(path, function, *split(settings, function, str(path)))


def load_values(name: str, values: Mapping[str, Any], known: Iterable[str] = ()) -> Study:
    """Load a study with Python values; known: other names to suggest."""
    path, function = loading.function("studies", name, "study")
    return _call(path, function, *from_values(values, function, str(path), known))


def _call(path: Path, function: Callable[..., Any], parameters: Mapping[str, Any], dotted: Mapping[str, Any]) -> Study:
    """The study that a function returns."""
    if dotted:
        raise ConfigurationError(f"{path}: --set {next(iter(dotted))}: a study has no dotted settings")
    try:
        content = function(**parameters)
    except ConfigurationError:
        raise
    except Exception as error:
        raise ConfigurationError(f"{path}: study(...): {type(error).__name__}: {error}") from error
    try:
        return _validated(path, content)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None


def _check(valid: object, problem: str) -> None:
    """Raise ConfigurationError with the problem of an entry that is not valid."""
    if not valid:
        raise ConfigurationError(problem)


def _validated(path: Path, content: Any) -> Study:
    runs = content.get("runs") if isinstance(content, dict) else None
    _check(runs and isinstance(runs, dict), "study(...) must return a dict with `runs`: label to dict(scenario=…)")
    for key in content:
        _check(key in KEYS, f"{key}: unknown key{nearest(str(key), KEYS)}")
    configurations = tuple(each for label, run in content["runs"].items() for each in _expand(path, label, run))
    labels = [checked_name(each.label, "runs") for each in configurations]
    duplicate = next((label for label in labels if labels.count(label) > 1), None)
    _check(duplicate is None, f"runs: two configurations are called {duplicate!r}")
    baseline = content.get("baseline", "baseline" if "baseline" in labels else labels[0])
    _check(baseline in labels, f"baseline: found {baseline!r}{nearest(str(baseline), labels)}")
    runtime = content.get("runtime")
    _check(runtime in RUNTIMES or "runtime" not in content, f"runtime: found {runtime!r}{nearest('', RUNTIMES)}")
    per_trial = content.get("per_trial", {})
    known = isinstance(per_trial, Mapping) and set(per_trial) <= set(PER_TRIAL)
    _check(known, f"per_trial: found {per_trial!r}, expected a dict with {', '.join(PER_TRIAL)}")
    return Study(
        path=path,
        name=checked_name(content.get("name", name_of_file(path.stem)), "name"),
        configurations=configurations,
        baseline=baseline,
        scenes=_scenes(content.get("scenes", [{}])),
        trials=_integer(content, "trials", 1),
        seed=_integer(content, "seed", 0) or 0,
        frames=_integer(content, "frames", 1),
        runtime=runtime,
        security=_levels(content.get("security", ())),
        kind=_kind(content.get("kind"), configurations),
        per_trial=dict(per_trial),
        search=_search(content, baseline) if content.get("search") is not None else None,
        driven=_driven(path, content["driven"], labels) if content.get("driven") is not None else None,
        attempts=_attempts(content.get("attempts", ()), content.get("security", ())),
    )


def _search(content: Mapping[str, Any], baseline: str) -> SearchPlan:
    """The plan of a search."""
    from mast_zenoh.study.search.plan import parse_plan  # Optuna may not be installed, and is slow to load

    return parse_plan(content, baseline)


def _driven(path: Path, run: Any, labels: Sequence[str]) -> DrivenRun:
    """The run with drivers. labels: of the other runs"""
    valid = isinstance(run, dict) and set(run) <= {"scenario", "parameters", "frames"} and "scenario" in run
    _check(valid, f"driven: found {run!r}, expected dict(scenario=…, parameters=…, frames=…)")
    _check(DRIVEN not in labels, f"runs: found the label {DRIVEN!r}, expected another: it is that of the key `driven`")
    frames = _integer(run, "frames", 1)
    (configuration,) = _expand(path, DRIVEN, {key: value for key, value in run.items() if key != "frames"})
    return DrivenRun(configuration, frames)


def _levels(content: Any) -> tuple[str, ...]:
    """The security levels, without duplicates."""
    expected = f"expected a list of {', '.join(LEVELS)}"
    _check(isinstance(content, (list, tuple)), f"security: found {content!r}, {expected}")
    for level in content:
        _check(level in LEVELS, f"security: found {level!r}{nearest(str(level), LEVELS)}")
    return tuple(dict.fromkeys(content))


def _attempts(content: Any, levels: Sequence[str]) -> tuple[Attempt, ...]:
    """The attempts of a study of security levels; every other study has none."""
    valid = isinstance(content, (list, tuple)) and all(isinstance(each, Attempt) for each in content)
    _check(valid, f"attempts: found {content!r:.120}, expected a list of {Attempt.__name__}")
    _check(bool(content) == bool(levels), "attempts: expected together with `security`, and neither empty")
    for values in ([each.name for each in content], [each.wire for each in content if each.wire]):
        duplicate = next((value for value in values if values.count(value) > 1), None)
        _check(duplicate is None, f"attempts: found {duplicate!r} twice, expected names and wires that differ")
    return tuple(content)


def _kind(kind: Any, configurations: Sequence[Configuration]) -> type[Kind] | None:
    """The kind of a study; its configurations have factors that differ."""
    if kind is None:
        return None
    valid = isinstance(kind, type) and issubclass(kind, Kind)
    _check(valid, f"kind: found {kind!r:.120}, expected a subclass of {Kind.__name__}")
    missing = [*sorted(kind.__abstractmethods__), *(["name"] * (not isinstance(getattr(kind, "name", None), str)))]
    _check(not missing, f"kind: {kind.__name__} has no {', '.join(missing)}")
    labels = {each.factors: each.label for each in configurations}
    for each in configurations:
        other = labels[each.factors]
        _check(other == each.label, f"runs.{each.label}.factors: the same as of {other!r}, expected others")
    return kind  # type: ignore[no-any-return]


def _expand(path: Path, label: Any, run: Any) -> list[Configuration]:
    """The configurations of one run: one for each point of its grid."""
    place = f"runs.{label}"
    valid = isinstance(run, dict) and "scenario" in run
    _check(valid, f"{place}: found {run!r}, expected dict(scenario=…, parameters=…)")
    for key in run:
        _check(key in RUN_KEYS, f"{place}.{key}: unknown key{nearest(str(key), RUN_KEYS)}")
    parameters, grid, factors = (run.get(key, {}) for key in ("parameters", "grid", "factors"))
    for key, values in (("parameters", parameters), ("grid", grid), ("factors", factors)):
        _check(isinstance(values, Mapping), f"{place}.{key}: found {values!r}, expected a dict")
    for name, values in grid.items():
        listed = isinstance(values, (list, tuple)) and values
        _check(listed, f"{place}.grid.{name}: found {values!r}, expected a list of values")
        reserved = "the tables of results have a column of this name, expected another"
        _check(name not in RESULT_COLUMNS, f"{place}.grid.{name}: {reserved}{_SUGGESTIONS.get(name, '')}")
    configurations = []
    for values in itertools.product(*grid.values()):
        point = dict(zip(grid, values, strict=True))
        name = "-".join([str(label), *map(str, values)])
        is_folder = "/" not in name and name not in ("", ".", "..")
        _check(is_folder, f"runs: found the label {name!r}, expected one that can name a folder")
        sibling = path.parent / str(run["scenario"])  # scenario paths are relative to the study file
        scenario_file = str(sibling) if sibling.is_file() else str(run["scenario"])
        settings = settings_of({**parameters, **point})
        known = Factors(point | dict(factors))
        configurations.append(Configuration(name, str(label), scenario_file, settings, tuple(point.items()), known))
    return configurations


def _scenes(content: Any) -> tuple[StudyScene, ...]:
    """The scenes, with unique labels.

    Labels are the settings' values, or keys and values if the values alone are ambiguous.
    """
    valid = isinstance(content, (list, tuple)) and content
    _check(valid, f"scenes: found {content!r}, expected a list of short names or dicts")
    scenes = [{"scene": scene} if isinstance(scene, str) else scene for scene in content]
    for index, scene in enumerate(scenes):
        expected = "expected a short name or a dict"
        _check(isinstance(scene, Mapping), f"scenes[{index}]: found {scene!r}, {expected}")
    labels = [", ".join(map(str, scene.values())) for scene in scenes]
    if len(set(labels)) < len(labels):
        labels = [", ".join(settings_of(scene)) for scene in scenes]
    labelled = [StudyScene(label or "default", settings_of(scene)) for label, scene in zip(labels, scenes, strict=True)]
    for index, scene in enumerate(labelled):
        first = labelled.index(scene)
        expected = f"the same as scenes[{first}] ({scene.label}), expected each scene once"
        _check(first == index, f"scenes[{index}]: {expected}")
    return tuple(labelled)


def settings_of(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Launch-time parameters as for `mast run --set`."""
    return tuple(f"{key}={value}" for key, value in parameters.items())


def _integer(content: Mapping[str, Any], key: str, minimum: int) -> int | None:
    """An optional integer of at least `minimum`."""
    value = content.get(key)
    valid = value is None or (type(value) is int and value >= minimum)
    _check(valid, f"{key}: found {value!r}, expected a whole number from {minimum}")
    return value
