"""Error messages and run.json about lost nodes."""

import json

import pytest

from mast_zenoh.errors import NodeLost, RunFolderError
from mast_zenoh.run_folder.recording import churn
from mast_zenoh.run_folder.recording.churn import comparable

EVENTS = [
    {"frame": 40, "node": "infra_2", "what": "lost"},
    {"frame": 52, "node": "infra_2", "what": "back"},
    {"frame": 60, "node": "recorder", "what": "lost"},
]


def test_the_error_names_nodes_frames_and_the_option_that_allows_churn():
    error = churn.error(EVENTS)
    assert isinstance(error, NodeLost)
    description = (
        "infra_2 was lost before frame 40; infra_2 came back before frame 52; recorder was lost before frame 60"
    )
    assert str(error).startswith(description)
    assert "--allow-churn" in str(error)


def test_a_lost_node_may_also_have_missed_the_previous_frame():
    assert churn.first_frames(EVENTS, "recorder") == [59]
    assert churn.first_frames(EVENTS, "infra_2") == [39, 51]
    assert churn.first_frames(EVENTS, "ego") == []


@pytest.mark.parametrize("from_frame", [12, 59])
def test_runs_are_not_comparable_after_a_gap_in_a_recording_also_where_a_node_was_lost(tmp_path, from_frame):
    record = {"churn": EVENTS[2:], "recording": {"complete": False, "from_frame": from_frame}}
    (tmp_path / "run.json").write_text(json.dumps(record))
    assert comparable(tmp_path) == (from_frame, f"the recording of {tmp_path} is incomplete")


def test_runs_are_comparable_up_to_the_first_loss_in_either(tmp_path):
    for name, events in (("a", EVENTS[2:]), ("b", EVENTS), ("c", [])):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text(json.dumps({"churn": events}))
    assert comparable(tmp_path / "c", tmp_path / "messages.mcap") == (None, "")
    frame, why = comparable(tmp_path / "a", tmp_path / "b")
    assert frame == 39, "the previous frame may not have been finished"
    assert f"lost in {tmp_path / 'b'}" in why


@pytest.mark.parametrize("content", ["{", "[1]", '{"churn": [1]}', '{"churn": [{}]}', '{"churn": 7}'])
def test_a_damaged_run_json_raises_its_own_error(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(RunFolderError, match=r"run\.json"):
        comparable(tmp_path)
