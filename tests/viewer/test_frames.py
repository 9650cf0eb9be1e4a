"""Frames of a run hold what was recorded, and what the evaluator found about it."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from plain_record import PlainRecord, assert_same_boxes
from pyarrow import parquet

import mast_zenoh as mast
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch import liveness
from mast_zenoh.metrics.record import Series
from mast_zenoh.metrics.scores import UNEVALUATED
from mast_zenoh.run_folder.recording.reader import Recorded, read
from mast_zenoh.runs import recorded as recordings
from mast_zenoh.runs.evaluated import Outcomes
from mast_zenoh.runs.recorded import frames_of, open_recorded
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.show.export.columns import stem
from mast_zenoh.wiring.model import Wiring


@pytest.fixture(scope="module")
def run(recorded: mast.Run) -> Run:
    return open_recorded(recorded.path)


@pytest.fixture
def copy(recorded: mast.Run, tmp_path: Path) -> Path:
    """A copy of the run folder, to damage."""
    return Path(shutil.copytree(recorded.path, tmp_path / "copy"))


def test_every_frame_has_the_recorded_objects_of_every_estimate(run: Run, record: PlainRecord) -> None:
    frames = list(frames_of(run))
    assert [frame.index for frame in frames] == record.frames
    assert {stem(series): topic for series, topic in run.topics.items()} == record.topics
    for series in run.topics:
        found = {}
        for frame in frames:
            states = frame.objects[series]
            found[frame.index] = states.id, np.column_stack([states.position, states.size, states.yaw])
        assert_same_boxes(found, record.boxes[stem(series)], 0.0)


def test_estimates_as_received_are_there_only_for_intercepted_wires(run: Run) -> None:
    assert {series.agent for series in run.topics if series.estimator == "received"} == {"infra_1", "infra_2"}
    inserted = [frame for frame in frames_of(run) if "inserted" in frame.changes.effect]
    assert inserted
    for frame in inserted:
        received, local = (frame.objects[Series("infra_1", name)] for name in ("received", "local"))
        assert set(local.id.tolist()) <= set(received.id.tolist())


def test_outcomes_are_those_of_the_evaluator(recorded: mast.Run, run: Run) -> None:
    judged: dict[tuple[int, str, str, str], dict[int, tuple[str, int]]] = {}
    for row in recorded.objects.to_pylist():
        place = row["frame"], row["agent"], row["estimator"], row["kind"]
        judged.setdefault(place, {})[row["id"]] = row["outcome"], row["match_id"]
    for frame in frames_of(run):
        for series in run.topics:
            agent, estimator = series.agent or "ego", "picture" if series == TRUTH else series.estimator
            kinds = {"truth": (frame.objects[TRUTH], frame.truth_outcomes[series])}
            if series != TRUTH:
                kinds["track"] = frame.objects[series], frame.outcomes[series]
            for kind, (states, outcomes) in kinds.items():
                found = dict(zip(states.id.tolist(), zip(*outcomes_of(outcomes), strict=True), strict=True))
                expected = judged.get((frame.index, agent, estimator, kind), {})
                assert found == dict.fromkeys(found, ("unevaluated", -1)) | expected
        assert frame.outcomes[TRUTH].names == frame.truth_outcomes[Series("", "picture")].names


def outcomes_of(outcomes: Outcomes) -> tuple[list[str], list[int]]:
    return outcomes.names, outcomes.match_id.tolist()


def test_scores_and_poses_are_those_of_the_run(recorded: mast.Run, run: Run, record: PlainRecord) -> None:
    rows = {(row["frame"], row["agent"], row["estimator"]): row for row in recorded.metrics.to_pylist()}
    for frame in frames_of(run):
        for (agent, estimator), score in frame.scores.items():
            row = rows[frame.index, agent, estimator]
            assert (score.fn, score.fp, score.tp) == (row["fn"], row["fp"], row["tp"])
        for agent in run.agents:
            assert frame.poses[agent].position.tolist() == record.poses[agent][frame.index][0].tolist()
    assert run.agents[0] == run.ego == "ego"


def test_a_wire_that_is_intercepted_later_has_the_estimate_as_received_from_then_on(
    recorded: mast.Run, record: PlainRecord, run: Run
) -> None:
    """The same recording, as if the adversaries had come after frame 14, and sent their own tracks before."""
    attacked = json.loads((recorded.path / "wiring.json").read_text())
    free = json.loads(json.dumps(attacked))
    for wire in free["wires"]:
        wire["legs"] = [wire["legs"][0] | {"key": wire["key"], "to": wire["legs"][-1]["to"]}]
    later = open_recorded(recorded.path)
    later.files.wirings = [(-1, Wiring.from_json(free)), (14, Wiring.from_json(attacked))]
    local, received = Series("infra_1", "local"), Series("infra_1", "received")
    for frame in frames_of(later):
        sent = record.boxes["infra_1.received" if frame.index <= 14 else "infra_1.local"][frame.index]
        assert sorted(frame.objects[local].id.tolist()) == sent.number.tolist()
        assert (received in frame.objects) == (frame.index > 14)


@pytest.mark.parametrize(
    ("name", "lack"),
    [
        ("objects.parquet", "no outcomes of objects, no bird's-eye and camera views."),
        ("metrics.parquet", "no counts over time."),
        ("attacks.parquet", "what interposers changed is not marked."),
        ("scene.npz", "no buildings, agents and camera view in the pictures."),
    ],
)
@pytest.mark.parametrize("damage", ["absent", "damaged", "of another version"])
def test_an_absent_or_damaged_table_is_named_with_its_consequence(
    copy: Path, name: str, lack: str, damage: str
) -> None:
    (copy / name).unlink()
    if damage == "damaged":
        (copy / name).write_bytes(b"damaged")
    elif damage == "of another version":
        parquet.write_table(pyarrow.table({"frame": [0]}), copy / name)
    run = open_recorded(copy)
    assert len(list(frames_of(run))) == 30
    (sentence,) = run.files.missing
    assert sentence.startswith(f"{name} is absent" if damage == "absent" else f"{name} cannot be read")
    assert ("found no column" in sentence) == (damage == "of another version" and name.endswith(".parquet"))
    assert sentence.endswith(lack)


@pytest.mark.parametrize(
    ("name", "column", "found"),
    [
        ("outcome", lambda n: pyarrow.array(["correct"] * n).dictionary_encode(), "correct"),
        ("kind", lambda n: pyarrow.array([1] * n), "int64"),
        ("id", lambda n: pyarrow.array([0.5] * n), "double"),
        ("match_id", lambda n: pyarrow.array([None] * n, pyarrow.int64()), "missing"),
        ("cause", lambda n: pyarrow.array([None] * n, pyarrow.string()).dictionary_encode(), "missing"),
        ("frame", lambda n: pyarrow.array([*range(20)] * (n // 20) + [10**6] * (n % 20 or 1))[-n:], "1000000"),
    ],
)
def test_outcomes_that_no_evaluator_writes_are_not_shown(copy: Path, name: str, column: Any, found: str) -> None:
    table = parquet.read_table(copy / "objects.parquet")
    table = table.set_column(table.column_names.index(name), name, column(len(table)))
    parquet.write_table(table, copy / "objects.parquet")
    run = open_recorded(copy)
    assert run.files.all_objects is None
    assert {code for frame in frames_of(run) for each in frame.outcomes.values() for code in each.code} == {UNEVALUATED}
    (sentence,) = run.files.missing
    assert f"column {name}: found" in sentence
    assert found in sentence


def test_a_recording_that_was_cut_off_gives_its_whole_frames_and_says_so(copy: Path) -> None:
    file = copy / "messages.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 9 // 10])
    run = open_recorded(copy)
    count = len(list(frames_of(run)))
    assert 0 < count < 30
    (missing,) = run.files.missing
    assert f"messages.mcap: the recording ends at frame {count - 1} of 30" in missing
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(RunFolderError, match="no whole frame"):
        list(frames_of(open_recorded(copy)))


def test_a_run_in_progress_is_refused_and_a_failed_one_is_named(copy: Path) -> None:
    record = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(record | {"status": "running", "launcher": liveness.identity()}))
    with pytest.raises(RunFolderError, match="still in progress"):
        open_recorded(copy)
    (copy / "run.json").write_text(json.dumps(record | {"status": "running", "launcher": {"machine": "another"}}))
    assert "cannot be known" in open_recorded(copy).files.missing[0]
    (copy / "run.json").write_text(json.dumps(record | {"status": "stalled", "message": "waited for ego"}))
    assert "stalled: waited for" in open_recorded(copy).files.missing[0]


def test_what_is_no_recorded_run_is_refused(copy: Path, tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="no such folder"):
        open_recorded(tmp_path / "nothing")
    with pytest.raises(RunFolderError, match=r"folder.*run"):
        open_recorded(copy / "messages.mcap")
    (copy / "run.json").write_text("[]")
    with pytest.raises(RunFolderError, match=r"run\.json.*object"):
        open_recorded(copy)


def test_an_invalid_message_is_left_out_and_counted(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def spoilt(path: Path) -> Iterator[Recorded]:
        for message in read(path):
            invalid = message.wire == "cc/picture" and message.frame == 7
            yield replace(message, payload=message.payload[:-1]) if invalid else message

    monkeypatch.setattr(recordings, "read", spoilt)
    run = open_recorded(copy)
    assert [frame.index for frame in frames_of(run) if Series("", "picture") not in frame.objects] == [7]
    (missing,) = run.files.missing
    assert missing.startswith("messages.mcap: invalid")
    assert missing.endswith(": 1")
