"""The folder of a study: one file per finished trial, and tables of all, written atomically.

Files:
study.json: status, configurations, versions, and every trial
report.html: the study as one page that needs no other file
table.md, table.tex, table.csv: the estimates: as Markdown, as LaTeX with `booktabs`, and with all digits
results.parquet: a row per trial and number
frames.parquet: the tables per frame of all trials
increments.png, increments_mission.png, success.png: what attacks add, and how often they succeed; also as PDF
KIND.md, KIND.csv, KIND.tex: tables of the kind of study, if it has one; its figures have its name, too
search.md, search.csv, search.tex, search.json: of a study with a search: its result
candidates.csv: of such a study: every candidate
attempts.md, attempts.csv: of a study of security levels: what each attempt achieved
trials/DIGEST.parquet: a file per trial: the columns of metrics.parquet, and metrics.json in the schema's metadata
runs/: the run folder of each trial; with --record
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow
from pyarrow import parquet

from mast_zenoh import run_folder
from mast_zenoh.errors import Interrupted, RunError, RunFolderError
from mast_zenoh.launch import ending, stop_signals
from mast_zenoh.run_folder import check_plain, parse_json, read_json, subfolder
from mast_zenoh.run_folder.recording.writer import FILE as RECORDING
from mast_zenoh.run_folder.tables import from_arrow, read_arrow, to_arrow
from mast_zenoh.study.definition import Study
from mast_zenoh.study.trial import Trial, TrialOutcome

_METADATA = b"mast-zenoh"


def new_folder(out: Path | None, name: str) -> Path:
    """Create an empty folder for a study: `out`, or runs/<name>-<time>; raises RunFolderError and DiskFull."""
    folder = run_folder.create(out, name)
    for part in ("logs", "figures"):
        (folder / part).rmdir()
    return folder


@contextmanager
def status_written(file: Path, write: Callable[[str], None], hint: str = "") -> Iterator[None]:
    """Write the status `running`, run the block, and write how it ended.

    file: that `write` writes; room for it is reserved, so that a full disk does not leave it at `running`
    hint: of what to do after an interruption, or an error of the operating system
    Stop signals that come while the final status is written are ignored.
    """
    write(ending.RUNNING)
    caught: BaseException | None = None
    try:
        run_folder.reserve(file.parent, 2 * file.stat().st_size)  # errors of trials are added
        yield
    except (KeyboardInterrupt, Interrupted, OSError) as raised:
        caught = ending.with_hint(raised, hint) if hint else raised
    except BaseException as raised:
        caught = raised
    with stop_signals.collected():
        error = None if caught is None else ending.from_exception(caught) or RunError(str(caught))
        run_folder.release(file.parent)
        try:
            write(ending.status(error))
        except OSError:
            if caught is None:
                raise
    if caught is not None:
        raise caught


class Store:
    """The folder of a study: `study.json`, `trials/<digest>.parquet`, the tables, and `runs` if they are kept."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.status_file = folder / "study.json"
        #: names of files that hold another trial than they say
        self.misplaced: set[str] = set()
        self._trials = folder / "trials"

    @classmethod
    def create(cls, out: Path | None, study: Study, *, resume: bool) -> Store:
        """Create a new study folder, or with `resume` open one that may hold trials.

        Raises RunFolderError if a new folder is not empty, or a folder to resume belongs to another study.
        """
        if not resume:
            folder = new_folder(out, study.name)
        elif out is None:
            raise RunFolderError("--resume: expected --out too: the folder of the study to continue")
        elif not out.exists() or not any(out.iterdir()):
            return cls.create(out, study, resume=False)
        else:
            folder = out.resolve()
            stored_name = read_json(folder / "study.json").get("name")
            if stored_name != study.name:
                raise RunFolderError(f"{folder}: holds the study {stored_name!r}, expected {study.name!r}")
        store = cls(folder)
        for part in (store._trials.name, "runs") if (folder / "runs").is_symlink() else (store._trials.name,):
            subfolder(folder, part)
        for leftover in store._trials.glob(".*"):
            leftover.unlink(missing_ok=True)  # from a study that was killed while writing
        return store

    def refuse_other(self, study: Study, trials: Sequence[Trial]) -> None:
        """Raise RunFolderError if the folder has configurations, scenes or frames that the study's tables would lack.

        trials: those planned
        """
        if not (self.folder / "study.json").is_file():
            return
        stored = read_json(self.folder / "study.json")
        known = {each.label: [each.scenario, list(each.settings)] for each in study.configurations}
        for label, content in stored.get("configurations", {}).items():
            if (settings := known.get(label)) != [content["scenario"], content["settings"]]:
                expected = "only those of this study" if settings is None else " ".join(settings[1])
                self._refuse(f"the configuration {label!r} ({' '.join(content['settings'])})", expected)
        scenes = {trial.scene for trial in trials}
        for content in stored.get("trials", []):
            if content["scene"] not in scenes:
                self._refuse(f"the scene {content['scene']!r}", f"one of {', '.join(sorted(scenes))}")
        if trials and stored.get("frames") != trials[0].frames:
            self._refuse(f"trials of {stored.get('frames')} frames", f"{trials[0].frames}")

    def _refuse(self, found: str, expected: str) -> None:
        raise RunFolderError(
            f"{self.folder}: holds another study, with {found}: expected {expected}. Its tables would be overwritten: "
            "use another folder, or the settings with which it was begun"
        )

    def write_status(
        self,
        study: Study,
        trials: Sequence[Trial],
        failures: Mapping[str, str],
        status: str,
        left_out: Sequence[str] = (),
    ) -> None:
        """Write study.json: the study's configurations and trials, and its status; with failures, `ok` is `failed`.

        Keys:
        name, status, baseline: of the study; as in run.json; label of a configuration
        configurations: by label, `scenario` and `settings`
        environment: versions of what the numbers depend on
        runtime, frames: of each trial
        trials: each with `digest`, configuration, scene, seed and command; `run`, its folder; `error`, if it failed
        left_out: why tables or figures of a kind are not there; with these, too, `ok` is `failed`
        """
        content = {
            "name": study.name,
            "status": "failed" if (failures or left_out) and status == ending.OK else status,
            **({"left_out": list(left_out)} if left_out else {}),
            "baseline": study.baseline,
            "configurations": {
                each.label: {"scenario": each.scenario, "settings": list(each.settings)}
                for each in study.configurations
            },
            "environment": dict(pair for trial in trials for pair in trial.environment),
            "runtime": trials[0].runtime if trials else None,
            "frames": trials[0].frames if trials else None,
            "trials": [
                {
                    "digest": trial.digest,
                    **trial.summary(),
                    **({"run": str(Path(trial.folder).relative_to(self.folder))} if trial.folder else {}),
                    **({"error": failures[trial.digest]} if trial.digest in failures else {}),
                }
                for trial in trials
            ],
        }
        run_folder.write_json(self.status_file, content)

    def save(self, outcome: TrialOutcome) -> None:
        """Store the outcome of a trial.

        Keys:
        digest: of all that the numbers depend on
        configuration, scene, seed, command: which trial it is; the command that runs it alone
        compromised: names of compromised agents
        cpu_s: processor time
        warning: handlers that failed, if that is allowed; empty: none
        metrics: the content of metrics.json
        """
        metadata = {
            "digest": outcome.trial.digest,
            **outcome.trial.summary(),
            "compromised": list(outcome.compromised),
            "cpu_s": outcome.cpu_s,
            "warning": outcome.warning,
            "metrics": run_folder.finite(outcome.metrics),
        }
        table = to_arrow(outcome.per_frame)
        table = table.replace_schema_metadata({_METADATA: json.dumps(metadata, allow_nan=False).encode()})
        write_parquet(self._path(outcome.trial), table)

    def load(self, trial: Trial) -> TrialOutcome | None:
        """The stored outcome of a trial; None if absent, broken, of another trial or with failures."""
        path = self._path(trial)
        try:
            table = read_arrow(path)
            metadata = parse_json(table.schema.metadata[_METADATA])
            if metadata["digest"] != trial.digest:  # renamed or copied
                self.misplaced.add(f"{path.parent.name}/{path.name}")
                return None
            columns = from_arrow(table)
            if metadata["warning"] and not trial.allow_failures:
                return None
            kept = {name: metadata[name] for name in ("metrics", "cpu_s", "warning")}
            return TrialOutcome(trial, per_frame=columns, compromised=tuple(metadata["compromised"]), **kept)
        except (OSError, ValueError, KeyError, TypeError, RunFolderError, pyarrow.ArrowException):
            return None

    @contextmanager
    def naming(self, trial: Trial) -> Iterator[None]:
        """Raise RunFolderError where the numbers of a trial cannot be computed from what is stored of it."""
        try:
            yield
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise RunFolderError(
                f"{self._path(trial)}: its contents cannot be used: {type(error).__name__}: {error}; remove it, and "
                "--resume plays the trial again"
            ) from None

    def run_folder(self, trial: Trial) -> Path:
        """Where the recorded run of a trial is kept."""
        return self.folder / "runs" / f"{trial.configuration}-seed_{trial.seed}-{trial.digest[:8]}"

    def is_kept(self, trial: Trial) -> bool:
        """Whether the recorded run of a trial is there, or not to be kept."""
        return not trial.folder or (Path(trial.folder) / RECORDING).is_file()

    def frame_schema(self, trials: Sequence[Trial]) -> pyarrow.Schema:
        """The union of the columns of all finished trials' tables per frame."""
        result = pyarrow.schema([])
        for trial in trials:
            try:
                columns = parquet.read_schema(check_plain(self._path(trial))).remove_metadata()
            except (OSError, RunFolderError, pyarrow.ArrowException):
                continue  # absent or broken
            with self.naming(trial):  # errors of Arrow are of these types
                result = pyarrow.unify_schemas([result, columns], promote_options="permissive")
        return result

    def _path(self, trial: Trial) -> Path:
        return self._trials / f"{trial.digest}.parquet"


