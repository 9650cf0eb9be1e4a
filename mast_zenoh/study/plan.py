"""Plans the trials of a study and validates all of them before the first one runs."""

from __future__ import annotations

from mast_zenoh import scenario, scenes
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.integrity.calibration import refuse_calibration_data
from mast_zenoh.scenario.timeline import attack_starts
from mast_zenoh.study import identity
from mast_zenoh.study.definition import Study
from mast_zenoh.study.trial import Trial


def trials(study: Study, *, count: int, seed: int, frames: int | None, runtime: str) -> list[Trial]:
    """One trial per configuration, scene and seed, grouped by scene and seed.

    Every configuration is resolved in every scene with the first seed. Raises what `scenario.load` and
    `scenario.resolve` raise, and ConfigurationError for a study of defences on calibration data.
    """
    environment = tuple(sorted(identity.environment().items()))
    by_seed: list[list[Trial]] = [[] for _ in range(count)]
    result = []
    for study_scene in study.scenes:
        for seed_trials in by_seed:
            seed_trials.clear()
        for configuration in study.configurations:
            common = (*study_scene.settings, *configuration.settings)
            settings = (*common, *study.trial_settings(seed, frames))
            path, loaded = scenario.load(configuration.scenario, settings)
            resolved = scenario.resolve(path, loaded, seed=seed, frames=frames)
            scene = registry.build(resolved.scene, scenes.Scene, f"{path}: scene")
            if study.cells:
                refuse_calibration_data(range(seed, seed + count), resolved.scene, str(study.path))
            files = identity.files_key(
                (*identity.user_files(path, loaded, resolved.modules), *identity.input_files(scene))
            )
            idle = _idle_period(resolved)
            for index, seed_trials in enumerate(by_seed):
                if study.per_trial and index:
                    settings = (*common, *study.trial_settings(seed + index, frames))
                    _, loaded = scenario.load(configuration.scenario, settings)
                seed_trials.append(
                    Trial(
                        digest=identity.digest(
                            loaded, files, seed + index, frames, runtime, evaluation=study.evaluation
                        ),
                        configuration=configuration.label,
                        scene=study_scene.label,
                        seed=seed + index,
                        scenario=configuration.scenario,
                        settings=settings,
                        frames=frames,
                        runtime=runtime,
                        scene_key=identity.scene_key(scene),
                        environment=environment,
                        idle=idle,
                        evaluation=study.evaluation,
                    )
                )
        result += [trial for seed_trials in by_seed for trial in seed_trials]
    return result


def _idle_period(resolved: Resolved) -> tuple[float, float] | None:
    """(start of first attack, end of run), s, if the run ends before any attack.

    None if an attack starts in time, if there is none, or if an adversary's start is not known.
    """
    starts = attack_starts(resolved.nodes)
    timed = {name for names in starts.values() for name in names}
    if not timed or any(spec.role == "adversary" and name not in timed for name, spec in resolved.nodes.items()):
        return None
    first, end = min(start for _, start in starts), resolved.frames * resolved.period_ns * 1e-9
    return (first, end) if first >= end else None
