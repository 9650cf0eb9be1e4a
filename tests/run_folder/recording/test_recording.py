"""A recording holds every byte sent, in order, up to its last whole chunk."""

import json
import os
import random
import re
import signal
import subprocess
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC, Writer
from recordings import HEARS, PERIOD_NS, TAP, add, begun, payload, small_run, write

from mast_zenoh.errors import RunFolderError
from mast_zenoh.messages import codec
from mast_zenoh.messages.layout import MAX_BYTES
from mast_zenoh.run_folder.recording import writer
from mast_zenoh.run_folder.recording.format import JOINED, LEFT, REWIRED, RecordedEvent
from mast_zenoh.run_folder.recording.reader import events, first_missing_frame, read
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.sensing.points import Points
from mast_zenoh.wiring.model import Input

PAGE = Path(__file__).parents[3] / "docs" / "how-to-record-and-replay.md"


@pytest.mark.parametrize("chunk_bytes", [1 << 20, 2000, 1], ids=["one chunk", "some chunks", "a chunk a message"])
def test_messages_are_read_in_the_order_of_frame_wire_publisher_and_sequence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_bytes: int
) -> None:
    monkeypatch.setattr(writer, "CHUNK_BYTES", chunk_bytes)
    sent = small_run()
    for shuffle in range(5):
        shuffled = random.Random(shuffle).sample(sent, len(sent))
        messages = list(read(write(tmp_path / f"{shuffle}.mcap", shuffled)))
        assert [(message.frame, message.wire, message.tap) for message in messages] == [
            (frame, key.split("/@")[0], "@" in key) for frame in range(6) for key in sorted(HEARS)
        ]
        assert [(message.key, message.payload) for message in messages] == sent


@pytest.mark.parametrize("chunk_bytes", [1 << 20, 2000, 1], ids=["one chunk", "some chunks", "a chunk a message"])
def test_messages_of_some_frames_and_wires_are_those_among_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_bytes: int
) -> None:
    monkeypatch.setattr(writer, "CHUNK_BYTES", chunk_bytes)
    path = write(tmp_path / "run.mcap", random.Random(1).sample(small_run(), len(small_run())))
    every = [message for message in read(path) if message.wire != "clock"]
    for frames in ([], [0], [5], [1, 4], [*range(6)]):
        times_ns = np.array(frames, np.int64) * PERIOD_NS
        some = [
            each for each in read(path, lambda channel: channel["wire"] != "clock", times_ns) if each.frame in frames
        ]
        assert some == [each for each in every if each.frame in frames], "channels of skipped chunks are known"


def test_messages_of_one_frame_on_one_wire_keep_their_sequence_order_and_duplicates_that_of_arrival(
    tmp_path: Path,
) -> None:
    sent = [("agent/a/status", payload("agent/a/status", 3, seq=seq)) for seq in (2**40, 0, 7, 2)]
    assert [message.seq for message in read(write(tmp_path / "run.mcap", sent))] == [0, 2, 7, 2**40]
    sent = [("clock", payload("clock", 0)), ("agent/a/status", payload("agent/a/status", 0))]
    twice = payload("agent/a/status", 0, {name: [9] for name in ("mobile", "detections", "tracks")})
    messages = list(read(write(tmp_path / "twice.mcap", [*sent, ("agent/a/status", twice)])))
    assert [message.payload for message in messages] == [sent[1][1], twice, sent[0][1]]


def test_a_key_added_later_is_recorded_like_the_others(tmp_path: Path) -> None:
    hears = {key: heard for key, heard in HEARS.items() if key == "clock"}
    log = MessageLog(tmp_path / "run.mcap")
    log.begin(hears)
    hears |= HEARS
    sent = small_run()
    add(log, [*random.Random(1).sample(sent, len(sent)), (TAP, b"nonsense")])
    log.close()
    messages = list(read(tmp_path / "run.mcap"))
    assert [(message.key, message.payload) for message in messages if not message.malformed] == sent
    assert sum(message.malformed for message in messages) == 1