class TableWriter:
    """Writes a table in pieces, buffered up to one row group, so memory use does not grow with the table."""

    ROW_GROUP = 500_000

    def __init__(self, writer: parquet.ParquetWriter) -> None:
        self._writer = writer
        self._pending: list[pyarrow.Table] = []

    def append(self, piece: pyarrow.Table) -> None:
        """Append rows; columns of the schema that they lack are null."""
        columns = [
            piece.column(field.name).cast(field.type)
            if field.name in piece.column_names
            else pyarrow.nulls(len(piece), field.type)
            for field in self._writer.schema
        ]
        self._pending.append(pyarrow.table(columns, schema=self._writer.schema))
        if sum(map(len, self._pending)) >= self.ROW_GROUP:
            self.flush()

    def flush(self) -> None:
        """Write what is buffered."""
        if self._pending:
            self._writer.write_table(pyarrow.concat_tables(self._pending).unify_dictionaries().combine_chunks())
        self._pending = []


@contextmanager
def table_writer(path: Path, schema: pyarrow.Schema) -> Iterator[TableWriter]:
    """Write a Parquet file: complete when the block ends, and as it was before if the block raises."""
    with (
        run_folder.replacing(path) as new,
        new.open("wb") as content,  # closed also where the writer cannot end, on a full disk
        parquet.ParquetWriter(content, schema, compression="zstd") as file,
    ):
        writer = TableWriter(file)
        yield writer
        writer.flush()


def write_parquet(path: Path, table: Any) -> None:
    """Write a table atomically: a reader finds the complete old or new file."""
    with table_writer(path, table.schema) as file:
        file.append(table)
