"""Driving metrics equal plain loops, with and without an attack."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from driving_oracle import compare, expected
from played import Played
from shipped import every, label

VARIANTS = [variant for variant in every() if variant[0] in ("uncoordinated", "coordinated", "chaos")]


@pytest.mark.parametrize("variant", VARIANTS, ids=label)
def test_corridor_and_braking_equal_a_plain_loop(
    shipped: Callable[..., tuple[Played, object]], variant: tuple[str, ...]
) -> None:
    played, _ = shipped(variant)
    sources = {"local": "agent/ego/tracks", "mission": "agent/ego/mission"}
    rows = expected(played, "ego", sources)
    table = played.table("driving")
    assert compare(table, "ego", rows) == len(table["frame"]) == 3 * played.metrics["frames"]
    first, last = played.metrics["scored_frames"]
    scored = range(first, last + 1)
    for estimate in sources:
        measured, expected_rows = (
            played.metrics["driving"]["ego"][estimate],
            [rows[estimate][frame] for frame in scored],
        )
        for name, column in (
            ("corridor_objects", "objects"),
            ("corridor_false", "false"),
            ("corridor_missed", "missed"),
            ("brake_share", "brake"),
            ("needless_brake_share", "needless"),
            ("missed_brake_share", "omitted"),
        ):
            assert measured[name] == pytest.approx(
                sum(each[column] for each in expected_rows) / len(expected_rows), abs=1e-12
            )
        for name, column in (("needless_brake_share_attack", "needless"), ("missed_brake_share_attack", "omitted")):
            share = sum(each[column] and each["attacked"] for each in expected_rows) / len(expected_rows)
            assert measured[name] == pytest.approx(share, abs=1e-12)
        times = [each["ttc_s"] for each in expected_rows if each["ttc_s"] == each["ttc_s"]]
        assert measured["min_ttc_s"] == (pytest.approx(min(times), abs=1e-9) if times else None)
