"""Commands for `nft` and `tc`, and packets that wait in a relay."""

import socket
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from mast_zenoh.faults.network import LinkState
from mast_zenoh.launch.netns import relay
from mast_zenoh.launch.netns.namespaces import bandwidth, netem, rules
from mast_zenoh.launch.netns.relay import Direction


def test_new_rules_replace_old_ones_on_the_input_hook() -> None:
    text = rules({"host1": LinkState(cut=True), "host2": LinkState(loss=0.25), "host3": LinkState()})
    assert text.splitlines() == [
        "add table inet mast",
        "delete table inet mast",
        "add table inet mast",
        "add chain inet mast input { type filter hook input priority 0 ; policy accept ; }",
        'add rule inet mast input iifname "host1" drop',
        'add rule inet mast input iifname "host2" numgen random mod 1000000 < 250000 drop',
    ]


def test_a_cut_link_needs_no_loss_rule() -> None:
    assert rules({"host1": LinkState(cut=True, loss=0.5)}).count("host1") == 1


@pytest.mark.parametrize(
    ("bits_per_s", "burst"),
    [(1e5, "4000b"), (1e7, "12500b"), (1e9, "1250000b")],
    ids=["at least two packets", "10 ms of it", "10 ms of it"],
)
def test_a_bandwidth_is_a_token_bucket(bits_per_s: float, burst: str) -> None:
    rate = f"{bits_per_s:.0f}bit"
    words = ["qdisc", "replace", "dev", "host1", "root", "tbf", "rate", rate, "burst", burst, "latency", "400ms"]
    assert bandwidth("host1", bits_per_s) == words
    assert bandwidth("host1", None) == ["qdisc", "del", "dev", "host1", "root"]


def test_netem_combines_delay_and_bandwidth_in_one_discipline() -> None:
    state = LinkState(delay_ms=20.0, jitter_ms=1.5, bits_per_s=1e6)
    words = "qdisc replace dev host1 root netem limit 100000 delay 20000us 1500us rate 1000000bit"
    assert netem("host1", state) == words.split()
    assert "rate" not in netem("host1", LinkState(delay_ms=20.0))


@pytest.fixture
def path(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[socket.socket, Direction, socket.socket]]:
    """Source, direction under test on a stopped clock, and destination."""
    monkeypatch.setattr(relay, "time", SimpleNamespace(monotonic=lambda: path_time[0]))
    path_time[0] = 0.0
    (near, near_end), (far_end, far) = (socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2))
    for end in (near, near_end, far_end, far):
        end.setblocking(False)
    yield near, Direction(near_end.fileno(), far_end.fileno()), far
    for end in (near, near_end, far_end, far):
        end.close()


path_time = [0.0]


def arrived(far: socket.socket) -> list[bytes]:
    got = []
    while True:
        try:
            got.append(far.recv(100))
        except BlockingIOError:
            return got


def test_a_packet_leaves_exactly_when_its_delay_has_passed(path) -> None:
    near, direction, far = path
    near.send(b"one")
    direction.receive(0.02, 0.0)
    path_time[0] = 0.0199
    direction.forward()
    assert arrived(far) == []
    path_time[0] = 0.0201
    direction.forward()
    assert arrived(far) == [b"one"]


def test_packets_do_not_overtake_each_other_despite_jitter(path) -> None:
    near, direction, far = path
    sent = []
    for number in range(200):
        path_time[0] = number * 0.001
        sent.append(b"%d" % number)
        near.send(sent[-1])
        direction.receive(0.005, 0.005)
    waits = [due - number * 0.001 for number, (due, _) in enumerate(direction.waiting)]
    assert len(set(waits)) > 1, "the delays vary"
    assert max(waits) <= 0.0101
    got = []
    while direction.waiting:
        path_time[0] += 0.001
        direction.forward()
        got += arrived(far)
    assert got == sent


def test_a_decreasing_delay_does_not_reorder_packets(path) -> None:
    near, direction, far = path
    for packet, delay_s in ((b"slow", 1.0), (b"quick", 0.0)):
        near.send(packet)
        direction.receive(delay_s, 0.0)
    direction.forward()
    assert arrived(far) == []
    path_time[0] = 1.0
    direction.forward()
    assert arrived(far) == [b"slow", b"quick"]


def test_packets_beyond_the_queue_limit_are_dropped(path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "_MAX_QUEUED", 3)
    near, direction, far = path
    for number in range(5):
        near.send(b"%d" % number)
    direction.receive(0.0, 0.0)
    direction.forward()
    assert arrived(far) == [b"0", b"1", b"2"]
