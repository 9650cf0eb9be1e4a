"""A malformed input on any wire costs one message and nothing else."""

import pickle
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import islice

import msgpack
import pytest
from damage import malformed_payloads
from fuzzing import Fuzzing
from tiny_world import Bench, Run, tiny, tracks

from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.wiring.model import Wiring

TOTAL, TOTAL_LONG = 4_000, 200_000
POINTS = "baseline with points"
SCENARIOS = {
    "baseline": (),
    "uncoordinated": ("attack_start_s=0.2",),
    "coordinated": ("attack_start_s=0.2",),
    POINTS: (),
}
FRAMES = 6
BEFORE = 3  # frames played before malformed messages arrive


@cache
def world(name: str):
    def edit(content):
        if name == POINTS:
            content["points"] = dict(lidar="VLP-16", clutter=None)

    return tiny(name.partition(" ")[0], *SCENARIOS[name], infrastructure=2, frames=FRAMES, edit=edit)


@cache
def played(name: str) -> Run:
    return Run(world(name))


@cache
def inputs() -> tuple[tuple[str, str, str, str], ...]:
    """(scenario, node, key, schema) of every input of every node."""
    entries = []
    for name in SCENARIOS:
        wiring = Wiring.from_json(world(name).wiring)
        for node in world(name).nodes:
            entries += [(name, node, key, hears.message) for key, hears in wiring.ports(node).inputs.items()]
    return tuple(entries)


@cache
def sound(schema: str) -> tuple[bytes, ...]:
    """The recorded messages of runs."""
    payloads = [
        payload
        for name in SCENARIOS
        for wire in world(name).wiring["wires"]
        if wire["message"] == schema
        for payload in played(name).messages[wire["key"]]
    ]
    return tuple(payloads[:: 1 + len(payloads) // 40])


def malformed(schema: str, count: int, seed: tuple[int, ...]) -> Iterator[bytes]:
    """Distinct payloads that are not valid messages of a type."""
    return islice(malformed_payloads(sound(schema), lambda payload: codec.decode(payload, schema), seed), count)


def rubbish(place: int, total: int, seed: int) -> Iterator[bytes]:
    """A share of `total` distinct malformed payloads for one of `inputs()`."""
    count = total // len(inputs()) + (place < total % len(inputs()))
    return malformed(inputs()[place][3], count, seed=(seed, place))


def play(bench: Bench, run: Run, frames: range) -> None:
    """Replay a node's inputs: in each frame its clock, then the others."""
    for frame in frames:
        for key, hears in sorted(bench.ports.inputs.items(), key=lambda item: item[1].message != "clock"):
            for message, payload in zip(run.decoded(key, hears.message), run.messages[key], strict=True):
                if message.header.frame == frame:
                    bench.host.deliver(key, payload, frame)


def test_malformed_messages_are_lost_without_ending_a_node(fuzzing: Fuzzing) -> None:
    planned = fuzzing.draws(TOTAL, TOTAL_LONG)
    places: dict[tuple[str, str], list[int]] = {}
    for place, (name, node, _, _) in enumerate(inputs()):
        places.setdefault((name, node), []).append(place)
    roles = {world(name).nodes[node].role for name, node in places}
    assert roles == {"agent", "detector", "broker", "command_center", "evaluator", "adversary", "coordinator"}
    total = 0
    for (name, node), here in places.items():
        bench = Bench(world(name), node)
        hears_all = world(name).nodes[node].role == "evaluator"
        play(bench, played(name), range(BEFORE))
        state, published, handled = pickle.dumps(bench.node), list(bench.outbox), bench.host.handled.copy()
        if not hears_all:
            bench.host.observe = lambda key, header: pytest.fail(f"{key}: a malformed message was taken for sound")
        sent: Counter[str] = Counter()
        for place in here:
            key = inputs()[place][2]
            for payload in rubbish(place, planned, fuzzing.seed):
                bench.host.deliver(key, payload, -1, counted=False)
                sent[key] += 1
        rejected: Counter[str] = Counter()
        for (key, _), n in bench.host.rejected.items():
            rejected[key] += n
        assert rejected == ({key: sent[key] for key in bench.node.routes} if hears_all else sent)
        assert hears_all or pickle.dumps(bench.node) == state
        assert (bench.outbox, bench.host.handled) == (published, handled)
        total += sent.total()

        bench.host.observe = None
        undisturbed = Bench(world(name), node)
        play(bench, played(name), range(BEFORE, FRAMES))
        play(undisturbed, played(name), range(FRAMES))
        assert bench.outbox == undisturbed.outbox, "it continues unaffected"
        if hears_all:
            scores, expected = (each.host.finish()["metrics"]["agents"] for each in (bench, undisturbed))
            assert scores == expected
        assert not bench.host.failures
    assert total == planned


@pytest.mark.parametrize("schema", ["clock", "status", "tracks", "collated", "directive", "truth", "points"])
def test_malformed_messages_cover_many_kinds_of_errors(schema: str) -> None:
    """Guards the test above against payloads that all fail at the first byte."""
    reasons: set[str] = set()
    for payload in malformed(schema, 1_000, seed=(1,)):
        with pytest.raises(MessageError) as caught:
            codec.decode(payload, schema)
        reasons.add(" ".join(str(caught.value).split()[:3]))
    assert len(reasons) >= {"clock": 25, "status": 90}.get(schema, 150)


@pytest.mark.parametrize("odd", [float, bool])
def test_a_size_that_only_equals_an_integer_is_refused_regardless_of_earlier_messages(odd: type) -> None:
    payload = codec.encode(codec.conform(codec.Header("tracks", "ego", 0, 0, 0), tracks((1.0, 2.0))))
    codec.decode(payload, "tracks")
    fields = msgpack.unpackb(payload)
    fields["body"]["yaw"][1] = [odd(1)]
    for body in (fields["body"], {name: [c[0], list(map(odd, c[1])), c[2]] for name, c in fields["body"].items()}):
        with pytest.raises(MessageError, match="shape"):
            codec.decode(msgpack.packb(fields | {"body": body}), "tracks")


def test_a_node_that_receives_only_malformed_messages_ends_normally() -> None:
    bench = Bench(world("baseline"), "evaluator")
    for key, hears in bench.ports.inputs.items():
        for payload in malformed(hears.message, 50, seed=(2,)):
            bench.host.deliver(key, payload, -1)
    assert bench.host.finish()["metrics"]["frames"] == 0
