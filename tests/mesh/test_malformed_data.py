"""Arbitrary messages on an open mesh cost one message each."""

import itertools
import json
import random
from collections import Counter
from contextlib import closing

import pytest
from launched import Launched, Observer, eventually

from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.wiring.model import Wiring

pytestmark = pytest.mark.mesh
MESSAGES = 100_000


def garbage(count: int) -> list[bytes]:
    """Bytes that are not messages: random, empty, truncated, oversized maps."""
    rng = random.Random(5)
    return [
        b"",
        b"\xc1",
        b"\x80",
        b"\xdf\xff\xff\xff\xff",
        *(rng.randbytes(rng.randrange(1, 200)) for _ in range(count)),
    ]


@pytest.mark.heavy
def test_a_hundred_thousand_malformed_messages_are_counted_and_end_no_node(launch) -> None:
    # At a tenth of its speed, the run lasts longer than the flood.
    run: Launched = launch(
        "coordinated", "--mode", "realtime", "--rate", "0.1", "--set", "scene_index=1", "--no-record"
    )
    with closing(Observer(run.started(), "clock")) as observer:
        eventually(lambda: observer.frame() > 3, "frames are played")
        wiring = Wiring.from_json(json.loads((run.out / "wiring.json").read_text()))
        hearers = {leg.key: len(leg.subscribers) for _, leg in wiring.legs()}
        sent = dict.fromkeys(hearers, 0)
        payloads = itertools.cycle(garbage(500))
        publishers = {key: observer.publisher(key) for key in hearers}

        def put(key: str) -> None:
            publishers[key].put(next(payloads))
            sent[key] += 1

        # A node logs the first malformed message of a key, after all that arrived before it. So a key that was not
        # flooded yet shows how far the evaluator has read, which subscribes to every key.
        # There are several, so that no message waits for the few seconds after which Zenoh closes the observer's link.
        milestones = [key for key in hearers if key.endswith(("/tracks", "/report", "/mission"))]
        flooded = [key for key in hearers if key not in milestones]
        log = run.out / "logs" / "evaluator.log"
        for milestone in milestones:
            for key in itertools.islice(itertools.cycle(flooded), MESSAGES // len(milestones)):
                put(key)
            put(milestone)
            line = f"rejected a message on {milestone}:"
            run.until(lambda line=line: line in log.read_text(), f"the evaluator has read all up to {milestone}")
            flooded.append(milestone)
    run.interrupted()
    nodes = run.record()["nodes"]
    assert all(node["ended"] == "ok" and not node["failures"] for node in nodes.values())
    expected = sum(sent[key] * hearers[key] for key in sent)
    assert sum(sent.values()) >= MESSAGES
    evaluator = nodes.pop("evaluator")  # subscribes to every key, and refuses malformed messages on those it needs
    assert sum(evaluator["foreign"].values()) == sum(sent.values())
    refused: Counter[str] = Counter()
    for what, n in evaluator["rejected"].items():
        refused[what.rpartition(": ")[0]] += n
    assert {"clock", "scene/truth", "cc/picture", "agent/ego/mission"} <= refused.keys()
    assert all(n == sent[key] for key, n in refused.items())
    assert sum(sum(node["foreign"].values()) for node in nodes.values()) == expected
    assert sum(n for node in nodes.values() for n in node["rejected"].values()) == expected
    logs = "".join((run.out / node["log"]).read_text() for node in nodes.values())
    assert 0 < logs.count("rejected a message") <= sum(hearers.values()), "logged once per source"


@pytest.mark.heavy
def test_foreign_messages_are_recorded_unchanged_and_marked(launch) -> None:
    run: Launched = launch("baseline", "--mode", "realtime", "--frames", "40")
    record = run.started()
    sent = garbage(500)
    with closing(Observer(record, "clock")) as observer:
        eventually(lambda: observer.frame() > 3, "frames are played")
        publisher = observer.publisher("cc/picture")
        for payload in sent:
            publisher.put(payload)
        eventually(lambda: observer.frame() >= 30, "the run continues")
    output = run.ended()
    assert run.record()["recorded"]["malformed"] == len(sent)
    marked = [message for message in read(run.out) if message.malformed]
    assert [message.payload for message in marked] == sent
    assert {message.wire for message in marked} == {"cc/picture"}
    assert f"rejected: {len(sent)} messages on 1 key (first, by " in output
    assert f"foreign: {len(sent)} messages without the mark of this run's nodes, on cc/picture" in output
