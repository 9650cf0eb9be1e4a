"""A study of a few named runs, one after the other, to be laid side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import HandlerFailed
from mast_zenoh.launch import ending
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch import run as launcher
from mast_zenoh.study.definition import Configuration, Study


@dataclass(frozen=True)
class Compared:
    """A study that has ended: its folder, and the run of each configuration."""

    out: Path
    runs: dict[str, launcher.Run]

    @property
    def folders(self) -> dict[str, Path]:
        """The run folder of each configuration."""
        return {label: ended.folder for label, ended in self.runs.items()}

    def raise_failures(self) -> None:
        """Raises HandlerFailed if handlers failed in any run and that was not allowed."""
        failed = [f"in run {label}, {ended.error}" for label, ended in self.runs.items() if ended.error]
        if failed:
            raise HandlerFailed("\n".join(failed))


def run(
    study: Study,
    out: Path | None = None,
    *,
    seed: int | None = None,
    frames: int | None = None,
    runtime: str | None = None,
    allow_failures: bool = False,
    console: Console | None = None,
) -> Compared:
    """Run every configuration once, in the first scene, with a run folder of its own.

    Everything is resolved, and refused if it is wrong, before the first run starts. Arguments that are not None win
    over the study's own. Raises what a run that failed has raised, after its run folder has been written. A run in
    which handlers failed does not stop the others: `Compared.raise_failures` raises its error.
    """
    seed = study.seed if seed is None else seed
    frames = frames or study.frames
    resolved = {each.label: _resolve(study, each, seed, frames) for each in study.configurations}
    folder = run_folder.create(out, study.name)
    for part in ("logs", "figures"):
        (folder / part).rmdir()
    runs: dict[str, launcher.Run] = {}
    place = runtime or study.runtime or "mesh"

    def note(status: str) -> None:
        run_folder.write_json(folder / "study.json", {"name": study.name, "status": status, "runs": list(runs)})

    with ending.written(note):
        for label, run_ in resolved.items():
            ended = launcher.run(run_, folder / label, runtime=place, allow_failures=allow_failures, console=console)
            if ended.error and not isinstance(ended.error, HandlerFailed):
                raise ended.error
            runs[label] = ended
    return Compared(folder, runs)


def _resolve(study: Study, configuration: Configuration, seed: int, frames: int | None) -> Resolved:
    """One run of the study, with nothing left to decide."""
    file, loaded = scenario.load(configuration.scenario, (*study.scenes[0].settings, *configuration.settings))
    return scenario.resolve(file, loaded | {"name": configuration.label}, seed=seed, frames=frames)