def test_the_step_in_which_a_message_was_sent_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "CHUNK_BYTES", 3000)
    log = begun(tmp_path / "run.mcap")
    steps = {}
    for number, (key, data) in enumerate(random.Random(3).sample(small_run(), len(small_run()))):
        header = codec.decode_header(data, HEARS[key].message)
        steps[key, header.frame] = header.frame + number % 3
        log.add(key, data, header, steps[key, header.frame])
    log.add_malformed(TAP, b"nonsense", 4, 4 * PERIOD_NS, 4)
    log.close()
    messages = list(read(tmp_path / "run.mcap"))
    assert {(message.key, message.frame): message.step for message in messages if not message.malformed} == steps
    assert [message.step for message in messages if message.malformed] == [4]


def test_of_a_message_that_is_too_long_the_beginning_is_recorded_as_malformed(tmp_path: Path) -> None:
    log = begun(tmp_path / "run.mcap")
    key, data = small_run()[0]
    log.add(key, data + bytes(5 * MAX_BYTES), codec.decode_header(data, HEARS[key].message), 0)
    log.close()
    (recorded,) = read(tmp_path / "run.mcap")
    assert (recorded.malformed, len(recorded.payload)) == (True, MAX_BYTES)


nodes = st.text(max_size=20)
happened = st.one_of(
    st.builds(RecordedEvent, st.sampled_from([JOINED, LEFT]), st.integers(-1, 10**9), nodes, nodes),
    st.builds(
        RecordedEvent,
        st.just(REWIRED),
        st.integers(-1, 10**9),
        wiring=st.dictionaries(st.text(max_size=9), st.lists(st.integers(-9, 9) | st.text(max_size=9), max_size=3)),
    ),
)


@given(events_sent=st.lists(happened, max_size=5))
def test_events_are_kept_in_order(tmp_path_factory: pytest.TempPathFactory, events_sent: list[RecordedEvent]) -> None:
    path = tmp_path_factory.mktemp("events") / "run.mcap"
    log = begun(path)
    sent = small_run(3)
    for number, message in enumerate(sent):
        add(log, [message])
        if number < len(events_sent):
            log.add_event(events_sent[number])
    log.close()
    assert events(path) == events_sent[: len(sent)]
    assert [message.payload for message in read(path)] == [data for _, data in sent]


@pytest.mark.parametrize(
    ("name", "metadata"),
    [
        ("event", {}),
        ("event", {"what": "exploded", "frame": "3", "node": "a", "role": "agent"}),
        ("event", {"what": "left", "frame": "three", "node": "a", "role": "agent"}),
        ("event", {"what": "rewired", "frame": "3", "wiring": "["}),
        ("event", {"what": "rewired", "frame": "3", "wiring": "[]"}),
        ("steps", {"0": "soon"}),
    ],
)
def test_invalid_metadata_is_refused_with_its_fault(tmp_path: Path, name: str, metadata: dict[str, str]) -> None:
    path = tmp_path / "run.mcap"
    log = begun(path)
    log._writer.add_metadata(name, metadata)
    log.close()
    with pytest.raises(RunFolderError, match=r"run\.mcap.*damaged metadata"):
        events(path)
    with pytest.raises(RunFolderError, match="damaged metadata"):
        list(read(path))


def test_other_readers_understand_channels_metadata_and_schemas(tmp_path: Path) -> None:
    with write(tmp_path / "run.mcap", small_run()).open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        messages = list(reader.iter_messages())
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert channels.keys() == HEARS.keys()
    assert channels[TAP].metadata == {
        "wire": "agent/b/detections",
        "publisher": "simulator",
        "message": "detections",
        "tap": "true",
        "malformed": "false",
    }
    assert {channel.message_encoding for channel in channels.values()} == {"msgpack"}
    schema = summary.schemas[channels["agent/b/detections"].schema_id]
    assert (schema.name, schema.encoding) == ("detections.1", "jsonschema")
    column = json.loads(schema.data)["properties"]["body"]["properties"]["position"]
    assert (column["unit"], column["prefixItems"][0]["const"], column["prefixItems"][1]["description"]) == (
        "m",
        "<f8",
        "n, 3",
    )
    assert [message.data for _, _, message in messages] == [data for _, data in small_run()]
    for _, channel, message in messages:
        header = codec.decode_header(message.data, channel.metadata["message"])
        assert message.publish_time == header.time_ns
        assert 0 <= message.log_time - header.time_ns < len(HEARS)
        assert message.sequence == header.seq


