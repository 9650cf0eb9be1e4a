"""Routers and nodes without a launcher leave, but routers give it time to arrive."""

import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from launched import eventually

from mast_zenoh.mesh.control import control_prefix
from mast_zenoh.mesh.hosting import UP, LauncherWatch
from mast_zenoh.mesh.session import open_router

pytestmark = pytest.mark.mesh


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[zenoh.Session]:
    """A session; the file that says that the launcher is up is in the test's folder."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    router, _ = open_router()
    with router:
        yield router


def test_without_a_launcher_the_process_leaves(session: zenoh.Session) -> None:
    left = threading.Event()
    with LauncherWatch(session, "a", 0.0, left.set) as watch:
        assert left.wait(10)
    assert watch.gone


def test_a_launcher_may_take_longer_to_arrive_than_it_may_be_absent_later(session, tmp_path) -> None:
    left = threading.Event()
    with LauncherWatch(session, "a", 0.0, left.set, arrival_s=60.0) as watch:
        launcher = session.liveliness().declare_token(f"{control_prefix('a')}/launcher")
        eventually((tmp_path / UP).exists, "the launcher is seen")
        assert not left.is_set()
        launcher.undeclare()
        assert left.wait(10), "without it, the patience counts"
    assert watch.limit_s == 0.0
