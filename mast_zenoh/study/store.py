"""The folder of a study: a file for each trial that is done, there whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow
from pyarrow import parquet

from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import folder as run_folder
from mast_zenoh.launch.tables import from_arrow, read_arrow, to_arrow
from mast_zenoh.study.definition import Study
from mast_zenoh.study.table_file import write_parquet
from mast_zenoh.study.trial import Outcome, Trial

_ABOUT = b"mast-zenoh"


class Store:
    """The folder of one study: `study.json`, `trials/<digest>.parquet`, and later the tables."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._trials = folder / "trials"

    @classmethod
    def create(cls, out: Path | None, study: Study, *, resume: bool) -> Store:
        """A new folder, or with `resume` one in which trials may be already.

        Raises RunFolderError when a new folder is not empty, or one to resume is that of another study.
        """
        if not resume:
            folder = run_folder.create(out, study.name)
            for part in ("logs", "figures"):
                (folder / part).rmdir()
        elif out is None:
            raise RunFolderError("--resume: expected --out too, the folder of the study to go on with")
        elif not out.exists() or not any(out.iterdir()):
            return cls.create(out, study, resume=False)
        else:
            folder = out.resolve()
            found = run_folder.read_json(folder / "study.json").get("name")
            if found != study.name:
                raise RunFolderError(f"{folder}: holds the study {found!r}, expected {study.name!r}")
        store = cls(folder)
        store._trials.mkdir(exist_ok=True)
        for left in store._trials.glob(".*"):
            left.unlink(missing_ok=True)  # of a study that was killed while it wrote
        return store

    def note(self, study: Study, trials: Sequence[Trial], failures: Mapping[str, str], status: str) -> None:
        """Write study.json: what the study consists of, and how it stands."""
        content = {
            "name": study.name,
            "status": status,
            "baseline": study.baseline,
            "configurations": {
                each.label: {"scenario": each.scenario, "settings": list(each.settings)}
                for each in study.configurations
            },
            "environment": dict(trials[0].environment) if trials else {},
            "runtime": trials[0].runtime if trials else None,
            "frames": trials[0].frames if trials else None,
            "trials": [
                {
                    "digest": trial.digest,
                    "configuration": trial.configuration,
                    "scene": trial.scene,
                    "seed": trial.seed,
                    "command": trial.command(),
                    **({"error": failures[trial.digest]} if trial.digest in failures else {}),
                }
                for trial in trials
            ],
        }
        run_folder.write_json(self.folder / "study.json", content)

    def save(self, outcome: Outcome) -> None:
        """Keep what came of a trial."""
        trial = outcome.trial
        about = {
            "configuration": trial.configuration,
            "scene": trial.scene,
            "seed": trial.seed,
            "command": trial.command(),
            "compromised": list(outcome.compromised),
            "cpu_s": outcome.cpu_s,
            "warning": outcome.warning,
            "metrics": run_folder.finite(outcome.metrics),
        }
        table = to_arrow(outcome.per_frame)
        table = table.replace_schema_metadata({_ABOUT: json.dumps(about, allow_nan=False).encode()})
        write_parquet(self._path(trial), table)

    def load(self, trial: Trial) -> Outcome | None:
        """What came of a trial; None if it is not done, its file is broken, or failures in it are not allowed now."""
        try:
            table = read_arrow(self._path(trial))
            about = json.loads(table.schema.metadata[_ABOUT])
            columns = from_arrow(table)
            if about["warning"] and not trial.allow_failures:
                return None
            rest = {"cpu_s": about["cpu_s"], "warning": about["warning"]}
            return Outcome(trial, about["metrics"], columns, tuple(about["compromised"]), **rest)
        except (OSError, ValueError, KeyError, TypeError, pyarrow.ArrowException):
            return None

    def frame_schema(self, trials: Sequence[Trial]) -> pyarrow.Schema:
        """The columns that the tables per frame of any trial have that is done, together."""
        schemas = [pyarrow.schema([])]
        for trial in trials:
            try:
                schemas.append(parquet.read_schema(self._path(trial)).remove_metadata())
            except (OSError, pyarrow.ArrowException):
                continue  # not done, or broken
        return pyarrow.unify_schemas(schemas, promote_options="permissive")

    def _path(self, trial: Trial) -> Path:
        return self._trials / f"{trial.digest}.parquet"
