"""Study files: what `study(...)` returns, checked, and its grid spread out into configurations."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mast_zenoh.config import loading
from mast_zenoh.config.settings import from_values, split
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.scenario.names import checked_name, name_of_file
from mast_zenoh.security.levels import LEVELS

#: The keys of a study, and of one of its `runs`.
KEYS = {
    "name": "what the study is called",
    "runs": "label to dict(scenario=…, parameters=…, grid=…)",
    "baseline": "label of the run that the others are paired with; by default `baseline`, or else the first",
    "scenes": "short names, or dicts of launch-time parameters; by default the scenarios' own",
    "trials": "seeds for each configuration and scene; without it, every configuration is run once, with a report",
    "seed": "the first seed",
    "frames": "how many to play, None for all",
    "runtime": "mesh or inproc",
    "security": "levels at which the attackers that each run's scenario file lists are let loose on it",
}
RUN_KEYS = ("scenario", "parameters", "grid")
RUNTIMES = ("mesh", "inproc")
#: What the tables call their own columns, so that no parameter of a grid can be called that: results.parquet,
#: frames.parquet, table.csv.
COLUMNS = {
    *("configuration", "scene", "seed", "who", "estimator", "metric", "value", "std", "frames"),
    *("frame", "agent", "fn", "fp", "tp", "rmse_m", "id_switches", "ospa_m", "gospa_m"),
    *("mean", "std_over_frames", "mean_over_trials", "low", "high", "scenes_low", "scenes_high", "p", "p_holm"),
    *("scenes", "seeds", "seeds_left_out"),
}
#: Where the study file has a key of its own for what such a parameter is probably meant to do.
_INSTEAD = {"scene": "; list scenes under `scenes`", "seed": "; say how many seeds under `trials`"}


@dataclass(frozen=True)
class Configuration:
    """One scenario under one choice of launch-time parameters.

    label:    unlike that of any other: the run's, and the values of its grid: "uncoordinated-2"
    run:      label of the run in the study file
    scenario: file, or name of one of ours
    settings: KEY=VALUE, as for `mast run --set`
    point:    this configuration's choice from the grid
    """

    label: str
    run: str
    scenario: str
    settings: tuple[str, ...]
    point: tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Place:
    """A scene of the study: its label, and the settings that choose it."""

    label: str
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """A study file with its parameters settled; trials None: it did not say how many."""

    path: Path
    name: str
    configurations: tuple[Configuration, ...]
    baseline: str
    scenes: tuple[Place, ...]
    trials: int | None
    seed: int
    frames: int | None
    runtime: str | None
    security: tuple[str, ...] = ()


def load(name: str, settings: Sequence[str] = ()) -> Study:
    """The study of a file (or the name of one of ours) under `--set` settings of its parameters.

    Raises ConfigurationError, which names the file, the place, what was found and what was expected.
    """
    path, function = loading.function("studies", name, "study")
    return _called(path, function, *split(settings, function, str(path)))


def load_values(name: str, values: Mapping[str, Any], known: Iterable[str] = ()) -> Study:
    """The same under parameters as Python values; known: further names to suggest where one is unknown."""
    path, function = loading.function("studies", name, "study")
    return _called(path, function, *from_values(values, function, str(path), known))


def _called(
    path: Path, function: Callable[..., Any], parameters: Mapping[str, Any], dotted: Mapping[str, Any]
) -> Study:
    """The study that a function returns."""
    if dotted:
        raise ConfigurationError(f"{path}: --set {next(iter(dotted))}: a study has no dotted settings")
    try:
        content = function(**parameters)
    except ConfigurationError:
        raise
    except Exception as error:
        raise ConfigurationError(f"{path}: study(...): {type(error).__name__}: {error}") from error
    return _checked(path, content)


def _checked(path: Path, content: Any) -> Study:
    if not isinstance(content, dict) or not isinstance(content.get("runs"), dict) or not content["runs"]:
        raise ConfigurationError(f"{path}: study(...) must return a dict with `runs`: label to dict(scenario=…)")
    for key in content:
        if key not in KEYS:
            raise ConfigurationError(f"{path}: {key}: unknown key{nearest(str(key), KEYS)}")
    configurations = tuple(each for label, run in content["runs"].items() for each in _spread(path, label, run))
    labels = [checked_name(each.label, f"{path}: runs") for each in configurations]
    if len(set(labels)) < len(labels):
        twice = next(label for label in labels if labels.count(label) > 1)
        raise ConfigurationError(f"{path}: runs: two configurations are called {twice!r}")
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
        scenes=_places(path, scenes),
        trials=_whole(path, content, "trials", 1),
        seed=_whole(path, content, "seed", 0) or 0,
        frames=_whole(path, content, "frames", 1),
        runtime=content.get("runtime"),
        security=_levels(path, content.get("security", ())),
    )


def _levels(path: Path, content: Any) -> tuple[str, ...]:
    """Levels of security, each once."""
    if not isinstance(content, (list, tuple)):
        raise ConfigurationError(f"{path}: security: found {content!r}, expected a list of {', '.join(LEVELS)}")
    for level in content:
        if level not in LEVELS:
            raise ConfigurationError(f"{path}: security: found {level!r}{nearest(str(level), LEVELS)}")
    return tuple(dict.fromkeys(content))


def _spread(path: Path, label: Any, run: Any) -> list[Configuration]:
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
            where = f"{path}: runs.{label}.grid.{name}"
            raise ConfigurationError(
                f"{where}: the tables of results have a column of this name, expected another{_INSTEAD.get(name, '')}"
            )
    found = []
    for values in itertools.product(*grid.values()):
        point = dict(zip(grid, values, strict=True))
        settings = _settings({**run.get("parameters", {}), **point})
        name = "-".join([str(label), *map(str, values)])
        if "/" in name or name in ("", ".", ".."):
            raise ConfigurationError(f"{path}: runs: found the label {name!r}, expected one that can name a folder")
        file = path.parent / str(run["scenario"])  # a scenario beside the study is found from anywhere
        beside = str(file) if file.is_file() else str(run["scenario"])
        found.append(Configuration(name, str(label), beside, settings, tuple(point.items())))
    return found


def _places(path: Path, scenes: Sequence[Any]) -> tuple[Place, ...]:
    """The scenes, with labels that tell them apart: their values, or where these are alike keys and values."""
    places = [_place(path, index, scene) for index, scene in enumerate(scenes)]
    if len({place.label for place in places}) < len(places):
        places = [Place(", ".join(place.settings) or "default", place.settings) for place in places]
    for index, place in enumerate(places):
        first = places.index(place)
        if first < index:
            raise ConfigurationError(
                f"{path}: scenes[{index}]: the same as scenes[{first}] ({place.label}), expected each scene once"
            )
    return tuple(places)


def _place(path: Path, index: int, scene: Any) -> Place:
    if isinstance(scene, str):
        scene = {"scene": scene}
    if not isinstance(scene, Mapping):
        raise ConfigurationError(f"{path}: scenes[{index}]: found {scene!r}, expected a short name or a dict")
    return Place(", ".join(str(value) for value in scene.values()) or "default", _settings(scene))


def _settings(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(f"{key}={value}" for key, value in parameters.items())


def _whole(path: Path, content: Mapping[str, Any], key: str, least: int) -> int | None:
    """A whole number from `least`, or None."""
    value = content.get(key)
    if value is not None and (type(value) is not int or value < least):
        raise ConfigurationError(f"{path}: {key}: found {value!r}, expected a whole number from {least}")
    return value
