"""tools/size.py counts code, in files and in commits."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
import size

CODE = '''"""A module.

Its docstring has two paragraphs."""

import os  # counted


# A comment.
class Thing:
    """One line."""

    name: str = "a"
    "What the attribute means."

    def text(self) -> str:
        """Return text."""
        return """first

third"""


def split(
    value,  # counted
):
    return (
        value

        # inside
        + 1
    )
'''


def test_lines_of_python_are_counted_without_comments_docstrings_and_blank_lines() -> None:
    assert size.python_lines(CODE) == 13
    assert size.python_lines("") == size.python_lines('"""Only this."""\n') == 0
    assert size.python_lines("x = 1") == 1


def test_lines_of_other_languages_are_counted_without_comments_that_begin_a_line() -> None:
    assert size.other_lines("// no\nlet a = 1; // yes\n\n/* no\n * no */\n  /** no */\nlet b = 2;\n") == 2
    assert size.other_lines("<p>\n<!-- no\n -->\n{# no #}\n</p>\n") == 2


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one commit."""
    files = {
        "mast_zenoh/errors.py": "a = 1\n",
        "mast_zenoh/show/pages/page.py": "a = 1\nb = 2\n",
        "mast_zenoh/show/page.html.j2": "<p>\n</p>\n",
        "mast_zenoh/kernels/fast.pyx": "cdef int a = 1  # yes\n",
        "plugins/datasets/mast_datasets/reader.py": "a = 1\n",
        "plugins/datasets/tests/test_reader.py": "\n# raw\n",
        "tests/report/test_page.py": "a = 1\n",
        "tools/tool.py": "a = 1\n",
        "docs/page.md": "Three words here\n",
        "docs/list.md": "<!-- Written by `make docs` -->\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    person = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    for arguments in (("init", "--quiet"), ("add", "."), (*person, "commit", "--quiet", "--message", "a")):
        subprocess.run(("git", *arguments), cwd=tmp_path, check=True)
    monkeypatch.setattr(size, "ROOT", tmp_path)
    return tmp_path


def test_rooms_tests_and_pages_are_counted_apart(checkout: Path, capsys: pytest.CaptureFixture[str]) -> None:
    size.main(["--json"])
    now = json.loads(capsys.readouterr().out)["now"]
    assert now["rooms"] == {"(files)": 1, "show": 2, "plugins": 1}
    counts = {size.TOTAL: 4, size.PACKAGE: 3, size.FILES: 3, size.TESTS: 3, "templates": 2, "Cython": 1}
    assert now["others"] == counts | {size.PAGES: 1, size.WORDS: 3, size.GENERATED: 1, size.GENERATED_WORDS: 6}


def test_a_commit_is_compared_with_what_is_checked_out(checkout: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (checkout / "mast_zenoh/show/pages/page.py").unlink()
    (checkout / "mast_zenoh/runs").mkdir()
    (checkout / "mast_zenoh/runs/run.py").write_text("a = 1\nb = 2\nc = 3\n")
    size.main(["--against", "HEAD"])
    lines = {line[:24].strip(): line[24:].split() for line in capsys.readouterr().out.splitlines()}
    assert lines["show"] == ["2", "0", "-2"]
    assert lines["runs"] == ["0", "3", "+3"]
    assert lines["(files)"] == ["1", "1", "+0"]
    assert lines[size.TOTAL] == ["4", "5", "+1"]
