"""The example of docs/how-to-ros2.md runs: a node by zenoh-ros2-sdk in a process of its own, and its scenario."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.session import open_router
from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.reader import read

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "how-to-ros2.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```python file=(\S+)\n(.*?)^```$", PAGE, flags=re.S | re.M))
FILES["near.py"] = (DOCS / "examples" / "near.py").read_text(encoding="utf-8")


@pytest.mark.heavy
def test_the_node_of_the_page_is_an_agents_perception(tmp_path: Path) -> None:
    pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk is not installed", exc_type=ImportError)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    session, endpoint = open_router()
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    node = subprocess.Popen([sys.executable, str(tmp_path / "near.py"), host, port])
    try:
        path, content = scenario.load(str(tmp_path / "with_ros.py"), [f"router={endpoint}"])
        resolved = scenario.resolve(path, content, frames=20, record=True)
        ended = launcher.run(resolved, tmp_path / "run", runtime="inproc")
    finally:
        node.kill()
        node.wait()
        session.close()
    assert ended.error is None
    assert ended.record["outside"]["infra_1"]["answered"] == 20
    tracks = [codec.decode(each.payload, "tracks") for each in read(ended.folder) if each.key == "agent/infra_1/tracks"]
    far = np.concatenate([np.abs(message.body["position"][:, 0]) for message in tracks])
    assert len(far) > 0
    assert far.max() < 25.0, "what is far away is forgotten"
