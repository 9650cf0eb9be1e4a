"""In lock-step a suspended node is waited for; a lost one fails the run."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from equal_runs import assert_equal, run_alone
from launched import MAST, Launched

from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder.recording.difference import compare
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

FRAMES = ("--frames", "100")  # the recorder writes 25 at a time


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Path:
    """The same run in one process."""
    return run_alone(tmp_path_factory.mktemp("undisturbed") / "run", "baseline", frames=100, record=True)


def at_frame(run: Launched, frame: int) -> dict:
    """run.json of a run of which a frame is recorded."""
    record = run.started()
    run.until(lambda: recorded_frame(run.out) >= frame, f"frame {frame} is recorded")
    return record


def recorded_frame(folder: Path) -> int:
    """The newest frame in a growing recording; -1 for none."""
    try:
        return max((message.frame for message in read(folder)), default=-1)
    except RunFolderError:
        return -1


def test_nodes_suspended_with_full_queues_for_longer_than_any_lease_are_waited_for(launch, tmp_path: Path) -> None:
    """Zenoh's default closes a link on which a message has waited for 5 s."""
    run: Launched = launch("baseline", "--set", "n_infrastructure=12", "--frames", "40")
    nodes = at_frame(run, 1)["nodes"]
    victims = [nodes[name]["pid"] for name in ("recorder", "command_center")]
    for pid in victims:
        os.kill(pid, signal.SIGSTOP)
    with pytest.raises(subprocess.TimeoutExpired):  # the other nodes wait for them
        run.process.wait(7.0)
    for pid in victims:
        os.kill(pid, signal.SIGCONT)
    run.ended()
    assert run.record()["churn"] == []
    assert_equal(run.out, run_alone(tmp_path / "twin", "baseline", "n_infrastructure=12", frames=40, record=True))


def test_a_node_lost_in_lock_step_fails_the_run_by_name(launch, undisturbed: Path) -> None:
    run: Launched = launch("baseline", *FRAMES)
    os.kill(at_frame(run, 15)["nodes"]["infra_2"]["pid"], signal.SIGKILL)
    output = run.ended(33)
    record = run.record()
    (lost,) = record["churn"]
    assert record["status"] == "node_lost"
    assert (lost["node"], lost["what"]) == ("infra_2", "lost")
    assert f"infra_2 was lost before frame {lost['frame']}" in output
    assert "--allow-churn" in output
    assert json.loads((run.out / "metrics.json").read_text())["frames"] == 100, "earlier results are kept"
    process = subprocess.run(
        [*MAST, "diff", str(run.out), str(undisturbed)], capture_output=True, text=True, check=False
    )
    assert process.returncode == 2
    assert f"not comparable from frame {lost['frame'] - 1} onwards: infra_2 was lost" in process.stdout + process.stderr
    subprocess.run([*MAST, "report", str(run.out)], check=True, capture_output=True)
    assert "infra_2 was lost" in (run.out / "report.html").read_text()


def test_a_recording_that_lost_its_recorder_is_marked_incomplete(launch, undisturbed: Path) -> None:
    run: Launched = launch("baseline", *FRAMES)
    os.kill(at_frame(run, 15)["nodes"]["recorder"]["pid"], signal.SIGKILL)
    output = run.ended(22)
    assert run.record()["status"] == "failed"
    assert "recorder killed by signal 9" in output
    assert (run.out / "metrics.json").is_file(), "the results of the other nodes are kept"
    from_frame = run.record()["recording"]["from_frame"]
    assert run.record()["recording"] == {"complete": False, "from_frame": from_frame}
    assert f"the recording is incomplete from frame {from_frame} on" in output.replace("\n", " ")
    assert compare(run.out, undisturbed, before=from_frame).first is None, "nothing earlier is missing"
    assert compare(run.out, undisturbed).first is not None
    process = subprocess.run(
        [*MAST, "diff", str(run.out), str(undisturbed)], capture_output=True, text=True, check=False
    )
    assert process.returncode == 2
    assert f"not comparable from frame {from_frame} onwards: the recording of" in process.stderr.replace("\n", " ")