def test_malformed_messages_are_kept_unchanged_and_marked(tmp_path: Path) -> None:
    rubbish = [b"", b"\xc1", payload("agent/a/status", 1)[:-3], payload("clock", 1)]
    sent = [*small_run(3), *(("agent/a/status", data) for data in rubbish)]
    messages = list(read(write(tmp_path / "run.mcap", sent)))
    marked = [message for message in messages if message.malformed]
    assert [message.payload for message in marked] == rubbish
    assert {(m.key, m.wire, m.frame, m.time_ns) for m in marked} == {
        ("agent/a/status/@malformed", "agent/a/status", -1, 2 * PERIOD_NS)
    }
    assert len(messages) - len(marked) == len(small_run(3))


def test_a_truncated_file_is_readable_up_to_its_last_whole_chunk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends: list[tuple[int, int]] = []  # (bytes, messages) of the file after each chunk
    monkeypatch.setattr(writer, "CHUNK_BYTES", 4000)
    flush = Writer.flush

    def noted(self: Writer) -> None:
        flush(self)
        ends.append((path.stat().st_size, len(ends) + 1))

    monkeypatch.setattr(Writer, "flush", noted)
    path = tmp_path / "run.mcap"
    write(path, small_run(12))
    data, whole = path.read_bytes(), [message.payload for message in read(path)]
    assert len(ends) > 3
    cut = tmp_path / "cut.mcap"
    before = 0
    for size in range(8, len(data), 23):
        cut.write_bytes(data[:size])
        payloads = [message.payload for message in read(cut)]
        assert payloads == whole[: len(payloads)]
        assert len(payloads) >= before, "whole chunks stay intact"
        before = len(payloads)
    assert before == len(whole)
    for end, chunks in ends:
        cut.write_bytes(data[:end])
        assert len(list(read(cut))) >= min(chunks, 1), "a written chunk can be read"


def test_a_killed_process_leaves_all_whole_chunks(tmp_path: Path) -> None:
    program = (
        "import os, signal\n"
        "from pathlib import Path\n"
        "from recordings import add, begun, small_run\n"
        "log = begun(Path('run.mcap'))\n"
        "add(log, small_run(60))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, check=False)
    assert ended.returncode == -signal.SIGKILL
    messages = [(message.key, message.payload) for message in read(tmp_path / "run.mcap")]
    assert messages == small_run(60)[: len(messages)]
    assert {frame for frame in range(60) if ("clock", payload("clock", frame)) in messages} >= set(range(50))


def test_a_recording_without_messages_is_readable(tmp_path: Path) -> None:
    log = begun(tmp_path / "run.mcap")
    assert list(read(tmp_path / "run.mcap")) == []
    log.close()
    assert list(read(tmp_path / "run.mcap")) == []


def test_a_chunk_with_an_impossible_size_is_refused_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "run.mcap", small_run())
    unpacked = MagicMock()
    monkeypatch.setattr("zstandard.decompress", unpacked)
    monkeypatch.setattr("mast_zenoh.run_folder.recording.reader.MAX_CHUNK_BYTES", 100)
    with pytest.raises(RunFolderError, match=r"run\.mcap.*damaged chunk"):
        list(read(path))
    unpacked.assert_not_called()


@pytest.mark.parametrize("kind", [*range(1, 6), *range(7, 18), 255])
def test_no_chunk_hides_behind_another_kind_of_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: int
) -> None:
    monkeypatch.setattr(writer, "CHUNK_BYTES", 2000)
    path = write(tmp_path / "run.mcap", small_run(40))
    content, at, chunks = bytearray(path.read_bytes()), len(MCAP0_MAGIC), []
    while content[at] != Opcode.DATA_END:
        chunks += [at] if content[at] == Opcode.CHUNK else []
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    for chunk in (chunks[1], chunks[-1]):
        changed = content.copy()
        changed[chunk] = kind
        path.write_bytes(changed)
        with pytest.raises(RunFolderError):
            list(read(path))


