"""Explains why a certificate is refused.

`look` collects the facts, `reasons` explains them. `reasons` is pure.
"""

from __future__ import annotations

import socket
import ssl
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import NameOID

from mast_zenoh.errors import CredentialsError
from mast_zenoh.security.credentials import AUTHORITY, CERTIFICATE, KEY, UNREACHED, Credentials

_CONNECT_S = 2.0
_VERDICT_S = 0.5

#: Zenoh's router pauses for 0.1 s after each failed handshake, and accepts no others meanwhile (zenoh#2685).
_BUSY = "it is busy or does not speak TLS"


@dataclass(frozen=True)
class Certificate:
    """The relevant parts of a certificate.

    trusted: signed by our authority; names: hosts that it is valid for
    """

    common_name: str
    not_before: datetime
    not_after: datetime
    trusted: bool
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Router:
    """Observations of the router.

    silent:  why it did not answer; a later attempt may succeed; plain: whether its answer is not TLS
    verdict: the alert that it sent us, in OpenSSL's words
    """

    silent: str = ""
    plain: bool = False
    certificate: Certificate | None = None
    verdict: str = ""


@dataclass(frozen=True)
class Facts:
    """The facts about a process's credentials and the router that it should join.

    where:     the folder, or a description
    unusable:  files that are missing or not PEM, and why
    too_wide:  files or folders that others may read, and their permissions
    key_fits:  whether the key belongs to the certificate; None if one of them is missing
    host:      the host of the endpoint; scheme: "tls"
    """

    now: datetime
    where: str = "the credentials"
    unusable: tuple[tuple[str, str], ...] = ()
    too_wide: tuple[tuple[str, int], ...] = ()
    authority: Certificate | None = None
    certificate: Certificate | None = None
    key_fits: bool | None = None
    scheme: str = "tls"
    host: str = ""
    router: Router | None = None


#: Meaning of a router's alert, by OpenSSL's name for it.
_VERDICTS = {
    "CERTIFICATE_REQUIRED": "it requires a certificate, and none was presented",
    "UNKNOWN_CA": "it does not trust the authority that issued our certificate",
    "CERTIFICATE_EXPIRED": "it considers our certificate expired: compare the clocks of the two hosts",
    "CERTIFICATE_UNKNOWN": "it does not accept our certificate",
    "BAD_CERTIFICATE": "it does not accept our certificate",
    "DECRYPT_ERROR": "our certificate was not signed by the authority named in it",
}


def explain(credentials: Credentials | Path, endpoint: str | None = None) -> list[str]:
    """Reasons why these credentials would be refused at this endpoint, as sentences.

    endpoint: of the router, tls/HOST:PORT; without it only the credentials are checked
    """
    return list(reasons(look(credentials, endpoint)))


def reasons(facts: Facts) -> Iterator[str]:
    """Explain the facts in sentences, the most direct cause first."""
    for file, why in facts.unusable:
        yield f"{file}: {why}"
    for file, mode in facts.too_wide:
        yield f"{file}: others may read it (mode {mode:04o}), expected {0o700 if mode & 0o100 else 0o600:04o}"
    if facts.authority is not None:
        yield from _validity("the authority's certificate", facts.where, facts.authority, facts.now)
    own = facts.certificate
    if own is not None:
        yield from _validity("the certificate", facts.where, own, facts.now)
        if not own.trusted:
            yield f"{facts.where}: the certificate of {own.common_name!r} was issued by another authority"
    if facts.key_fits is False:
        yield f"{facts.where}: the key does not belong to the certificate"
    if facts.scheme != "tls":
        yield f"{facts.scheme}/{facts.host}: not encrypted; with credentials an endpoint is tls/HOST:PORT"
    elif facts.router is not None:
        yield from _router_reasons(facts, facts.router)


def _router_reasons(facts: Facts, router: Router) -> Iterator[str]:
    if router.silent:
        yield f"the router at {facts.host} {UNREACHED}: {router.silent}"
    if router.plain:
        yield f"the router at {facts.host} does not speak TLS"
    certificate = router.certificate
    if certificate is not None:
        yield from _validity("the router's certificate", facts.host, certificate, facts.now)
        if not certificate.trusted:
            yield f"the router at {facts.host} has a certificate from another authority: it may be a rogue"
        elif facts.host not in certificate.names:
            text = ", ".join(certificate.names) or "no host at all"
            yield f"the router's certificate is not for {facts.host!r}, but for {text}"
    if router.verdict:
        text = next((words for word, words in _VERDICTS.items() if word in router.verdict), router.verdict)
        yield f"the router at {facts.host} refuses us: {text}"


def _validity(what: str, where: str, certificate: Certificate, now: datetime) -> Iterator[str]:
    if now > certificate.not_after:
        yield f"{where}: {what} expired at {_utc_text(certificate.not_after)}, now it is {_utc_text(now)}"
    if now < certificate.not_before:
        yield f"{where}: {what} is not valid before {_utc_text(certificate.not_before)}, now it is {_utc_text(now)}"


