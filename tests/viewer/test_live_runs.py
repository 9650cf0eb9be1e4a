"""A running run is measured, shown and sent to other viewers frame by frame, as it is after its end."""

import threading
from collections import deque
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import zenoh
from recorded_observer import NUMBERS, RecordedObserver

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.mesh.control import prefix
from mast_zenoh.mesh.protocol.traffic import stamp
from mast_zenoh.mesh.session import open_client, open_router
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.run_folder.tables import from_arrow, read_table
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.live.measurement import FrameMeter, seen
from mast_zenoh.runs.live.observer import Observer
from mast_zenoh.runs.live.reception import KEPT, LegState, Sample, WireMeter
from mast_zenoh.runs.recorded import frames_of, open_recorded
from mast_zenoh.show.page.live_server import LASTING, LiveBlocks
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
        self.record = seen(scene, self.wiring, self.meter.agents)  # type: ignore[arg-type]
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
    return from_arrow(frame.run.files.all_objects)


def rows(table: Any, names: tuple[str, ...], mask: Any = slice(None)) -> list[tuple[Any, ...]]:
    columns = [np.asarray(table[name])[mask].tolist() for name in names]
    return sorted(zip(*[[str(value) for value in column] for column in columns], strict=True))


@pytest.mark.parametrize("number", [3, 17, 29])
def test_outcomes_and_effects_of_a_frame_are_those_of_the_finished_run(
    measured: Measured, recorded: mast.Run, number: int
) -> None:
    frame = measured.frame(number)
    objects, attacks = (read_table(recorded.path / f"{name}.parquet") for name in ("objects", "attacks"))
    # An estimate that equals another one in this frame alone has rows of its own in the finished run.
    own = {(agent, estimator) for agent, estimator in zip(*(objects_of(frame)[n] for n in _OBJECTS[:2]), strict=True)}
    pairs = zip(objects["agent"].tolist(), objects["estimator"].tolist(), strict=True)
    here = (objects["frame"] == number) & np.array([pair in own for pair in pairs])
    expected = rows(objects, _OBJECTS, here)
    assert rows(objects_of(frame), _OBJECTS) == expected
    assert len(expected) > 100
    changed = rows(attacks, _EFFECTS, attacks["frame"] == number)
    assert rows(frame.run.files.effects, _EFFECTS) == changed
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
    assert (sound.refused, disturbed.refused) == (0, 1)
    assert rows(objects_of(sound), _OBJECTS) == rows(objects_of(disturbed), _OBJECTS)


def test_a_scorer_that_is_not_on_this_machine_is_replaced_by_the_default_and_said_so(recorded: mast.Run) -> None:
    resolved = Resolved.read(recorded.path)
    resolved.nodes["evaluator"].config["scorer"] = {"type": "NobodysScorer"}
    meter = FrameMeter(resolved)
    assert "NobodysScorer" in meter.notes[0]
    assert meter.agents == ("ego", "infra_1", "infra_2", "infra_3", "infra_4")


@pytest.mark.parametrize("has_scene", [True, False])
def test_a_frame_is_shown_with_and_without_a_prepared_scene(recorded: mast.Run, has_scene: bool) -> None:
    observer: Any = RecordedObserver(recorded.path, has_scene=has_scene)
    blocks = LiveBlocks(observer)
    sizes = []
    while not observer.is_over():
        if (frame := observer.advance()) is not None:
            lasting, block = blocks.header_and_block(frame)
            assert {*lasting} == {*LASTING}
            assert bool(lasting["agents"]) is has_scene
            assert bool(lasting["tops"]) is has_scene
            sizes.append((frame.index, len(block)))
    assert [number for number, _ in sizes] == list(NUMBERS)
    assert min(size for _, size in sizes) > 500, "with objects"


def test_the_newest_frame_of_a_run_that_ends_comes_out_even_if_it_ends_at_once(recorded: mast.Run) -> None:
    """All messages have arrived before the observer looks for the first time."""
    known = Measured(recorded.path)
    run: Any = SimpleNamespace(
        id="short",
        resolved=known.resolved,
        roles=known.roles,
        scene=None,
        credentials=None,
        folder=recorded.path,
        current_wiring=lambda session: None,
        is_over=lambda session: True,
    )
    router, endpoint = open_router()
    with router, open_client(endpoint) as session, open_client(endpoint) as publisher:
        observer = Observer(run, session)
        arrived = session.declare_subscriber(f"{prefix('short')}/end")
        for message in read(recorded.path):
            attachment = stamp(message.key, 0, message.step)
            publisher.put(f"{prefix('short')}/{message.key}", message.payload, attachment=attachment)
        publisher.put(f"{prefix('short')}/end", b"")
        arrived.recv()
        ended: list[bool] = []
        (frame,) = observer.frames(threading.Event(), lambda: ended.append(True))
        assert observer.last_frame() is None, "only once"
        observer.close()
    *_, last = frames_of(open_recorded(recorded.path))
    assert (frame.index, observer.frame, ended) == (last.index, last.index, [True])
    assert frame.objects.keys() == last.objects.keys()
    for series, states in last.objects.items():
        assert np.array_equal(frame.objects[series].position, states.position)


