"""Files, modules and names that docstrings and pages mention exist."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import mast_zenoh

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "mast_zenoh"
MODULES = sorted([*PACKAGE.rglob("*.py"), *(ROOT / "nodes").glob("*.py")])
EXTENSIONS = [*PACKAGE.rglob("*.pyx")]
FOLDERS = [path for path in [PACKAGE, *PACKAGE.rglob("*")] if path.is_dir()]
OF_DOCS = [page for pattern in ("*.md", "results/*.md") for page in (ROOT / "docs").glob(pattern)]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", *OF_DOCS])

#: Folders from which texts name files.
PLACES = (ROOT, PACKAGE, ROOT / "docs", ROOT / "tests", *(path for path in PACKAGE.iterdir() if path.is_dir()))
#: Names of the Python API that are not in a module of their name.
PUBLIC = {*mast_zenoh.__all__, "__all__"}
#: Files that users write.
PLACEHOLDERS = {"/home/me/shover.py"}
#: Documents of the working group that are not shipped.
NOT_SHIPPED = re.compile(r"\b(DESIGN|ANCHORS|INTEGRITY|STYLE|DATASETS|REVIEWS|ZENOH)\b|layout-moves")
#: Prefixes in backticks that are not modules: suffixes of data files, labels, other packages.
FOREIGN = {
    "detections",
    "report",
    "visibility",
    "buildings",
    "scene",
    "study",
    "mast",
    "self",
    "role",
    "filterpy",
    "subprocess",
}


def docstrings(path: Path) -> Iterator[str]:
    """All docstrings of a file."""
    nodes: list[Any] = [ast.parse(path.read_text(encoding="utf-8"))]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""
        nodes += getattr(node, "body", ())


@cache
def words_of(path: Path) -> frozenset[str]:
    """The words in a module, or in all modules of a package."""
    files = path.rglob("*.py") if path.is_dir() else [path]
    return frozenset(word for file in files for word in re.findall(r"\w+", file.read_text("utf-8")))


@cache
def classes_of(path: Path) -> frozenset[str]:
    """The names of the classes in a module."""
    return frozenset(re.findall(r"class (\w+)", path.read_text("utf-8")))


@cache
def named(name: str) -> tuple[Path, ...]:
    """Modules and packages of this name, and modules that define such a class."""
    folders = [path for path in FOLDERS if path.name == name]
    files = [path for path in [*MODULES, *EXTENSIONS] if path.stem == name]
    return (*folders, *files, *(path for path in MODULES if name in classes_of(path)))


def exists(reference: str, beside: Path) -> bool:
    """Whether a path mentioned in a text in the folder `beside` is a file."""
    return any((folder / reference).exists() for folder in (beside, *PLACES))


def test_references_in_texts_exist() -> None:
    assert not [f"{path.relative_to(ROOT)}: {wrong}" for path in (*MODULES, *PAGES) for wrong in wrong_references(path)]


def wrong_references(path: Path) -> Iterator[str]:
    """What the texts of a file refer to that does not exist."""
    texts = [path.read_text(encoding="utf-8")] if path.suffix == ".md" else list(docstrings(path))
    for text in texts:
        for reference in re.findall(r"[\w./-]*\w/[\w./-]*\.(?:pyx|pxd|py|md|toml)\b", text):
            if reference not in PLACEHOLDERS and not exists(reference, path.parent):
                yield f"no file {reference}"
        for reference in re.findall(r"\bmast_zenoh((?:\.[a-z_]\w*)+)", text):
            first, *remaining = reference[1:].split(".")
            folder = PACKAGE / first
            if first in PUBLIC or reference == ".plugins":  # the group of entry points
                continue
            if not (folder.is_dir() or folder.with_suffix(".py").is_file()):
                yield f"no module mast_zenoh.{first}"
            elif remaining:
                module = folder / remaining[0]
                is_module = module.is_dir() or module.with_suffix(".py").is_file()
                if not is_module and remaining[0] not in words_of(folder):
                    yield f"no {reference}"
        if path.suffix == ".py":
            for first, second in re.findall(r"`([A-Za-z]\w*)\.([A-Za-z]\w*)[\w.()]*`", text):
                if first not in {"mast_zenoh", *FOREIGN} and not has(first, second):
                    yield f"no `{first}.{second}`"
        if NOT_SHIPPED.search(text):
            yield "refers to a document that is not shipped"


def has(first: str, second: str) -> bool:
    """Whether something named `first` has a module or mentions a word `second`."""
    for candidate in named(first):
        beside = (candidate.parent / f"{second}.py", candidate / f"{second}.py")
        if second in words_of(candidate) or any(file.is_file() for file in beside):
            return True
    return False
