"""Files that remote nodes receive and send: only their own, and none outside their folder."""

import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import RunError
from mast_zenoh.launch.file_server import files_for_node, with_local_imports
from mast_zenoh.mesh.control import files
from mast_zenoh.mesh.control.codec import ControlMessage
from mast_zenoh.mesh.file_client import FileClient, files_written_by
from mast_zenoh.run_folder.recording.writer import MessageLog


@pytest.fixture(scope="module")
def small() -> Resolved:
    return scenario.resolve(*scenario.load("baseline", ["n_infrastructure=1"]), frames=2, record=True)


def test_a_node_gets_only_its_own_file_and_imports(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import near, package.inside\nfrom os import path\n")
    (tmp_path / "near.py").write_text("from further import x\n")
    (tmp_path / "further.py").write_text("import mine\nx = 1\n")
    (tmp_path / "secret.py").write_text("")
    (tmp_path / "package").mkdir()
    for name in ("__init__", "inside"):
        (tmp_path / "package" / f"{name}.py").write_text("")
    names = {path.relative_to(tmp_path).as_posix() for path in with_local_imports(tmp_path / "mine.py")}
    assert names == {"mine.py", "near.py", "further.py", "package/__init__.py", "package/inside.py"}


def test_the_scene_is_served_only_to_the_driver(tmp_path: Path, small: Resolved) -> None:
    served = {name: dict(files_for_node(small, name, tmp_path)) for name in small.nodes}
    assert served["simulator"].keys() == {"scenario.json", "wiring.json", "files/0/simulator.py", "scene.npz"}
    assert served["ego"].keys() == {"scenario.json", "wiring.json", "files/0/agent.py"}
    content = served["ego"]["scenario.json"]
    assert isinstance(content, bytes)
    assert str(Path(__file__).parents[2]).encode() not in content, "no path of the launcher's machine"


def test_only_a_recorder_may_send_a_log(small: Resolved) -> None:
    written = {name: files_written_by(small, name) for name in small.nodes}
    assert {name: paths for name, paths in written.items() if paths} == {"recorder": (str(MessageLog().path),)}


class Launcher(FileClient):
    """A launcher that names one empty file for a node."""

    def __init__(self, path: str) -> None:
        super().__init__(None, "run", "node")  # type: ignore[arg-type]
        self.path = path

    def ask(self, what: str, request: ControlMessage, seconds: float, kind: type[Any]) -> Any:
        is_clock = isinstance(request, files.Clock)
        return files.LauncherTime(time.time_ns()) if is_clock else files.NodeFiles({self.path: 0}, [])


@given(st.text(st.sampled_from("./ab~\\"), min_size=1, max_size=12))
def test_file_names_cannot_escape_the_folder(name: str) -> None:
    with tempfile.TemporaryDirectory() as around:
        folder = Path(around) / "a" / "b" / "folder"
        folder.mkdir(parents=True)
        if Path(name).is_absolute():
            with pytest.raises(RunError, match=r"leads outside.*folder"):
                Launcher(name).fetch(folder, 1.0)
        with suppress(RunError, IsADirectoryError):
            Launcher(name).fetch(folder, 1.0)
        written = [path for path in Path(around).rglob("*") if path.is_file()]
        assert all(path.is_relative_to(folder) for path in written)
