"""Users' Python files are loaded; errors name the file and line."""

import sys
from pathlib import Path

import pytest

from mast_zenoh.config import bundle, loading
from mast_zenoh.errors import ConfigurationError, NodeFileError
from mast_zenoh.integrity import Integrity

NODE = """
from mast_zenoh.node import Node

class {name}(Node):
    role = "{role}"
    inputs = {{"clock": "clock"}}

    def on_clock(self, received, context):
        pass
"""


def write(folder: Path, name: str, text: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def test_a_function_is_found_in_a_users_file(tmp_path: Path) -> None:
    file = write(tmp_path, "mine.py", "def scenario(a=1):\n    return dict(a=a)\n")
    path, function = loading.function("scenarios", str(file), "scenario")
    assert path == file
    assert function(a=3) == {"a": 3}


@pytest.mark.parametrize("name", ["baseline", "baseline.py", "scenarios/baseline.py"])
def test_shipped_files_are_found_by_name_from_any_directory(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path, function = loading.function("scenarios", name, "scenario")
    assert path == bundle.ROOT / "scenarios" / "baseline.py"
    assert callable(function)


def test_a_users_file_overrides_a_shipped_one_of_the_same_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write(tmp_path, "baseline.py", "def scenario():\n    return {}\n")
    monkeypatch.chdir(tmp_path)
    assert loading.function("scenarios", "baseline.py", "scenario")[0] == file


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("baselin", r"baselin.*'baseline.py'.*mast"),
        ("nosuch", r"nosuch.*scenarios.*mast"),
        ("nowhere/baseline.py", r"nowhere/baseline.py: no.*file"),
        (".", r"\.: is a folder"),
        ("", "no such file"),
    ],
)
def test_a_missing_file_is_refused_with_the_nearest_name(name: str, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        loading.function("scenarios", name, "scenario")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x = 1\n", r"defines.*function `scenario`"),
        ("scenario = 3\n", r"defines.*function `scenario`"),
        ("x = 1\ndef scenario(:\n", "bad.py:2: SyntaxError"),
        ("x = 1\n\nimport no_such_module\n", r"bad.py:3.*'no_such_module'.*installed"),
        ("def f():\n    return 1 / 0\n\nf()\n", "bad.py:2: ZeroDivisionError"),
        ("\udcff".encode("utf-8", "surrogateescape").decode("latin-1") + "=\n", "bad.py"),
    ],
)
def test_an_error_in_a_file_is_reported_with_file_and_line(tmp_path: Path, text: str, reason: str) -> None:
    file = write(tmp_path, "bad.py", text)
    with pytest.raises(ConfigurationError, match=reason):
        loading.function("scenarios", str(file), "scenario")


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("scenario.txt", "hello\n", r"scenario\.txt.*Python file"),
        (
            "mine.py",
            "\nfrom baseline import scenario as base\n",
            r'mine.py:2.*load\("baseline"\)',
        ),
        ("mine.py", "import baselin\n", r"mine.py:1.*'baselin'.*'baseline'"),
        ("mine.py", "import my_scen\n", r"mine.py:1.*'my_scen'.*'my_scene'"),
    ],
)
def test_what_cannot_be_imported_is_refused_with_what_to_do(tmp_path: Path, name: str, text: str, reason: str) -> None:
    write(tmp_path, "my_scene.py", "x = 1\n")
    with pytest.raises(ConfigurationError, match=reason):
        loading.function("scenarios", str(write(tmp_path, name, text)), "scenario")


def test_a_file_imports_the_module_next_to_it_not_a_namesake_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("one", "two"):
        write(tmp_path / folder, "beside.py", f"WHERE = {folder!r}\n")
        write(tmp_path / folder, "main.py", "from beside import WHERE\n\ndef scenario():\n    return WHERE\n")
    monkeypatch.chdir(tmp_path)
    for folder in ("one", "two", "one"):
        for name in (f"{folder}/main.py", str(tmp_path / folder / "main.py")):
            assert loading.function("scenarios", name, "scenario")[1]() == folder
    assert "beside" not in sys.modules
    assert str(tmp_path / "one") not in sys.path


def test_sys_path_is_restored_when_a_file_fails(tmp_path: Path) -> None:
    file = write(tmp_path, "bad.py", "import beside_bad\n1 / 0\n")
    write(tmp_path, "beside_bad.py", "")
    before, modules = list(sys.path), set(sys.modules)
    with pytest.raises(ConfigurationError):
        loading.module(file)
    assert sys.path == before
    assert set(sys.modules) == modules


def test_a_file_may_have_the_name_of_a_standard_module(tmp_path: Path) -> None:
    import types

    loaded = loading.module(write(tmp_path, "types.py", "MINE = True\n"))
    assert loaded.MINE
    assert sys.modules["types"] is types


def test_a_file_may_define_dataclasses_with_postponed_annotations(tmp_path: Path) -> None:
    text = (
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\n"
        "from typing import ClassVar\n"
        "@dataclass\n"
        "class Point:\n"
        "    x: float\n"
        "    kind: ClassVar[str] = 'point'\n"
    )
    assert loading.module(write(tmp_path, "points.py", text)).Point(1.0).x == 1.0


