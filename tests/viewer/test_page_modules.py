"""The unit tests of the page's JavaScript, in tests/viewer/page, pass."""

import shutil
import subprocess
from pathlib import Path

import pytest


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_modules_of_the_page_do_what_their_unit_tests_say() -> None:
    folder = Path(__file__).with_name("page")
    ended = subprocess.run(["node", "--test", str(folder)], capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0, ended.stdout
    assert "# pass 0" not in ended.stdout
