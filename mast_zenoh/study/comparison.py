"""Runs every configuration of a study once, for a side-by-side comparison."""

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
from mast_zenoh.study.store import new_folder
from mast_zenoh.study.trial import run_command


@dataclass(frozen=True)
class ComparisonResult:
    """A finished study: its folder, and the run of each configuration by label."""

    out: Path
    runs: dict[str, launcher.Run]

    @property
    def folders(self) -> dict[str, Path]:
        """The run folder of each configuration."""
        return {label: finished.folder for label, finished in self.runs.items()}

    def raise_failures(self) -> None:
        """Raises HandlerFailed if handlers failed in any run and that was not allowed."""
        failed = [f"in run {label}, {finished.error}" for label, finished in self.runs.items() if finished.error]
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
    record: bool = False,
    console: Console | None = None,
) -> ComparisonResult:
    """Run every configuration once, in the first scene, in its own run folder.

    All configurations are resolved and validated before the first run starts. Arguments that are not None override
    the study's own. record: write every message to messages.mcap
    If a run fails, its error is raised after its run folder has been written. Failed handlers do not stop the other
    runs: `ComparisonResult.raise_failures` raises their error.
    """
    seed = study.seed if seed is None else seed
    frames = frames or study.frames
    resolved = {each.label: _resolve(study, each, seed, frames, record) for each in study.configurations}
    folder = new_folder(out, study.name)
    runs: dict[str, launcher.Run] = {}
    chosen_runtime = runtime or study.runtime or "mesh"

    def write_status(status: str) -> None:
        run_folder.write_json(folder / "study.json", {"name": study.name, "status": status, "runs": list(runs)})

    with ending.status_written(write_status):
        for configuration in study.configurations:
            label = configuration.label
            settings = (*study.scenes[0].settings, *configuration.settings)
            command = run_command(configuration.scenario, settings, seed, frames)
            finished = launcher.run(
                resolved[label],
                folder / label,
                command=[*command, "--runtime", chosen_runtime, *([] if record else ["--no-record"])],
                runtime=chosen_runtime,
                allow_failures=allow_failures,
                console=console,
            )
            if finished.error and not isinstance(finished.error, HandlerFailed):
                raise finished.error
            runs[label] = finished
    return ComparisonResult(folder, runs)


def _resolve(study: Study, configuration: Configuration, seed: int, frames: int | None, record: bool) -> Resolved:
    """The fully resolved run of one configuration."""
    file, loaded = scenario.load(configuration.scenario, (*study.scenes[0].settings, *configuration.settings))
    return scenario.resolve(file, loaded | {"name": configuration.label}, seed=seed, frames=frames, record=record)
