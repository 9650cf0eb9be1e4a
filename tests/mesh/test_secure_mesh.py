"""Admission to a secure mesh: real routers and clients, in this process."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, timedelta

import pytest
import zenoh
from launched import eventually

from mast_zenoh.errors import CredentialsError
from mast_zenoh.mesh import session as sessions
from mast_zenoh.mesh.security import diagnosis, explain
from mast_zenoh.mesh.security.authority import Authority
from mast_zenoh.mesh.security.credentials import ROUTER, Credentials
from mast_zenoh.mesh.security.deployment import Deployment
from mast_zenoh.mesh.security.levels import router_settings
from mast_zenoh.mesh.session import open_client, open_router
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
WIRING = Wiring((Wire("w", "", "clock", (Leg("w", Endpoint("a", "out"), (Endpoint("b", "in"),)),)),))


@pytest.fixture(autouse=True)
def fast_diagnosis(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused clients diagnose the reason sooner than in a run."""
    monkeypatch.setattr(sessions, "_DIAGNOSE_MS", 500)


@contextmanager
def secure_router(level: str) -> Iterator[tuple[Deployment, str]]:
    """The router of a separate deployment, and its endpoint."""
    with Deployment(level, "r", WIRING, ["a", "b"], prefix="mast/r", driver="a", hosts=["127.0.0.1"]) as deployment:
        router, endpoint = open_router("tls/127.0.0.1:0", security=deployment.router)
        with router:
            yield deployment, endpoint


def credentials_of(deployment: Deployment, name: str = "a") -> Credentials:
    folder = deployment.of(name)
    assert folder is not None
    return Credentials.read(folder)


def refusal(endpoint: str, credentials: Credentials) -> str:
    """The reason why a client is refused."""
    with pytest.raises(CredentialsError) as error:
        open_client(endpoint, credentials)
    return str(error.value)


@pytest.mark.parametrize("level", ["tls", "mtls", "acl"])
def test_a_node_with_valid_credentials_is_admitted(level: str) -> None:
    with secure_router(level) as (deployment, endpoint):
        assert explain(credentials_of(deployment), endpoint) == []
        with open_client(endpoint, credentials_of(deployment)) as session:
            assert list(session.info.routers_zid())


@pytest.mark.parametrize("level", ["mtls", "acl"])
def test_a_client_without_a_valid_certificate_of_this_deployment_is_refused_with_the_reason(level: str) -> None:
    with secure_router(level) as (deployment, endpoint), secure_router(level) as (other, _):
        assert "it may be a rogue" in refusal(endpoint, credentials_of(other))
        assert deployment.authority is not None
        authority, now = deployment.authority, datetime.now(UTC)
        foreign = Authority("r").issue("a")
        assert "another authority" in refusal(endpoint, Credentials(authority.pem, foreign.certificate, foreign.key))
        expired = authority.issue("a", begins=now - timedelta(hours=2), ends=now - timedelta(hours=1))
        assert "expired at" in refusal(endpoint, expired)
        assert "none was presented" in refusal(endpoint, Credentials(authority.pem))


def test_the_routers_certificate_must_match_its_host_name() -> None:
    with secure_router("acl") as (deployment, endpoint):
        by_name = endpoint.replace("127.0.0.1", "localhost")
        assert "not for 'localhost', but for 127.0.0.1" in refusal(by_name, credentials_of(deployment))


def test_a_compromised_node_cannot_impersonate_the_router() -> None:
    authority = Authority("r")
    router, endpoint = open_router("tls/127.0.0.1:0", security=router_settings("mtls", authority.issue("a")))
    with router:
        assert "not for '127.0.0.1'" in refusal(endpoint, authority.issue("b"))


def test_a_client_with_credentials_never_connects_unencrypted() -> None:
    router, endpoint = open_router()
    with router:
        credentials = Authority("r").issue("a")
        assert "not encrypted" in refusal(endpoint, credentials)
        with pytest.raises(zenoh.ZError):
            open_client(endpoint.replace("tcp", "tls"), credentials, try_ms=500)
        assert "is busy or does not speak TLS" in "".join(explain(credentials, endpoint.replace("tcp", "tls")))


@pytest.mark.parametrize("sent", [b"GET / HTTP/1.0\r\n\r\n", bytes.fromhex("1603010200010001fc0303"), b""])
def test_a_client_is_admitted_while_others_send_invalid_data(sent, monkeypatch, caplog) -> None:
    """After each failed handshake, the router accepts no client for 0.1 s."""
    monkeypatch.setattr(diagnosis, "_CONNECT_S", 0.2)
    with secure_router("acl") as (deployment, endpoint), ExitStack() as stack:
        host, _, port = endpoint.partition("/")[2].rpartition(":")
        for _ in range(30):
            stack.enter_context(socket.create_connection((host, int(port)))).sendall(sent)
        with open_client(endpoint, credentials_of(deployment)) as session:
            assert list(session.info.routers_zid())
        assert bool(caplog.records) == sent.startswith(b"GET"), "a slow handshake does not block others"
        if caplog.records:
            first = caplog.records[0].message
            assert "cannot be reached: it accepted the connection" in first
            assert "but did not complete the TLS handshake within 0.2 s" in first
            assert first.endswith("it is busy or does not speak TLS; trying again")


