"""Two recordings are compared and their first difference is described."""

from pathlib import Path

import numpy as np
import pytest
from kept_texts import assert_kept
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


def other(data: bytes, key: str = WIRE, frame: int = 3) -> tuple[list[tuple[str, bytes]], ...]:
    return small_run(), with_message(key, frame, data)


FEWER = [(k, d) for k, d in small_run() if (k, d) != (WIRE, payload(WIRE, 4))]
MALFORMED = tuple([*small_run(), ("clock", data)] for data in (b"\x01\x02", b"\x01\x03"))
DIFFERENCES = {
    "written in another order": (small_run(), small_run()[::-1]),
    "another place": other(payload(WIRE, 3, detections(1.0, 5.5))),
    "fewer objects": other(payload(WIRE, 3, detections(1.0))),
    "the sign of zero": other(payload(WIRE, 3, detections(1.0, 5.0) | {"yaw": np.array([0.0, -0.0])})),
    "another mount": other(payload(WIRE, 3, detections(1.0, 5.0) | {"mount_position": np.array([0.0, 2.0, 0.0])})),
    "an invalid message": other(payload(WIRE, 3, detections(np.nan, 5.0))),
    "the last byte": other(payload(WIRE, 3)[:-1] + b"\x01"),
    "a missing message": (small_run(), FEWER),
    "malformed messages": MALFORMED,
    "a tap leg": other(payload(TAP, 2, detections(7.0)), TAP, 2),
}


def test_the_first_difference_is_described_by_field_with_units_and_tap_legs_are_left_out_unless_asked_for(
    tmp_path: Path,
) -> None:
    lines = []
    for number, (name, pair) in enumerate({**DIFFERENCES, "a tap leg, asked for": DIFFERENCES["a tap leg"]}.items()):
        (folder := tmp_path / str(number)).mkdir()
        lines += [f"{name}:", text(folder, *pair, taps=name.endswith("asked for")).replace(str(folder), "FOLDER"), ""]
    assert_kept("differences", *lines)


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
