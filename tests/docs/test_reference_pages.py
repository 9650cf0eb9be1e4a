"""The pages of reference name everything, and say what each thing means."""

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest
from pyarrow import parquet
from reference import run_folder, scenario
from reference.classes import KINDS, shipped
from reference.docstrings import entries
from reference.metrics import PARTS

from mast_zenoh import scenario as scenario_files
from mast_zenoh.api.catalogue import Entry
from mast_zenoh.launch import run as launcher
from mast_zenoh.metrics.measures import MEASURES
from mast_zenoh.show.tables.text_table import BOUNDS
from mast_zenoh.study import definition
from mast_zenoh.study import numbers as study_numbers

DOCS = Path(__file__).parents[2] / "docs"


def listed(kind: str) -> Iterator[Entry]:
    for _, of_group in shipped(kind):
        yield from of_group


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "messages"])
def test_every_class_is_listed_and_each_of_its_parameters_has_a_meaning(kind: str) -> None:
    page = (DOCS / "ref-classes.md").read_text("utf-8")
    for entry in listed(kind):
        assert f"#### {entry.name}\n" in page or f"| `{entry.name}` |" in page, entry.name
        assert entry.description, entry.name
        assert not [each.name for each in entry.parameters if not each.words], (
            f"{entry.name}: describe them as `name: …`"
        )


def test_every_parameter_of_a_node_and_of_its_parts_has_a_meaning() -> None:
    parts = list(scenario.parts())
    assert not [f"{part.heading}: {each.name}" for part in parts for each in part.parameters if not each.words]
    roles = {cls.role for cls in scenario.node_classes()}
    assert roles >= {"agent", "broker", "command_center", "peer", "driver", "adversary", "evaluator", "link"}


def names(writers: str | Sequence[str], head: str = "Keys") -> set[str]:
    """What the docstrings of what writes a document or a table describe."""
    of = [writers] if isinstance(writers, str) else writers
    return {name for writer in of for each in entries(resolve_name(writer), head) for name in each.names}


#: Scenarios whose runs have, all together, everything that a run can have, each with settings.
RUNS = {
    "attack_during_partition": (),
    "coordinated": (),
    "defended": (),
    "driving": (),
    "congested": ("background=0", "n_mobile=2", "n_infrastructure=2"),
}


@pytest.fixture(scope="module", params=sorted(RUNS))
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of each of these runs."""
    out = tmp_path_factory.mktemp("run") / request.param
    path, loaded = scenario_files.load(request.param, RUNS[request.param])
    resolved = scenario_files.resolve(path, loaded, frames=24, record=True)
    launcher.run(resolved, out, runtime="inproc")
    return out


def test_the_page_has_every_column_of_every_table_of_a_run(folder: Path) -> None:
    of_frames = {name for name, measure in MEASURES.items() if measure.axis}
    for file in folder.glob("*.parquet"):
        described = names(run_folder.TABLES[file.name], "Columns")
        described |= of_frames if file.name == "metrics.parquet" else set()
        assert set(parquet.read_schema(file).names) == described, file.name


def test_the_page_has_every_key_of_every_document_of_a_run(folder: Path) -> None:
    for document, writer in run_folder.DOCUMENTS.items():
        name, _, part = document.partition(": ")
        if (folder / name).exists():
            content = json.loads((folder / name).read_text("utf-8"))
            for each in parts_of(content, part):
                assert set(each) <= names(writer), document
    assert {file.name for file in folder.iterdir()} <= described_files()


def test_the_page_has_every_number_of_a_run(folder: Path) -> None:
    metrics = json.loads((folder / "metrics.json").read_text("utf-8"))
    for heading, place, *writers in PARTS:
        for key in re.findall(r"`([\w.]+)` of metrics.json", place):
            known = names(writers) | (set(MEASURES) if heading == "Causes of errors" else set())
            beginnings = tuple(name.removesuffix("…") for name in known if name.endswith("…"))
            for part in parts_of(metrics, key + ".QUANTITY" * (heading == "Confidence and accuracy")):
                found = {name for name in flat(part, known) if not (beginnings and name.startswith(beginnings))}
                assert found <= known, heading


def parts_of(content: Any, place: str) -> Iterator[Any]:
    """What is at a dotted place, in which a name in capitals stands for any; nothing, if the content lacks it."""
    first, _, deeper = place.partition(".")
    if not place:
        yield content
    elif first.isupper():
        for part in content.values():
            yield from parts_of(part, deeper)
    elif first in content:
        yield from parts_of(content[first], deeper)


def flat(content: Mapping[str, Any], known: Collection[str]) -> Iterator[str]:
    """The keys; of a dict that is described by its parts, those of the parts, as `key.part`."""
    for key, value in content.items():
        inner = any(name.startswith(f"{key}.") for name in known)
        yield from (f"{key}.{name}" for name in value) if inner else (key,)


def described_files() -> set[str]:
    return {name.partition("/")[0] for name in names("mast_zenoh.runs.files", "Files")}


def test_the_page_has_every_column_of_the_tables_of_a_study() -> None:
    described = {name: names(writers, "Columns") for name, writers in run_folder.STUDY_TABLES.items()}
    assert described.pop("KIND.csv, search.csv") == {"measure", *BOUNDS}
    described.pop("candidates.csv")
    assert described["results.parquet"] == set(study_numbers.COLUMNS)
    columns = set.union(*described.values()) | {"frame", "agent", "scored"}
    columns |= {name for name, measure in MEASURES.items() if measure.axis}
    assert columns == set(definition.RESULT_COLUMNS)
