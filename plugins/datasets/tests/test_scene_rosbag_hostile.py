"""A ROS 2 bag of anybody's costs an error that names the file: never a crash, code, or reading outside its folder."""

import contextlib
import copy
import json
import shutil
import sqlite3
import struct
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import mast_datasets
import numpy as np
import pytest
import zstandard
from comparison import junction
from damages import ANYTHING, Damage, assert_refused, content, places_of, removed, text
from hypothesis import given, settings
from hypothesis import strategies as st
from mast_datasets import RosBag, rosbag_storage
from mast_datasets.rosbag import parse_map
from mast_datasets.rosbag_reading import DetectionReader
from mast_datasets.rosbag_storage import OwnType, parse_definition
from mast_ros2 import type_store
from mast_ros2.object_messages import tracked_objects
from rosbag_writer import Sent, pose_stamped, write_bag, write_recording
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat

from mast_zenoh.errors import ConfigurationError, MastError, MessageError, SceneError

POSE = dict(topic="/pose")
HEADER = {"stamp": {"sec": 1, "nanosec": 1}, "frame_id": "a"}
MAP = dict(frames=dict(map={}), agents=dict(ego=dict(pose=POSE, detections=dict(kind="lidar"))))


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag in SQLite3 with its map."""
    return write_recording(tmp_path_factory.mktemp("sound") / "bag", junction(frames=4))


@pytest.fixture
def bag(sound: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(sound, tmp_path / "bag"))


@pytest.fixture(scope="module")
def sound_mcap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag in MCAP with its map."""
    folder = write_recording(tmp_path_factory.mktemp("sound") / "mcap", junction(frames=4), "mcap, zstd chunks")
    read(folder)
    return folder


@pytest.fixture
def mcap(sound_mcap: Path, tmp_path: Path) -> Path:
    """A copy of it, to be damaged."""
    return Path(shutil.copytree(sound_mcap, tmp_path / "mcap"))


def read(folder: Path) -> object:
    return RosBag(path=str(folder)).record(0, None)


def sql(*statements: str) -> Damage:
    """Run SQL in the database of a bag."""

    def change(root: Path) -> None:
        with contextlib.closing(sqlite3.connect(root / "bag.db3")) as connection:
            for statement in statements:
                connection.execute(statement)
            connection.commit()

    return Damage("bag.db3", change)


def link(file: str, target: str) -> Damage:
    """Put a link in the place of a file."""

    def change(root: Path) -> None:
        outside = root.parent / "outside"
        (root / file).rename(outside)
        (root / file).symlink_to(target or outside)

    return Damage(file, change)


