"""A malformed control message costs one message and does not affect the run."""

import hashlib
import hmac
import os
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
import pytest
import zenoh
from damage import malformed_payloads
from equal_runs import assert_equal
from held_back import allow, resolved
from launched import Launched, Observer, eventually
from sound_controls import CODECS, packed
from test_flood import LIMIT_MB, peak_mb

from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.live_interception import SECRET_FILE
from mast_zenoh.mesh.control import CONTROLS

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

TOTAL, TOTAL_LONG = 1_000, 50_000
FRAMES = 20
AWAY = "infra_1"  # leaves and returns; its first process takes its counters with it
STRANGER = "nobody"
SCENARIO = f"""
from mast_zenoh import scenario as scenarios



def scenario():
    _, loaded = scenarios.load("coordinated", ["n_infrastructure=2", "attack_start_s=0.3"])
    loaded["faults"] = [dict(type="Leave", node={AWAY!r}, at=0.8, return_after=0.6)]
    return loaded | dict(run=dict(mode="lockstep", seed=3, frames={FRAMES}))
"""
QUERIES = ("result", "fetch", "file", "drain", "rewire", "intercept")
MAX_UNANSWERED = 20  # the sender waits for the nodes: a link that is full for 10 s counts as lost
MAX_OVERSIZED = 5 << 20  # bytes


class Target(NamedTuple):
    """A control key, examples of its messages, and a final change of the bytes."""

    key: str
    examples: tuple[str, ...]
    wrap: Callable[[bytes], bytes] = bytes

    @property
    def kind(self) -> str:
        """As in CONTROLS, except that `leave` is treated like `stop`."""
        return self.key.partition("/")[0]

    def payloads(self, seed: tuple[int, ...]) -> Iterator[bytes]:
        """Endless malformed messages: one that is too long, then of one example after the other."""
        made = [
            malformed_payloads([CODECS[name][1]], CODECS[name][0], (*seed, number))
            for number, name in enumerate(self.examples)
        ]
        damaged = (payload for several in zip(*made, strict=True) for payload in several)
        size = CONTROLS[self.kind].max_bytes
        return map(self.wrap, chain([bytes(size + 1)] if size <= MAX_OVERSIZED else [], damaged))


def targets(nodes: list[str], secret: bytes) -> list[Target]:
    """Every control key that has a receiver, and the keys of an absent node."""

    def sealed(body: bytes) -> bytes:
        return packed([body, hmac.digest(secret, body, hashlib.sha256)])

    common = [
        Target("epoch", ("epoch", "epoch with a wiring")),
        *(Target(key, (key,)) for key in ("stop", "act", "rewire")),
        Target("intercept", ("sealed",)),
        Target("intercept", ("intercept", "release"), sealed),
    ]
    of_nodes = [
        (
            Target(f"counts/{node}", ("counts",)),
            Target(f"failed/{node}", ("failed",)),
            Target(f"result/{node}", ("driver's result" if node == "simulator" else "result",)),
            Target(f"fetch/{node}", ("join", "clock", "piece")),
            Target(f"file/{node}", ("file",)),
        )
        for node in (*nodes, STRANGER)
    ]
    to_nodes = [(Target(f"leave/{node}", ("stop",)), Target(f"drain/{node}", ("drain",))) for node in nodes]
    return [*common, *chain(*of_nodes, *to_nodes)]


class Sender:
    """A client on a run's mesh that sends malformed messages.

    sent: number of messages by control key;  targets: what it sends to
    """

    def __init__(self, run: Launched, seed: int) -> None:
        self.observer = Observer(run.record(), "clock")
        self.nodes = sorted(run.record()["nodes"])
        self.sent: Counter[str] = Counter()
        self._unanswered = threading.Semaphore(MAX_UNANSWERED)
        self._rng = np.random.default_rng((seed, 0))
        self.targets = targets(self.nodes, (run.out / SECRET_FILE).read_bytes())
        self._payloads = [target.payloads((seed, 1 + number)) for number, target in enumerate(self.targets)]
        self._order: list[int] = []

    def send(self) -> None:
        """Send one message to a random target; all targets get equally many."""
        self._order = self._order or list(self._rng.permutation(len(self.targets)))
        number = self._order.pop()
        self._send(self.targets[number], next(self._payloads[number]))

    def settle(self) -> None:
        """Wait until everything sent has been handled: drains are answered in order."""
        for number, target in enumerate(self.targets):
            if target.kind == "drain":
                self._send(target, next(self._payloads[number]))
        for _ in range(MAX_UNANSWERED):
            assert self._unanswered.acquire(timeout=60.0), "every query is answered or refused"

    def _send(self, target: Target, payload: bytes) -> None:
        self.sent[target.key] += 1
        key, session = f"{self.observer.prefix}@control/{target.key}", self.observer.session
        if target.kind not in QUERIES:
            session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
            return
        assert self._unanswered.acquire(timeout=60.0), "queries are answered or refused"
        answered: Any = zenoh.handlers.Callback(lambda reply: None, self._unanswered.release, indirect=False)
        session.get(key, answered, payload=payload, timeout=60.0, congestion_control=zenoh.CongestionControl.BLOCK)


