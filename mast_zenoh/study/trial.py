"""A trial of a study, a configuration, a scene and a seed: its outcome, and the digest of its inputs."""

from __future__ import annotations

import hashlib
import json
import platform
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from mast_zenoh import kernels, scenes
from mast_zenoh.config import bundle, plugins
from mast_zenoh.metrics import Table
from mast_zenoh.version import fingerprint

#: Packages whose versions affect the results.
_PACKAGES = ("mast-zenoh", "numpy", "scipy", "filterpy", "msgpack")


class TrialKey(NamedTuple):
    """Scene and seed of a trial: trials of other configurations with the same key are paired with it."""

    scene: str
    seed: int


def run_command(scenario: str, settings: Sequence[str], seed: int, frames: int | None) -> list[str]:
    """The words of the command that runs a scenario of a study alone."""
    words = ["mast", "run", scenario, *(word for setting in settings for word in ("--set", setting))]
    return [*words, "--seed", str(seed), *(["--frames", str(frames)] if frames else [])]


@dataclass(frozen=True)
class Trial:
    """One run of a study.

    Trials with equal digests (`digest_of`) have equal outcomes.

    configuration, scene: labels in the study
    scenario, settings:   as for `mast run SCENARIO --set …`
    scene_key:            equal for trials that play the same recording
    environment:          code and versions that a worker must have
    allow_failures:       whether the trial counts even if handlers of its nodes failed
    idle:                 s of scene time: start of the first attack and end of the trial, if the trial ends first;
                          None: an attack starts, or there is none
    evaluation:           name of the kind of study by which it is evaluated (`kinds.kind_of`); "": none
    folder:               where its recorded run is kept; "": nowhere
    """

    digest: str
    configuration: str
    scene: str
    seed: int
    scenario: str
    settings: tuple[str, ...]
    frames: int | None
    runtime: str
    scene_key: str
    environment: tuple[tuple[str, str], ...]
    allow_failures: bool = False
    idle: tuple[float, float] | None = None
    evaluation: str = ""
    folder: str = ""

    @property
    def key(self) -> TrialKey:
        """Its scene and seed."""
        return TrialKey(self.scene, self.seed)

    def summary(self) -> dict[str, Any]:
        """Its place in the study, and its command, as JSON values."""
        place = {"configuration": self.configuration, "scene": self.scene, "seed": self.seed}
        return place | {"command": self.command()}

    def command(self) -> str:
        """The command that runs this trial alone, with a run folder and a report."""
        allowed = ["--allow-failures"] if self.allow_failures else []
        return shlex.join(
            [*run_command(self.scenario, self.settings, self.seed, self.frames), *allowed, "--runtime", self.runtime]
        )


@dataclass(frozen=True)
class TrialOutcome:
    """The outcome of a trial.

    error: why it failed, or ""; warning: handler failures that were allowed
    metrics:     content of metrics.json
    per_frame:   the columns of metrics.parquet
    compromised: agents with adversaries on their wires
    cpu_s:       s, CPU time of the process that ran it, without preparing its scene and evaluating it, which differs
                 from run to run
    """

    trial: Trial
    metrics: Mapping[str, Any]
    per_frame: Table
    compromised: tuple[str, ...] = ()
    error: str = ""
    cpu_s: float = 0.0
    warning: str = ""

    @classmethod
    def failed(cls, trial: Trial, reason: str) -> TrialOutcome:
        """The outcome of a trial without results."""
        return cls(trial, {}, {}, error=reason)


def environment(distributions: Iterable[str]) -> dict[str, str]:
    """Versions of Python, kernels and packages, and hashes of our code and files and of the plugins that are used.

    distributions: as for `plugins.versions_of`
    """
    return _environment() | plugins.versions_of(distributions)


@cache
def _environment() -> dict[str, str]:
    versions = {"python": platform.python_version(), "kernels": kernels.USED} | {
        name: version(name) for name in _PACKAGES
    }
    folders = [bundle.ROOT / kind for kind in ("nodes", "keyexpr_maps", "scenarios")]
    files = sorted(path for folder in folders for path in folder.iterdir() if path.suffix in (".py", ".toml"))
    return versions | {"code": fingerprint(), "files": _hash(path.read_bytes() for path in files)}


def scene_key(scene: scenes.Scene) -> str:
    """A key that is equal for scenes with equal recordings; ignores the seed."""
    description = json.dumps([type(scene).__qualname__, vars(scene)], sort_keys=True, default=repr)
    return re.sub(r" at 0x[0-9a-f]+", "", description)  # addresses differ between equal objects


@cache
def files_key(paths: tuple[Path, ...]) -> str:
    """A hash of files or folders: names, sizes and modification times of all files."""
    lines = []
    for path in paths:
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            stat = file.stat()
            lines.append(f"{file.relative_to(path.parent)} {stat.st_size} {stat.st_mtime_ns}".encode())
    return _hash(lines)


def user_files(path: Path, study: Path, modules: Iterable[str] = ()) -> tuple[Path, ...]:
    """Python files in a user's scenario folder, which the scenario may import, and in those of its classes.

    path: of the scenario;  study: the study's file, which counts only if it is used, or if another file has its name
    modules: files of classes that the scenario uses
    """
    used = {path, *map(Path, modules)}
    folders = {file.parent for file in used} - {bundle.ROOT / "scenarios"}
    files = [file for folder in sorted(folders) for file in sorted(folder.glob("*.py"))]
    others = [file for file in files if file != study]
    imports = re.compile(rf"\b{re.escape(study.stem)}\b")
    is_used = study in used or any(imports.search(file.read_text(errors="replace")) for file in others)
    return tuple(files if is_used else others)


def digest_of(
    loaded: Mapping[str, Any],
    files: str,
    seed: int,
    frames: int | None,
    runtime: str,
    environment: Mapping[str, str],
    *,
    evaluation: str = "",
) -> str:
    """Digest of a scenario's content, files and run options; 40 hexadecimal digits.

    environment: code and versions
    evaluation: name of the kind of study by which the trial is evaluated; "": none
    """
    parts = {
        "scenario": loaded,
        "files": files,
        "seed": seed,
        "frames": frames,
        "runtime": runtime,
        "environment": environment,
        **({"evaluation": evaluation} if evaluation else {}),
    }
    return _hash([json.dumps(parts, sort_keys=True, default=repr).encode()])


def _hash(parts: Iterable[bytes]) -> str:
    hasher = hashlib.blake2b(digest_size=20)
    for part in parts:
        hasher.update(len(part).to_bytes(8, "little") + part)
    return hasher.hexdigest()
