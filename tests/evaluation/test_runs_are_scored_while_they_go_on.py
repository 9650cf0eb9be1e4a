"""A long run is scored block by block; the results are those of an evaluation of the whole run."""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from played import play

from mast_zenoh import scenario
from mast_zenoh.evaluation import Evaluation, RunData, RunScoring, run_scoring
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.metrics.causes import KINDS

FRAMES = 200
#: Means over blocks instead of the run; and what several blocks have of every series instead of the distinct ones.
OF_BLOCKS = {"amota", "samota", "amotp_m", "consistency"}

Tables = Mapping[str, Mapping[str, np.ndarray]]
Results = tuple[Tables, dict[str, Any]]


@pytest.fixture(scope="module", autouse=True)
def messages_come_soon() -> Iterator[None]:
    """Blocks end sooner, as nothing is late here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_scoring, "LATEST_S", 1.0)
        patch.setattr(run_scoring, "BETWEEN_KEYS", 6)
        yield


def scored(name: str, *settings: str, frames: int) -> tuple[Results, Results]:
    """Tables and metrics of a run, scored in blocks of 40 frames and as a whole."""
    path, content = scenario.load(name, list(settings))
    process = InProcess(scenario.resolve(path, content, frames=frames))
    node: Any = next(host.node for host in process.hosts.values() if host.node.role == "evaluator")
    node.finish = lambda context: {}
    process.run()
    return in_blocks(node.evaluation, deepcopy(node.data), frames), in_blocks(node.evaluation, node.data, 0)


def in_blocks(evaluation: Evaluation, data: RunData, frames: int) -> Results:
    """The results of blocks that end while so many frames are played; 0: of one block."""
    scoring = RunScoring(evaluation, data)
    scoring.whole_frames = scoring.block_frames = 40
    parts = [part for frame in range(frames) if (part := scoring.advance(frame))]
    assert len(parts) >= (2 if frames else 0), "expected more blocks"
    results = scoring.results()
    last = results["tables"]
    tables = {
        name: {
            column: np.concatenate([*(np.asarray(part[name][column]) for part in parts if name in part), values])
            for column, values in last[name].items()
        }
        for name in last
    }
    return tables, results["metrics"]


@pytest.fixture(scope="module")
def run() -> tuple[Results, Results]:
    """A run in which an attack begins in a later block than the first."""
    return scored("defended", "defence=FaultOrLie", "attack_start_s=6.0", "n_infrastructure=3", frames=FRAMES)


@pytest.mark.parametrize("table", ["metrics", "attacks", "trust", "trust_objects"])
def test_tables_of_a_run_that_was_scored_in_blocks_are_those_of_the_whole(run, table):
    (blocks, _), (whole, _) = run
    assert rows(blocks[table]) == rows(whole[table])


def test_objects_of_every_estimate_are_judged_as_in_the_whole(run: tuple[Results, Results]) -> None:
    (blocks, metrics), (whole, expected) = run
    assert expected["same_as"], "no two estimates are equal over the whole run"
    assert metrics["same_as"] == expected["same_as"]
    parts = [whole["objects"]]
    for agent, pairs in expected["same_as"].items():
        for estimate, twin in pairs.items():
            of_twin = (parts[0]["agent"] == agent) & (parts[0]["estimator"] == twin)
            part = {name: column[of_twin] for name, column in parts[0].items()}
            parts.append(part | {"estimator": np.full(int(of_twin.sum()), estimate, object)})
    every = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    assert rows(blocks["objects"]) == rows(every)


def test_manipulated_objects_are_believed_as_in_the_whole_and_keep_their_number(run: tuple[Results, Results]) -> None:
    targets = [tables["targets"] for tables, _ in run]
    # Insertions have numbers of their own, other manipulations the ids of their objects.
    blocks, whole = ({kind: len(set(table["object"][table["kind"] == kind])) for kind in KINDS} for table in targets)
    assert blocks == whole
    unnumbered = ({name: column for name, column in table.items() if name != "object"} for table in targets)
    one, other = (rows(table) for table in unnumbered)
    assert one == other


def test_the_summary_is_that_of_the_whole(run: tuple[Results, Results]) -> None:
    (_, blocks), (_, whole) = run
    differences = [path for path in different(blocks, whole) if OF_BLOCKS.isdisjoint(path)]
    # The path of a vehicle is sampled from the first frame that is evaluated on.
    assert {path[0] for path in differences} <= {"driving"}
    for path in differences:
        assert at(blocks, path) == pytest.approx(at(whole, path), abs=0.1)
    for agent, estimates in whole["agents"].items():
        for estimate, expected in estimates.items():
            found = blocks["agents"][agent][estimate]
            for name in ("amota", "samota"):
                assert found[name] == pytest.approx(expected[name], abs=0.05), (agent, estimate, name)


def test_what_happened_to_a_driven_car_is_told_as_in_the_whole() -> None:
    (blocks, metrics), (whole, expected) = scored("driving", "n_infrastructure=2", frames=FRAMES)
    assert rows(blocks["driven"]) == rows(whole["driven"])
    assert list(different(metrics["driven"], expected["driven"])) == []


def test_a_run_that_is_longer_than_a_block_keeps_no_more_messages(tmp_path, monkeypatch):
    kept: list[int] = []
    results = RunScoring.results

    def noting(self: RunScoring) -> dict[str, Any]:
        kept.extend(self.data.record.frames().tolist())
        return results(self)

    monkeypatch.setattr(RunScoring, "WHOLE", (60, 60, 0))
    monkeypatch.setattr(RunScoring, "results", noting)
    run = play(tmp_path, "baseline", "n_infrastructure=1", frames=290)
    assert kept[0] >= 180 - 150, "of three blocks, all but the last 15 s are forgotten"
    assert kept[-1] == 289
    assert sorted(set(run.table("objects")["frame"].tolist())) == list(range(290))


def rows(table: Mapping[str, np.ndarray]) -> list[str]:
    """The rows of a table in a fixed order, numbers to 9 digits."""
    columns = [
        np.round(column, 9) if column.dtype.kind == "f" else column for column in map(np.asarray, table.values())
    ]
    return sorted(map(repr, zip(*(column.tolist() for column in columns), strict=True)))


def at(document: Any, path: tuple[str, ...]) -> Any:
    """The value at a path of `different`."""
    for part in path:
        document = document[int(part) if isinstance(document, list) else part]
    return document


def different(one: Any, other: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Paths in two documents at which they differ by more than rounding."""
    if isinstance(one, dict) and isinstance(other, dict):
        for name in sorted(one.keys() | other.keys()):
            yield from different(one.get(name), other.get(name), (*path, str(name)))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for index, pair in enumerate(zip(one, other, strict=True)):
            yield from different(*pair, (*path, str(index)))
    elif isinstance(one, float) and isinstance(other, float):
        if one != pytest.approx(other, rel=1e-9, abs=1e-12):
            yield path
    elif one != other:
        yield path
