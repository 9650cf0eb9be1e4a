"""Counts the code: lines of each room without comments, docstrings and blank lines, lines of tests, words of pages.

python tools/size.py                  of the files of this checkout
python tools/size.py --against REV    and of a commit, with the difference
python tools/size.py --json           for other programs

A room is a folder at the top of mast_zenoh, or one of the folders beside it that users read. Only Python counts as
code; JavaScript, Cython and templates of pages are counted apart.
"""

from __future__ import annotations

import argparse
import io
import json
import re
import subprocess
import tarfile
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[1]
#: Folders beside the package that are counted with it.
BESIDE = ("nodes", "plugins", "scenarios", "studies")
#: Languages other than Python, by the end of a file's name.
APART = {
    ".js": "JavaScript",
    ".pyx": "Cython",
    ".pxd": "Cython",
    **dict.fromkeys((".j2", ".html", ".css"), "templates"),
}
PACKAGE, TOTAL, FILES = "of these in the package", "code lines in all", "files"
TESTS, PAGES, WORDS = "raw lines of tests", "pages", "words of pages"
#: What `make docs` has written is counted apart, too.
GENERATED, GENERATED_WORDS = "generated pages", "words of generated pages"
#: Tokens that are no code.
_SILENT = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENCODING, tokenize.ENDMARKER),
}
#: Of these, the ones after which a statement begins.
_BEFORE_A_STATEMENT = {tokenize.ENCODING, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}


def python_lines(text: str) -> int:
    """Code lines of Python or Cython: those with a token that is no comment and no docstring, and no blank ones."""
    lines = text.splitlines()
    counted: set[int] = set()
    statement: list[tokenize.TokenInfo] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _SILENT:
            statement.append(token)
        elif token.type in _BEFORE_A_STATEMENT | {tokenize.ENDMARKER} and statement:
            if any(each.type != tokenize.STRING for each in statement):  # otherwise a docstring
                counted.update(line for each in statement for line in range(each.start[0], each.end[0] + 1))
            statement = []
    return sum(1 for line in counted if lines[line - 1].strip())


def other_lines(text: str) -> int:
    """Lines of JavaScript, CSS or HTML that are not blank, nor in a comment that begins a line."""
    text = re.sub(r"(?ms)^[ \t]*(/\*.*?\*/|<!--.*?-->|\{#.*?#\})[ \t]*$", "", text)
    return sum(1 for line in text.splitlines() if line.strip() and not line.lstrip().startswith("//"))


def room_of(path: PurePosixPath) -> str | None:
    """The room of a file, None if it has none."""
    first, *inner = path.parts
    if first == "mast_zenoh":
        return inner[0] if len(inner) > 1 else "(files)"
    return first if first in BESIDE else None


def measure(files: Iterator[tuple[str, bytes]]) -> tuple[Counter[str], Counter[str]]:
    """Code lines by room, and the other counts by name."""
    rooms: Counter[str] = Counter()
    others: Counter[str] = Counter()
    for name, content in files:
        path = PurePosixPath(name)
        if "tests" in path.parts[:-1]:
            others[TESTS] += content.count(b"\n") * (path.suffix == ".py")
        elif path.parts[0] == "docs":
            if path.suffix == ".md":
                generated = b"<!-- Written by" in content
                others[GENERATED if generated else PAGES] += 1
                others[GENERATED_WORDS if generated else WORDS] += len(content.split())
        elif (room := room_of(path)) is not None:
            if path.suffix == ".py":
                rooms[room] += python_lines(content.decode())
                others[FILES] += 1
            elif path.suffix in APART:
                count = python_lines if APART[path.suffix] == "Cython" else other_lines
                others[APART[path.suffix]] += count(content.decode())
    others[TOTAL] = sum(rooms.values())
    others[PACKAGE] = sum(lines for room, lines in rooms.items() if room not in BESIDE)
    return rooms, others


def checked_out() -> Iterator[tuple[str, bytes]]:
    """Names and contents of the files of this checkout that Git does not ignore."""
    listed = _git("ls-files", "-z", "--cached", "--others", "--exclude-standard").decode().split("\0")
    return ((name, (ROOT / name).read_bytes()) for name in listed if name and (ROOT / name).is_file())


def committed(revision: str) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the files of a commit."""
    with tarfile.open(fileobj=io.BytesIO(_git("archive", "--format=tar", revision))) as archive:
        for member in archive:
            if (file := archive.extractfile(member)) is not None:
                yield member.name, file.read()


def _git(*arguments: str) -> bytes:
    return subprocess.run(("git", "-C", str(ROOT), *arguments), stdout=subprocess.PIPE, check=True).stdout


def table(now: Counter[str], before: Counter[str] | None) -> Iterator[str]:
    """Lines with the counts, and with those before and the difference."""
    for name in sorted(now | (before or Counter()), key=lambda name: (-max(now[name], (before or now)[name]), name)):
        if before is None:
            yield f"{name:24} {now[name]:9,}"
        else:
            yield f"{name:24} {before[name]:9,} {now[name]:9,} {now[name] - before[name]:+9,}"


def main(arguments: list[str] | None = None) -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--against", metavar="REV", help="a commit, counted too: before, now, difference")
    parser.add_argument("--json", action="store_true", help="print JSON")
    chosen = parser.parse_args(arguments)
    rooms, others = measure(checked_out())
    before = measure(committed(chosen.against)) if chosen.against else (None, None)
    if chosen.json:
        counts = {"now": {"rooms": rooms, "others": others}}
        if chosen.against:
            counts["before"] = {"rooms": before[0], "others": before[1]}
        print(json.dumps(counts, indent=2))
        return
    if chosen.against:
        print(f"{'':24} {'before':>9} {'now':>9} {'':>9}")
    print("\n".join((*table(rooms, before[0]), "", *table(others, before[1]))))


if __name__ == "__main__":
    main()
