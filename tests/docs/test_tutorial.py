"""The tutorial works as written."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.heavy

PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"


@pytest.mark.mesh
@pytest.mark.timeout(300)
def test_every_file_and_command_of_the_tutorial_works_as_written(tmp_path: Path) -> None:
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    blocks = re.findall(r"^```(console|python file=(\S+))\n(.*?)^```$", PAGE.read_text(), flags=re.S | re.M)
    assert len(blocks) == len(re.findall(r"^```\w", PAGE.read_text(), flags=re.M)), "a block that no test runs"
    commands = 0
    for kind, file, text in blocks:
        if file:
            (tmp_path / file).write_text(text)
            continue
        assert kind == "console"
        for line in text.splitlines():
            assert line.startswith("$ ")
            process = subprocess.run(
                line[2:], shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
            )
            assert process.returncode == 0, f"{line}\n{process.stdout}{process.stderr}"
            commands += 1
    assert commands >= 9
    assert (tmp_path / "study" / "report.html").is_file()
