"""Two recordings are compared and their first difference is described."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recordings import TAP, detections, payload, small_run, write

from mast_zenoh.cli import app
from mast_zenoh.run_folder.recording.difference import compare, explain

WIRE = "agent/b/detections"


def with_message(key: str, frame: int, data: bytes) -> list[tuple[str, bytes]]:
    """The small run with one message replaced."""
    return [(k, data if d == payload(key, frame) and k == key else d) for k, d in small_run()]


def text(folder: Path, a: list[tuple[str, bytes]], b: list[tuple[str, bytes]], **options: object) -> str:
    a_file, b_file = write(folder / "a.mcap", a), write(folder / "b.mcap", b)
    return "\n".join(explain(compare(a_file, b_file, **options)))  # type: ignore[arg-type]


def test_equal_recordings_are_equal_in_any_order_of_writing(tmp_path: Path) -> None:
    assert text(tmp_path, small_run(), small_run()[::-1]) == "equal: 24 messages"


def test_the_first_difference_is_shown_field_by_field_with_units(tmp_path: Path) -> None:
    other = with_message(WIRE, 3, payload(WIRE, 3, detections(1.0, 5.5)))
    description = text(tmp_path, small_run(), other)
    assert f"first difference: frame 3, {WIRE}, publisher simulator, sequence 3" in description
    assert "position row 1[0]: A 5.0 m, B 5.5 m; 1 of 6 values differ" in description
    assert f"1 messages differ: {WIRE} 1" in description
    assert "23 messages are equal" in description
    assert "score" not in description


@pytest.mark.parametrize(
    ("data", "description"),
    [
        (payload(WIRE, 3, detections(1.0)), "position: A has 2 rows, B has 1 rows"),
        (payload(WIRE, 3, detections(1.0, 5.0) | {"yaw": np.array([0.0, -0.0])}), "yaw row 1: A 0.0 rad, B -0.0 rad"),
        (payload(WIRE, 3, detections(1.0, 5.0) | {"mount_position": np.array([0.0, 2.0, 0.0])}), "n[1]: A 0.0 m"),
        (payload(WIRE, 3, detections(np.nan, 5.0)), "B is not a valid message"),
        (payload(WIRE, 3)[:-1] + b"\x01", "mount_rotation[3]: A 0.0"),
    ],
)
def test_every_kind_of_difference_is_described(tmp_path: Path, data: bytes, description: str) -> None:
    assert description in text(tmp_path, small_run(), with_message(WIRE, 3, data))


def test_a_missing_message_is_reported_with_the_run_that_lacks_it(tmp_path: Path) -> None:
    fewer = [(k, d) for k, d in small_run() if (k, d) != (WIRE, payload(WIRE, 4))]
    description = text(tmp_path, small_run(), fewer)
    assert f"first difference: frame 4, {WIRE}" in description
    assert "only in A: detections of 400000000 ns: position (2, 3)" in description
    assert f"1 messages are only in A: {WIRE} 1" in description


def test_tap_legs_are_left_out_unless_asked_for(tmp_path: Path) -> None:
    other = with_message(TAP, 2, payload(TAP, 2, detections(7.0)))
    assert text(tmp_path, small_run(), other) == "equal: 24 messages"
    (tmp_path / "taps").mkdir()
    assert f"frame 2, {TAP}" in text(tmp_path / "taps", small_run(), other, taps=True)


def test_malformed_messages_are_compared_byte_by_byte(tmp_path: Path) -> None:
    description = text(tmp_path, [*small_run(), ("clock", b"\x01\x02")], [*small_run(), ("clock", b"\x01\x03")])
    assert "first difference: malformed, clock/@malformed" in description
    assert "byte 1: A 02, B 03; lengths 2, 2" in description


@pytest.mark.parametrize(
    ("other", "words", "code"),
    [
        (small_run(), (), 0),
        (with_message(WIRE, 3, payload(WIRE, 3, detections())), (), 1),
        (with_message(WIRE, 3, payload(WIRE, 3, detections())), ("--ignore", WIRE), 0),
        (with_message(WIRE, 3, payload(WIRE, 3, detections())), ("--wire", "clock", "--wire", "*/status"), 0),
        (with_message(WIRE, 3, payload(WIRE, 3, detections())), ("--wire", "agent/b/*"), 1),
        (with_message(TAP, 3, payload(TAP, 3, detections())), ("--taps",), 1),
        (None, (), 2),
        (small_run(), ("--ignore", "*"), 2),
        (small_run(), ("--wire", "cc/picture"), 2),
    ],
    ids=["equal", "different", "ignored", "others", "wire", "taps", "nothing there", "nothing left", "no such wire"],
)
def test_the_command_exits_with_0_1_or_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    other: list[tuple[str, bytes]] | None,
    words: tuple[str, ...],
    code: int,
) -> None:
    for name, messages in (("a", small_run()), ("b", other)):
        (tmp_path / name).mkdir()
        if messages is not None:
            write(tmp_path / name / "messages.mcap", messages)
    monkeypatch.setattr("sys.argv", ["mast", "diff", str(tmp_path / "a"), str(tmp_path / "b"), *words])
    with pytest.raises(SystemExit) as raised:
        app.main()
    assert (raised.value.code or 0) == code
    printed = capsys.readouterr()
    assert ("cannot compare" in printed.err) == (code == 2)
    assert ("first difference" in printed.out) == (code == 1)
