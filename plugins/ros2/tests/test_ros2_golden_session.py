"""A recorded session of the bridge: keys, tokens, attachments and payloads of a tiny run, byte by byte.

After a change that is meant to change them, this writes the session again:

    PYTHONPATH=tests/support python tests/viewer/test_ros2_golden_session.py
"""

import base64
import json
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from launched import eventually
from mast_ros2.attachments import GID_BYTES, MessageAttachment, gid_of, parse_attachment
from mast_ros2.bridge import NODE, Ros2Bridge
from mast_ros2.liveliness_tokens import EndpointToken, parse_token
from mast_ros2.mesh import Connection
from mast_ros2.participant import Participant
from mast_ros2.type_store import STORE, decode
from ros2_client import plain_message, ros2_router
from ros2_keys import parse_data_key
from tiny_world import tiny

from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.session import open_client
from mast_zenoh.runs.recorded import frames_of, open_recorded

GOLDEN = Path(__file__).parent / "ros2_golden_session.json"
_SESSION = "5e5510f0"


def recorded_session(folder: Path) -> dict[str, Any]:
    """What the bridge puts on a router, with the id of its session and the wall times replaced."""
    resolved = tiny("defended", "n_adversaries=0", infrastructure=1, frames=2, record=True)
    launcher.run(resolved, folder / "run", runtime="inproc")
    run = open_recorded(folder / "run")
    samples: list[zenoh.Sample] = []
    with ros2_router() as router, open_client(router) as listener:
        take: Any = zenoh.handlers.Callback(samples.append, indirect=False)
        listener.declare_subscriber("7/**", take)
        with Participant(Connection(router, domain=7), NODE, "/mast") as participant:
            bridge = Ros2Bridge(run, participant, "/mast")
            for frame in frames_of(run):
                bridge.publish(frame)
            sent = sum(publisher.sent for publisher in bridge._publishers.values())
            eventually(lambda: len(samples) == sent, "all messages", 20)
            replies = listener.liveliness().get("@ros2_lv/7/**", timeout=5.0)
            tokens = sorted({str(reply.ok.key_expr) for reply in replies if reply.ok is not None})
            session = participant._node.session
    publishers = [each for each in map(parse_token, tokens) if isinstance(each, EndpointToken)]
    gids = {gid_of(each.write()): each.topic for each in publishers}
    messages = []
    for sample in samples:
        assert sample.attachment is not None
        data = sample.attachment.to_bytes()
        attachment = parse_attachment(data)
        assert gids[attachment.gid] == parse_data_key(str(sample.key_expr)).topic
        assert data == attachment.write()
        messages.append(
            {
                "key": str(sample.key_expr),
                "attachment": MessageAttachment(attachment.sequence, 0, bytes(GID_BYTES)).write().hex(),
                "payload": base64.b64encode(zlib.compress(sample.payload.to_bytes(), 9)).decode(),
            }
        )
    return {"tokens": [token.replace(session, _SESSION) for token in tokens], "messages": messages}


def payload_of(message: dict[str, str]) -> bytes:
    return zlib.decompress(base64.b64decode(message["payload"]))


def test_a_session_of_the_bridge_is_the_recorded_one(tmp_path: Path) -> None:
    golden, found = json.loads(GOLDEN.read_text()), recorded_session(tmp_path)
    assert found["tokens"] == golden["tokens"]
    for name in ("key", "attachment"):
        assert [each[name] for each in found["messages"]] == [each[name] for each in golden["messages"]]
    for own, recorded in zip(found["messages"], golden["messages"], strict=True):
        if payload_of(own) != payload_of(recorded):  # processors differ in the last bit of a fused number
            assert_nearly_equal(own, recorded)


def assert_nearly_equal(own: dict[str, str], recorded: dict[str, str]) -> None:
    kind = parse_data_key(own["key"]).type_name
    numbers = [numbers_in(plain_message(decode(kind, payload_of(each)), STORE.fielddefs)) for each in (own, recorded)]
    assert len(payload_of(own)) == len(payload_of(recorded)), own["key"]
    np.testing.assert_allclose(*numbers, rtol=1e-9, atol=1e-9, err_msg=own["key"])


def numbers_in(value: Any) -> list[float]:
    """All numbers of a message, in order."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [number for each in value for number in numbers_in(each)]
    return [] if isinstance(value, str) else [float(value)]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        GOLDEN.write_text(json.dumps(recorded_session(Path(place)), indent=1) + "\n")
