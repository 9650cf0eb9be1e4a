"""docs/deploy.md works as written, as far as possible on one machine."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from containers import base

from mast_zenoh import scenario
from mast_zenoh.deploy.ssh import hostsfile

pytestmark = pytest.mark.heavy

PAGE = Path(__file__).parents[2] / "docs" / "deploy.md"


@pytest.mark.mesh
@pytest.mark.timeout(600)
def test_every_command_for_one_machine_works_as_written(tmp_path: Path) -> None:
    here = base()
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    blocks = re.findall(r"^```console( image)?\n(.*?)^```$", PAGE.read_text(), flags=re.S | re.M)
    assert len(blocks) >= 3
    for image, text in blocks:
        for line in text.splitlines():
            assert line.startswith("$ ")
            command = line[2:].replace("python:3.12-slim", here) if image else line[2:]
            process = subprocess.run(
                command, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
            )
            assert process.returncode == 0, f"{line}\n{process.stdout}{process.stderr}"
    assert (tmp_path / "composed" / "report.html").is_file()


def test_the_example_places_nodes_as_described() -> None:
    text = re.findall(r"^```toml\n(.*?)^```$", PAGE.read_text(), flags=re.S | re.M)[0]
    path, loaded = scenario.load("uncoordinated")
    nodes = scenario.resolve(path, loaded, frames=2, record=True).nodes
    placed = hostsfile.parse(text, "hosts.toml").placed(nodes)
    assert {spec.role for name, spec in nodes.items() if placed[name] == "there"} == {"agent", "adversary"}
