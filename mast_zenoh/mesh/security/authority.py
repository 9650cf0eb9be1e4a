"""One certificate authority per deployment, whose key never leaves this process.

All certificates of a deployment are issued before any process starts, so the key is not needed later. They are
worthless in another deployment, which trusts another authority. Node certificates are for clients only and the
router's for a server only (extended key usage): a compromised node cannot impersonate the router.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from mast_zenoh.mesh.security.credentials import LIFETIME, Credentials, common_name

#: How far back validity begins, for hosts whose clocks are a little behind.
SKEW = timedelta(minutes=5)


class Authority:
    """Issues the certificates of one deployment.

    run:      id of the run; in every certificate's common name
    lifetime: how long the certificates are valid
    """

    def __init__(self, run: str, lifetime: timedelta = LIFETIME) -> None:
        self.run = run
        self.lifetime = lifetime
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = _name(common_name(run, "@authority"))
        # Valid longer than what it signs, so that an "expired" error always refers to the right certificate.
        now = datetime.now(UTC)
        self._certificate = (
            _builder(self._name, self._name, self._key, now - 2 * SKEW, now + 2 * lifetime)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_key_usage(signs_certificates=True), critical=True)
            .sign(self._key, hashes.SHA256())
        )
        self.pem = self._certificate.public_bytes(serialization.Encoding.PEM)

    def issue(
        self, name: str, hosts: Iterable[str] = (), *, begins: datetime | None = None, ends: datetime | None = None
    ) -> Credentials:
        """Issue a new key and certificate.

        name:  name of the node, or ROUTER or LAUNCHER
        hosts: names and addresses of a router; if there are any, the certificate is a router's
        begins, ends: validity; by default from now, for the authority's lifetime
        """
        key = ec.generate_private_key(ec.SECP256R1())
        now = datetime.now(UTC)
        hosts = list(hosts)
        usage = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
        subject = _name(common_name(self.run, name))
        builder = (
            _builder(subject, self._name, key, begins or now - SKEW, ends or now + self.lifetime)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_key_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
        )
        if hosts:
            builder = builder.add_extension(
                x509.SubjectAlternativeName([_alternative(h) for h in hosts]), critical=False
            )
        certificate = builder.sign(self._key, hashes.SHA256())
        return Credentials(
            self.pem,
            certificate.public_bytes(serialization.Encoding.PEM),
            key.private_bytes(
                serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
            ),
        )


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, begins: datetime, ends: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins)
        .not_valid_after(ends)
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _alternative(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
