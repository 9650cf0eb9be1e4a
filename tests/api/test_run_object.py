"""A run object gives access to its folder, during the run and afterwards."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.launch import liveness
from mast_zenoh.runs import messages as recorded
from mast_zenoh.scenes.recording import Recording

BOX = ["x", "y", "z", "vx", "vy", "vz", "l", "w", "h", "yaw"]


@pytest.mark.parametrize("name", ["metrics", "objects", "attacks", "targets", "driving"])
def test_a_table_equals_its_file(name: str, attacked: mast.Run) -> None:
    table = getattr(attacked, name)
    assert table.equals(parquet.read_table(attacked.path / f"{name}.parquet"))
    assert table.num_rows


def test_columns_have_units_and_tables_become_data_frames_where_pandas_is_installed(attacked: mast.Run) -> None:
    schema = attacked.picture.schema
    units = {name: (schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in schema.names}
    names = ("time_s", "x", "l", "vx", "yaw", "id", "score")
    assert [units[name] for name in names] == ["s", "m", "m", "m/s", "rad", "", ""]
    pytest.importorskip("pandas")
    frame = attacked.metrics.to_pandas()
    assert (frame[frame.estimator == "picture"].fp > 0).any()


def test_messages_are_selected_by_wire_and_ordered_by_frame(attacked: mast.Run) -> None:
    messages = list(attacked.messages("agent/*/tracks"))
    assert {message.wire for message in messages} == {f"agent/{name}/tracks" for name in attacked.agents}
    assert {message.type for message in messages} == {"tracks"}
    assert [message.frame for message in messages] == sorted(message.frame for message in messages)
    assert len(messages) == 60 * 3
    last = messages[-1]
    assert last["position"].shape == (len(last["id"]), 3)
    assert "agent/infra_2/tracks, frame 59" in repr(last)
    assert last.columns is last.body, "by their former name"
    with pytest.raises(ConfigurationError, match=r"matches 'agent/ego/trakcs'.*'agent/ego/t"):
        list(attacked.messages("agent/ego/trakcs"))


def test_the_truth_equals_the_scenes_truth(attacked: mast.Run) -> None:
    truth = attacked.truth
    assert truth.column_names == ["frame", "time_s", "id", "class", *BOX, "points"]
    recording = Recording.load(attacked.path / "scene.npz")
    for frame in (0, 30, 59):
        rows = truth.filter(np.asarray(truth["frame"]) == frame)
        there = recording.truth_at(frame)
        order = np.argsort(there.id)
        by_id = np.argsort(np.asarray(rows["id"]))
        np.testing.assert_array_equal(np.asarray(rows["x"])[by_id], there.position[order, 0])
        np.testing.assert_array_equal(np.asarray(rows["yaw"])[by_id], there.yaw[order])
        np.testing.assert_allclose(rows["time_s"], frame * 0.1)


def test_the_picture_and_the_tracks_are_near_the_truth(baseline: mast.Run) -> None:
    truth = baseline.truth.filter(np.asarray(baseline.truth["frame"]) == 50)
    there = np.stack([truth["x"], truth["y"]], axis=1)
    for table in (baseline.picture, baseline.agent("infra_1").tracks, baseline.agent("ego").mission):
        rows = table.filter(np.asarray(table["frame"]) == 50)
        here = np.stack([rows["x"], rows["y"]], axis=1)
        assert len(here) > 3
        nearest = np.linalg.norm(here[:, None] - there, axis=2).min(axis=1)
        assert np.median(nearest) < 1.0, "in the world frame, even for an agent whose sensor is not at its origin"


def test_tables_of_several_wires_equal_those_of_all_messages(attacked: mast.Run) -> None:
    wires = [f"agent/{agent}/tracks" for agent in attacked.agents]
    tables = recorded.tables_of(attacked.path, [*wires, "agent/nobody/tracks"], recorded.states)
    for wire in wires:
        messages = list(attacked.messages(wire))
        assert tables[wire].equals(
            recorded.table((each.frame, each.time_s, recorded.states(each.body)) for each in messages)
        )
        assert len(set(tables[wire]["frame"].to_pylist())) > 10
    assert tables["agent/nobody/tracks"].num_rows == 0


def test_an_agent_has_its_detections_and_its_pose(baseline: mast.Run) -> None:
    assert baseline.agents == ("ego", "infra_1", "infra_2")
    ego = baseline.agent("ego")
    assert ego.detections.column_names == ["frame", "time_s", "class", "x", "y", "z", "l", "w", "h", "yaw", "score"]
    assert ego.pose.num_rows == 60
    speed = np.hypot(ego.pose["vx"], ego.pose["vy"])
    moved = np.hypot(np.diff(ego.pose["x"]), np.diff(ego.pose["y"])) / 0.1
    np.testing.assert_allclose(moved, speed[:-1], atol=0.5)
    with pytest.raises(ConfigurationError, match="mean 'infra_1'"):
        baseline.agent("infra_11")


def test_taps_hold_messages_as_sent_before_an_adversary_changed_them(attacked: mast.Run) -> None:
    wire = "agent/infra_1/detections"
    assert not any(message.tap for message in attacked.messages(wire))
    both = list(attacked.messages(wire, taps=True))
    sent, received = ([len(m["yaw"]) for m in both if m.tap is tap and m.frame > 30] for tap in (True, False))
    assert len(sent) == len(received) == 29
    assert sent != received


def test_a_missing_table_is_named_in_the_error(attacked: mast.Run, tmp_path: Path) -> None:
    shutil.copytree(attacked.path, tmp_path / "run")
    for name in ("targets.parquet", "messages.mcap", "metrics.parquet"):
        (tmp_path / "run" / name).unlink()
    run = mast.open(tmp_path / "run")
    with pytest.raises(RunFolderError, match=r"targets\.parquet: missing.*run"):
        _ = run.targets
    with pytest.raises(RunFolderError, match=r"run\.json counts.*messages"):
        _ = run.truth
    with pytest.raises(RunFolderError, match=r"metrics\.parquet is absent"):
        run.plot.over_time("fp")


def test_an_unfinished_run_is_read_as_far_as_it_has_been_recorded(attacked: mast.Run, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(attacked.path, folder)
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"status": "running", "launcher": liveness.identity()}))
    content = (folder / "messages.mcap").read_bytes()
    (folder / "messages.mcap").write_bytes(content[: len(content) // 2])
    for name in ("metrics.parquet", "metrics.json"):
        (folder / name).unlink()
    run = mast.open(folder)
    assert run.running
    assert 5 < max(run.truth["frame"].to_pylist()) < 55
    with pytest.raises(RunFolderError, match=r"still.*progress.*writes"):
        _ = run.metrics
    assert "running" in repr(run)
    assert "running" in run._repr_html_()
    (folder / "run.json").write_text(json.dumps(record))
    shutil.copy(attacked.path / "metrics.parquet", folder)
    assert not run.running
    assert run.metrics.num_rows
    assert run.plot.over_time("fp").axes


def test_the_repr_of_a_run_is_one_line(attacked: mast.Run) -> None:
    assert repr(attacked).startswith("<Run uncoordinated-")
    assert "seed 3, inproc" in repr(attacked)
    assert "common picture" in attacked.headline
    assert attacked.headline in attacked._repr_html_()
    assert [each.kind for each in attacked.findings[:2]] == ["adversaries", "change"]
    assert attacked.name == "uncoordinated"
    assert attacked.summary["frames"] == 60
