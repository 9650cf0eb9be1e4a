"""Security levels of a mesh, as settings of a Zenoh session. Pure.

open   TCP: any process may join, read and write
tls    the router authenticates itself, and the link is encrypted; any process may join
mtls   clients authenticate themselves too; a member may read and write everything
acl    mtls, and a member has only the rights that the wiring gives it (mast_zenoh.mesh.security.access)
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.mesh.security.credentials import Credentials

LEVELS = ("open", "tls", "mtls", "acl")

#: The level of `--secure` without a value.
SECURE = "acl"

_TLS = "transport/link/tls"

#: A session with credentials uses only TLS: it must not connect to a TCP endpoint unencrypted.
_ONLY_TLS: dict[str, Any] = {"transport/link/protocols": ["tls"]}


def check(level: str) -> str:
    """Return the level; raises ConfigurationError if it does not exist."""
    if level not in LEVELS:
        raise ConfigurationError(f"security level: found {level!r}{nearest(level, LEVELS)}")
    return level


def endpoint(level: str, address: str) -> str:
    """An endpoint with the level's protocol: tcp/HOST:PORT if open, else tls/HOST:PORT."""
    return f"{'tcp' if level == 'open' else 'tls'}/{address.partition('/')[2]}"


def hosts(endpoints: Iterable[str]) -> list[str]:
    """The hosts in endpoints tls/HOST:PORT, without duplicates, for a router's certificate."""
    names = [end.partition("/")[2].partition("?")[0].partition("#")[0].rpartition(":")[0] for end in endpoints]
    return list(dict.fromkeys(host.strip("[]") for host in names))


def router_settings(level: str, credentials: Credentials, access: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Settings of a router at this level.

    access: Zenoh's `access_control` settings, for level "acl"
    """
    if check(level) == "open":
        return {}
    tls: dict[str, Any] = {
        "listen_certificate_base64": _base64(credentials.certificate),
        "listen_private_key_base64": _base64(credentials.key),
        "enable_mtls": level != "tls",
    }
    if level != "tls":
        tls["root_ca_certificate_base64"] = _base64(credentials.authority)
    settings = {**_ONLY_TLS, _TLS: tls}
    if level == "acl":
        if access is None:
            raise ConfigurationError(
                "security level acl: found no access rules, expected rules derived from the wiring"
            )
        settings["access_control"] = dict(access)
    return settings


def client_settings(credentials: Credentials) -> dict[str, Any]:
    """Settings of a client with a trusted authority, and with its certificate if any.

    The PEM data are passed in memory: Zenoh keeps such values out of its logs, and no file has to stay readable.
    """
    tls: dict[str, Any] = {"root_ca_certificate_base64": _base64(credentials.authority), "verify_name_on_connect": True}
    if credentials.certificate:
        tls["connect_certificate_base64"] = _base64(credentials.certificate)
        tls["connect_private_key_base64"] = _base64(credentials.key)
        tls["enable_mtls"] = True
    return {**_ONLY_TLS, _TLS: tls}


def _base64(pem: bytes) -> str:
    return base64.b64encode(pem).decode("ascii")
