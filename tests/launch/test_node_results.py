"""Results of `finish` are written to the run folder and nowhere else."""

import json
import tracemalloc
from functools import partial
from pathlib import Path
from typing import Any

import failing
import numpy as np
import pytest
from equal_runs import run_alone

from mast_zenoh import run_folder, scenario
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import conclusion, run
from mast_zenoh.launch.table_files import TableFiles
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.control.results import PartedTables, TablePart, collations, late
from mast_zenoh.run_folder import read_json
from mast_zenoh.run_folder.tables import read_arrow, read_table
from mast_zenoh.wiring.model import Branch, Endpoint, Leg, Traits, Wire, Wiring

METRICS = {"frames": 3, "agents": {}}
TABLE = {"frame": np.arange(3), "rmse_m": np.array([0.5, np.nan, 1.0])}


def written(results: dict[str, Any], folder: Path, **measured: Any) -> tuple[list[str], set[str]]:
    """Write results to a new run folder, as nodes hand them in; returns (refusals, names of the files)."""
    folder.mkdir()
    files, rest = TableFiles(folder), {}
    for node, result in results.items():
        tables = PartedTables()
        tables.hand_in = partial(files.add, node, "process")
        rest[node] = tables.close(result)
    files.close()
    refused = conclusion.write_results(folder, rest, measured, files)
    return refused, {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_only_the_evaluator_writes_to_the_top_level_of_the_folder(tmp_path: Path) -> None:
    results = {
        "zeta": {"metrics": {"mine": 1}, "tables": {"metrics": {"a": [1]}}},
        "evaluator": {"metrics": METRICS, "tables": {"metrics": TABLE}, "more": [1]},
        "alpha": {"metrics": {"mine": 2}, "tables": {"metrics": {"a": [2]}}},
        "silent": {},
    }
    refused, files = written(results, tmp_path / "run", late={"ego": 1})
    assert refused == []
    assert files == {
        "metrics.json",
        "metrics.parquet",
        "results/evaluator/results.json",
        "results/zeta/results.json",
        "results/zeta/metrics.parquet",
        "results/alpha/results.json",
        "results/alpha/metrics.parquet",
    }
    top = tmp_path / "run"
    assert read_json(top / "metrics.json") == METRICS | {"late": {"ego": 1}}
    assert read_table(top / "metrics.parquet").keys() == TABLE.keys()
    assert read_json(top / "results/zeta/results.json") == {"metrics": {"mine": 1}}
    assert read_json(top / "results/evaluator/results.json") == {"more": [1]}


def test_numpy_arrays_and_numbers_become_plain_json(tmp_path: Path) -> None:
    values = {"n": np.int64(3), "yes": np.bool_(True), "x": np.array([[1.0, np.inf]]), "names": np.array(["a"], object)}
    written({"node": values}, tmp_path / "run")
    back = json.loads((tmp_path / "run/results/node/results.json").read_text())
    assert back == {"n": 3, "yes": True, "x": [[1.0, None]], "names": ["a"]}


BAD_NAMES = ["../metrics", "/nowhere/metrics", "a/b", "..", ".hidden", "", "a\\b", "x" * 65, "a\nb", "a\0b", 7, "ä"]


@pytest.mark.parametrize("node", ["evaluator", "other"])
def test_a_table_name_that_leads_outside_the_folder_is_refused_and_reported(tmp_path: Path, node: str) -> None:
    refused, files = written({node: {"tables": dict.fromkeys([*BAD_NAMES, "good"], TABLE)}}, tmp_path / "run")
    assert len(refused) == len(BAD_NAMES)
    for sentence, name in zip(refused, BAD_NAMES, strict=True):
        assert sentence.startswith(f"{node}: table {name!r:.80}")
    assert {path.rpartition("/")[2] for path in files} == {"good.parquet"}
    assert {path.name for path in tmp_path.iterdir()} == {"run"}


INVALID = ({"a": [1, 2], "b": [1]}, {"a": np.zeros((2, 2))}, [1, 2], {"a": 3}, {1: [1]}, {"a": [[1], [2, 3]]})


def test_an_invalid_table_is_refused_and_the_others_are_written(tmp_path: Path) -> None:
    tables = {f"bad{number}": table for number, table in enumerate(INVALID)}
    refused, files = written({"node": {"tables": tables | {"good": TABLE}, "n": 1}}, tmp_path / "run")
    assert [sentence.split(": ")[1] for sentence in refused] == [f"table {name}" for name in tables]
    assert files == {"results/node/good.parquet", "results/node/results.json"}


@pytest.mark.parametrize(
    ("results", "refusals", "expected"),
    [
        ({"..": {"metrics": METRICS}}, ["'..': expected a name"], set()),
        (
            {"evaluator": {"tables": [1], "metrics": METRICS}},
            ["evaluator: tables: found a list, expected a dict of tables"],
            {"metrics.json"},
        ),
        ({"evaluator": {"metrics": 3}}, [], {"results/evaluator/results.json"}),
        (
            {"evaluator": {"tables": {"mine": TABLE, "objects": TABLE}}},
            [],
            {"results/evaluator/mine.parquet", "objects.parquet"},
        ),
    ],
    ids=["a node's name leads outside", "tables are no dict", "metrics are no dict", "an unknown table"],
)
def test_results_in_another_form_are_refused_or_kept_as_they_are(
    tmp_path: Path, results: dict[str, Any], refusals: list[str], expected: set[str]
) -> None:
    refused, files = written(results, tmp_path / "run")
    assert [text.startswith(start) for text, start in zip(refused, refusals, strict=True)] == [True] * len(refusals)
    assert files == expected


def test_metrics_and_tables_of_another_node_do_not_replace_the_evaluators(tmp_path: Path) -> None:
    file, loaded = scenario.load(str(failing.write("second", tmp_path)), [])
    outcome = run.run(scenario.resolve(file, loaded, frames=5), tmp_path / "run", runtime="inproc")
    assert outcome.error is None
    assert read_json(outcome.folder / "metrics.json")["frames"] == 5
    assert "rmse_m" in read_table(outcome.folder / "metrics.parquet")
    own = outcome.folder / "results" / "counter"
    assert read_json(own / "results.json") == {"metrics": {"frames": "mine", "mean": None, "all": [*range(5)]}}
    assert read_table(own / "metrics.parquet")["frame"].tolist() == [*range(5)]
    assert not list(tmp_path.rglob("other.parquet"))
    (notice,) = (notice for notice in outcome.record["notices"] if notice["kind"] == "results")
    assert "other: table '../other'" in notice["text"]


@pytest.mark.parametrize(
    ("name", "setting", "node", "missing"),
    [
        ("hide_object", "near=[900,900]", "coordinator", "no target"),
        ("uncoordinated", "region=victim_only", "adversary_2", "no place for"),
    ],
)
def test_an_attack_without_targets_or_positions_is_reported(
    tmp_path: Path, name: str, setting: str, node: str, missing: str
) -> None:
    folder = run_alone(tmp_path / "run", name, setting, "attack_start_s=1.0", frames=30)
    counts = json.loads((folder / f"results/{node}/results.json").read_text())
    log = (folder / f"logs/{node}.log").read_text()
    assert missing in log
    if name == "hide_object":
        assert counts == {"selected": 0, "placed": 0, "wanted": 0}
    else:
        assert counts["placed"] < counts["wanted"]


def test_a_node_writes_at_most_a_hundred_tables_of_a_thousand_columns(tmp_path: Path) -> None:
    refused, files = written({"node": {"tables": {f"t{i}": {"a": [i]} for i in range(103)}}}, tmp_path / "many")
    assert refused == [
        f"node: table t{i}: found more than 100 tables, expected at most as many" for i in range(100, 103)
    ]
    assert len(files) == 100
    tables = {name: {f"c{i}": [i] for i in range(n)} for name, n in (("most", 1000), ("more", 1001))}
    refused, files = written({"node": {"tables": tables}}, tmp_path / "wide")
    assert refused == ["node: table more: found 1001 columns, expected 1 to 1000"]
    assert files == {"results/node/most.parquet"}


def test_a_node_that_hands_in_more_tables_than_a_node_has_keeps_no_more_files_open(tmp_path: Path) -> None:
    files = TableFiles(tmp_path)
    for number in range(1000):
        files.add("node", "process", TablePart(f"t{number}", number, {"a": np.arange(2)}))
    files.add("other", "process", TablePart("t", 0, {"a": np.arange(2)}))
    files.close()
    assert len(list((tmp_path / "results/node").iterdir())) == 100
    assert files.written >= {("other", "t")}
    assert len(files.refused) == 900
    assert files.problem is None


SPECS = {
    name: NodeSpec(role, "", "", {}, "continue")
    for name, role in (("rec", "recorder"), ("ego", "agent"), ("sim", "simulator"))
}


def noted(folder: Path, message: str, **recorded: Any) -> dict[str, Any]:
    """run.json after these nodes have returned what they recorded."""
    record: dict[str, Any] = {"message": message}
    conclusion.note_recording(folder, record, {name: {"recorded": counts} for name, counts in recorded.items()}, SPECS)
    return record


def test_recorded_counts_come_only_from_a_recorder_and_must_be_numbers(tmp_path: Path) -> None:
    valid: dict[str, int] = {"messages": 7, "lost": 0}
    for recorded in (valid, [1], "none", {"messages": "many"}, None):
        nothing = {"complete": False, "from_frame": 0}
        assert noted(tmp_path, "", ego=recorded, stranger=recorded) == {"message": "", "recording": nothing}
        counts = {"recorded": recorded} if recorded == valid else {}
        assert noted(tmp_path, "", rec=recorded) == {"message": "", "recording": {"complete": True}} | counts


def test_lost_messages_are_reported(tmp_path: Path) -> None:
    record = noted(tmp_path, "so far", rec={"messages": 7, "lost": 2})
    assert "2 messages could" in record["message"]
    assert record["recording"] == {"complete": False, "from_frame": 0}, "no recording exists here"


def test_one_long_text_does_not_widen_the_others(tmp_path: Path) -> None:
    texts = ["x" * 1_000_000, *[""] * 10_000]  # as a text array this takes 40 GB
    results = {"node": {"tables": {"t": {"a": texts}}, "plain": np.array(texts, object)}}
    tracemalloc.start()
    try:
        assert written(results, tmp_path / "run")[0] == []
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 64 << 20
    assert read_arrow(tmp_path / "run/results/node/t.parquet").num_rows == len(texts)


def test_completeness_in_real_time_is_measured_from_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node_results = {"rec": {"recorded": {"messages": 7, "lost": 0}}}
    for mode, gap, expected in (("realtime", 185, False), ("realtime", None, True), ("lockstep", 185, True)):
        monkeypatch.setattr(conclusion, "first_missing_frame", lambda folder, publisher, scans, gap=gap: gap)
        record: dict[str, Any] = {"message": "", "mode": mode}
        conclusion.note_recording(tmp_path, record, node_results, SPECS)
        assert record["recording"]["complete"] is expected


def test_only_one_of_two_runs_that_start_in_the_same_folder_gets_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other run creates its folders between our check and our creation."""
    (tmp_path / "logs").mkdir()
    monkeypatch.setattr(Path, "iterdir", lambda self: iter(()))
    with pytest.raises(RunFolderError, match="is not empty"):
        run_folder.create(tmp_path, "run")


MS = 1_000_000
SENT = {0: 0, 1: 100 * MS, 2: 200 * MS}


def wire(key: str, publisher: str, *subscribers: str) -> Wire:
    return Wire(key, "", "status", (Leg(key, Endpoint(publisher, "out"), ends(*subscribers)),))


def ends(*nodes: str) -> tuple[Endpoint, ...]:
    return tuple(Endpoint(node, "in") for node in nodes)


def came(key: str, *ms: float) -> dict[str, dict[int, int]]:
    """Arrival of each frame's message, ms after the frame was sent."""
    return {key: {frame: SENT[frame] + round(after * MS) for frame, after in enumerate(ms)}}


def test_percentiles_cover_frames_that_were_sent_and_received() -> None:
    percentiles = conclusion.percentiles(SENT, {0: 5 * MS, 2: 207 * MS, 9: 1})
    assert percentiles == {"p50": 6.0, "p95": pytest.approx(6.9), "p99": pytest.approx(6.98), "n": 2}
    assert conclusion.percentiles(SENT, {}) == {}


def test_latency_is_measured_at_the_first_subscriber_with_arrivals_or_else_at_the_first_listener() -> None:
    wiring = Wiring((wire("a/tracks", "a", "evaluator", "broker", "cc"), wire("b", "broker"), wire("c", "cc")))
    arrived = {"evaluator": came("a/tracks", 90.0), "broker": came("a/tracks", 3.0), "cc": came("a/tracks", 40.0)}
    assert conclusion.by_wire(wiring, SENT, arrived)["a/tracks"] == {"p50": 3.0, "p95": 3.0, "p99": 3.0, "n": 1}
    del arrived["broker"]
    assert conclusion.by_wire(wiring, SENT, arrived)["a/tracks"]["p50"] == 40.0, "it was killed and returned nothing"
    wiring = Wiring((wire("truth", "simulator", "evaluator", "watcher"), wire("dead", "x", "evaluator")))
    arrived = {"evaluator": came("truth", 7.0), "watcher": came("truth", 1.0), "recorder": came("dead", 1.0)}
    by_frame = conclusion.by_wire(wiring, SENT, arrived)
    assert {key: of["p50"] for key, of in by_frame.items()} == {"truth": 7.0}, "without arrivals there is none"


def test_latency_is_measured_after_interposers_on_trunk_and_branch() -> None:
    trunk = (
        Leg("a/tracks/@tap/0", Endpoint("a", "out"), ends("adversary")),
        Leg("a/tracks", Endpoint("adversary", "out"), ends("link", "evaluator")),
    )
    leg = Leg("a/tracks/@tap/broker", Endpoint("link", "out"), ends("broker"))
    branch = Branch(Endpoint("link", "in"), Endpoint("broker", "in"), (leg,))
    wiring = Wiring((Wire("a/tracks", "a", "tracks", trunk, (branch,)), wire("cc", "broker", "evaluator")))
    arrived = {
        "adversary": came("a/tracks/@tap/0", 1.0),
        "link": came("a/tracks", 2.0),
        "broker": came("a/tracks/@tap/broker", 30.0),
        "evaluator": came("a/tracks", 2.0),
    }
    assert conclusion.by_wire(wiring, SENT, arrived)["a/tracks"]["p50"] == 30.0


def test_the_picture_has_come_when_the_first_node_has_it_and_before_interposers() -> None:
    legs = (
        Leg("cc/picture/@tap/0", Endpoint("cc", "out"), ends("link", "evaluator")),
        Leg("cc/picture", Endpoint("link", "out"), ends("ego", "evaluator")),
    )
    arrived = {
        "evaluator": came("cc/picture/@tap/0", 9000.0, 5.0) | came("cc/picture", 9000.0, 600.0),  # it was scoring
        "link": came("cc/picture/@tap/0", 40.0, 6.0),
        "ego": came("cc/picture", 540.0, 506.0),
    }
    measured = conclusion.latency_ms(
        Wiring((Wire("cc/picture", "", "picture", legs, traits=Traits(estimate="picture")),)),
        {
            "simulator": {"sent_ns": SENT},
            **{node: {"arrived_ns": arrivals} for node, arrivals in arrived.items()},
        },
    )
    assert measured["sim_to_picture"] == {"p50": 22.5, "p95": pytest.approx(38.25), "p99": pytest.approx(39.65), "n": 2}
    assert measured["by_wire"]["cc/picture"]["p50"] == 523.0


def test_only_counts_of_brokers_are_collations_and_invalid_ones_are_ignored() -> None:
    assert late([{"late": {"infra_2": 3, "ego": 1}}, {"late": {"ego": 2}}]) == {"ego": 3, "infra_2": 3}
    assert late([]) == {}
    nodes = {name: NodeSpec(role, "", "", {}, "fail") for name, role in (("broker", "broker"), ("spy", "visualizer"))}
    counted = {"late": {"ego": 1}}
    handed_in = {"broker": {"collation": counted}, "spy": {"collation": 7}, "gone": {"collation": counted}}
    assert collations(handed_in, nodes) == [counted]
    assert collations({"broker": {"collation": "nonsense"}}, nodes) == []
    odd = {"late": [1], "overdue": "many", "complete": 3}
    assert collations({"broker": {"collation": odd}}, nodes) == [{"complete": 3, "late": {}}]
    for value in ({"a": -1}, {"a\nb": 1}, {"a": True}, {"a": 1.5}, [1], None):
        assert results.counts_of(value) == {}