@pytest.fixture
def begin(start: Callable[..., Launched], tmp_path: Path) -> Callable[[int], Launched]:
    """Starts the run, allowing this many frames."""
    (tmp_path / "fuzzed.py").write_text(SCENARIO)

    def launch(frames: int) -> Launched:
        path = os.pathsep.join(sys.path)
        script = Path(__file__).parent / "held_back.py"
        allow(tmp_path / "run_0", frames)
        return start(sys.executable, str(script), str(tmp_path / "fuzzed.py"), PYTHONPATH=path)

    return launch


def ended_as_if_nothing_had_been(run: Launched, tmp_path: Path) -> dict[str, Any]:
    """Assert that a run ended like its twin, without traceback; returns run.json."""
    code, output = run.end()
    logs = output + "".join(path.read_text() for path in (run.out / "logs").iterdir())
    assert code == 0, logs
    assert "Traceback" not in logs
    assert "panicked" not in logs
    twin = launcher.run(resolved(str(tmp_path / "fuzzed.py")), tmp_path / "twin", runtime="inproc")
    assert twin.error is None
    assert_equal(twin.folder, run.out)
    record = run.record()
    assert record["status"] == "ok"
    assert all(node["ended"].endswith("ok") and not node["failures"] for node in record["nodes"].values())
    return record


def refused(invalid: dict[str, list[Any]]) -> dict[str, int]:
    """Refused messages by key, from run.json."""
    return {key: count for key, (count, _) in invalid.items()}


def test_each_malformed_control_message_is_refused_and_counted_once_per_receiver(begin, tmp_path, fuzzing) -> None:
    total = fuzzing.draws(TOTAL, TOTAL_LONG)
    run = begin(2)
    run.started()
    sender = Sender(run, fuzzing.seed)
    try:
        run.until(lambda: sender.observer.frame() >= 2, "all nodes take part")
        for number in range(total):
            frames = 2 + number * (FRAMES - 2) // total  # all but the last
            if frames > sender.observer.frame():
                allow(run.out, frames)
                run.until(lambda: sender.observer.frame() >= frames, f"frame {frames}")  # noqa: B023
            sender.send()
        sender.settle()
        processes = [run.process.pid, *(child.pid for child in psutil.Process(run.process.pid).children())]
        peaks = {pid: peak_mb(pid) for pid in processes}
        allow(run.out, FRAMES + 1)  # and messages after the last
        record = ended_as_if_nothing_had_been(run, tmp_path)
    finally:
        sender.observer.close()
    assert len(peaks) == 1 + len(sender.nodes)
    assert {pid: mb for pid, mb in peaks.items() if mb > LIMIT_MB} == {}

    # A message to all nodes is counted by each on its own key; any other by its one receiver.
    expected: dict[str, dict[str, int]] = {node: {} for node in [*sender.nodes, ""]}  # "": the launcher
    for key, n in sender.sent.items():
        kind, _, node = key.partition("/")
        if kind in ("epoch", "stop"):
            receivers = sender.nodes
        elif kind in ("leave", "drain"):
            receivers = [node]
        else:
            receivers = ["simulator"] if kind in ("counts", "rewire") else [""]
        for receiver in receivers:
            expected[receiver][f"{kind}/*" if node == STRANGER else key] = n
    counted = {name: refused(node["invalid_control"]) for name, node in record["nodes"].items()}
    counted[""] = refused(record["invalid_control"])
    away, sent_away = counted.pop(AWAY), expected.pop(AWAY)
    assert away
    assert all(n <= sent_away[key] for key, n in away.items())
    places = {(name, key) for each in (counted, expected) for name in each for key in each[name]}
    both = {(name, key): (counted[name].get(key), expected[name].get(key)) for name, key in places}
    assert {place: pair for place, pair in both.items() if pair[0] != pair[1]} == {}, "(counted, sent)"


def test_malformed_control_messages_until_the_end_cost_no_valid_one(begin, tmp_path, fuzzing) -> None:
    run = begin(1)
    run.started()
    sender = Sender(run, fuzzing.seed)
    over = threading.Event()

    def send() -> None:
        while not over.is_set():
            sender.send()

    thread = threading.Thread(target=send)
    thread.start()
    try:
        eventually(lambda: len(sender.sent) == len({target.key for target in sender.targets}), "something on every key")
        allow(run.out, FRAMES + 1)
        eventually(lambda: run.process.poll() is not None, "the run has ended")
    finally:
        over.set()
        thread.join()
        sender.observer.close()
    record = ended_as_if_nothing_had_been(run, tmp_path)
    assert record["invalid_control"]
    assert all(node["invalid_control"] for node in record["nodes"].values())
