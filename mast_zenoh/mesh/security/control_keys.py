"""Ed25519 keys (RFC 8032) for signing control messages, new for every run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

from mast_zenoh.errors import CredentialsError

#: The signers of control messages; no other process has a private key.
DRIVER, LAUNCHER = "driver", "launcher"

_BYTES = 32  # of a key, private or public


@dataclass(frozen=True)
class ControlKeys:
    """The control keys of one process; raw keys, 32 bytes each.

    public:  by signer, DRIVER or LAUNCHER
    private: the process's own; empty for one that only verifies
    """

    public: Mapping[str, bytes]
    private: bytes = field(default=b"", repr=False)

    def to_json(self) -> bytes:
        """The content of a node's control.json."""
        keys = {name: key.hex() for name, key in self.public.items()}
        return json.dumps(keys | ({"private": self.private.hex()} if self.private else {})).encode()

    @classmethod
    def from_json(cls, content: bytes, where: str) -> ControlKeys:
        """The keys that `to_json` wrote; otherwise CredentialsError, naming `where`."""
        if not content:
            raise CredentialsError(f"{where}: is missing")
        try:
            keys = {name: bytes.fromhex(key) for name, key in json.loads(content).items()}
        except (ValueError, TypeError, AttributeError):
            raise CredentialsError(f"{where}: expected a JSON map of keys in hexadecimal digits") from None
        private = keys.pop("private", b"")
        lengths = {len(key) for key in (*keys.values(), *([private] if private else []))}
        if keys.keys() != {DRIVER, LAUNCHER} or lengths != {_BYTES}:
            raise CredentialsError(f"{where}: expected the keys {DRIVER} and {LAUNCHER}, of {_BYTES} bytes each")
        return cls(keys, private)


def make() -> dict[str, ControlKeys]:
    """Make new keys: for DRIVER, for LAUNCHER, and under "" for all other processes."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # slow to load

    keys = {name: Ed25519PrivateKey.generate() for name in (DRIVER, LAUNCHER)}
    public = {name: key.public_key().public_bytes_raw() for name, key in keys.items()}
    signing = {name: ControlKeys(public, key.private_bytes_raw()) for name, key in keys.items()}
    return signing | {"": ControlKeys(public)}