GENERATED = "(topic_id INTEGER, timestamp INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)))"
COPY = "CREATE TABLE copy AS SELECT * FROM messages"


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        *(
            (text("metadata.yaml", "- bag.db3", f"- {name}")._replace(file=Path(name.strip("'")).name), "no such file")
            for name in ("../outside.db3", "/etc/passwd", "a/b/other.db3", "'a?mode=rwc'", "missing.db3", ".")
        ),
        (text("metadata.yaml", "rosbag2_bagfile_information", "information"), "rosbag2_bagfile_information is missing"),
        (content("metadata.yaml", b"a: &a [*a]"), "found unconstructable recursive node"),
        (content("metadata.yaml", b"!!python/object/apply:os.system [ls]"), "could not determine a constructor"),
        (content("metadata.yaml", b"[" * 100_000), "not YAML|nested deeper"),
        (removed("bag.db3"), "found no such file"),
        (link("bag.db3", ""), "found a link"),
        (link("bag.db3", "/dev/zero"), "found a link"),
        (link("metadata.yaml", ""), "found a link"),
        (content("bag.db3", b"no database"), "cannot be read as a bag: .* file is not a database"),
        (content("bag.db3", b"SQLite format 3\0" + bytes(5000)), "file is not a database"),
        (content("bag.db3-wal", b"x"), "has a change that is not in the bag, expected a closed bag"),
        (content("bag.db3-journal", b"\xd9\xd5\x05\xf9"), "has a change that is not in the bag, expected a closed bag"),
        (sql("DROP TABLE messages"), "cannot be read as a bag"),
        (sql("ALTER TABLE topics DROP COLUMN type"), "no such column: type"),
        (sql(COPY, "DROP TABLE messages", "CREATE VIEW messages AS SELECT * FROM copy"), "database missing tables"),
        (sql("DROP TABLE messages", f"CREATE TABLE messages {GENERATED}"), "cannot be read as a bag"),
        (sql("UPDATE messages SET data = zeroblob(20000000)"), "a message has more than 16777216 bytes"),
        (sql("UPDATE messages SET data = 'text'"), "found a message that is no bytes"),
        (sql("UPDATE messages SET timestamp = 'late'"), "cannot be read as a bag"),
        (sql("UPDATE topics SET name = zeroblob(100)"), "found a name of a topic"),
        (sql("UPDATE topics SET serialization_format = 'json'"), "found messages encoded as 'json', expected cdr"),
    ],
)
def test_a_hostile_folder_or_database_is_refused(damage: Damage, message: str, bag: Path) -> None:
    assert_refused(read, bag, damage, message)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (sql("UPDATE messages SET data = substr(data, 1, length(data) - 4)"), "message 0, .* cannot be read"),
        (sql("UPDATE messages SET data = x'00010000ffffffff'"), "cannot be read"),
        (sql("UPDATE topics SET type_description_hash = 'RIHS01_00'"), "another version .*hash RIHS01_00,"),
        (sql("UPDATE message_definitions SET encoded_message_definition = 'int32 x'"), "another version of tf2"),
        (sql("UPDATE message_definitions SET encoded_message_definition = '{'"), "cannot be read"),
        (sql("DELETE FROM messages"), "/tf has no messages"),
    ],
)
def test_messages_that_are_not_of_their_type_are_refused(damage: Damage, message: str, bag: Path) -> None:
    assert_refused(read, bag, Damage("bag", damage.apply), message)


def test_a_query_ends_that_takes_more_steps_than_a_sound_file_can(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 20000) "
    sql(f"{rows} INSERT INTO messages (topic_id, timestamp, data) SELECT 99, i, x'' FROM n").apply(bag)
    read(bag)
    monkeypatch.setattr(rosbag_storage, "_STEPS_ALWAYS", 10_000)
    monkeypatch.setattr(rosbag_storage, "_STEPS_PER_BYTE", 0)
    monkeypatch.setattr(rosbag_storage, "_STEPS_AT_ONCE", 1000)
    with pytest.raises(SceneError, match=r"bag\.db3: cannot be read as a bag: .*interrupted"):
        read(bag)


def test_an_empty_journal_is_no_reason_to_refuse_a_bag(bag: Path) -> None:
    (bag / "bag.db3-wal").touch()
    (bag / "bag.db3-journal").write_bytes(bytes(512))
    read(bag)


