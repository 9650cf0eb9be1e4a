"""Above level "open", driver and launcher messages need a valid signature."""

from pathlib import Path

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.errors import CredentialsError, MessageError
from mast_zenoh.mesh import hosting
from mast_zenoh.mesh.control import CONTROLS
from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.security.control_keys import DRIVER, LAUNCHER, ControlKeys, make
from mast_zenoh.mesh.security.credentials import CONTROL, Credentials
from mast_zenoh.mesh.security.deployment import Deployment
from mast_zenoh.mesh.security.levels import LEVELS
from mast_zenoh.wiring.model import Wiring

KEYS = make()
NODE = Signatures("r", KEYS[""])
SIGNERS = {name: Signatures("r", KEYS[name]) for name in (DRIVER, LAUNCHER)}
SIGNED = {name: control for name, control in CONTROLS.items() if control.signed}


def refused(signatures: Signatures, what: str, payload: bytes) -> str:
    """The reason why a message is refused; its body is not decoded."""
    with pytest.raises(MessageError) as caught:
        signatures.open(what, payload, lambda body: pytest.fail("an unsigned body was decoded"))
    return str(caught.value)


def test_control_messages_reserved_for_driver_and_launcher_are_signed() -> None:
    assert {*SIGNED} == {"epoch", "stop", "leave", "act", "rewire"}


@pytest.mark.parametrize("what", SIGNED)
@pytest.mark.parametrize("signer", SIGNERS)
def test_a_message_signed_by_a_permitted_sender_is_accepted(what: str, signer: str) -> None:
    payload = SIGNERS[signer].sign(what, b"body")
    if signer in CONTROLS[what].senders:
        assert NODE.open(what, payload, bytes) == b"body"
        assert NODE.obeyed == 0
    else:
        assert "expected" not in (reason := refused(NODE, what, payload))
        assert reason.startswith(f"{what}: found a")


def test_a_signature_is_not_valid_for_another_run_key_or_node() -> None:
    leave = SIGNERS[LAUNCHER].sign("leave/ego", b"leave")
    assert NODE.open("leave/ego", leave, bytes) == b"leave"
    refused(NODE, "leave/infra_1", leave)
    refused(NODE, "stop", leave)
    refused(Signatures("another", KEYS[""]), "leave/ego", leave)
    refused(Signatures("r", make()[""]), "leave/ego", leave)
    body, signature = msgpack.unpackb(leave)
    refused(NODE, "leave/ego", msgpack.packb([body + b" now", signature]))


@given(
    st.binary(max_size=200)
    | st.recursive(st.none() | st.integers(0, 9) | st.binary(max_size=64), st.lists).map(msgpack.packb)
)
def test_any_other_payload_is_refused(payload: bytes) -> None:
    refused(NODE, "stop", payload)


@pytest.mark.parametrize("place", [0, 30, 60])
def test_one_flipped_bit_invalidates_a_signed_message(place: int) -> None:
    payload = bytearray(SIGNERS[DRIVER].sign("epoch", b"0123456789"))
    payload[place % len(payload)] ^= 1
    refused(NODE, "epoch", bytes(payload))


def test_an_oversized_message_is_refused_before_any_check() -> None:
    assert "bytes, expected" in refused(NODE, "stop", SIGNERS[DRIVER].sign("stop", b"x" * 10_000))


def test_on_an_open_mesh_every_valid_message_is_accepted_and_counted() -> None:
    plain = Signatures("r")
    assert plain.sign("stop", b"end") == b"end"
    assert plain.open("stop", b"end", bytes.decode) == "end"
    with pytest.raises(UnicodeDecodeError):
        plain.open("stop", b"\xff", bytes.decode)
    assert plain.obeyed == 1


@pytest.mark.parametrize("level", LEVELS[1:])
def test_every_node_can_verify_but_only_driver_and_launcher_can_sign(tmp_path: Path, level: str) -> None:
    common = {"prefix": "mast/r", "driver": "sim", "hosts": ["127.0.0.1"], "folder": tmp_path / "keys"}
    with Deployment(level, "r", Wiring(()), ["sim", "ego"], **common) as deployment:
        ego, sim = (hosting.signatures("r", deployment.of(name)) for name in ("ego", "sim"))
        assert deployment.control is not None
        stop = Signatures("r", deployment.control).sign("stop", b"end")
        assert [each.open("stop", stop, bytes) for each in (ego, sim)] == [b"end", b"end"]
        assert ego.open("epoch", sim.sign("epoch", b"1"), bytes) == b"1"
        keys = ControlKeys.from_json(Credentials.read(tmp_path / "keys" / "ego").control, "")
        assert keys.private == b""
        assert (tmp_path / "keys" / "ego" / CONTROL).stat().st_mode & 0o077 == 0
    assert "private" not in repr(KEYS[DRIVER])


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"{}", b'{"driver": 1, "launcher": ""}', b'{"driver": "00", "launcher": "00"}']
)
def test_invalid_keys_are_refused_with_their_location(tmp_path: Path, content: bytes) -> None:
    folder = Credentials(b"authority", control=content).write(tmp_path / "ego")
    with pytest.raises(CredentialsError, match=CONTROL):
        hosting.signatures("r", folder)
