"""Only the user can change a deployment's files or read its secrets."""

import json
import os
import stat
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from mast_zenoh.deploy import remote_node
from mast_zenoh.deploy.compose import hand_over
from mast_zenoh.deploy.docker import USER
from mast_zenoh.deploy.ssh import onhost
from mast_zenoh.mesh.security.deployment import Deployment
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring

WIRING = Wiring((Wire("w", "", "clock", (Leg("w", Endpoint("a", "out"), (Endpoint("b", "in"),)),)),))


@pytest.fixture(autouse=True, params=[0o000, 0o022, 0o077], ids="{:03o}".format)
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def modes(folder: Path) -> dict[str, int]:
    paths = (folder, *folder.rglob("*"))
    return {str(path.relative_to(folder)): stat.S_IMODE(path.lstat().st_mode) for path in paths}


@pytest.mark.parametrize("level", ["tls", "mtls", "acl"])
def test_only_their_user_can_read_the_credentials_of_containers(tmp_path: Path, level: str) -> None:
    folder = tmp_path / "credentials"
    with Deployment(
        level, "r", WIRING, ["a", "b"], prefix="mast/r", driver="a", hosts=["router"], folder=folder
    ) as deployment:
        hand_over(folder, deployment.router, USER if not os.getuid() else f"{os.getuid()}:{os.getgid()}")
        permissions = modes(folder)
        assert {"a/ca.pem", "b", "router/router.json", "router"} <= permissions.keys()
        assert ("a/key.pem" in permissions) == (level != "tls")
        for path, mode in permissions.items():
            assert mode == (0o600 if Path(path).suffix else 0o700), path
        if not os.getuid():
            owner = folder / "router" / "router.json"
            assert f"{owner.stat().st_uid}:{owner.stat().st_gid}" == USER
    assert not folder.exists()


def on_host(home: Path, *words: str) -> dict:
    command = [sys.executable, onhost.__file__, *words]
    process = subprocess.run(
        command, env={**os.environ, "HOME": str(home)}, capture_output=True, text=True, check=True, timeout=60
    )
    return json.loads(process.stdout)


def test_other_users_cannot_change_installed_files_on_a_host(tmp_path: Path) -> None:
    on_host(tmp_path, "probe", "mast", "e", "r")
    new = tmp_path / "mast" / "releases" / "new"
    new.mkdir(mode=0o700)
    with zipfile.ZipFile(new / "some.whl", "w") as wheel:
        wheel.writestr("package/module.py", "x = 1\n")
    on_host(tmp_path, "unpack", str(new), str(tmp_path / "mast" / "releases" / "r"), "0")
    permissions = modes(tmp_path / "mast")
    assert "releases/r/package/module.py" in permissions
    assert permissions["runs"] == 0o700
    assert {path: oct(mode) for path, mode in permissions.items() if mode & 0o022} == {}


def test_other_users_cannot_read_the_files_of_a_remote_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["mast-node", "--run", "r", "--name", "ego", "--endpoint", "tcp/127.0.0.1:1"])
    monkeypatch.setattr(remote_node, "_host", lambda arguments: (tmp_path / "written").touch())
    remote_node.main()
    assert modes(tmp_path)["written"] == 0o600
