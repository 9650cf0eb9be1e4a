"""Only the user can change a run's files or read its secrets."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from launched import MAST, Launched

from mast_zenoh.launch.live_interception import SECRET_FILE

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
LAX = ("sh", "-c", 'umask 000; exec "$@"', "sh", *MAST)
SMALL = ("--set", "n_infrastructure=1", "--out")


def modes(*folders: Path) -> dict[Path, int]:
    """Permissions of folders and their content, without symbolic links."""
    paths: Iterable[Path] = (path for folder in folders for path in (folder, *folder.rglob("*")))
    return {path: stat.S_IMODE(path.stat().st_mode) for path in paths if not path.is_symlink()}


def writable_by_others(permissions: dict[Path, int]) -> dict[str, str]:
    return {str(path): oct(mode) for path, mode in permissions.items() if mode & 0o022}


def test_runs_reports_and_the_cache_are_not_writable_by_others(
    start: Callable[..., Launched], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    run = start(*LAX, "run", "baseline", "--frames", "12", *SMALL)
    assert run.end()[0] == 0
    permissions = modes(run.out, tmp_path / "cache")
    names = {path.name for path in permissions}
    assert {"run.json", "messages.mcap", "metrics.json", "report.html", "scene.npz", "broker.log", "scenes"} <= names
    assert writable_by_others(permissions) == {}


def test_keys_of_a_secure_run_are_not_readable_by_others(start: Callable[..., Launched], tmp_path: Path) -> None:
    run = start(*LAX, "run", "baseline", "--secure", "--mode", "realtime", "--frames", "40", "--no-report", *SMALL)
    run.started()
    (keys,) = Path(os.environ["TMPDIR"]).glob("mast-keys-*")
    during = modes(keys)
    secret = stat.S_IMODE((run.out / SECRET_FILE).stat().st_mode)
    run.ended()
    files = {path: mode for path, mode in during.items() if path.suffix}
    assert {path.name for path in files} == {"ca.pem", "certificate.pem", "key.pem", "control.json"}
    assert set(files.values()) == {0o600}
    folders = {path: mode for path, mode in during.items() if path not in files}
    assert {path.name for path in folders} > {"ego", "infra_1", "simulator", "broker", "command_center"}
    assert set(folders.values()) == {0o700}
    assert secret == 0o600
    assert writable_by_others(modes(run.out)) == {}
    assert not list(Path(os.environ["TMPDIR"]).glob("mast-keys-*")), "keys do not outlive their run"
