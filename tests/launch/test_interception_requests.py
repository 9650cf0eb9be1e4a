"""Requests to change a running run are checked and authenticated."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tiny_world import tiny

from mast_zenoh.config import bundle
from mast_zenoh.config.loading import SHIPPED
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.config.settings import nested
from mast_zenoh.errors import ConfigurationError, MastError, MessageError, NodeFileError, NotRunning, WiringError
from mast_zenoh.launch.launcher_protocol import Interceptions
from mast_zenoh.launch.live_interception import intercept, plan, release, seal, unseal
from mast_zenoh.mesh.control.interception import place_json, place_of
from mast_zenoh.messages import Schema
from mast_zenoh.scenario.nodes import add_surroundings

TRACKS = "agent/infra_1/tracks"
ATTACK = ("attack.type=UncoordinatedAttack", "attack.start_s=0")


@pytest.fixture(scope="module")
def resolved() -> Resolved:
    return tiny(frames=2)


def node_file(folder: Path, inputs: dict[str, str], outputs: dict[str, str], role: str = "link") -> str:
    """A node with these ports and no behaviour."""
    handlers = "".join(f"    def on_{port}(self, received, context): ...\n" for port in inputs)
    path = folder / "mine_own.py"
    path.write_text(
        "from mast_zenoh.node import Node\n"
        f"class Mine(Node):\n    role = {role!r}\n    inputs = {inputs!r}\n    outputs = {outputs!r}\n{handlers}"
    )
    return str(path)


def test_an_adversary_gets_the_wire_the_clock_its_agents_pose_and_a_report_key(resolved: Resolved) -> None:
    name, spec, place = plan(resolved, TRACKS, "adversary.py", settings=ATTACK)
    assert (name, spec.role, spec.on_exit) == ("adversary_1", "adversary", "continue")
    add_surroundings({name: spec}, resolved.recording)
    surroundings = spec.config.pop("surroundings")
    assert (surroundings["victims"], next(iter(surroundings["agents"]))) == (["infra_1"], "ego"), "it knows the scene"
    assert spec.config == {"agent": "infra_1", "attack": {"type": "UncoordinatedAttack", "start_s": 0}}
    assert (place.wire, place.input, place.output) == (TRACKS, "tracks", "tracks_out")
    assert place.other_inputs == {"clock": "clock", "agent/infra_1/pose": "pose"}
    assert [(wire.key, [end.node for end in wire.subscribers]) for wire in place.published_wires] == [
        ("attack/adversary_1/report", [])
    ]
    assert place_of(json.loads(json.dumps(place_json(place)))) == place


LIES = """
from mast_zenoh.attacks import PassThrough
from mast_zenoh.node import Node
class Lie(PassThrough):
    def __init__(self, *, gain: float = 1.0) -> None: self.gain = gain
"""
TRUTHS = "class Truth(PassThrough): ...\n"
MINE = """class Mine(Node):
    role, inputs, outputs = "adversary", {"tracks": "tracks"}, {"tracks_out": "tracks"}
    def on_tracks(self, received, context): ...
