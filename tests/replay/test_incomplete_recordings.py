"""Recordings that lack something are refused, or replayed with a notice."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from recorded_runs import FRAMES
from tiny_world import Run as Played

from mast_zenoh import scenario
from mast_zenoh.errors import ConfigurationError, MastError, NodeFileError, RunFolderError, WiringError
from mast_zenoh.launch import liveness, replay
from mast_zenoh.launch import run as launcher
from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.format import REWIRED, RecordedEvent
from mast_zenoh.run_folder.recording.reader import Recorded, read
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.wiring.insertion import InsertionPoint, insert
from mast_zenoh.wiring.model import Wiring


@pytest.fixture
def copied(recorded: Callable[[str], Path], tmp_path: Path) -> Path:
    """A copy of the recorded baseline that a test may damage."""
    shutil.copytree(recorded("baseline"), tmp_path / "run")
    return tmp_path / "run"


def edit_json(file: Path, **changes: object) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def rewrite(folder: Path, keep: Callable[[Recorded], bool], step: Callable[[Recorded], int] = lambda m: m.step) -> None:
    """Replace a recording by one without some messages, or with other steps."""
    messages = list(read(folder))
    (folder / "messages.mcap").unlink()
    wiring = Wiring.from_json(json.loads((folder / "wiring.json").read_text()))
    log = MessageLog(folder / "messages.mcap")
    log.begin(wiring.ports("recorder").inputs)
    for message in filter(keep, messages):
        log.add(message.key, message.payload, codec.decode_header(message.payload, message.message), step(message))
    log.close()


def notices(folder: Path) -> str:
    """The notices of a replay, which must play."""
    prepared = replay.resolve(folder, record=False)
    assert Played(prepared.resolved).messages["cc/picture"]
    return "\n".join(prepared.notices)


def test_a_complete_recording_has_no_notice(recorded: Callable[[str], Path]) -> None:
    for name in ("baseline", "lossy", "crashing"):
        assert not replay.resolve(recorded(name)).notices


def test_a_recording_that_was_cut_off_is_played_up_to_its_last_whole_frame(
    recorded: Callable[[str], Path], copied: Path
) -> None:
    rewrite(copied, lambda message: message.frame < 9)
    data, place = (copied / "messages.mcap").read_bytes(), len(MCAP0_MAGIC)
    while data[place] != Opcode.DATA_END:
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    (copied / "messages.mcap").write_bytes(data[:place])  # all chunks are whole
    assert f"frames of {FRAMES}" in notices(copied)
    pictures = Played(replay.resolve(copied, record=False).resolved).messages["cc/picture"]
    assert pictures == [m.payload for m in read(recorded("baseline")) if m.key == "cc/picture"][:8]


TRACKS = "agent/infra_1/tracks"


@pytest.mark.parametrize(
    ("keep", "step", "notice"),
    [
        (
            lambda m: m.key != TRACKS or m.frame not in (3, 7),
            lambda m: m.step,
            "wire (most: agent/infra_1/tracks",
        ),
        (lambda m: m.key != TRACKS, lambda m: m.step, "recorded on agent/infra_1/tracks"),
        (
            lambda m: True,
            lambda m: -1 if (m.key, m.frame) == (TRACKS, 4) else m.step,
            "1 message without",
        ),
    ],
)
def test_missing_messages_and_those_of_outsiders_are_counted(
    copied: Path, keep: Callable[[Recorded], bool], step: Callable[[Recorded], int], notice: str
) -> None:
    rewrite(copied, keep, step)
    assert notice in notices(copied)


def test_a_frame_without_a_clock_is_played_at_its_regular_time(recorded: Callable[[str], Path], copied: Path) -> None:
    rewrite(copied, lambda message: not (message.key == "clock" and message.frame == 5))
    assert "clock is recorded" in notices(copied)
    pictures = [m.payload for m in read(recorded("baseline")) if m.key == "cc/picture"]
    assert Played(replay.resolve(copied, record=False).resolved).messages["cc/picture"] == pictures


def test_what_subscribers_received_is_played_though_a_node_came_during_the_run(
    recorded: Callable[[str], Path], copied: Path
) -> None:
    wire, tap = "agent/infra_1/tracks", "agent/infra_1/tracks/@tap/0"
    before = Wiring.from_json(json.loads((copied / "wiring.json").read_text()))
    after = insert(before, "mallory", InsertionPoint(wire, "tracks", "tracks_out"))
    messages = list(read(copied))
    (copied / "messages.mcap").unlink()
    log = MessageLog(copied / "messages.mcap")
    log.begin(after.ports("recorder").inputs)
    log.add_event(RecordedEvent(REWIRED, -1, wiring=before.to_json()))
    log.add_event(RecordedEvent(REWIRED, 7, wiring=after.to_json()))
    for message in messages:
        header = codec.decode_header(message.payload, message.message)
        for key in (message.key, tap) if message.key == wire and message.frame > 7 else (message.key,):
            log.add(key, message.payload, header, message.step)
    log.close()
    edit_json(copied / "wiring.json", **after.to_json())
    assert "inserted or removed" in notices(copied)
    prepared = replay.resolve(copied, record=False)
    assert "mallory" not in prepared.resolved.nodes
    pictures = [m.payload for m in read(recorded("baseline")) if m.key == "cc/picture"]
    assert Played(prepared.resolved).messages["cc/picture"] == pictures


def test_circumstances_of_the_recorded_run_are_named(copied: Path) -> None:
    versions = json.loads((copied / "run.json").read_text())["versions"] | {"mast-zenoh": "0.0.9"}
    churn = [{"frame": 5, "node": "infra_1", "what": "lost"}]
    recording = {"complete": False, "from_frame": 4}
    edit_json(copied / "run.json", mode="realtime", versions=versions, churn=churn, recording=recording)
    edit_json(copied / "run.json", status="node_lost", message="infra_1 was lost")
    edit_json(copied / "scenario.json", network={"hosts": {}})
    (copied / "scene.npz").unlink()
    text = notices(copied)
    edit_json(copied / "run.json", status="running", launcher=liveness.identity() | {"machine": "elsewhere"})
    text += notices(copied)
    for part in (
        "ended as 'node lost': infra_1 was lost",
        "recorded by mast-zenoh 0.0.9, replayed by",
        "recorded in real time",
        "has not ended, by its run.json",
        "hosts in network namespaces",
        "infra_1 was lost before frame 5 in the recorded run",
        "incomplete from frame 4 onwards",
        "scene.npz cannot be read",
    ):
        assert part in text, part


def damage(folder: Path) -> None:
    file = folder / "messages.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 0xFF
    file.write_bytes(bytes(data))


def run_it(folder: Path) -> None:
    edit_json(folder / "run.json", status="running", launcher=liveness.identity())


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda folder: (folder / "messages.mcap").unlink(), "expected the recording"),
        (lambda folder: (folder / "scenario.json").unlink(), r"scenario.json.*wiring.json.*read"),
        (damage, "damaged"),
        (run_it, r"still.*progress"),
        (lambda folder: rewrite(folder, lambda message: False), "no whole frame"),
        (lambda folder: rewrite(folder, lambda message: message.message != "clock"), "clock's wire"),
        (lambda folder: rewrite(folder, lambda message: message.message != "tracks"), "receives as 'tracks'"),
    ],
)
def test_a_recording_that_cannot_be_replayed_is_refused(
    copied: Path, spoil: Callable[[Path], None], reason: str
) -> None:
    spoil(copied)
    with pytest.raises(RunFolderError, match=reason):
        replay.resolve(copied)


NODE = """
from mast_zenoh.node import Node


