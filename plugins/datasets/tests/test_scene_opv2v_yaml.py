"""The YAML loader makes numbers, text and arrays, and nothing else."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mast_datasets.files import Coordinate, Element, read_yaml

from mast_zenoh.errors import SceneError

PLAIN = st.recursive(
    st.none() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=15,
)
NUMBER = st.integers(-(10**8), 10**8) | st.floats(-1e8, 1e8)
BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(k + 1)}: &{chr(k + 1)} [{', '.join([f'*{chr(k)}'] * 10)}]\n" for k in range(ord("a"), ord("i"))
)
OPTIONS = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def value(tmp_path: Path, text: str | bytes) -> Any:
    path = tmp_path / "000000.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_yaml(path).value


@OPTIONS
@given(PLAIN)
def test_plain_values_are_those_of_pyyaml(tmp_path: Path, content: Any) -> None:
    assert value(tmp_path, yaml.safe_dump(content)) == content


@OPTIONS
@given(st.lists(NUMBER))
def test_numbers_are_those_of_pyyaml_in_other_spellings_too(tmp_path: Path, numbers: list[float]) -> None:
    found = value(tmp_path, yaml.safe_dump(numbers))
    assert Element(found, tmp_path).read(list[Coordinate]) == numbers
    found = value(tmp_path, "[1e5, -2.5E-3, 3, '4', 1.0e-05]")
    assert Element(found, tmp_path).read(list[Coordinate]) == [1e5, -2.5e-3, 3.0, 4.0, 1e-5]


@pytest.mark.parametrize(
    "array",
    [
        np.arange(16.0).reshape(4, 4),
        np.asfortranarray(np.arange(6.0, dtype=np.float32).reshape(2, 3)),
        np.arange(4, dtype=">i4"),
        np.array([True, False]),
        np.zeros((0, 3)),
        np.array(2.5),
    ],
    ids=lambda array: f"{array.dtype.str} {array.shape}",
)
def test_arrays_are_those_that_numpy_wrote(tmp_path: Path, array: Any) -> None:
    for module in ("numpy._core", "numpy.core"):
        text = yaml.dump({"a": array, "b": array}).replace("numpy._core", module)
        assert "python/object/apply:numpy" in text
        assert value(tmp_path, text) == {"a": array.tolist(), "b": array.tolist()}


@pytest.mark.parametrize("number", [np.float64(-1.5), np.float32(0.5), np.int64(7), np.uint8(3), np.bool_(True)])
def test_numbers_are_those_that_numpy_wrote(tmp_path: Path, number: Any) -> None:
    found = value(tmp_path, yaml.dump({"gps": [number, (1, 2)]}))
    assert found == {"gps": [number.item(), ["1", "2"]]}
    assert type(found["gps"][0]) in (int, float, bool)


def test_a_file_cannot_run_anything(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    calls = [
        f"!!python/object/apply:os.system ['touch {mark}']",
        f"!!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path ['{mark}']]",
        f"!!python/object/new:subprocess.Popen [['touch', '{mark}']]",
        "!!python/module:antigravity ''",
        "!!python/object/apply:numpy.load [x]",
    ]
    for call in calls:
        with pytest.raises(SceneError, match=r"000000\.yaml: .* the tag 'tag:yaml\.org,2002:python/.* at line 1"):
            value(tmp_path, f"a: {call}")
    assert not mark.exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("? [1]\n: 2", "found unhashable key at line 1"),
        ("&a [*a]", "found unconstructable recursive node at line 1"),
        ("a: !!set {1}", "tag 'tag:yaml.org,2002:set' at line 1"),
        ("a: !!int 1", "tag 'tag:yaml.org,2002:int' at line 1"),
        ("- " * 40 + "1", "found more than 32 levels at line 1"),
        ("[" * 1_000_000, "found more than 32 levels at line 1"),
        ("a: !!python/object/apply:numpy.dtype [f8]", "found no NumPy value"),
        ("a: !!python/object/apply:numpy.core.multiarray.scalar [f8, x]", "found no NumPy value"),
        ("a: !!python/object/apply:numpy.core.multiarray._reconstruct [1, 2, 3]", "found no NumPy value"),
        ("{", "not YAML .*line 2"),
        (b"a: \xff\xfe", r"000000\.yaml: .*utf-8"),
        ("lidar_pose: *a", "found undefined alias at line 1"),
    ],
    ids=lambda value: str(value[:20]),
)
def test_other_values_are_refused_with_their_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        value(tmp_path, text)


def test_what_aliases_repeat_is_not_copied_and_not_shown(tmp_path: Path) -> None:
    (tmp_path / "000000.yaml").write_text(BOMB)
    content = read_yaml(tmp_path / "000000.yaml")
    assert content["c"].value[0] is content["c"].value[9] is content["b"].value
    with pytest.raises(SceneError, match=r"000000\.yaml: \$\.i: found \[\[.{,90}, expected `float`, got `array`"):
        content["i"].read(float)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("- 4\n    - 4\n", "- 4\n    - 5\n", r"found no NumPy value: 128 bytes, expected 20 of 8 at line \d+"),
        ("- 4\n    - 4\n", "- 0\n    - 100000000\n", "an array of shape .*, expected at most 64 numbers"),
        ("- 4\n    - 4\n", "- 4\n    - x\n", "found no NumPy value"),
        ("- f8", "- O8", "found no NumPy value"),
        ("- <", "- '?'", "found no NumPy value"),
        ("numpy.ndarray", "numpy.matrix", "tag .*name:numpy.matrix"),
        ("multiarray._reconstruct", "multiarray.fromfile", r"tag .*fromfile' at line \d+"),
        ("AAAAAAAA8D8", "%%%%", "bytes, expected 16 of 8"),
        ("!!binary |\n    AAAA", "|\n    AAAA", "bytes, expected 16 of 8"),
    ],
)
def test_damaged_arrays_are_refused_with_their_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    whole = yaml.dump({"a": np.eye(4)})
    assert old in whole
    with pytest.raises(SceneError, match=message):
        value(tmp_path, whole.replace(old, new, 1))


def test_a_large_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mast_datasets.files._MAX_VALUES", 1000)
    with pytest.raises(SceneError, match="found more than 1000 values at line 1"):
        value(tmp_path, "[" + "1," * 1000 + "1]")
    with (tmp_path / "000000.yaml").open("wb") as file:
        file.truncate(10_000_001)
    with pytest.raises(SceneError, match="found 10000001 bytes, expected at most 10000000"):
        read_yaml(tmp_path / "000000.yaml")
    with pytest.raises(SceneError, match=r"nowhere\.yaml: .*No such file"):
        read_yaml(tmp_path / "nowhere.yaml")


@settings(OPTIONS, max_examples=150)
@given(st.text(alphabet="[]{},:-?&*!|>'\"%@#ab1. \n", max_size=40) | st.binary(max_size=40))
def test_any_content_is_read_or_refused(tmp_path: Path, content: str | bytes) -> None:
    with contextlib.suppress(SceneError):
        value(tmp_path, content)
