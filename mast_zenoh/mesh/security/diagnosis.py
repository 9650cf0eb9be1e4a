"""Explains why a certificate is refused."""

from __future__ import annotations

import socket
import ssl
import stat
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import NameOID

from mast_zenoh.errors import CredentialsError
from mast_zenoh.mesh.security.credentials import AUTHORITY, CERTIFICATE, KEY, UNREACHED, Credentials

_CONNECT_S = 2.0
_VERDICT_S = 0.5

#: Zenoh's router pauses for 0.1 s after each failed handshake, and accepts no others meanwhile (zenoh#2685).
_BUSY = "it is busy or does not speak TLS"

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
    """Reasons why these credentials would be refused at this endpoint, as sentences, the most direct cause first.

    endpoint: of the router, tls/HOST:PORT; without it only the credentials are checked

    Takes at most about 3 s.
    """
    where, unusable, too_wide = "the credentials", [], []
    if isinstance(credentials, Path):
        folder, where = credentials, str(credentials)
        for path in (folder, folder / KEY):
            if path.exists() and (mode := stat.S_IMODE(path.stat().st_mode)) & 0o077:
                expected_mode = 0o700 if mode & 0o100 else 0o600
                too_wide.append(f"{path}: others may read it (mode {mode:04o}), expected {expected_mode:04o}")
        present = [name for name in (AUTHORITY, CERTIFICATE, KEY) if (folder / name).is_file()]
        expected = (AUTHORITY,) if present == [AUTHORITY] else (AUTHORITY, CERTIFICATE, KEY)
        unusable = [f"{folder / name}: is missing" for name in expected if name not in present]
        try:
            credentials = Credentials.read(folder)
        except CredentialsError as error:
            unusable = unusable or [f"{folder}: {error}"]
            credentials = Credentials(b"")
    authority, own = _parsed(credentials.authority), _parsed(credentials.certificate)
    for name, content, parsed in (
        (AUTHORITY, credentials.authority, authority),
        (CERTIFICATE, credentials.certificate, own),
    ):
        if content and parsed is None:
            unusable.append(f"{where}/{name}: is not a PEM certificate")
    reasons = [*_validity("the authority's certificate", where, authority), *_validity("the certificate", where, own)]
    if own is not None and not _is_from(authority, own):
        reasons.append(f"{where}: the certificate of {_common_name(own)!r} was issued by another authority")
    key_fits = True
    if credentials.key:
        try:
            key = serialization.load_pem_private_key(credentials.key, None)
            key_fits = own is None or key.public_key() == own.public_key()
        except (ValueError, TypeError):
            unusable.append(f"{where}/{KEY}: is not a PEM private key")
    if not key_fits:
        reasons.append(f"{where}: the key does not belong to the certificate")
    reasons = [*unusable, *too_wide, *reasons]
    if endpoint is None:
        return reasons
    scheme, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    if scheme != "tls":
        return [*reasons, f"{scheme}/{host}: not encrypted; with credentials an endpoint is tls/HOST:PORT"]
    usable = authority is not None and not unusable and key_fits
    problem, certificate = handshake(host, int(port), credentials if usable else None)
    return [*reasons, *_of_router(host, authority, certificate), *([problem] if problem else [])]


def _of_router(host: str, authority: x509.Certificate | None, certificate: x509.Certificate | None) -> Iterator[str]:
    yield from _validity("the router's certificate", host, certificate)
    if certificate is None:
        return
    if not _is_from(authority, certificate):
        yield f"the router at {host} has a certificate from another authority: it may be a rogue"
    elif host not in (names := _hosts(certificate)):
        yield f"the router's certificate is not for {host!r}, but for {', '.join(names) or 'no host at all'}"


def handshake(host: str, port: int, credentials: Credentials | None) -> tuple[str, x509.Certificate | None]:
    """Try a TLS handshake as a client would, but accept any certificate for inspection.

    Returns why the router did not answer or refuses us, or "", and its certificate.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    if credentials is not None and credentials.certificate:
        with tempfile.TemporaryDirectory(prefix="mast-") as folder:  # OpenSSL takes files only
            credentials.write(Path(folder))
            context.load_cert_chain(Path(folder) / CERTIFICATE, Path(folder) / KEY)
    silent = f"the router at {host} {UNREACHED}"
    try:
        raw = socket.create_connection((host, port), _CONNECT_S)
    except OSError as error:
        return f"{silent}: {error.strerror or error}", None
    with raw:
        certificate = None
        try:
            with context.wrap_socket(raw, server_hostname=host) as link:
                der = link.getpeercert(binary_form=True)
                certificate = x509.load_der_x509_certificate(der) if der else None
                link.settimeout(_VERDICT_S)
                link.recv(1)  # in TLS 1.3 the server's refusal comes after the handshake
        except TimeoutError:
            if certificate is None:
                problem = f"it accepted the connection, but did not complete the TLS handshake within {_CONNECT_S:g} s"
                return f"{silent}: {problem}: {_BUSY}", None
        except ssl.SSLEOFError:
            if certificate is None:
                return f"{silent}: it closed the connection during the TLS handshake: {_BUSY}", None
        except ssl.SSLError as error:
            verdict = error.reason or str(error)
            if certificate is None and "ALERT" not in verdict:
                return f"the router at {host} does not speak TLS", None
            return f"the router at {host} refuses us: {meaning(verdict)}", certificate
        except OSError as error:
            if certificate is None:
                return f"{silent}: {error.strerror or error}", None
        return "", certificate


def meaning(verdict: str) -> str:
    """A router's alert in words; by OpenSSL's name for it if it is unknown."""
    return next((words for word, words in _VERDICTS.items() if word in verdict), verdict)


def _validity(what: str, where: str, certificate: x509.Certificate | None) -> Iterator[str]:
    now = datetime.now(UTC)
    if certificate is not None and now > certificate.not_valid_after_utc:
        yield f"{where}: {what} expired at {_utc(certificate.not_valid_after_utc)}, now it is {_utc(now)}"
    if certificate is not None and now < certificate.not_valid_before_utc:
        yield f"{where}: {what} is not valid before {_utc(certificate.not_valid_before_utc)}, now it is {_utc(now)}"


def _utc(time: datetime) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S UTC")


def _parsed(pem: bytes) -> x509.Certificate | None:
    try:
        return x509.load_pem_x509_certificate(pem) if pem else None
    except ValueError:
        return None


def _is_from(authority: x509.Certificate | None, certificate: x509.Certificate) -> bool:
    try:
        if authority is not None:
            certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return authority is not None


def _common_name(certificate: x509.Certificate) -> str:
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def _hosts(certificate: x509.Certificate) -> list[str]:
    """The hosts that a router's certificate is valid for."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in names]