class Mute(Node):
    role = "command_center"
    inputs = {inputs}
    outputs = {outputs}

    def on_clock(self, received, context):
        pass

    def on_collated(self, received, context):
        pass
"""


@pytest.mark.parametrize(
    ("setting", "error", "reason"),
    [
        ("x=1", ConfigurationError, "no launch-time parameters"),
        ("command_center.pipeline", ConfigurationError, "expected KEY=VALUE"),
        ("agents.infra_1.status_every=2", ConfigurationError, r"played.*recording"),
        ("scene.n=2", ConfigurationError, r"nodes.*command_center, evaluator"),
        ("comand_center.x=2", ConfigurationError, "mean 'command_center'"),
        ("command_center.pipelin.x=2", ConfigurationError, "mean 'pipeline'"),
        ("broker.patience=-1", ConfigurationError, "0 or more"),
        ("command_center.file=nosuch.py", NodeFileError, r"node file 'nosuch.py'"),
        ("broker.file=another.py", NodeFileError, r"role 'command_center'.*'broker'"),
        ("command_center.file=another.py", WiringError, r"'tracks' messages.*'collated'"),
    ],
)
def test_a_setting_that_does_not_fit_is_refused(
    recorded: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    setting: str,
    error: type[MastError],
    reason: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    ports = dict(inputs={"clock": "clock", "collated": "tracks"}, outputs={"picture": "picture"})
    (tmp_path / "another.py").write_text(NODE.format(**ports))
    with pytest.raises(error, match=reason):
        replay.resolve(recorded("baseline"), settings=[setting])


def test_a_command_center_that_publishes_no_picture_has_no_picture_wire(
    recorded: Callable[[str], Path], tmp_path: Path
) -> None:
    """From the agents, no node needs the picture; from the simulator, agents do."""
    (tmp_path / "mute.py").write_text(NODE.format(inputs={"clock": "clock", "collated": "collated"}, outputs={}))
    settings = [f"command_center.file={tmp_path / 'mute.py'}"]
    wires = replay.resolve(recorded("baseline"), settings=settings).resolved.wiring["wires"]
    assert "cc/picture" not in {wire["key"] for wire in wires}
    with pytest.raises(WiringError, match="output port 'picture'"):
        replay.resolve(recorded("baseline"), "simulator", settings=settings)


def test_a_spoofed_run_is_replayed_from_its_agents_and_needs_recorded_scans_from_its_simulator(tmp_path: Path) -> None:
    resolved = scenario.resolve(*scenario.load("spoofed", ["n_infrastructure=1"]), frames=4, record=True)
    folder = launcher.run(resolved, tmp_path / "run", runtime="inproc").folder
    assert notices(folder) == ""
    with pytest.raises(RunFolderError, match=r"found no message on agent/infra_1/points.*with points.recorded=true"):
        replay.resolve(folder, "simulator")
