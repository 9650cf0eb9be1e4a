"""What a process trusts, and what it shows of itself: a folder of files, or the same in memory."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path

from mast_zenoh.errors import CredentialsError

AUTHORITY, CERTIFICATE, KEY, CONTROL = "ca.pem", "certificate.pem", "key.pem", "control.json"

#: In what is said of a router that may be there later: the only reason that time may take away.
UNREACHED = "cannot be reached"

#: Who else has a certificate. No node can have such a name: `@` is not allowed in one.
ROUTER, LAUNCHER = "@router", "@launcher"

#: How long certificates are valid unless said otherwise.
LIFETIME = timedelta(hours=12)

#: Longest common name (X.520, ub-common-name).
_LONGEST = 64


def common_name(run: str, name: str) -> str:
    """The common name in the certificate of a node of a run; shortened by a digest where X.520's 64 do not hold it."""
    full = f"{name}.{run}"
    if len(full) <= _LONGEST:
        return full
    return f"{full[:31]}~{hashlib.sha256(full.encode()).hexdigest()[:32]}"


@dataclass(frozen=True)
class Credentials:
    """PEM texts, and one in JSON; keys are never shown.

    authority:   certificate of the authority whose word is taken
    certificate: this process's own, and key: its private key; both empty for one that shows none
    control:     the keys of control messages, see `control_keys`; empty for a router, which checks none
    """

    authority: bytes
    certificate: bytes = b""
    key: bytes = field(default=b"", repr=False)
    control: bytes = field(default=b"", repr=False)

    @classmethod
    def read(cls, folder: Path) -> Credentials:
        """What `write` wrote; raises CredentialsError for a file that is missing or cannot be read."""

        def content(name: str) -> bytes:
            try:
                return (folder / name).read_bytes()
            except OSError as error:
                raise CredentialsError(f"{folder / name}: {error.strerror}") from None

        control = content(CONTROL) if (folder / CONTROL).exists() else b""
        if not (folder / CERTIFICATE).exists() and not (folder / KEY).exists():
            return cls(content(AUTHORITY), control=control)
        return cls(content(AUTHORITY), content(CERTIFICATE), content(KEY), control)

    def write(self, folder: Path) -> Path:
        """Into a folder of its own that nobody else may enter (0700); the key is nobody else's to read (0600)."""
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        names = (AUTHORITY, CERTIFICATE, KEY, CONTROL)
        for name, content in zip(names, (self.authority, self.certificate, self.key, self.control), strict=True):
            if content:
                handle = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
                with os.fdopen(handle, "wb") as file:
                    file.write(content)
        return folder

    def without_certificate(self) -> Credentials:
        """The same trust, and nothing to show."""
        return Credentials(self.authority, control=self.control)
