"""Credentials of a process: authority, own certificate and keys; kept in files."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path

from mast_zenoh.errors import CredentialsError

AUTHORITY, CERTIFICATE, KEY, CONTROL = "ca.pem", "certificate.pem", "key.pem", "control.json"

#: Part of the message about an unreachable router, which may start later: the only problem that waiting may resolve.
UNREACHED = "cannot be reached"

#: Other holders of certificates. No node can have such a name: `@` is not allowed in one.
ROUTER, LAUNCHER, VIEWER = "@router", "@launcher", "@viewer"

#: Default validity of certificates.
LIFETIME = timedelta(hours=12)

#: Longest common name (X.520, ub-common-name).
_MAX_COMMON_NAME = 64


def common_name(run: str, name: str) -> str:
    """The common name of a node's certificate; a digest replaces its end if too long."""
    full = f"{name}.{run}"
    if len(full) <= _MAX_COMMON_NAME:
        return full
    return f"{full[:31]}~{hashlib.sha256(full.encode()).hexdigest()[:32]}"


@dataclass(frozen=True)
class Credentials:
    """Certificates and key as PEM, control keys as JSON; the repr omits keys.

    authority:   certificate of the trusted authority
    certificate: this process's own; key: its private key; both empty for a process without a certificate
    control:     the keys that sign and verify control messages (`control_keys`); empty for a router, which needs none
    """

    authority: bytes
    certificate: bytes = b""
    key: bytes = field(default=b"", repr=False)
    control: bytes = field(default=b"", repr=False)

    @classmethod
    def read(cls, folder: Path) -> Credentials:
        """Read what `write` wrote; raises CredentialsError for an unreadable file."""

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
        """Write the files, mode 0600, into a folder, mode 0700: for this user only."""
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        names = (AUTHORITY, CERTIFICATE, KEY, CONTROL)
        for name, content in zip(names, (self.authority, self.certificate, self.key, self.control), strict=True):
            if content:
                handle = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
                with os.fdopen(handle, "wb") as file:
                    file.write(content)
        return folder

    def without_certificate(self) -> Credentials:
        """A copy with the trusted authority, but without a certificate and key."""
        return Credentials(self.authority, control=self.control)
