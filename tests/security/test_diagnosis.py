"""Refused certificates are explained in a sentence with the file or host."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from mast_zenoh.security import diagnosis, explain
from mast_zenoh.security.authority import Authority
from mast_zenoh.security.credentials import UNREACHED, Credentials
from mast_zenoh.security.diagnosis import Certificate, Facts, Router, reasons

NOW = datetime(2026, 11, 20, 12, 0, tzinfo=UTC)
HOUR = timedelta(hours=1)
SOUND = Certificate("infra_1.r", NOW - HOUR, NOW + HOUR, trusted=True)
THEIRS = replace(SOUND, common_name="@router.r", names=("router", "10.0.0.1"))
FACTS = Facts(
    NOW, "/keys", authority=SOUND, certificate=SOUND, key_fits=True, host="router", router=Router(certificate=THEIRS)
)


def test_valid_credentials_have_no_reasons() -> None:
    assert list(reasons(FACTS)) == []


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"certificate": replace(SOUND, not_after=NOW - HOUR)}, "expired at 2026-11-20 11:00:00 UTC, now it is"),
        ({"certificate": replace(SOUND, not_before=NOW + HOUR)}, "not valid before 2026-11-20 13:00:00 UTC"),
        ({"certificate": replace(SOUND, trusted=False)}, "'infra_1.r' was issued by another authority"),
        ({"authority": replace(SOUND, not_after=NOW - HOUR)}, "the authority's certificate expired at"),
        ({"key_fits": False}, "the key does not belong to the certificate"),
        ({"unusable": (("/keys/key.pem", "is missing"),)}, "/keys/key.pem: is missing"),
        ({"too_wide": (("/keys/key.pem", 0o644),)}, "others may read it (mode 0644), expected 0600"),
        ({"too_wide": (("/keys", 0o755),)}, "others may read it (mode 0755), expected 0700"),
        ({"scheme": "tcp"}, "tcp/router: not encrypted"),
        ({"host": "elsewhere"}, "not for 'elsewhere', but for router, 10.0.0.1"),
        ({"router": Router(silent="Connection refused")}, "cannot be reached: Connection refused"),
        ({"router": Router(plain=True)}, "does not speak TLS"),
        ({"router": Router(certificate=replace(THEIRS, trusted=False))}, "it may be a rogue"),
        ({"router": Router(certificate=replace(THEIRS, not_after=NOW - HOUR))}, "router's certificate expired at"),
        ({"router": Router(certificate=THEIRS, verdict="TLSV1_ALERT_UNKNOWN_CA")}, "does not trust the authority"),
        ({"router": Router(certificate=THEIRS, verdict="TLSV13_ALERT_CERTIFICATE_REQUIRED")}, "none was presented"),
        ({"router": Router(certificate=THEIRS, verdict="SSLV3_ALERT_CERTIFICATE_EXPIRED")}, "compare the clocks"),
        ({"router": Router(certificate=THEIRS, verdict="SOMETHING_NEW")}, "SOMETHING_NEW"),
    ],
)
def test_each_fault_is_explained_once(changed: dict, reason: str) -> None:
    (sentence,) = reasons(replace(FACTS, **changed))
    assert reason in sentence


def test_valid_files_have_no_reasons(tmp_path: Path) -> None:
    assert explain(Authority("r").issue("a").write(tmp_path / "a")) == []


def test_faults_of_files_are_found(tmp_path: Path) -> None:
    authority, now = Authority("r"), datetime.now(UTC)

    def of(credentials: Credentials) -> list[str]:
        return explain(credentials.write(tmp_path / os.urandom(4).hex()))

    good, other = authority.issue("a"), Authority("r").issue("a")
    assert "expired at" in "".join(of(authority.issue("a", begins=now - 2 * HOUR, ends=now - HOUR)))
    assert "not valid before" in "".join(of(authority.issue("a", begins=now + HOUR)))
    assert "another authority" in "".join(of(Credentials(authority.pem, other.certificate, other.key)))
    assert "does not belong" in "".join(of(Credentials(authority.pem, good.certificate, other.key)))
    assert "not a PEM certificate" in "".join(of(Credentials(authority.pem, b"nonsense", good.key)))
    assert "not a PEM private key" in "".join(of(Credentials(authority.pem, good.certificate, b"nonsense")))
    assert "key.pem: is missing" in "".join(of(Credentials(authority.pem, good.certificate)))
    assert "ca.pem: is missing" in "".join(explain(tmp_path / "nowhere"))
    folder = good.write(tmp_path / "wide")
    (folder / "key.pem").chmod(0o640)
    assert "mode 0640" in "".join(explain(folder))


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


def test_a_router_that_does_not_answer_a_handshake_may_be_busy_and_is_tried_again(
    port: Callable[..., str],
) -> None:
    (reason,) = explain(Authority("r").issue("a"), port())
    assert UNREACHED in reason
    assert "did not complete the TLS handshake within 0.3 s: it is busy or does not speak TLS" in reason


def test_a_router_that_closes_the_connection_in_the_handshake_is_tried_again(port: Callable[..., str]) -> None:
    (reason,) = explain(Authority("r").issue("a"), port(closes=True))
    assert UNREACHED in reason
    assert "closed the connection during the TLS handshake: it is busy or does not speak TLS" in reason


@pytest.mark.parametrize("answer", [b"HTTP/1.0 400 Bad Request\r\n\r\n", b"\x05\x00\x41\x42\x43\x44\x45", bytes(64)])
def test_a_router_without_tls_is_diagnosed(port: Callable[..., str], answer: bytes) -> None:
    assert explain(Authority("r").issue("a"), port(answer)) == ["the router at 127.0.0.1 does not speak TLS"]


def test_a_tls_alert_is_a_final_refusal(port: Callable[..., str]) -> None:
    alert = bytes([21, 3, 3, 0, 2, 2, 48])  # fatal, unknown_ca
    (reason,) = explain(Authority("r").issue("a"), port(alert))
    assert "refuses us: it does not trust the authority that issued" in reason