def _utc_text(time: datetime) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S UTC")


# -- collecting the facts ----------------------------------------------------------------------------------------------


def look(credentials: Credentials | Path, endpoint: str | None = None) -> Facts:
    """Collect the facts about credentials and a router; takes at most about 3 s."""
    where, unusable, too_wide = "the credentials", [], []
    if isinstance(credentials, Path):
        folder, where = credentials, str(credentials)
        for path in (folder, folder / KEY):
            if path.exists() and (mode := stat.S_IMODE(path.stat().st_mode)) & 0o077:
                too_wide.append((str(path), mode))
        present = [name for name in (AUTHORITY, CERTIFICATE, KEY) if (folder / name).is_file()]
        expected = (AUTHORITY,) if present == [AUTHORITY] else (AUTHORITY, CERTIFICATE, KEY)
        unusable = [(str(folder / name), "is missing") for name in expected if name not in present]
        try:
            credentials = Credentials.read(folder)
        except CredentialsError as error:
            if not unusable:
                unusable.append((str(folder), str(error)))
            credentials = Credentials(b"")
    authority, certificate = _parsed(credentials.authority), _parsed(credentials.certificate)
    for name, content, parsed in (
        (AUTHORITY, credentials.authority, authority),
        (CERTIFICATE, credentials.certificate, certificate),
    ):
        if content and parsed is None:
            unusable.append((f"{where}/{name}", "is not a PEM certificate"))
    key_fits = None
    if credentials.key:
        try:
            key = serialization.load_pem_private_key(credentials.key, None)
            key_fits = None if certificate is None else key.public_key() == certificate.public_key()
        except (ValueError, TypeError):
            unusable.append((f"{where}/{KEY}", "is not a PEM private key"))
    scheme, host, router = "tls", "", None
    if endpoint is not None:
        scheme, _, address = endpoint.partition("/")
        host, _, port = address.rpartition(":")
        host = host.strip("[]")
        if scheme == "tls":
            usable = authority is not None and not unusable and key_fits is not False
            router = _router(host, int(port), credentials if usable else None, authority)
    return Facts(
        datetime.now(UTC),
        where,
        tuple(unusable),
        tuple(too_wide),
        _summary(authority, authority),
        _summary(certificate, authority),
        key_fits,
        scheme,
        host,
        router,
    )


def _router(host: str, port: int, credentials: Credentials | None, authority: x509.Certificate | None) -> Router:
    """Try a TLS handshake as a client would, but accept any certificate for inspection."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    if credentials is not None and credentials.certificate:
        with tempfile.TemporaryDirectory(prefix="mast-") as folder:  # OpenSSL takes files only
            credentials.write(Path(folder))
            context.load_cert_chain(Path(folder) / CERTIFICATE, Path(folder) / KEY)
    try:
        raw = socket.create_connection((host, port), _CONNECT_S)
    except OSError as error:
        return Router(silent=error.strerror or str(error))
    with raw:
        certificate, verdict = None, ""
        try:
            with context.wrap_socket(raw, server_hostname=host) as link:
                der = link.getpeercert(binary_form=True)
                certificate = _summary(x509.load_der_x509_certificate(der), authority) if der else None
                link.settimeout(_VERDICT_S)
                link.recv(1)  # in TLS 1.3 the server's refusal comes after the handshake
        except TimeoutError:
            if certificate is None:
                problem = f"it accepted the connection, but did not complete the TLS handshake within {_CONNECT_S:g} s"
                return Router(silent=f"{problem}: {_BUSY}")
        except ssl.SSLEOFError:
            if certificate is None:
                return Router(silent=f"it closed the connection during the TLS handshake: {_BUSY}")
        except ssl.SSLError as error:
            verdict = error.reason or str(error)
            if certificate is None and "ALERT" not in verdict:
                return Router(plain=True)
        except OSError as error:
            if certificate is None:
                return Router(silent=error.strerror or str(error))
        return Router(certificate=certificate, verdict=verdict)


def _parsed(pem: bytes) -> x509.Certificate | None:
    try:
        return x509.load_pem_x509_certificate(pem) if pem else None
    except ValueError:
        return None


def _summary(certificate: x509.Certificate | None, authority: x509.Certificate | None) -> Certificate | None:
    if certificate is None:
        return None
    trusted = authority is not None
    if authority is not None:
        try:
            certificate.verify_directly_issued_by(authority)
        except (ValueError, TypeError, InvalidSignature):
            trusted = False
    common_names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    try:
        alternative_names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        names = tuple(str(name.value) for name in alternative_names)
    except x509.ExtensionNotFound:
        names = ()
    return Certificate(
        str(common_names[0].value) if common_names else "",
        certificate.not_valid_before_utc,
        certificate.not_valid_after_utc,
        trusted,
        names,
    )
