"""Which trials a study consists of. All that can be refused is refused here, before the first one runs."""

from __future__ import annotations

from mast_zenoh import registry, scenario, scenes
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
                    )
                )
        result += [trial for row in planned for trial in row]
    return result
