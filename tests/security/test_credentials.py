"""Certificates: subject, validity and usage; permissions of key files."""

import stat
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.errors import ConfigurationError, CredentialsError
from mast_zenoh.mesh.security.authority import Authority
from mast_zenoh.mesh.security.credentials import LAUNCHER, ROUTER, Credentials, common_name
from mast_zenoh.mesh.security.deployment import Deployment
from mast_zenoh.mesh.security.levels import LEVELS, client_settings, endpoint, hosts, router_settings
from mast_zenoh.wiring.model import Wiring


def parsed(credentials: Credentials) -> x509.Certificate:
    return x509.load_pem_x509_certificate(credentials.certificate)


def test_a_certificate_is_for_one_node_of_one_run_and_short_lived() -> None:
    certificate = parsed(Authority("run-1", timedelta(hours=2)).issue("infra_1"))
    (name,) = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert name.value == "infra_1.run-1"
    assert certificate.not_valid_after_utc - certificate.not_valid_before_utc <= timedelta(hours=2, minutes=6)
    usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usage) == [ExtendedKeyUsageOID.CLIENT_AUTH], "a node cannot impersonate the router"


def test_the_routers_certificate_names_its_hosts_and_is_not_valid_for_clients() -> None:
    certificate = parsed(Authority("r").issue(ROUTER, ["127.0.0.1", "::1", "router"]))
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(name.value) for name in names] == ["127.0.0.1", "::1", "router"]
    usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usage) == [ExtendedKeyUsageOID.SERVER_AUTH]


def test_a_certificate_from_another_authority_with_the_same_name_is_not_trusted() -> None:
    one, other = Authority("r"), Authority("r")
    with pytest.raises(InvalidSignature):
        parsed(one.issue("a")).verify_directly_issued_by(x509.load_pem_x509_certificate(other.pem))


@given(st.text("abcdefghij_-.", min_size=1, max_size=120), st.text("abcdefghij_-.", min_size=1, max_size=120))
def test_common_names_are_short_enough_and_unique(run: str, node: str) -> None:
    names = [common_name(run, name) for name in (node, node + "x", LAUNCHER)]
    assert len(set(names)) == 3
    assert all(0 < len(name) <= 64 for name in names)


def test_only_the_user_can_read_keys_and_the_repr_omits_them(tmp_path: Path) -> None:
    credentials = Authority("r").issue("a")
    folder = credentials.write(tmp_path / "a")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()} == {0o600}
    assert Credentials.read(folder) == credentials
    secret = credentials.key.decode().splitlines()[1]
    assert secret not in repr(credentials) + str(credentials)


def test_credentials_without_a_certificate_hold_only_the_authority(tmp_path: Path) -> None:
    credentials = Authority("r").issue("a").without_certificate()
    folder = credentials.write(tmp_path / "a")
    assert [path.name for path in folder.iterdir()] == ["ca.pem"]
    assert Credentials.read(folder) == credentials
    assert "enable_mtls" not in client_settings(credentials)["transport/link/tls"]


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    for missing in ("ca.pem", "certificate.pem", "key.pem"):
        folder = Authority("r").issue("a").write(tmp_path / missing)
        (folder / missing).unlink()
        with pytest.raises(CredentialsError, match=missing):
            Credentials.read(folder)


def deployed(level: str, folder: Path | None = None) -> Deployment:
    return Deployment(
        level, "r", Wiring(()), ["a", "b"], prefix="mast/r", driver="a", hosts=["127.0.0.1"], folder=folder
    )


def test_only_the_nodes_keys_are_on_disk_until_the_deployment_closes(tmp_path: Path) -> None:
    with deployed("acl") as deployment:
        assert deployment.folder is not None
        assert stat.S_IMODE(deployment.folder.stat().st_mode) == 0o700
        assert {path.relative_to(deployment.folder).as_posix() for path in deployment.folder.rglob("*.pem")} == {
            f"{node}/{file}.pem" for node in ("a", "b") for file in ("ca", "certificate", "key")
        }
        assert deployment.arguments("a") == ["--credentials", str(deployment.folder / "a")]
    assert not deployment.folder.exists()


def test_an_open_deployment_makes_no_credentials() -> None:
    with deployed("open") as deployment:
        assert (deployment.folder, deployment.authority, deployment.router, deployment.arguments("a")) == (
            *(None, None, {}),
            [],
        )


def test_each_level_requires_more_than_the_one_before() -> None:
    credentials = Authority("r").issue(ROUTER, ["h"])
    tls = {level: router_settings(level, credentials, {"enabled": True}) for level in LEVELS}
    assert tls["open"] == {}
    assert tls["tls"]["transport/link/tls"]["enable_mtls"] is False
    assert tls["mtls"]["transport/link/tls"]["enable_mtls"] is True
    assert "access_control" not in tls["mtls"]
    assert tls["acl"] == tls["mtls"] | {"access_control": {"enabled": True}}
    assert all(tls[level]["transport/link/protocols"] == ["tls"] for level in LEVELS[1:]), "no fallback to TCP"


def test_an_unknown_level_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ConfigurationError, match="'mtls'"):
        router_settings("mtsl", Authority("r").issue(ROUTER, ["h"]))
    with pytest.raises(ConfigurationError, match="no access rules"):
        router_settings("acl", Authority("r").issue(ROUTER, ["h"]))


def test_endpoints_follow_the_level_and_name_their_hosts() -> None:
    assert endpoint("acl", "tcp/127.0.0.1:0") == "tls/127.0.0.1:0"
    assert endpoint("open", "tls/router:7447") == "tcp/router:7447"
    assert hosts(["tls/127.0.0.1:0", "tcp/[::1]:7447", "tls/router:1", "tls/127.0.0.1:9"]) == [
        "127.0.0.1",
        "::1",
        "router",
    ]