def test_an_end_that_claims_to_be_longer_than_any_file_hides_no_message(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", small_run())
    content, sent = bytearray(path.read_bytes()), list(read(path))
    at = len(MCAP0_MAGIC)
    while content[at] != Opcode.DATA_END:
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    after = at + 9 + 4
    content[after + 1 : after + 9] = (2**63).to_bytes(8, "little")
    path.write_bytes(content)
    assert list(read(path)) == sent


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda folder: folder / "nowhere", "no such folder"),
        (lambda folder: folder, r"not.*folder.*run"),
        (lambda folder: (folder / "run.json").write_text("{}") and folder, r"run.*not recorded"),
        (
            lambda folder: (folder / "x.mcap").write_text("hello") and folder / "x.mcap",
            r"does.*begin.*MCAP",
        ),
        (lambda folder: (folder / "x.mcap").write_text("") == 0 and folder / "x.mcap", r"does.*begin.*MCAP"),
    ],
)
def test_a_file_that_is_not_a_recording_is_refused(tmp_path: Path, make, reason: str) -> None:
    with pytest.raises(RunFolderError, match=reason):
        list(read(make(tmp_path)))


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", small_run())
    with pytest.raises(RunFolderError, match=r"create.*recording.*exists"):
        MessageLog(path).begin(HEARS)


def test_a_recording_stays_readable_when_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "CHUNK_BYTES", 2000)
    log = begun(tmp_path / "run.mcap")
    sent = small_run(40)
    add(log, sent[:100])

    def full(self: Writer) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "flush", full)
    add(log, sent[100:])
    log.close()
    assert "written: No space" in log.problem
    assert 0 < log.messages <= 100
    assert log.messages + log.lost == len(sent)
    assert len(list(read(tmp_path / "run.mcap"))) == log.messages


def test_the_program_in_the_documentation_reads_a_recording(tmp_path: Path) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.S | re.M)
    assert len(program.splitlines()) <= 14
    write(tmp_path / "messages.mcap", small_run(3))
    process = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60
    )
    assert process.returncode == 0, process.stderr
    assert "agent/b/detections 2 (2, 3)" in process.stdout


def without(path: Path, *missing: tuple[str, int]) -> Path:
    """A recording of the small run without some messages, each as (key, frame)."""
    keys = [(key, number // 5) for number, (key, _) in enumerate(small_run())]
    return write(path, [sent for at, sent in zip(keys, small_run(), strict=True) if at not in missing])


@pytest.mark.parametrize(
    ("missing", "first"),
    [
        ((), None),
        ((("clock", 3),), 3),
        ((("clock", 0),), 0),
        ((("clock", 4), ("agent/b/detections", 2), (TAP, 2)), 2),
        ((("agent/b/detections", 2),), None),  # an interposer dropped it: it was heard before the interposer
        ((("clock", 5),), None),  # nothing indicates that there was one more
        ((("agent/a/status", 3),), None),  # of another publisher
    ],
)
def test_a_gap_in_a_publishers_sequence_is_found(
    tmp_path: Path, missing: tuple[tuple[str, int], ...], first: int | None
) -> None:
    assert first_missing_frame(without(tmp_path / "run.mcap", *missing), "simulator") == first


def test_scans_that_are_recorded_only_while_they_are_intercepted_leave_no_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key, turn = "agent/a/points", np.array([1.0, 0.0, 0.0, 0.0])
    others = small_run()
    monkeypatch.setitem(HEARS, key, Input("everything", "a", "points", "simulator"))
    body = Points.empty().columns() | dict(mount_position=np.zeros(3), mount_rotation=turn, level_rotation=turn)
    sent = [(key, payload(key, frame, body)) for frame in (2, 3, 5)]
    path = write(tmp_path / "run.mcap", [*others, *sent])
    assert first_missing_frame(path, "simulator") == 0
    assert first_missing_frame(path, "simulator", scans=False) is None


def test_an_unreadable_recording_may_lack_everything(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"no recording")
    assert first_missing_frame(tmp_path / "run.mcap", "simulator") == 0
    assert len(list(read(without(tmp_path / "whole.mcap")))) == len(small_run())