def test_a_bag_that_was_cut_off_is_refused_wherever(mcap: Path) -> None:
    whole = (mcap / "mcap.mcap").read_bytes()
    end = whole.rindex(b"\x0f" + struct.pack("<Q", 4))  # of the data; what follows is a summary
    for length in (8, 9, 100, end // 2, end - 1, end, end + 13, len(whole) - 30, len(whole) - 1):
        (mcap / "mcap.mcap").write_bytes(whole[:length])
        with pytest.raises(SceneError, match=r"mcap\.mcap: cannot be read as a bag"):
            read(mcap)


@pytest.mark.parametrize("kind", [0, 2, 7, 8, 9, 0x0C, 0x0F, 0x16, 0x80])
def test_a_chunk_whose_kind_is_damaged_makes_no_bag_shorter(kind: int, mcap: Path) -> None:
    damaged = bytearray((mcap / "mcap.mcap").read_bytes())
    first = len(MAGIC) + 9 + struct.unpack_from("<Q", damaged, len(MAGIC) + 1)[0]  # after the header
    assert damaged[first] == 6
    damaged[first] = kind
    (mcap / "mcap.mcap").write_bytes(damaged)
    with pytest.raises(SceneError, match=r"mcap\.mcap: .*found 0 messages, expected 4: the file is damaged"):
        read(mcap)


def record(opcode: int, data: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(data)) + data


def string(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def chunk(data: bytes, compression: str, size: int, crc: int = 0) -> bytes:
    return record(6, struct.pack("<QQQI", 0, 0, size, crc) + string(compression) + struct.pack("<Q", len(data)) + data)


MAGIC = b"\x89MCAP0\r\n"
END = record(15, bytes(4)) + record(2, bytes(20)) + MAGIC
BOMB = zstandard.compress(bytes(300_000_000))
SCHEMA = struct.pack("<H", 1) + string("a/msg/B") + string("ros2msg")
CHANNEL = record(4, struct.pack("<HH", 1, 9) + string("/pose") + string("cdr") + struct.pack("<I", 0))
ZSTD_OF_ZEROS = zstandard.compress(bytes(1000))


@pytest.mark.parametrize(
    ("records", "message"),
    [
        (chunk(BOMB, "zstd", 300_000_000), "found a chunk of 300000000 bytes unpacked"),
        (chunk(BOMB, "zstd", 1000), "Chunk size mismatch: expected 1000 bytes, got 1001"),
        (chunk(ZSTD_OF_ZEROS, "zstd", 999), "Chunk size mismatch: expected 999 bytes, got 1000"),
        (chunk(ZSTD_OF_ZEROS, "zstd", 1001), "Chunk size mismatch: expected 1001 bytes, got 1000"),
        (chunk(ZSTD_OF_ZEROS, "zstd", 1000, crc=1), "checksum"),
        (chunk(b"no frame", "zstd", 1000), "zstd decompress error"),
        (chunk(b"no frame", "lz4", 1000), "LZ4F_decompress failed"),
        (chunk(b"", "rar", 0), "Unsupported chunk compression 'rar'"),
        (chunk(struct.pack("<BQ", 5, 10**15), "", 9), "Truncated record"),
        (struct.pack("<BQ", 5, 2**63), "cannot be read as a bag"),
        (record(5, b""), "Invalid message record length 0"),
        (record(3, b"\1"), "cannot be read as a bag"),
        (record(4, struct.pack("<HH", 1, 9) + struct.pack("<I", 2**32 - 1)), "Truncated record"),
        (record(4, struct.pack("<HH", 1, 9) + string("/" * 2000) + string("cdr") + bytes(4)), "found a name of a"),
        (struct.pack("<BQ", 3, 2**40), "expected at most 268435456"),
        (record(3, SCHEMA + struct.pack("<I", 2) + b"\xff\xfe") + CHANNEL[:9] + b"\1\0\1\0" + CHANNEL[13:], "utf-8"),
    ],
)
def test_hostile_records_of_mcap_are_refused(records: bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    file.write_bytes(MAGIC + record(1, string("ros2") + string("")) + records + END)
    with pytest.raises(SceneError, match=rf"a\.mcap: .*{message}"):
        RosBag(path=str(file), topics=MAP).record(0, None)


def test_compressed_files_and_messages_unpack_to_their_limits_only(tmp_path: Path) -> None:
    source = junction(frames=4)
    files = write_recording(tmp_path / "files", source, "sqlite3, zstd file")
    with pytest.raises(SceneError, match=r"files\.db3\.zstd: unpacks to more than 0\.05 MB"):
        RosBag(path=str(files), max_unpacked_mb=0.05).record(0, None)
    (files / "files.db3.zstd").write_bytes(b"no frame")
    with pytest.raises(SceneError, match=r"files\.db3\.zstd: cannot be unpacked"):
        read(files)
    messages = write_recording(tmp_path / "messages", source, "sqlite3, zstd messages")
    with contextlib.closing(sqlite3.connect(messages / "messages.db3")) as connection:
        connection.execute("UPDATE messages SET data = ?", (zstandard.compress(bytes(100_000_000)),))
        connection.commit()
    with pytest.raises(SceneError, match=r"messages\.db3: .* a message has more than 16777216 bytes"):
        read(messages)


def test_absurd_times_are_refused_before_frames_are_made(tmp_path: Path) -> None:
    far = [Sent("/pose", time, pose_stamped(time, "map", (0.0, 0.0, 0.0))) for time in (-(10**18), 0, 10**8)]
    path = str(write_bag(tmp_path / "bag", far))
    with pytest.raises(SceneError, match=r"found 100000\d* frames from .* expected at most 200000"):
        RosBag(path=path, topics=MAP).record(0, None)


def test_times_that_overflow_are_left_out(bag: Path) -> None:
    (bag / "topics.toml").write_text('time = "received"\n' + (bag / "topics.toml").read_text())
    last = f"UPDATE messages SET timestamp = {2**63 - 1} WHERE id = (SELECT max(id) FROM messages)"
    sql(last, f"UPDATE messages SET timestamp = {-(2**63)} WHERE id = (SELECT min(id) FROM messages)").apply(bag)
    notes = RosBag(path=str(bag)).record(0, None).notes
    assert sum(f"left out: a time further than {2**61} ns from 1970" in note for note in notes) == 2


def test_names_of_topics_do_not_reach_the_terminal_as_they_are(bag: Path) -> None:
    sql("UPDATE topics SET name = '/a' || char(27, 91, 50, 74) || char(10) || 'b' WHERE name = '/objects'").apply(bag)
    with pytest.raises(ConfigurationError, match=r"\n  /a\[2Jb  autoware_perception_msgs/msg/TrackedObjects  4"):
        read(bag)


def message_of(value: Any) -> Any:
    """A message with the values of nested dicts and lists."""
    if isinstance(value, dict):
        return SimpleNamespace(__msgtype__="", **{name: message_of(each) for name, each in value.items()})
    return [message_of(each) for each in value] if isinstance(value, list) else value


GOOD = {"place": [1.0, 2.0, 3.0], "score": 0.5}


@pytest.mark.parametrize(
    ("message", "used"),
    [
        ({}, 0),
        ({"header": 5}, 0),
        ({"header": {"stamp": {"sec": "x", "nanosec": 1}, "frame_id": "a"}}, 0),
        ({"header": {"stamp": {"sec": 1, "nanosec": 1}, "frame_id": 7}}, 0),
        ({"header": HEADER, "list": np.zeros(3)}, 0),
        ({"header": HEADER, "list": [{}] * 1001}, 0),
        *(
            ({"header": HEADER, "list": [GOOD, element]}, 1)
            for element in (
                *(5, GOOD | {"score": "high"}, GOOD | {"score": 7.0}, {"place": {"x": 1.0, "y": 2.0}}),
                *({"place": [1.0, 2.0]}, {"place": ["a", "b", "c"]}, {"place": [1.0, 2.0, np.inf]}),
            )
        ),
    ],
)
def test_messages_of_an_own_type_with_other_values_are_left_out(message: dict[str, Any], used: int) -> None:
    fields = dict(list="list", position="place", score="score")
    sensor = dict(kind="camera", topic="/found", frame="a", fields=fields, size=[1.0, 1.0, 1.0], axes=["z", "-x", "-y"])
    bag_map = parse_map(dict(agents=dict(ego=dict(pose=POSE, detections=sensor))), Path("map"))
    (agent,) = bag_map.agents.values()
    reader = DetectionReader(agent.sensors[0], "map", bag_map)
    reader.add(message_of(message), 0)
    assert (reader.used, sum(reader.remarks.values())) == (used, 1)
    assert reader.measured().detections.position.tolist() == [[3.0, -1.0, -2.0]] * used


def test_poses_none_of_which_can_be_used_are_refused_with_the_reason(tmp_path: Path) -> None:
    nowhere = [Sent("/pose", time, pose_stamped(time, "map", (1e300, 0.0, 0.0))) for time in (0, 10**8)]
    with pytest.raises(SceneError, match=r"/pose: found 2 messages, none .*position: beyond 1e.07 m: 2"):
        RosBag(path=str(write_bag(tmp_path / "bag", nowhere)), topics=MAP).record(0, None)


def test_without_rosbags_the_error_says_how_to_get_it(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("rosbag_reading", "rosbag_recording", "rosbag_storage"):
        monkeypatch.delitem(sys.modules, f"mast_datasets.{module}")
        monkeypatch.delattr(mast_datasets, module)
    for module in [name for name in sys.modules if name.partition(".")[0] == "rosbags"]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigurationError, match=r"rosbags is not installed, .* pip install 'mast-zenoh\[ros2\]'"):
        read(bag)


@settings(max_examples=60, deadline=None)
@given(place=st.floats(0, 0.999), value=ANYTHING)
def test_any_map_is_read_or_refused(place: float, value: Any) -> None:
    source = dict(topic="/a", child="b", origin=dict(position=[0, 0, 0], yaw_deg=1.0), offset_s=0.5, time="header")
    sensor = dict(kind="camera", frame="c", topic="/d", axes=["z", "-x", "-y"], classes={"0": "car"}, size=[1, 1, 1])
    sensor |= dict(fields=dict(list="a.b", position="c"), azimuth_deg=[-10, 10], range_m=9.0, nearest_m=0.1)
    body = {"size": [1, 1, 1], "class": "car", "centre": [0, 0, 0]}
    whole: dict[str, Any] = dict(
        rate_hz=10.0,
        frames=dict(map={}),
        types={"a/msg/B": "int32 x"},
        agents=dict(ego=dict(pose=source, body=body, detections=[sensor])),
        truth=dict(one=source | body, all=dict(topic="/e", without=[1, "x"])),
    )
    whole = json.loads(json.dumps(whole))
    parse_map(copy.deepcopy(whole), Path("map"))
    places = places_of(whole)
    holder, key = places[int(len(places) * place)]
    holder[key] = value
    with contextlib.suppress(ConfigurationError):
        parse_map(whole, Path("map"))


def topic(kind: str, definition: str = "") -> Connection:
    form = MessageDefinitionFormat.MSG if definition else MessageDefinitionFormat.NONE
    return Connection(1, "/topic", kind, MessageDefinition(form, definition), "", 1, cast("Any", None), None)


@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_any_bytes_of_an_own_type_are_a_message_or_none(data: st.DataObject) -> None:
    kind = "vision_msgs/msg/Detection3DArray"
    payload = bytearray(type_store.encode(tracked_objects(junction(frames=4).truth_at(0), 7, "map"))[:400])
    for _ in range(data.draw(st.integers(0, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(MessageError):
        OwnType("bag", topic(kind), {}).decode(bytes(payload[: data.draw(st.integers(0, len(payload)))]))


@pytest.mark.parametrize(
    ("definition", "error", "message"),
    [
        ("a/Own inner\n", SceneError, "recursion"),
        ("uint8[0] data\n", SceneError, "a list of 0 elements"),
        ("string[600] a\na/Own[600] b\n", SceneError, "expected 1 to 1000 in all"),
        ("a/Other inner\n", ConfigurationError, "the bag has no definition of 'a/msg/Other'"),
        ("uint8[-3] data\n", SceneError, "a list of -3 elements"),
        ("int32 x; import os\n", SceneError, "cannot be read"),
        ("int32 x\n" * 50_000, SceneError, "a definition of 400000 characters"),
        ("uint8[" + "9" * 5000 + "] data\n", SceneError, "cannot be read"),
    ],
)
def test_hostile_definitions_are_refused(definition: str, error: type[MastError], message: str) -> None:
    with pytest.raises(error, match=message):
        OwnType("bag", topic("a/msg/Own", definition), {})


def test_lists_of_absurd_length_end_with_the_message() -> None:
    other = parse_definition("a/msg/Own2", "")
    for definition in ("string[999999999999] data\n", "a/Own2[999999999999] data\n"):
        with pytest.raises(SceneError, match="a list of 999999999999 elements"):
            OwnType("bag", topic("a/msg/Own", definition), other)
    for definition in ("uint8[999999999999] data\n", "float64[] data\n"):
        decode = OwnType("bag", topic("a/msg/Own", definition), {}).decode
        with pytest.raises(MessageError, match="a/msg/Own"):
            decode(b"\0\1\0\0" + b"\xff" * 4 + bytes(100))
