"""Why a certificate is refused: `look` finds out what is the case, `reasons` (pure) says it in sentences."""

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

#: Zenoh's router pauses for 0.1 s after each broken handshake, and lets others wait meanwhile (zenoh#2685).
_BUSY = "it is busy or does not speak TLS"


@dataclass(frozen=True)
class Certificate:
    """What matters of a certificate. trusted: our authority signed it; names: hosts that it is good for."""

    common_name: str
    not_before: datetime
    not_after: datetime
    trusted: bool
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Router:
    """What was seen of the router.

    silent:  why it could not be reached, or not asked: time may help; plain: what it says is not TLS
    verdict: its alert about us, in OpenSSL's words
    """

    silent: str = ""
    plain: bool = False
    certificate: Certificate | None = None
    verdict: str = ""


@dataclass(frozen=True)
class Facts:
    """All that is known of a process's credentials and of the router that it is to join.

    where:     the folder, or words for it
    unusable:  files that are missing or no PEM, and why
    too_wide:  files or folders that others may read, and their permissions
    key_fits:  whether the key belongs to the certificate; None where one of them is not there
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


#: What a router's alert means, by the words that OpenSSL has for it.
_VERDICTS = {
    "CERTIFICATE_REQUIRED": "it admits nobody without a certificate, and none was shown",
    "UNKNOWN_CA": "another authority has issued ours than the one it trusts",
    "CERTIFICATE_EXPIRED": "it finds ours expired: compare the clocks of the two hosts",
    "CERTIFICATE_UNKNOWN": "it does not accept ours",
    "BAD_CERTIFICATE": "it does not accept ours",
    "DECRYPT_ERROR": "ours was not signed by the authority that it names",
}


def explain(credentials: Credentials | Path, endpoint: str | None = None) -> list[str]:
    """Why these credentials would be refused at this endpoint, a sentence each; none when nothing is wrong.

    endpoint: of the router, tls/HOST:PORT; without it only the credentials themselves are looked at
    """
    return list(reasons(look(credentials, endpoint)))


def reasons(facts: Facts) -> Iterator[str]:
    """The facts in sentences, the nearest cause first."""
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
        yield from _of_router(facts, facts.router)


def _of_router(facts: Facts, router: Router) -> Iterator[str]:
    if router.silent:
        yield f"the router at {facts.host} {UNREACHED}: {router.silent}"
    if router.plain:
        yield f"the router at {facts.host} does not speak TLS"
    theirs = router.certificate
    if theirs is not None:
        yield from _validity("the router's certificate", facts.host, theirs, facts.now)
        if not theirs.trusted:
            yield f"the router at {facts.host} was certified by another authority than ours: it may be a rogue"
        elif facts.host not in theirs.names:
            known = ", ".join(theirs.names) or "no host at all"
            yield f"the router's certificate is not for {facts.host!r}, but for {known}"
    if router.verdict:
        known = next((words for word, words in _VERDICTS.items() if word in router.verdict), router.verdict)
        yield f"the router at {facts.host} refuses us: {known}"


def _validity(what: str, where: str, certificate: Certificate, now: datetime) -> Iterator[str]:
    if now > certificate.not_after:
        yield f"{where}: {what} has expired at {_said(certificate.not_after)}, now it is {_said(now)}"
    if now < certificate.not_before:
        yield f"{where}: {what} is not valid before {_said(certificate.not_before)}, now it is {_said(now)}"


def _said(time: datetime) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S UTC")


# -- looking -----------------------------------------------------------------------------------------------------------


def look(credentials: Credentials | Path, endpoint: str | None = None) -> Facts:
    """Find out about credentials, and about the router if an endpoint is named (at most about three seconds)."""
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
            unusable.append((f"{where}/{name}", "is no certificate in PEM"))
    key_fits = None
    if credentials.key:
        try:
            key = serialization.load_pem_private_key(credentials.key, None)
            key_fits = None if certificate is None else key.public_key() == certificate.public_key()
        except (ValueError, TypeError):
            unusable.append((f"{where}/{KEY}", "is no private key in PEM"))
    scheme, host, router = "tls", "", None
    if endpoint is not None:
        scheme, _, address = endpoint.partition("/")
        host, _, port = address.rpartition(":")
        host = host.strip("[]")
        if scheme == "tls":
            sound = authority is not None and not unusable and key_fits is not False
            router = _router(host, int(port), credentials if sound else None, authority)
    return Facts(
        datetime.now(UTC),
        where,
        tuple(unusable),
        tuple(too_wide),
        _seen(authority, authority),
        _seen(certificate, authority),
        key_fits,
        scheme,
        host,
        router,
    )


def _router(host: str, port: int, credentials: Credentials | None, authority: x509.Certificate | None) -> Router:
    """Shake hands with the router as a client would, but look at its certificate whatever it is."""
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
        theirs, verdict = None, ""
        try:
            with context.wrap_socket(raw, server_hostname=host) as link:
                der = link.getpeercert(binary_form=True)
                theirs = _seen(x509.load_der_x509_certificate(der), authority) if der else None
                link.settimeout(_VERDICT_S)
                link.recv(1)  # in TLS 1.3 the server's refusal comes after the handshake
        except TimeoutError:
            if theirs is None:
                found = f"it has accepted a connection, but no TLS handshake within {_CONNECT_S:g} s"
                return Router(silent=f"{found}: {_BUSY}")
        except ssl.SSLEOFError:
            if theirs is None:
                return Router(silent=f"it has closed the connection during the TLS handshake: {_BUSY}")
        except ssl.SSLError as error:
            verdict = error.reason or str(error)
            if theirs is None and "ALERT" not in verdict:
                return Router(plain=True)
        except OSError as error:
            if theirs is None:
                return Router(silent=error.strerror or str(error))
        return Router(certificate=theirs, verdict=verdict)


def _parsed(pem: bytes) -> x509.Certificate | None:
    try:
        return x509.load_pem_x509_certificate(pem) if pem else None
    except ValueError:
        return None


def _seen(certificate: x509.Certificate | None, authority: x509.Certificate | None) -> Certificate | None:
    if certificate is None:
        return None
    trusted = authority is not None
    if authority is not None:
        try:
            certificate.verify_directly_issued_by(authority)
        except (ValueError, TypeError, InvalidSignature):
            trusted = False
    common = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    try:
        alternatives = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        names = tuple(str(each.value) for each in alternatives)
    except x509.ExtensionNotFound:
        names = ()
    return Certificate(
        str(common[0].value) if common else "",
        certificate.not_valid_before_utc,
        certificate.not_valid_after_utc,
        trusted,
        names,
    )
