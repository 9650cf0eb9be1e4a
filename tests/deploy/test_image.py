"""The image holds only what nodes need."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from containers import base, built

from mast_zenoh import version
from mast_zenoh.config import plugins
from mast_zenoh.deploy import docker as image
from mast_zenoh.deploy import wheel
from mast_zenoh.deploy.docker import docker
from mast_zenoh.errors import EngineError

pytestmark = pytest.mark.heavy

ROOT = Path(__file__).parents[2]
LARGEST = 350_000_000

#: Rejects imports that a node must not need; runs every node's file and late imports.
PROBE = """
import pathlib, sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {refused}:
            raise ModuleNotFoundError(f"a node needs {{name}}")
sys.meta_path.insert(0, Refuse())
from mast_zenoh.config import loading
from mast_zenoh.deploy import remote_node
for file in sorted(pathlib.Path({nodes!r}).glob("*.py")):
    loading.module(file)
import filterpy.kalman, mcap.writer, mast_zenoh.mesh.security.diagnosis, mast_zenoh.tracking.box_tracker
"""


def needed() -> set[str]:
    return {requirement.partition("==")[0] for requirement in wheel.requirements()}


def test_nodes_need_only_the_node_requirements() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    all_of_it = {line.partition(">")[0].partition("[")[0] for line in project["dependencies"]}
    more = all_of_it - needed()
    assert {"pyarrow", "matplotlib", "jinja2", "rich", "typer"} <= more
    refused = {*more, "dask", "distributed", "rerun", "yaml", "asyncssh", "psutil"}
    code = PROBE.format(refused=refused, nodes=str(ROOT / "nodes"))
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr


def test_the_wheel_always_has_the_same_sources_and_entry_points(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "ab"]
    for folder in folders:
        folder.mkdir()
    first, second = (wheel.build(folder) for folder in folders)
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as archive:
        names = archive.namelist()
        info = next(name.split("/")[0] for name in names if ".dist-info/" in name)
        assert "mast-node = mast_zenoh.deploy.remote_node:main" in archive.read(f"{info}/entry_points.txt").decode()
        recorded = {line.split(",")[0] for line in archive.read(f"{info}/RECORD").decode().splitlines()}
    assert recorded == set(names)
    assert {"mast_zenoh/bundled/deploy/Dockerfile", "mast_zenoh/bundled/nodes/agent.py"} <= recorded
    assert "mast_zenoh/show/page/js/main.js" in recorded, "a launcher writes reports"


@pytest.mark.mesh
@pytest.mark.timeout(600)
def test_the_image_is_small_and_holds_these_sources_their_plugins_and_only_node_requirements() -> None:
    on, tag = base(), built()
    assert image.size_over_base(tag, on) < LARGEST
    assert docker("image", "inspect", "--format", "{{.Config.User}} {{.Config.Entrypoint}}", tag).split() == [
        image.USER,
        "[mast-node]",
    ]
    code = (
        "import importlib.metadata as m\n"
        "from mast_zenoh import version\n"
        "print(version.fingerprint(), *{d.name.lower() for d in m.distributions()})"
    )
    fingerprint, *there = docker("run", "--rm", "--network=none", "--entrypoint=python3", tag, "-c", code).split()
    assert fingerprint == version.fingerprint()
    carried = {"mast-zenoh", *(plugin.distribution.partition(" ")[0] for plugin in plugins.installed())}
    assert set(there) - {"pip", "setuptools", "wheel"} == needed() | carried


@pytest.mark.mesh
def test_an_image_of_other_sources_is_refused_and_both_are_named() -> None:
    with pytest.raises(EngineError, match=r"holds mast-zenoh .*\(sources unknown\), expected .*mast deploy image"):
        image.check_image(base())
