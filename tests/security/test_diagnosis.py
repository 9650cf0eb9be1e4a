"""Refused certificates are explained in a sentence with the file or host."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509

from mast_zenoh.mesh.security import diagnosis, explain
from mast_zenoh.mesh.security.authority import Authority
from mast_zenoh.mesh.security.credentials import ROUTER, UNREACHED, Credentials

# Fixed times, because the names of these tests contain them: all pytest workers must find the same names.
LONG_AGO, FAR_AHEAD, HOUR = datetime(2020, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC), timedelta(hours=1)
OURS, OTHER = Authority("r"), Authority("r")
GOOD, FOREIGN = OURS.issue("a"), OTHER.issue("a")
OLD = OURS.issue("a", begins=LONG_AGO, ends=LONG_AGO + HOUR)
EARLY = OURS.issue("a", begins=FAR_AHEAD, ends=FAR_AHEAD + HOUR)
PAST = "expired at 2020-01-01 01:00:00 UTC, now it is "


@pytest.mark.parametrize(
    ("credentials", "reason"),
    [
        (OLD, f"the certificate {PAST}"),
        (EARLY, "2100-01-01 00:00:00 UTC"),
        (Credentials(OURS.pem, FOREIGN.certificate, FOREIGN.key), "certificate of 'a.r'"),
        (Credentials(OURS.pem, GOOD.certificate, FOREIGN.key), "does not belong"),
        (Credentials(OURS.pem, b"nonsense", GOOD.key), "PEM certificate"),
        (Credentials(OURS.pem, GOOD.certificate, b"nonsense"), "PEM private key"),
        (Credentials(OURS.pem, GOOD.certificate), "key.pem: is missing"),
        (Credentials(OLD.certificate), f"authority's certificate {PAST}"),
        (GOOD, None),
    ],
)
def test_each_fault_of_a_folder_is_explained_once(tmp_path: Path, credentials: Credentials, reason: str | None) -> None:
    reasons = explain(credentials.write(tmp_path / "keys"))
    if reason is None:
        assert reasons == []
    else:
        (sentence,) = reasons
        assert sentence.startswith(str(tmp_path / "keys"))
        assert reason in sentence


def test_permissions_and_missing_folders_are_explained(tmp_path: Path) -> None:
    folder = GOOD.write(tmp_path / "wide")
    (folder / "key.pem").chmod(0o640)
    folder.chmod(0o755)
    key, place = f"{folder / 'key.pem'}", f"{folder}"
    for path, mode, reason in zip((place, key), ("0755", "0640"), explain(folder), strict=True):
        assert reason.startswith(f"{path}: others")
        assert mode in reason
    assert "ca.pem: is missing" in "".join(explain(tmp_path / "nowhere"))


THEIRS = OURS.issue(ROUTER, ["router", "10.0.0.1"])
STALE = OURS.issue(ROUTER, ["router"], begins=LONG_AGO, ends=LONG_AGO + HOUR)


@pytest.mark.parametrize(
    ("endpoint", "problem", "certificate", "reason"),
    [
        ("tls/router:1", "", THEIRS, None),
        ("tcp/router:1", "", None, "tcp/router: not encrypted"),
        ("tls/elsewhere:1", "", THEIRS, "router, 10.0.0.1"),
        ("tls/router:1", "it refuses us", THEIRS, "it refuses us"),
        ("tls/router:1", "", OTHER.issue(ROUTER, ["router"]), "be a rogue"),
        ("tls/router:1", "", STALE, f"router's certificate {PAST}"),
    ],
)
def test_each_fault_of_a_router_is_explained_once(monkeypatch, endpoint, problem, certificate, reason) -> None:
    parsed = certificate and x509.load_pem_x509_certificate(certificate.certificate)
    monkeypatch.setattr(diagnosis, "handshake", lambda *_: (problem, parsed))
    reasons = explain(GOOD, endpoint)
    assert len(reasons) == (reason is not None)
    assert all(reason in sentence for sentence in reasons)


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., str]]:
    """Start a server that answers with some bytes and may close the connection."""
    monkeypatch.setattr(diagnosis, "_CONNECT_S", 0.3)
    with ExitStack() as stack:

        def serve(answer: bytes = b"", closes: bool = False) -> str:
            server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

            def accept() -> None:
                with suppress(OSError):
                    link = stack.enter_context(server.accept()[0])
                    link.recv(4096)  # otherwise the connection would be reset
                    link.sendall(answer)
                    if closes:
                        link.close()

            thread = threading.Thread(target=accept)
            thread.start()
            stack.callback(thread.join)
            return f"tls/127.0.0.1:{server.getsockname()[1]}"

        yield serve


@pytest.mark.parametrize("closes", [False, True])
def test_a_router_that_does_not_answer_a_handshake_or_closes_it_is_tried_again(
    port: Callable[..., str], closes: bool
) -> None:
    (reason,) = explain(Authority("r").issue("a"), port(closes=closes))
    assert UNREACHED in reason
    assert "TLS handshake" in reason


@pytest.mark.parametrize("answer", [b"HTTP/1.0 400 Bad Request\r\n\r\n", b"\x05\x00\x41\x42\x43\x44\x45", bytes(64)])
def test_a_router_without_tls_is_diagnosed(port: Callable[..., str], answer: bytes) -> None:
    assert explain(Authority("r").issue("a"), port(answer)) == ["the router at 127.0.0.1 does not speak TLS"]


@pytest.mark.parametrize(
    ("alert", "meaning"),
    [
        (48, "does not trust"),
        (45, "compare the clocks"),
        (80, "TLSV1_ALERT_INTERNAL_ERROR"),
    ],
)
def test_a_tls_alert_is_a_final_refusal(port: Callable[..., str], alert: int, meaning: str) -> None:
    (reason,) = explain(GOOD, port(bytes([21, 3, 3, 0, 2, 2, alert])))
    assert "refuses us: " in reason
    assert meaning in reason


def test_a_router_that_requires_a_certificate_says_so() -> None:
    assert "none was presented" in diagnosis.meaning("TLSV13_ALERT_CERTIFICATE_REQUIRED")