def test_a_live_source_ends_when_it_is_stopped(recorded: mast.Run) -> None:
    stop = threading.Event()
    observer: Any = RecordedObserver(recorded.path)
    frames = Observer.frames(observer, stop)
    assert next(frames).index == NUMBERS[0]
    stop.set()
    assert list(frames) == []


class Kept:
    """The steps of the kept messages of each key."""

    def __init__(self) -> None:
        self.by_key: dict[str, list[int]] = {}

    def steps(self, key: str) -> list[int]:
        return self.by_key.get(key, [])

    def newest_step(self, key: str) -> int:
        return max(self.steps(key), default=-1)


@pytest.fixture(scope="module")
def wiring() -> Wiring:
    path, loaded = scenario.load("uncoordinated", ("n_infrastructure=1", "n_adversaries=1"))
    return Wiring.from_json(scenario.resolve(path, loaded, frames=2).wiring)


def test_loss_and_lag_are_of_the_steps_that_both_legs_can_have(wiring: Wiring) -> None:
    wire = next(each for each in wiring.wires if each.interposers)
    before, after = (leg.key for leg in wire.every_leg)
    kept: Any = Kept()
    meter = WireMeter(kept)

    def second_leg(step: int, entering: list[int], leaving: list[int]) -> LegState:
        kept.by_key = {before: entering, after: leaving}
        (state,) = (each for each in meter.states(wiring, {before: "", after: ""}, {}, step) if each.key == wire.key)
        assert state.legs[0].lost == 0.0
        return state.legs[1]

    assert (second_leg(0, [], []).lost, second_leg(0, [], []).lag) == (None, None), "nothing is known yet"
    first = second_leg(9, [4, 5, 6, 7, 8, 9], [6, 7, 8])
    assert (first.lost, first.lag) == (0.0, 1), "6 and 7 arrived; 4 and 5 were before, 8 and 9 may be under way"
    assert second_leg(109, [104, 105, 106, 107], [104, 106, 107]).lost == pytest.approx(1 / 6), "of 6, 7, 104 to 107"
    for _ in range(5):
        blocked = second_leg(209, [204, 205, 206, 207], [])
    assert (blocked.lost, blocked.lag) == (1.0, None), "a wire that is blocked"


class FallingBehind:
    """A session of Zenoh whose own thread receives frames of a recording, also while Python takes them key by key.

    arrivals: frames that arrive, the last ones when the poses of an agent are taken next
    """

    def __init__(self, folder: Path) -> None:
        self.rings: dict[str, deque[Any]] = {}
        self.late: list[int] = []
        self._messages = [*read(folder)]

    def liveliness(self) -> Any:
        return MagicMock()

    def declare_subscriber(self, key: str, _: Any) -> Any:
        name = key.removeprefix(prefix("run-1") + "/")
        self.rings[name] = deque(maxlen=KEPT)
        return SimpleNamespace(handler=SimpleNamespace(try_recv=lambda: self.taken(name)))

    def arrive(self, *frames: int) -> None:
        for message in self._messages:
            if message.frame in frames and message.key in self.rings:
                mark = zenoh.ZBytes(stamp(message.key, 0, message.step))
                self.rings[message.key].append(SimpleNamespace(attachment=mark, payload=zenoh.ZBytes(message.payload)))

    def taken(self, key: str) -> Any:
        if key == "agent/infra_1/pose" and self.late:
            frames, self.late = self.late, []
            self.arrive(*frames)
        return self.rings[key].popleft() if self.rings[key] else None


def test_frames_of_which_messages_were_dropped_while_others_were_taken_are_not_shown(recorded: mast.Run) -> None:
    of_recording: Any = RecordedObserver(recorded.path)
    run: Any = SimpleNamespace(**vars(of_recording.address), roles=of_recording.roles, credentials="none")
    run.current_wiring = lambda session: None
    session: Any = FallingBehind(recorded.path)
    observer = Observer(run, session)
    session.arrive(*range(4))
    assert observer.advance() is None, "the subscription is new"
    session.arrive(*range(4, 12))
    session.late = [*range(12, 30)]
    frame = observer.advance()
    assert frame is not None
    assert frame.bodies.keys() == {each.index: each for each in frames_of(recorded)}[frame.index].bodies.keys()
