"""Which trials a study consists of. All that can be refused is refused here, before the first one runs."""

from __future__ import annotations

from mast_zenoh import scenario, scenes
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.scenario.timeline import attack_starts
from mast_zenoh.study import identity
from mast_zenoh.study.definition import Study
from mast_zenoh.study.trial import Trial


def trials(study: Study, *, count: int, seed: int, frames: int | None, runtime: str) -> list[Trial]:
    """Every configuration in every scene with `count` seeds from `seed`, those of one scene and seed together.

    Every configuration is resolved in every scene with the first seed. Raises what `scenario.load` and
    `scenario.resolve` raise.
    """
    environment = tuple(sorted(identity.environment().items()))
    planned: list[list[Trial]] = [[] for _ in range(count)]
    result = []
    for place in study.scenes:
        for row in planned:
            row.clear()
        for each in study.configurations:
            settings = (*place.settings, *each.settings)
            path, loaded = scenario.load(each.scenario, settings)
            resolved = scenario.resolve(path, loaded, seed=seed, frames=frames)
            scene = registry.build(resolved.scene, scenes.Scene, f"{path}: scene")
            files = identity.files_key((*identity.user_files(path, loaded), *identity.input_files(scene)))
            idle = _idle(resolved)
            for index, row in enumerate(planned):
                row.append(
                    Trial(
                        digest=identity.digest(loaded, files, seed + index, frames, runtime),
                        configuration=each.label,
                        scene=place.label,
                        seed=seed + index,
                        scenario=each.scenario,
                        settings=settings,
                        frames=frames,
                        runtime=runtime,
                        scene_key=identity.scene_key(scene),
                        environment=environment,
                        idle=idle,
                    )
                )
        result += [trial for row in planned for trial in row]
    return result


def _idle(resolved: Resolved) -> tuple[float, float] | None:
    """When the first attack would begin and when the run ends, s of scene time, if no adversary gets to attack.

    None where one does, where there is none, and where an adversary's file does not say when it begins.
    """
    starts = attack_starts(resolved.nodes)
    timed = {name for names in starts.values() for name in names}
    if not timed or any(spec.role == "adversary" and name not in timed for name, spec in resolved.nodes.items()):
        return None
    first, end = min(start for _, start in starts), resolved.frames * resolved.period_ns * 1e-9
    return (first, end) if first >= end else None