def test_a_file_is_run_once_so_its_classes_stay_identical(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write(tmp_path, "mine.py", "class Mine:\n    pass\n")
    monkeypatch.chdir(tmp_path)
    assert loading.module(file).Mine is loading.module(Path("mine.py")).Mine


@pytest.mark.parametrize("imported", ["time", "sys", "itertools", "xml", "namespace_without_a_file"])
def test_a_module_without_a_file_may_be_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, imported: str
) -> None:
    """Built-in modules have no `__file__`; for a namespace package it is None."""
    (tmp_path / "mine" / "namespace_without_a_file").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "mine")
    loaded = loading.module(write(tmp_path / "mine", "scenario.py", f"import {imported}\n"))
    assert not loading.defines_algorithms(loaded)


def test_an_algorithm_in_a_neighbouring_file_is_recognised_among_modules_without_a_file(tmp_path: Path) -> None:
    text = "from mast_zenoh.scenes.base import Scene\n\nclass Mine(Scene):\n    pass\n"
    write(tmp_path, "my_scene_beside.py", text)
    assert loading.defines_algorithms(
        loading.module(write(tmp_path, "scenario.py", "import sys, time\nimport my_scene_beside\n"))
    )


# -- nodes ---------------------------------------------------------------------------------------------------------


def test_the_only_node_that_a_file_defines_needs_no_name_and_one_of_several_does(tmp_path: Path) -> None:
    file = write(tmp_path, "base_node.py", NODE.format(name="Base", role="link"))
    assert loading.node_class(file).__name__ == "Base"
    assert loading.node_class(file, "Base") is loading.node_class(file, "Base"), "the same class"
    mine = write(tmp_path, "mine.py", "from base_node import Base\n\nclass Mine(Base):\n    pass\n")
    assert loading.node_class(mine).__name__ == "Mine", "an imported node does not count"
    two = write(tmp_path, "two.py", NODE.format(name="One", role="link") + NODE.format(name="Two", role="link"))
    with pytest.raises(NodeFileError, match=r"two\.py: defines.*type=…"):
        loading.node_class(two)
    assert loading.node_class(two, "Two").__name__ == "Two"
    write(tmp_path, "base_node.py", NODE.format(name="Base", role="counting"))
    assert loading.node_class(file).role == "counting", "the file has changed"


@pytest.mark.parametrize(
    ("text", "name", "reason"),
    [
        ("x = 1\n", None, r"mine\.py: defines.*nodes"),
        (NODE.format(name="Mine", role="link"), "Mnie", r"mine\.py.*'Mnie'.*'Mine'"),
        (NODE.format(name="Mine", role="link"), 3, r"mine\.py: type.*3"),
        (NODE.format(name="Mine", role="link"), ["Mine"], r"type.*\['Mine'\].*name"),
        (NODE.replace("on_clock", "on_clok").format(name="Mine", role="x"), None, r"mine.py: Mine.*on_clock"),
    ],
)
def test_a_file_without_the_node_is_refused(tmp_path: Path, text: str, name: object, reason: str) -> None:
    file = write(tmp_path, "mine.py", text)
    with pytest.raises(NodeFileError, match=reason):
        loading.node_class(file, name)  # type: ignore[arg-type]


def test_a_changed_file_and_files_that_import_it_are_loaded_again(tmp_path: Path) -> None:
    write(tmp_path, "beside.py", "VALUE = 1\n")
    file = write(tmp_path, "mine.py", "from beside import VALUE\n\ndef scenario():\n    return dict(value=VALUE)\n")
    first = loading.function("scenarios", str(file), "scenario")[1]
    assert loading.function("scenarios", str(file), "scenario")[1] is first
    write(tmp_path, "beside.py", "VALUE = 22\n")
    assert loading.function("scenarios", str(file), "scenario")[1]() == {"value": 22}
    write(tmp_path, "mine.py", "def scenario():\n    return dict(value=333)\n")
    assert loading.function("scenarios", str(file), "scenario")[1]() == {"value": 333}


CONVOY = """
from mast_zenoh.attacks import PassThrough

class Convoy(PassThrough):
    pass
"""
GUARD = """
from mast_zenoh.integrity import Integrity

class Guard(Integrity):
    pass
"""


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (CONVOY, "", r"mine\.py.*PassThrough.*Integrity"),
        (CONVOY, ":Convoy", r"subclass.*PassThrough.*Integrity"),
        (GUARD, "", r"defines.*without.*Integrity"),
        ("x = 1\n", "", r"defines.*Integrity.*Integrity"),
    ],
)
def test_a_file_without_the_class_says_what_it_defines_instead(
    text: str, name: str, message: str, tmp_path: Path
) -> None:
    file = write(tmp_path, "mine.py", text)
    with pytest.raises(ConfigurationError, match=message):
        loading.class_name(f"{file}{name}", Integrity)


def test_a_folder_is_no_class_unless_it_has_the_name_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "KOfN").mkdir()
    monkeypatch.chdir(tmp_path)
    assert loading.class_name("KOfN", Integrity) == "KOfN"
    for name in ("KOfN/", str(tmp_path / "KOfN")):
        with pytest.raises(ConfigurationError, match=r"KOfN/?.*FILE\.py.*FILE"):
            loading.class_name(name, Integrity)
