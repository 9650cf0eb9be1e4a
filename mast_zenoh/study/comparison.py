"""A study of a few named runs, one after the other, to be laid side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from mast_zenoh import scenario
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch import local
from mast_zenoh.resolved import Resolved
from mast_zenoh.study.definition import Configuration, Study


@dataclass(frozen=True)
class Compared:
    """A study that has ended: its folder, and the run folder of each configuration."""

    out: Path
    folders: dict[str, Path]


def run(
    study: Study,
    out: Path | None = None,
    *,
    seed: int | None = None,
    frames: int | None = None,
    runtime: str | None = None,
    console: Console | None = None,
) -> Compared:
    """Run every configuration once, in the first scene, with a run folder of its own.

    Everything is resolved, and refused if it is wrong, before the first run starts. Arguments that are not None win
    over the study's own. Raises what a run that failed has raised, after its run folder has been written.
    """
    seed = study.seed if seed is None else seed
    frames = frames or study.frames
    resolved = {each.label: _resolve(study, each, seed, frames) for each in study.configurations}
    folder = run_folder.create(out, study.name)
    for part in ("logs", "figures"):
        (folder / part).rmdir()
    folders: dict[str, Path] = {}
    for label, run_ in resolved.items():
        ended = local.run(run_, folder / label, runtime=runtime or study.runtime or "mesh", console=console)
        if ended.error:
            raise ended.error
        folders[label] = ended.folder
    run_folder.write_json(folder / "study.json", {"name": study.name, "runs": list(folders)})
    return Compared(folder, folders)


def _resolve(study: Study, configuration: Configuration, seed: int, frames: int | None) -> Resolved:
    """One run of the study, with nothing left to decide."""
    file, loaded = scenario.load(configuration.scenario, (*study.scenes[0].settings, *configuration.settings))
    return scenario.resolve(file, loaded | {"name": configuration.label}, seed=seed, frames=frames)
