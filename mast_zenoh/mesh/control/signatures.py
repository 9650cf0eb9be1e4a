"""Signs and verifies control messages of the driver and the launcher.

A signed message is MessagePack [body, signature]. The Ed25519 signature (RFC 8032) covers the run's id, the key below
@control/ and the body, so it is not valid in another run, on another key or for another node. It does not prevent
replays, which have no effect: epochs count up, a step is carried out once, and a second stop changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import CONTROLS, codec
from mast_zenoh.mesh.security.control_keys import ControlKeys

T = TypeVar("T")

_ENVELOPE = 256  #: most bytes that a signature and its wrapping take


class Signatures:
    """Signs and checks the control messages of one run.

    keys:   None on an open mesh, where nothing is signed and everything is accepted
    obeyed: number of messages accepted without a signature
    """

    def __init__(self, run: str, keys: ControlKeys | None = None) -> None:
        self.obeyed = 0
        self._run = run
        self._keys = keys

    def sign(self, what: str, body: bytes) -> bytes:
        """Sign a message; what: its key below @control/, like "stop" or "leave/infra_1"."""
        if self._keys is None:
            return body
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # slow to load

        key = Ed25519PrivateKey.from_private_bytes(self._keys.private)
        return codec.encode((body, key.sign(self._covered(what, body))))

    def open(self, what: str, payload: bytes, decode: Callable[[bytes], T]) -> T:
        """Verify and decode a message.

        Raises MessageError if no permitted sender has signed it, and whatever `decode` raises.
        """
        if self._keys is None:
            message = decode(payload)
            self.obeyed += 1
            return message
        return decode(self._checked(what, payload, self._keys))

    def _checked(self, what: str, payload: bytes, keys: ControlKeys) -> bytes:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        kind = what.partition("/")[0]
        senders, max_bytes = CONTROLS[kind].senders, CONTROLS[kind].max_bytes + _ENVELOPE
        codec.fits(payload, kind, max_bytes)
        try:
            body, signature = codec.decode(tuple[bytes, bytes], payload, kind, max_bytes)
        except MessageError:
            expected = " or the ".join(senders)
            raise MessageError(f"{kind}: found no signature, expected that of the {expected}") from None
        for sender in senders:
            try:
                Ed25519PublicKey.from_public_bytes(keys.public[sender]).verify(signature, self._covered(what, body))
            except InvalidSignature:
                continue
            return body
        raise MessageError(f"{kind}: found a signature that is not that of the {' or the '.join(senders)}")

    def _covered(self, what: str, body: bytes) -> bytes:
        return b"\0".join((b"mast control", self._run.encode(), what.encode(), body))
