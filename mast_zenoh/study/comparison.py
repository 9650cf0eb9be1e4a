"""A study of a few named runs, one after the other, to be laid side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from mast_zenoh import loading, scenario
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch import local

_KEYS = {"name", "runs", "runtime", "seed", "frames"}
_RUN_KEYS = {"scenario", "parameters"}


@dataclass(frozen=True)
class Study:
    """A study that has ended: its folder, and the run folder of each label."""

    out: Path
    folders: dict[str, Path]


def run(
    study_file: str,
    settings: Sequence[str] = (),
    out: Path | None = None,
    *,
    seed: int | None = None,
    frames: int | None = None,
    runtime: str | None = None,
    console: Console | None = None,
) -> Study:
    """Run all runs of a study file. Everything is resolved, and refused if it is wrong, before the first run starts.

    Raises what a run that failed has raised, after its run folder has been written.
    """
    path, function = loading.function("studies", study_file, "study")
    parameters, dotted = scenario.split_settings(settings, function, str(path))
    if dotted:
        raise ConfigurationError(f"{path}: --set {next(iter(dotted))}: a study has no dotted settings")
    study = _checked(function(**parameters), path)
    resolved = {
        label: _resolve(
            path, label, entry, study.get("seed", 0) if seed is None else seed, frames or study.get("frames")
        )
        for label, entry in study["runs"].items()
    }
    folder = run_folder.create(out, str(study.get("name", path.stem)))
    for part in ("logs", "figures"):
        (folder / part).rmdir()
    folders: dict[str, Path] = {}
    for label, run_ in resolved.items():
        ended = local.run(run_, folder / label, runtime=runtime or study.get("runtime", "mesh"), console=console)
        if ended.error:
            raise ended.error
        folders[label] = ended.folder
    run_folder.write_json(folder / "study.json", {"name": study.get("name", path.stem), "runs": list(folders)})
    return Study(folder, folders)


def _resolve(path: Path, label: str, entry: Mapping[str, Any], seed: int, frames: int | None) -> scenario.Resolved:
    """One run of the study, with nothing left to decide."""
    settings = [f"{key}={value}" for key, value in entry.get("parameters", {}).items()]
    file, loaded = scenario.load(entry["scenario"], settings)
    return scenario.resolve(file, loaded | {"name": label}, seed=seed, frames=frames)


def _checked(study: Any, path: Path) -> dict[str, Any]:
    """The study, refused unless every key is known."""
    if not isinstance(study, dict) or not isinstance(study.get("runs"), dict) or not study["runs"]:
        raise ConfigurationError(f"{path}: study(...) must return a dict with `runs`: label to dict(scenario=…)")
    for key in study:
        if key not in _KEYS:
            raise ConfigurationError(f"{path}: {key}: unknown key{nearest(key, _KEYS)}")
    for label, entry in study["runs"].items():
        if not isinstance(entry, dict) or "scenario" not in entry:
            raise ConfigurationError(f"{path}: runs.{label}: found {entry!r}, expected dict(scenario=…, parameters=…)")
        for key in entry:
            if key not in _RUN_KEYS:
                raise ConfigurationError(f"{path}: runs.{label}.{key}: unknown key{nearest(key, _RUN_KEYS)}")
    return study