"""


@pytest.mark.parametrize(
    ("source", "chosen", "attack"),
    [
        (LIES, "{}", {"type": "Lie", "gain": 2.0}),
        (LIES + TRUTHS + MINE, "{}:Lie", {"type": "Lie", "gain": 2.0}),
        ("", "UncoordinatedAttack", {"type": "UncoordinatedAttack", "start_s": 2.0}),
        (LIES + MINE, "{}", None),
        (LIES + MINE, "{}:Mine", None),
    ],
    ids=["a file of one attack", "a class", "a shipped attack", "a node beside attacks", "a node by its class"],
)
def test_an_attack_can_be_named_in_place_of_a_node(
    resolved: Resolved, tmp_path: Path, source: str, chosen: str, attack: dict[str, Any] | None
) -> None:
    file = tmp_path / "lies.py"
    file.write_text(source)
    chosen = chosen.format(file)
    if attack is None:
        assert plan(resolved, TRACKS, chosen)[1].type == "Mine"
        return
    settings = [f"attack.{name}={value}" for name, value in attack.items() if name != "type"]
    _, spec, _ = plan(resolved, TRACKS, chosen, settings=settings)
    assert (spec.type, Path(spec.file).name) == ("Adversary", "adversary.py")
    assert spec.config == {"agent": "infra_1", "attack": attack}


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ("{}", r"defines.*classes.*FILE.py:CLASS"),
        ("{}:Lei", r"defines.*'Lei'.*'Lie'"),
    ],
)
def test_which_attack_of_a_file_must_be_clear(resolved: Resolved, tmp_path: Path, chosen: str, message: str) -> None:
    file = tmp_path / "lies.py"
    file.write_text(LIES + TRUTHS)
    with pytest.raises(ConfigurationError, match=message):
        plan(resolved, TRACKS, chosen.format(file))


def test_a_port_must_be_named_if_several_match(resolved: Resolved, tmp_path: Path) -> None:
    two = node_file(tmp_path, {"a": "tracks", "b": "tracks"}, {"out": "tracks"})
    with pytest.raises(NodeFileError, match=r"inputs.*b.*--input"):
        plan(resolved, TRACKS, two)
    assert plan(resolved, TRACKS, two, input="b")[2].input == "b"
    with pytest.raises(NodeFileError, match=r"input.*'bb'.*'b'"):
        plan(resolved, TRACKS, two, input="bb")
    with pytest.raises(NodeFileError, match="wire 'cc/picture' carries"):
        plan(resolved, "cc/picture", two)


def test_a_link_is_put_on_a_wire_with_the_ports_named_after_its_message_type(resolved: Resolved) -> None:
    _, spec, place = plan(resolved, TRACKS, str(bundle.ROOT / "nodes" / "link.py"))
    assert spec.type == "Link"
    assert (place.input, place.output) == ("tracks", "tracks_out")
    assert place.other_inputs == {"clock": "clock", "agent/infra_1/pose": "pose"}
    assert [wire.message for wire in place.published_wires] == ["link_report"]


def test_a_node_that_redefines_a_message_type_of_the_run_is_refused(resolved: Resolved, tmp_path: Path) -> None:
    text = (
        "from mast_zenoh.messages import Schema\nfrom mast_zenoh.node import Node\n"
        "class Mine(Node):\n    role = 'link'\n    inputs = {'a': 'tracks'}\n"
        "    outputs = {'b': 'tracks', 'wind': Schema('wind', 1, '', ())}\n    def on_a(self, *_): ...\n"
    )
    (tmp_path / "windy.py").write_text(text)
    file = str(tmp_path / "windy.py")
    same, other = (replace(resolved, messages=(Schema("wind", version, "", ()),)) for version in (1, 2))
    assert plan(same, TRACKS, file)[1].type == "Mine"
    with pytest.raises(NodeFileError, match=r"windy\.py: Mine.*'wind'"):
        plan(other, TRACKS, file)


@pytest.mark.parametrize(
    ("arguments", "error", "what"),
    [
        (dict(wire="agent/infra_1/trcks"), WiringError, "mean 'agent/infra_1/tracks'"),
        (dict(file="adversry.py"), NodeFileError, r"mean 'adversary.py'"),
        (dict(file="recorder.py"), MastError, "log"),
        (dict(name="broker"), ConfigurationError, "'broker' already exists"),
        (dict(name="a/b"), WiringError, r"chunk.*key expression"),
        (dict(settings=()), ConfigurationError, "attack"),
        (dict(settings=(*ATTACK, "attack.start=1")), ConfigurationError, "mean 'start_s'"),
        (dict(settings=("attack",)), ConfigurationError, "expected KEY=VALUE"),
        (dict(settings=("attack=1", "attack.type=x")), ConfigurationError, r"attack.*1.*dict"),
    ],
)
def test_an_invalid_request_is_refused_with_the_nearest_valid_choice(
    resolved: Resolved, arguments: dict[str, Any], error: type[MastError], what: str
) -> None:
    with pytest.raises(error, match=what):
        plan(resolved, **{"wire": TRACKS, "file": "adversary.py", "settings": ATTACK, **arguments})


def test_dotted_settings_change_nested_dicts_and_are_typed() -> None:
    assert nested(["a.b.c=1", "a.b.d=x y", "e=[1, 2]", "f=True", "g=a=b"]) == {
        "a": {"b": {"c": 1, "d": "x y"}},
        "e": [1, 2],
        "f": True,
        "g": "a=b",
    }


def test_only_requests_sealed_with_the_secret_are_accepted_and_each_is_unique() -> None:
    request = {"do": "release", "name": "m"}
    sealed = seal(request, b"secret")
    assert unseal(sealed, b"secret").items() >= request.items()
    assert sealed != seal(request, b"secret")
    with pytest.raises(MessageError):
        unseal(sealed, b"guess")
    body, digest = msgpack.unpackb(sealed)
    with pytest.raises(MessageError):
        unseal(msgpack.packb([body.replace(b"release", b"destroy"), digest]), b"secret")


@given(
    st.binary(max_size=200) | st.recursive(st.none() | st.integers(0, 2**63) | st.text(), st.lists).map(msgpack.packb)
)
def test_arbitrary_bytes_are_refused_as_a_request(payload: bytes) -> None:
    with pytest.raises(MessageError):
        unseal(payload, b"secret")


def test_a_run_that_is_not_up_yet_is_told_from_a_folder_that_is_none(tmp_path: Path) -> None:
    for folder, what in (
        ("later", "no such folder: the run is not up yet"),
        (".", "found no run.json: the run is not up"),
    ):
        with pytest.raises(NotRunning, match=what):
            intercept(tmp_path / folder, TRACKS, "adversary.py")
        with pytest.raises(NotRunning, match=what):
            release(tmp_path / folder, name="m")


@pytest.mark.parametrize(
    ("record", "what"),
    [
        (dict(status="ok", runtime="mesh"), r"run.*over: ok"),
        (dict(status="running", runtime="inproc"), r"run.*process"),
        (dict(status="running", runtime="mesh", security="mtls", endpoint="tcp/127.0.0.1:1"), "security level mtls"),
        (dict(status="running", runtime="mesh"), r"started.*nodes yet"),
    ],
)
def test_a_run_that_cannot_be_changed_gives_the_reason(tmp_path: Path, record: dict[str, str], what: str) -> None:
    (tmp_path / "run.json").write_text(json.dumps(record))
    with pytest.raises(NotRunning, match=what):
        intercept(tmp_path, TRACKS, "adversary.py")
    with pytest.raises(NotRunning, match=what):
        release(tmp_path, name="m")


@pytest.mark.parametrize(
    ("wire", "input", "others"),
    [
        ("agent/infra_1/detections", "detections", {"clock", "agent/infra_1/pose"}),
        (TRACKS, "tracks", {"clock", "agent/infra_1/pose"}),
        ("agent/infra_1/view", "view", {"clock", "agent/infra_1/pose"}),
        ("agent/infra_1/pose", "pose", {"clock"}),
        ("cc/picture", "picture", {"clock", "agent/ego/pose"}),
    ],
)
def test_the_shipped_adversary_gets_its_agents_pose_and_overhears_nothing(
    wire: str, input: str, others: set[str]
) -> None:
    resolved = tiny(frames=2, edit=lambda content: content.update(keyexpr=dict(rewrites=["views.toml"])))
    settings = (*ATTACK, "agent=ego") if wire == "cc/picture" else ATTACK
    _, _, place = plan(resolved, wire, "adversary.py", settings=settings)
    assert (place.input, place.output) == (input, f"{input}_out")
    assert set(place.other_inputs) == others
    assert {own.key for own in place.published_wires} == {"attack/adversary_1/report"}


def test_code_of_the_run_that_is_not_trusted_is_neither_run_nor_needed_for_another_node(
    resolved: Resolved, tmp_path: Path
) -> None:
    own, marker = tmp_path / "theirs.py", tmp_path / "ran"
    own.write_text(f"import pathlib\npathlib.Path({str(marker)!r}).touch()\n")
    running = replace(resolved, modules=(str(own),)).allowing(SHIPPED, "a run")
    assert plan(running, TRACKS, "adversary.py", settings=ATTACK)[0] == "adversary_1"
    with pytest.raises(ConfigurationError, match=r"'Theirs'.*theirs\.py.*--trust"):
        plan(running, TRACKS, "adversary.py", settings=("attack.type=Theirs",))
    assert not marker.exists()


@pytest.mark.parametrize(
    ("exit", "handed_in", "heals"), [(0, True, False), (0, False, True), (-9, False, True), (None, False, False)]
)
def test_a_wire_is_healed_if_its_node_died_and_not_if_it_left_at_the_end_of_the_run(
    tmp_path: Path, exit: int | None, handed_in: bool, heals: bool
) -> None:
    context = MagicMock(folder=tmp_path, record={}, run_id="a", stop=MagicMock(requested=False))
    child = MagicMock(exit=exit, exit_expected=False, handed_in=handed_in)
    server = Interceptions(context, MagicMock(children={"mallory": child}), MagicMock())
    server._inserted.add("mallory")
    assert (server._next() is not None) == heals
