"""How far a mesh is secured, and what that means as settings of a Zenoh session. Pure.

open   TCP: everybody may join, read and write
tls    the router proves who it is, and the link is encrypted; anybody may join
mtls   who joins must prove who it is as well; a member may read and write everything
acl    mtls, and a member may do only what the wiring gives it (mast_zenoh.security.access)
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.security.credentials import Credentials

LEVELS = ("open", "tls", "mtls", "acl")

#: What `--secure` means without a level.
SECURE = "acl"

_TLS = "transport/link/tls"

#: A session with credentials speaks nothing else: who is pointed at a TCP endpoint must not go there in the clear.
_ONLY_TLS: dict[str, Any] = {"transport/link/protocols": ["tls"]}


def check(level: str) -> str:
    """The level, if there is such a one; raises ConfigurationError."""
    if level not in LEVELS:
        raise ConfigurationError(f"security level: found {level!r}{nearest(level, LEVELS)}")
    return level


def endpoint(level: str, address: str) -> str:
    """An endpoint as this level has it: tcp/HOST:PORT when open, else tls/HOST:PORT."""
    return f"{'tcp' if level == 'open' else 'tls'}/{address.partition('/')[2]}"


def hosts(endpoints: Iterable[str]) -> list[str]:
    """The hosts of endpoints such as tls/HOST:PORT: what a router's certificate must name. Each once, in order."""
    found = [each.partition("/")[2].partition("?")[0].partition("#")[0].rpartition(":")[0] for each in endpoints]
    return list(dict.fromkeys(host.strip("[]") for host in found))


def router_settings(level: str, credentials: Credentials, access: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Settings of a router at this level. access: Zenoh's `access_control`, for the level "acl"."""
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
            raise ConfigurationError("security level acl: found no access rules, expected those of the wiring")
        settings["access_control"] = dict(access)
    return settings


def client_settings(credentials: Credentials) -> dict[str, Any]:
    """Settings of a client that trusts one authority, and shows its certificate if it has one.

    The PEM texts are handed over in memory: Zenoh keeps such values out of its logs, and no file must stay readable.
    """
    tls: dict[str, Any] = {"root_ca_certificate_base64": _base64(credentials.authority), "verify_name_on_connect": True}
    if credentials.certificate:
        tls["connect_certificate_base64"] = _base64(credentials.certificate)
        tls["connect_private_key_base64"] = _base64(credentials.key)
        tls["enable_mtls"] = True
    return {**_ONLY_TLS, _TLS: tls}


def _base64(pem: bytes) -> str:
    return base64.b64encode(pem).decode("ascii")