def test_an_unreachable_router_is_not_reported_as_a_credentials_error() -> None:
    router, endpoint = open_router()
    router.close()
    (reason,) = explain(Authority("r").issue("a"), endpoint.replace("tcp", "tls"))
    assert "cannot be reached" in reason


def test_the_router_reveals_no_key() -> None:
    credentials = Authority("r").issue(ROUTER, ["127.0.0.1"])
    router, _ = open_router("tls/127.0.0.1:0", security=router_settings("mtls", credentials))
    secret = credentials.key.splitlines()[1]
    with router:
        answers = [reply.ok.payload.to_bytes() for reply in router.get("@/**", timeout=2.0) if reply.ok is not None]
    assert answers
    assert not any(secret in content or b"PRIVATE" in content for content in answers)


def test_the_router_forwards_only_what_the_wiring_permits() -> None:
    received: list[tuple[str, bytes]] = []
    record_sample = zenoh.handlers.Callback(
        lambda s: received.append((str(s.key_expr), s.payload.to_bytes())), indirect=False
    )
    with secure_router("acl") as (deployment, endpoint):
        a, b = open_client(endpoint, credentials_of(deployment)), open_client(endpoint, credentials_of(deployment, "b"))
        with a, b:
            expressions = ("mast/r/w", "mast/r/**", "**", "mast/r/other")
            subscribers = [b.declare_subscriber(expression, record_sample) for expression in expressions]
            publisher = a.declare_publisher("mast/r/w")
            eventually(lambda: publisher.matching_status.matching, "the publisher knows of its subscriber", 5.0)
            a.put("mast/r/other", b"stray")
            a.put("mast/r/*", b"to all")
            a.delete("mast/r/w")
            publisher.put(b"true")  # behind the others, on the same link
            eventually(lambda: received, "all permitted messages have arrived", 5.0)
            for subscriber in subscribers:
                subscriber.undeclare()
    # The router accepted one of the four subscribers; the others share its session and receive the same messages.
    assert set(received) == {("mast/r/w", b"true")}


def test_a_remote_launcher_controls_a_run_as_a_client_of_its_router() -> None:
    received: list[str] = []
    record_sample = zenoh.handlers.Callback(lambda sample: received.append(str(sample.key_expr)), indirect=False)
    present: list[str] = []
    record_token = zenoh.handlers.Callback(lambda sample: present.append(str(sample.key_expr)), indirect=False)
    answer = zenoh.handlers.Callback(lambda query: query.reply(query.key_expr, b"taken"), indirect=False)
    with secure_router("acl") as (deployment, endpoint):
        assert deployment.launcher is not None
        launcher, a, b = (
            open_client(endpoint, credentials)
            for credentials in (deployment.launcher, credentials_of(deployment), credentials_of(deployment, "b"))
        )
        with launcher, a, b:
            declared = [
                launcher.declare_queryable("mast/r/@control/result/*", answer),
                launcher.declare_subscriber("mast/r/@control/act", record_sample),
                a.declare_subscriber("mast/r/@control/counts/*", record_sample),
                b.declare_subscriber("mast/r/@control/stop", record_sample),
                b.declare_subscriber("mast/r/@control/leave/b", record_sample),
                a.liveliness().declare_subscriber("mast/r/alive/*", record_token, history=True),
                launcher.liveliness().declare_subscriber("mast/r/alive/*", record_token, history=True),
            ]
            pairs = ((a, "act"), (a, "stop"), (b, "counts/b"), (launcher, "stop"), (launcher, "leave/b"))
            publishers = [session.declare_publisher(f"mast/r/@control/{key}") for session, key in pairs]
            for publisher in publishers:
                eventually(
                    lambda p=publisher: p.matching_status.matching, f"{publisher.key_expr} has a subscriber", 5.0
                )
                publisher.put(b"")
            alive = b.liveliness().declare_token("mast/r/alive/b")
            eventually(lambda: len(present) == 2, "driver and launcher see all nodes", 5.0)
            eventually(lambda: len(received) == len(pairs), "all messages have arrived", 5.0)
            for session, node, expected in ((b, "b", [b"taken"]), (b, "a", [])):
                replies = session.get(f"mast/r/@control/result/{node}", payload=b"x", timeout=2.0)
                assert [r.ok.payload.to_bytes() for r in replies if r.ok is not None] == expected, node
            for entity in (*declared, alive):
                entity.undeclare()
    assert sorted(received) == sorted(f"mast/r/@control/{key}" for _, key in pairs)
