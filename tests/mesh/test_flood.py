"""A flood of large messages uses a bounded amount of memory."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from launched import Launched, Observer, eventually

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.mesh.protocol.traffic import stamp
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header

pytestmark = pytest.mark.mesh
MESSAGES, LAST = 30, 149
LIMIT_MB = 400


def peak_mb(pid: int) -> float:
    """The peak memory of a process, MB."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1000


def tracks_of(source: str) -> bytes:
    """Valid tracks of 15 MB about the last frame of the run."""
    n = 20_000
    states = ObjectStates.of(np.zeros((n, 3)), id=np.arange(n), covariance=np.tile(np.eye(9), (n, 1, 1)))
    reference = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    header = Header("tracks", source, LAST, LAST * 10**8, 0)
    return codec.encode(codec.conform(header, states.columns() | reference))


@pytest.mark.heavy
def test_messages_waiting_for_a_clock_or_an_epoch_use_bounded_memory(launch) -> None:
    # Within the limits on rows, so that the messages are kept whole.
    limits = ("--set", "run.max_rows=20000", "--set", 'broker.input_limit={"type": "NoInputLimit"}')
    run: Launched = launch("baseline", "--mode", "realtime", "--no-record", "--rate", "0.3", *limits)
    with closing(Observer(run.started(), "clock")) as observer:
        eventually(lambda: observer.frame() > 3, "frames are played")
        flood = observer.publisher("agent/infra_1/tracks")
        payload = tracks_of("infra_1")
        for number in range(MESSAGES):
            flood.put(payload, attachment=stamp("agent/infra_1/tracks", 1 + number % 2, LAST))
        after = observer.frame()
        eventually(lambda: observer.frame() > after + 5, "all messages have arrived")
        peaks = {name: peak_mb(node["pid"]) for name, node in run.record()["nodes"].items()}
    output = run.interrupted()
    assert {name: mb for name, mb in peaks.items() if mb > LIMIT_MB} == {}
    nodes = run.record()["nodes"]
    assert all(node["ended"] == "ok" and not node["failures"] for node in nodes.values())
    dropped = {place.rpartition(": ")[2]: n for place, n in nodes["broker"]["rejected"].items()}
    assert sum(dropped.values()) >= MESSAGES - 10
    assert dropped.keys() <= {"held", "early", "queued"}
    assert "rejected: " in output
