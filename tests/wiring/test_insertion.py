"""Insertion is invisible to subscribers; removal restores the wiring."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.errors import WiringError
from mast_zenoh.wiring.insertion import InsertionPoint, insert, interposer_of, never_inserted, remove, taps_into
from mast_zenoh.wiring.model import TAP, Branch, Endpoint, Leg, Listener, Wire, Wiring


def wire(key: str, publisher: str, *subscribers: str) -> Wire:
    ends = tuple(Endpoint(name, "in") for name in subscribers)
    return Wire(key, "", "tracks", (Leg(key, Endpoint(publisher, "out"), ends),))


RECORDER = (Endpoint("recorder", "everything"),)
HEARD_BY_D = replace(wire("b/out", "b", "c"), listeners=(Listener(Endpoint("d", "in")),))
PLAIN = Wiring((wire("clock", "sim", "a", "b"), wire("a/tracks", "a", "b", "c"), HEARD_BY_D), RECORDER)
LINK, LAST = Endpoint("link", "in"), Endpoint("b", "in")
TRUNK = Leg("a/tracks", Endpoint("a", "out"), (LINK, Endpoint("c", "in")))
BRANCH = Branch(LINK, LAST, (Leg(f"a/tracks/{TAP}/b/0", Endpoint("link", "out"), (LAST,)),))
#: A link is before b alone.
BRANCHED = Wiring((Wire("a/tracks", "", "tracks", (TRUNK,), (BRANCH,)),), RECORDER)
NODES, WIRES = ("m", "n", "o", "p"), [found.key for found in PLAIN.wires]


def ends(wiring: Wiring) -> dict[str, tuple]:
    """Publisher, subscribers and listeners of each wire."""
    strangers = {
        each.key: tuple(end for end in each.subscribers if end.node not in NODES)
        for each in wiring.wires
        if each.legs[0].publisher.node not in NODES
    }
    return {each.key: (each.legs[0].publisher, strangers[each.key]) for each in wiring.wires if each.key in strangers}


@given(st.lists(st.tuples(st.sampled_from(NODES), st.sampled_from(WIRES)), max_size=12))
def test_insertions_and_removals_keep_wire_ends_and_chains_intact(steps: list[tuple[str, str]]) -> None:
    wiring, sitting = PLAIN, {}
    for node, key in steps:
        if node in sitting:
            before = {each.key: each.interposers for each in wiring.wires}
            wiring = remove(wiring, node)
            after = {each.key: each.interposers for each in wiring.wires}
            assert after == {k: tuple(name for name in names if name != node) for k, names in before.items()}
            del sitting[node]
        else:
            wiring = insert(wiring, node, InsertionPoint(key, "in", "out"))
            sitting[node] = key
        assert ends(wiring) == ends(PLAIN)
        keys = wiring.keys()
        assert len(set(keys)) == len(keys)
        for each in wiring.wires:
            assert each.legs[-1].key == each.key
            assert [end.node for end in each.listeners_of(each.legs[-1])] == ["d"] * (each.key == "b/out")
            assert all(leg.key.startswith(f"{each.key}/{TAP}/") for leg in each.legs[:-1])
            for leg, onward in zip(each.legs, each.legs[1:], strict=False):
                assert [end.node for end in leg.subscribers] == [onward.publisher.node]
        assert Wiring.from_json(wiring.to_json()) == wiring
    for node in list(sitting):
        wiring = remove(wiring, node)
    assert wiring == PLAIN


def test_an_inserted_node_has_the_wires_of_its_position_until_removed() -> None:
    report = wire("attack/m/report", "m", "c")
    wiring = insert(PLAIN, "m", InsertionPoint("a/tracks", "in", "out", {"clock": "clock"}, (report,)))
    ports = wiring.ports("m")
    assert {key: heard.port for key, heard in ports.inputs.items()} == {"clock": "clock", f"a/tracks/{TAP}/0": "in"}
    assert wiring.ports("c").inputs["attack/m/report"].source == "m"
    assert wiring.ports("a").outputs == {("out", ""): f"a/tracks/{TAP}/0"}
    assert wiring.ports("b").inputs == PLAIN.ports("b").inputs, "a subscriber's ports are unchanged"
    assert f"a/tracks/{TAP}/0" in wiring.ports("recorder").inputs
    assert taps_into(wiring, ["m"]) == {f"a/tracks/{TAP}/0": "m"}
    assert interposer_of(wiring, "a/tracks") == "m"
    assert remove(wiring, "m") == PLAIN


def test_the_next_free_tap_is_used_so_each_leg_changes_its_key_at_most_once() -> None:
    chain = insert(insert(PLAIN, "m", InsertionPoint("clock", "in", "out")), "n", InsertionPoint("clock", "in", "out"))
    without = remove(chain, "m")
    assert [leg.key for leg in without.wires[0].legs] == [f"clock/{TAP}/1", "clock"]
    again = insert(without, "o", InsertionPoint("clock", "in", "out"))
    assert [leg.key for leg in again.wires[0].legs] == [f"clock/{TAP}/1", f"clock/{TAP}/0", "clock"]


def test_an_inserted_node_comes_before_branches_whose_nodes_cannot_be_released() -> None:
    wiring = insert(BRANCHED, "m", InsertionPoint("a/tracks", "in", "out"))
    assert wiring.wires[0].branches == BRANCHED.wires[0].branches
    assert wiring.wires[0].subscribers == BRANCHED.wires[0].subscribers
    assert remove(wiring, "m") == BRANCHED
    with pytest.raises(WiringError, match=r"begins.*subscriber.*'a/tracks'"):
        remove(wiring, "link")


def test_nodes_come_and_go_before_one_subscriber_that_has_a_branch_and_nobody_else_notices() -> None:
    one = insert(BRANCHED, "m", InsertionPoint("a/tracks", "in", "out", before="b"))
    both = insert(one, "n", InsertionPoint("a/tracks", "in", "out", before="b"))
    assert both.wires[0].interposers == ("link", "m", "n")
    for name in ("a", "b", "c"):
        assert both.ports(name) == BRANCHED.ports(name), name
    assert taps_into(both, ["m", "n"]) == {f"a/tracks/{TAP}/b/1": "m", f"a/tracks/{TAP}/b/2": "n"}
    assert Wiring.from_json(both.to_json()) == both
    assert {passage.before for passage in both.passages()} == {"b"}
    assert remove(both, "n") == one
    assert remove(remove(both, "m"), "n") == BRANCHED
    assert never_inserted(both, {"m", "n"}) == BRANCHED
    with pytest.raises(WiringError, match=r"before.*'a/tracks'.*subscriber"):
        insert(BRANCHED, "m", InsertionPoint("a/tracks", "in", "out", before="c"))
    with pytest.raises(WiringError, match=r"'d'.*subscribe.*'a/tracks'"):
        insert(BRANCHED, "m", InsertionPoint("a/tracks", "in", "out", before="d"))


@pytest.mark.parametrize(
    ("node", "place", "what"),
    [
        ("m", InsertionPoint("a/track", "in", "out"), r"wire 'a/track'.*'a/tracks'"),
        ("m", InsertionPoint("a/tracks", "in", "out", {"clok": "clock"}), r"wire 'clok'.*'clock'"),
        ("b", InsertionPoint("a/tracks", "in", "out"), r"already.*wire 'a/tracks'"),
        ("d", InsertionPoint("b/out", "in", "out"), r"already.*wire 'b/out'"),
        ("a/b", InsertionPoint("a/tracks", "in", "out"), r"chunk.*key expression"),
        ("m", InsertionPoint("a/tracks", "in", "out", {}, (wire("clock", "m", "c"),)), r"already.*publisher"),
    ],
)
def test_an_impossible_insertion_is_refused(node: str, place: InsertionPoint, what: str) -> None:
    with pytest.raises(WiringError, match=what):
        insert(PLAIN, node, place)


def test_only_a_node_on_a_wire_can_be_removed_and_the_wire_must_have_only_one() -> None:
    both = insert(insert(PLAIN, "m", InsertionPoint("clock", "in", "out")), "n", InsertionPoint("clock", "in", "out"))
    with pytest.raises(WiringError, match=r"node 'mm'.*'m'"):
        remove(both, "mm")
    with pytest.raises(WiringError, match=r"wire 'clock'.*m"):
        interposer_of(both, "clock")
    with pytest.raises(WiringError, match=r"wire 'b/out'.*node"):
        interposer_of(both, "b/out")


def test_a_wiring_without_some_nodes_equals_one_that_never_had_them() -> None:
    wiring = insert(
        insert(PLAIN, "m", InsertionPoint("a/tracks", "in", "out")), "n", InsertionPoint("a/tracks", "in", "out")
    )
    assert never_inserted(wiring, {"m", "n"}) == PLAIN
    (kept,) = (each for each in never_inserted(wiring, {"m"}).wires if each.interposers)
    assert kept.interposers == ("n",)
    assert [leg.publisher.node for leg in kept.legs] == ["a", "n"]


def test_removing_a_publisher_removes_its_wires_and_removing_a_listener_its_inputs() -> None:
    without = never_inserted(PLAIN, {"a", "d", "recorder"})
    assert [each.key for each in without.wires] == ["clock", "b/out"]
    assert without.overhearers == ()
    assert all(
        end.node not in ("a", "d") for key in without.wires for end in (*key.subscribers, *key.receivers(key.legs[-1]))
    )


def test_a_branch_keeps_its_remaining_nodes() -> None:
    chain = ("m", "link", "n")
    ends = [*(Endpoint(name, "in") for name in chain), Endpoint("c", "in")]
    legs = tuple(Leg(f"a/tracks/{TAP}/c/{i}", Endpoint(name, "out"), (ends[i + 1],)) for i, name in enumerate(chain))
    trunk = Leg("a/tracks", Endpoint("a", "out"), (Endpoint("b", "in"), ends[0]))
    each = Wire("a/tracks", "", "tracks", (trunk,), (Branch(ends[0], ends[3], legs),))
    (kept,) = never_inserted(Wiring((each,)), {"m", "n"}).wires
    assert kept.legs[-1].subscribers == (Endpoint("b", "in"), Endpoint("link", "in"))
    (branch,) = kept.branches
    assert (branch.entrance, branch.subscriber) == (Endpoint("link", "in"), Endpoint("c", "in"))
    assert branch.legs == (Leg(f"a/tracks/{TAP}/c/2", Endpoint("link", "out"), (Endpoint("c", "in"),)),)
    (bare,) = never_inserted(Wiring((each,)), set(chain)).wires
    assert bare == Wire(
        "a/tracks", "", "tracks", (Leg("a/tracks", Endpoint("a", "out"), (Endpoint("b", "in"), ends[3])),)
    )
