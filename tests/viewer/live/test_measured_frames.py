"""A frame of a running run is measured as the evaluator measures it at the end."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mast_zenoh as mast
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch.tables import from_arrow, read_table
from mast_zenoh.messagelog.reader import read
from mast_zenoh.viewer.frame import Frame
from mast_zenoh.viewer.live.measurement import FrameMeter, LiveRun
from mast_zenoh.viewer.live.reception import Sample
from mast_zenoh.wiring.model import Wiring

_OBJECTS = ("agent", "estimator", "kind", "outcome", "id", "match_id", "x", "y")
_EFFECTS = ("interposer", "wire", "effect", "id", "after_x")


class Measured:
    """Frames of a recorded run, measured one by one."""

    def __init__(self, path: Path) -> None:
        self.resolved = Resolved.read(path)
        self.wiring = Wiring.from_json(self.resolved.wiring)
        self.meter = FrameMeter(self.resolved)
        scene = SimpleNamespace(scene=None, id="run-1", resolved=self.resolved)
        self.record = LiveRun.of(scene, self.wiring, self.meter.agents)  # type: ignore[arg-type]
        self.roles = {name: spec.role for name, spec in self.resolved.nodes.items()}
        self.samples: dict[int, list[tuple[str, Sample]]] = {}
        for message in read(path):
            self.samples.setdefault(message.frame, []).append((message.key, Sample(message.step, message.payload)))

    def frame(self, number: int, *more: tuple[str, Sample]) -> Frame | None:
        """Measure a frame, with its neighbours' messages and others among its own."""
        messages = [each for frame in (number - 1, number, number + 1) for each in self.samples.get(frame, ())]
        return self.meter.measure(self.record, number, [*more, *messages], self.wiring, self.roles)


@pytest.fixture(scope="module")
def measured(recorded: mast.Run) -> Measured:
    return Measured(recorded.path)


def objects_of(frame: Frame) -> dict[str, Any]:
    return from_arrow(frame.run.read_objects())


def rows(table: Any, names: tuple[str, ...], mask: Any = slice(None)) -> list[tuple[Any, ...]]:
    columns = [np.asarray(table[name])[mask].tolist() for name in names]
    return sorted(zip(*[[str(value) for value in column] for column in columns], strict=True))


@pytest.mark.parametrize("number", [3, 17, 29])
def test_outcomes_and_effects_of_a_frame_are_those_of_the_finished_run(
    measured: Measured, recorded: mast.Run, number: int
) -> None:
    frame = measured.frame(number)
    assert frame is not None
    objects, attacks = (read_table(recorded.path / f"{name}.parquet") for name in ("objects", "attacks"))
    # An estimate that equals another one in this frame alone has rows of its own in the finished run.
    own = {(agent, estimator) for agent, estimator in zip(*(objects_of(frame)[n] for n in _OBJECTS[:2]), strict=True)}
    pairs = zip(objects["agent"].tolist(), objects["estimator"].tolist(), strict=True)
    here = (objects["frame"] == number) & np.array([pair in own for pair in pairs])
    expected = rows(objects, _OBJECTS, here)
    assert rows(objects_of(frame), _OBJECTS) == expected
    assert len(expected) > 100
    changed = rows(attacks, _EFFECTS, attacks["frame"] == number)
    assert rows(frame.run.effects, _EFFECTS) == changed
    assert bool(changed) == (number >= 5), "the attack begins after half a second"


def test_a_frame_without_its_clock_is_not_shown(measured: Measured) -> None:
    without = [each for each in measured.samples[8] if each[0] != measured.meter.clock_key(measured.wiring)]
    assert measured.meter.measure(measured.record, 8, without, measured.wiring, measured.roles) is None


def test_invalid_messages_are_counted_and_change_nothing(measured: Measured) -> None:
    key = next(key for key in measured.meter.keys(measured.wiring) if key.endswith("ego/tracks"))
    sound, disturbed = (
        measured.frame(12),
        measured.frame(12, (key, Sample(12, b"\x93rubbish")), ("stranger", Sample(12, b""))),
    )
    assert sound is not None
    assert disturbed is not None
    assert (sound.refused, disturbed.refused) == (0, 1)
    assert rows(objects_of(sound), _OBJECTS) == rows(objects_of(disturbed), _OBJECTS)


def test_a_scorer_that_is_not_on_this_machine_is_replaced_by_the_default_and_said_so(recorded: mast.Run) -> None:
    resolved = Resolved.read(recorded.path)
    resolved.nodes["evaluator"].config["scorer"] = {"type": "NobodysScorer"}
    meter = FrameMeter(resolved)
    assert "NobodysScorer" in meter.notes[0]
    assert meter.agents == ("ego", "infra_1", "infra_2", "infra_3", "infra_4")
