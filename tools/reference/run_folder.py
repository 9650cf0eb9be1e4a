"""docs/ref-run-folder.md: the files of a run folder and of a study's folder, their keys and columns."""

from __future__ import annotations

from collections.abc import Iterator

from mast_zenoh.api.catalogue import parameters_of
from mast_zenoh.run_folder.finding import Finding
from reference import page, parameter_table
from reference.docstrings import described_table

_INTRODUCTION = """\
Look up here which files a run and a study write, and what each key and column means. Numbers of metrics.json are in
[ref-metrics.md](ref-metrics.md). [how-to-read-a-report.md](how-to-read-a-report.md) says where to look first, and
[how-to-record-and-replay.md](how-to-record-and-replay.md) how messages.mcap is written.

Frames count from 0; frame k is row k of scene.npz. Places are in metres in the world frame: x east, y north, z up. Any
Parquet reader opens the tables; text is dictionary-encoded, and NaN is a missing value. Readers of run folders ignore
other keys and columns."""
#: Files of a run, then of a study: each with what writes it. What has several parts has several writers.
DOCUMENTS = {
    "run.json": "mast_zenoh.launch.run:run",
    "run.json: timings": "mast_zenoh.launch.conclusion:rates",
    "run.json: nodes.NODE": "mast_zenoh.launch.supervisor:Supervisor.to_json",
    "scenario.json": "mast_zenoh.config.resolved:Resolved.to_json",
    "wiring.json": "mast_zenoh.wiring.model:Wiring.to_json",
    "metrics.json": "mast_zenoh.evaluation.run_scoring:RunScoring.results",
    "metrics.json: interposers.NODE": "mast_zenoh.evaluation.effects.reports:summary",
    "checks.json": "mast_zenoh.launch.checks:run",
}
TABLES = {
    "metrics.parquet": (
        "mast_zenoh.metrics.measures:frame_keys",
        "mast_zenoh.evaluation.run_scoring:RunScoring._scored",
    ),
    "objects.parquet": (
        "mast_zenoh.metrics.scores:Scores.objects",
        "mast_zenoh.evaluation.evaluation:ScoredFrames.tables",
    ),
    "attacks.parquet": ("mast_zenoh.evaluation.evaluation:attacks",),
    "targets.parquet": ("mast_zenoh.metrics.achievement:Manipulated.table",),
    "driving.parquet": ("mast_zenoh.metrics.driving:table",),
    "driven.parquet": ("mast_zenoh.driving.consequences:course",),
    "trust.parquet": ("mast_zenoh.metrics.trust:agent_table",),
    "trust_objects.parquet": ("mast_zenoh.metrics.trust:object_table",),
}
STUDY_TABLES = {
    "results.parquet": ("mast_zenoh.study.numbers:columns",),
    "frames.parquet": ("mast_zenoh.study.numbers:frames",),
    "table.csv": ("mast_zenoh.show.tables.study:as_csv",),
    "KIND.csv, search.csv": ("mast_zenoh.show.tables.text_table:numbers_of_rows",),
    "candidates.csv": ("mast_zenoh.study.search.report:candidates_csv",),
}
_STUDY = """\
## The folder of a study

A study of single runs has a run folder for each configuration, study.json, report.html and figures/. A study of trials
has these files.
"""
#: What else is in a table, by name.
_METRICS = "It also has each [metric](ref-metrics.md#scores-of-an-estimate) of frames, and yours, by its name.\n"
_FURTHER = {
    "metrics.parquet": _METRICS,
    "frames.parquet": "Then come the columns of metrics.parquet.\n",
}


def run_folder_page() -> str:
    """The files that a run and a study write, from what writes them."""
    return page("Run folders and studies' folders", "the code that writes them", _INTRODUCTION, _sections())


def _sections() -> Iterator[str]:
    yield "## The folder of a run\n"
    yield described_table("Files", "mast_zenoh.runs.files")
    for name, writer in DOCUMENTS.items():
        yield f"### {name}\n"
        yield described_table("Keys", writer)
    yield "### findings.json\n\nA list, each item also with `text`, its sentence. `notices` of run.json are the same.\n"
    yield parameter_table(parameters_of(Finding))
    yield from _tables(TABLES)
    yield _STUDY
    yield described_table("Files", "mast_zenoh.study.store")
    yield "### study.json\n"
    yield described_table("Keys", "mast_zenoh.study.store:Store.write_status")
    yield "### trials/DIGEST.parquet\n\nThe columns of metrics.parquet, and in the schema's metadata as JSON:\n"
    yield described_table("Keys", "mast_zenoh.study.store:Store.save")
    yield from _tables(STUDY_TABLES)


def _tables(tables: dict[str, tuple[str, ...]]) -> Iterator[str]:
    for name, writers in tables.items():
        yield f"### {name}\n"
        yield described_table("Columns", *writers)
        yield _FURTHER.get(name, "")
