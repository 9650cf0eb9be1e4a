"""Study files: validates what `study(...)` returns and expands its grids."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mast_zenoh.config import loading
from mast_zenoh.config.settings import from_values, split
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.metrics.measures import MEASURES
from mast_zenoh.scenario.reading import checked_name, name_of_file
from mast_zenoh.security.levels import LEVELS
from mast_zenoh.study.defences.kinds import DefenceCell

#: The keys of a study, and of one of its `runs`.
KEYS = {
    "name": "name of the study",
    "runs": "label to dict(scenario=…, parameters=…, grid=…)",
    "baseline": "label of the run that the others are paired with; by default `baseline`, or else the first",
    "scenes": "short names, or dicts of launch-time parameters; by default the scenarios' own",
    "trials": "seeds for each configuration and scene; without it, every configuration is run once, with a report",
    "seed": "the first seed",
    "frames": "frames of each run, None for all",
    "runtime": "mesh or inproc",
    "cells": "label to a cell of a study of defences: each trial is evaluated for it (mast_zenoh.study.defences)",
    "per_trial": "launch-time parameters that get each trial's seed and frames: dict(seed=…, frames=…)",
    "security": "security levels at which the attackers in each run's scenario file are tried",
}
PER_TRIAL = ("seed", "frames")
RUN_KEYS = ("scenario", "parameters", "grid")
RUNTIMES = ("mesh", "inproc")
#: Columns of results.parquet, frames.parquet and table.csv: no parameter of a grid may have one of these names.
COLUMNS = {
    *("configuration", "scene", "seed", "who", "estimator", "metric", "value", "std", "frames"),
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
    """

    label: str
    run: str
    scenario: str
    settings: tuple[str, ...]
    point: tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class StudyScene:
    """A scene of the study: its label, and the settings that choose it."""

    label: str
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """A validated study file with its parameters set; trials: None if not set.

    cells: by label of configuration, its cell in a study of defences; {}: another study
    per_trial: names of launch-time parameters that get the `seed` and the `frames` of each trial
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
    cells: Mapping[str, DefenceCell] = field(default_factory=dict)
    per_trial: Mapping[str, str] = field(default_factory=dict)

    @property
    def evaluation(self) -> str:
        """The module of `study.defences` by which each trial is evaluated; "": another study."""
        return next((cell.kind for cell in self.cells.values()), "")

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
    return _validated(path, content)


def _validated(path: Path, content: Any) -> Study:
    if not isinstance(content, dict) or not isinstance(content.get("runs"), dict) or not content["runs"]:
        raise ConfigurationError(f"{path}: study(...) must return a dict with `runs`: label to dict(scenario=…)")
    for key in content:
        if key not in KEYS:
            raise ConfigurationError(f"{path}: {key}: unknown key{nearest(str(key), KEYS)}")
    configurations = tuple(each for label, run in content["runs"].items() for each in _expand(path, label, run))
    labels = [checked_name(each.label, f"{path}: runs") for each in configurations]
    if len(set(labels)) < len(labels):
        duplicate = next(label for label in labels if labels.count(label) > 1)
        raise ConfigurationError(f"{path}: runs: two configurations are called {duplicate!r}")
    baseline = content.get("baseline", "baseline" if "baseline" in labels else labels[0])
    if baseline not in labels:
        raise ConfigurationError(f"{path}: baseline: found {baseline!r}{nearest(str(baseline), labels)}")
    scenes = content.get("scenes", [{}])
    if not isinstance(scenes, (list, tuple)) or not scenes:
        raise ConfigurationError(f"{path}: scenes: found {scenes!r}, expected a list of short names or dicts")
    if content.get("runtime", "mesh") not in RUNTIMES:
        raise ConfigurationError(f"{path}: runtime: found {content['runtime']!r}{nearest('', RUNTIMES)}")
    return Study(
        path=path,
        name=checked_name(content.get("name", name_of_file(path.stem)), f"{path}: name"),
        configurations=configurations,
        baseline=baseline,
        scenes=_scenes(path, scenes),
        trials=_integer(path, content, "trials", 1),
        seed=_integer(path, content, "seed", 0) or 0,
        frames=_integer(path, content, "frames", 1),
        runtime=content.get("runtime"),
        security=_levels(path, content.get("security", ())),
        cells=_cells(path, content.get("cells", {}), labels),
        per_trial=_per_trial(path, content.get("per_trial", {})),
    )


def _levels(path: Path, content: Any) -> tuple[str, ...]:
    """The security levels, without duplicates."""
    if not isinstance(content, (list, tuple)):
        raise ConfigurationError(f"{path}: security: found {content!r}, expected a list of {', '.join(LEVELS)}")
    for level in content:
        if level not in LEVELS:
            raise ConfigurationError(f"{path}: security: found {level!r}{nearest(str(level), LEVELS)}")
    return tuple(dict.fromkeys(content))


def _cells(path: Path, content: Any, labels: Sequence[str]) -> dict[str, DefenceCell]:
    """The cells of all configurations, or of none."""
    if not isinstance(content, Mapping) or not all(isinstance(cell, DefenceCell) for cell in content.values()):
        raise ConfigurationError(f"{path}: cells: found {content!r:.120}, expected label to {DefenceCell.__name__}")
    if len({type(cell) for cell in content.values()}) > 1:
        raise ConfigurationError(f"{path}: cells: expected cells of one class, found several")
    if content and set(content) != set(labels):
        different = sorted(set(content) ^ set(labels))[0]
        raise ConfigurationError(f"{path}: cells: {different!r}: expected exactly the labels of `runs`")
    return dict(content)


def _per_trial(path: Path, content: Any) -> dict[str, str]:
    if not isinstance(content, Mapping) or not set(content) <= set(PER_TRIAL):
        raise ConfigurationError(f"{path}: per_trial: found {content!r}, expected a dict with {', '.join(PER_TRIAL)}")
    return dict(content)


def _expand(path: Path, label: Any, run: Any) -> list[Configuration]:
    """The configurations of one run: one for each point of its grid."""
    if not isinstance(run, dict) or "scenario" not in run:
        raise ConfigurationError(f"{path}: runs.{label}: found {run!r}, expected dict(scenario=…, parameters=…)")
    for key in run:
        if key not in RUN_KEYS:
            raise ConfigurationError(f"{path}: runs.{label}.{key}: unknown key{nearest(str(key), RUN_KEYS)}")
    for key in ("parameters", "grid"):
        if not isinstance(run.get(key, {}), Mapping):
            raise ConfigurationError(f"{path}: runs.{label}.{key}: found {run[key]!r}, expected a dict")
    grid = run.get("grid", {})
    for name, values in grid.items():
        if not isinstance(values, (list, tuple)) or not values:
            raise ConfigurationError(f"{path}: runs.{label}.grid.{name}: found {values!r}, expected a list of values")
        if name in COLUMNS:
            suggestion = _SUGGESTIONS.get(name, "")
            raise ConfigurationError(
                f"{path}: runs.{label}.grid.{name}: the tables of results have a column of this name, "
                f"expected another{suggestion}"
            )
    configurations = []
    for values in itertools.product(*grid.values()):
        point = dict(zip(grid, values, strict=True))
        settings = _settings({**run.get("parameters", {}), **point})
        name = "-".join([str(label), *map(str, values)])
        if "/" in name or name in ("", ".", ".."):
            raise ConfigurationError(f"{path}: runs: found the label {name!r}, expected one that can name a folder")
        sibling = path.parent / str(run["scenario"])  # scenario paths are relative to the study file
        scenario_file = str(sibling) if sibling.is_file() else str(run["scenario"])
        configurations.append(Configuration(name, str(label), scenario_file, settings, tuple(point.items())))
    return configurations


def _scenes(path: Path, scenes: Sequence[Any]) -> tuple[StudyScene, ...]:
    """The scenes, with unique labels.

    Labels are the settings' values, or keys and values if the values alone are ambiguous.
    """
    labelled = [_scene(path, index, content) for index, content in enumerate(scenes)]
    if len({scene.label for scene in labelled}) < len(labelled):
        labelled = [StudyScene(", ".join(scene.settings) or "default", scene.settings) for scene in labelled]
    for index, scene in enumerate(labelled):
        first = labelled.index(scene)
        if first < index:
            raise ConfigurationError(
                f"{path}: scenes[{index}]: the same as scenes[{first}] ({scene.label}), expected each scene once"
            )
    return tuple(labelled)


def _scene(path: Path, index: int, scene: Any) -> StudyScene:
    if isinstance(scene, str):
        scene = {"scene": scene}
    if not isinstance(scene, Mapping):
        raise ConfigurationError(f"{path}: scenes[{index}]: found {scene!r}, expected a short name or a dict")
    return StudyScene(", ".join(str(value) for value in scene.values()) or "default", _settings(scene))


def _settings(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(f"{key}={value}" for key, value in parameters.items())


def _integer(path: Path, content: Mapping[str, Any], key: str, minimum: int) -> int | None:
    """An optional integer of at least `minimum`."""
    value = content.get(key)
    if value is not None and (type(value) is not int or value < minimum):
        raise ConfigurationError(f"{path}: {key}: found {value!r}, expected a whole number from {minimum}")
    return value
