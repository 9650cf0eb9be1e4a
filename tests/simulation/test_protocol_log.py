"""The log of a process replays to the same actions, and shows where another protocol does something else."""

from collections import defaultdict
from typing import Any

import planted_bugs as bugs
import pytest
from small_worlds import small_worlds

from mast_zenoh.errors import MessageError
from mast_zenoh.mesh import protocol_log as log
from mast_zenoh.mesh.protocol.events import AnyEvent, DroppedEvent, MessageEvent, RewireEvent
from mast_zenoh.mesh.protocol_log import ProcessLog, difference, logged_protocol, read, replay
from mast_zenoh.testing.simulation import Disturbance, Schedule, SimulatedWorld, play, processes, random_schedule

WORLDS = small_worlds()
INSERTED = Schedule(2, (Disturbance(0.03, "intercept", "relay"), Disturbance(0.2, "release", "relay")))


def logs_of(world: SimulatedWorld, schedule: Schedule, monkeypatch: pytest.MonkeyPatch) -> list[ProcessLog]:
    """The logs of all processes of a simulated run."""
    written: dict[str, list[bytes]] = defaultdict(list)

    def build(resolved: Any, name: str, *more: Any) -> Any:
        return logged_protocol(written[name].append, resolved, name, *more)

    with monkeypatch.context() as patch:
        patch.setattr(processes, "protocol_of", build)
        play(world, schedule)
    return [process for parts in written.values() for process in read(b"".join(parts))]


def replayed(world: SimulatedWorld, recorded: ProcessLog) -> ProcessLog:
    name = recorded.beginning.node
    return replay(recorded, world.build(name, world.resolved.nodes.get(name)))  # type: ignore[arg-type]


def events(logs: list[ProcessLog]) -> list[AnyEvent]:
    return [step.event for process in logs for step in process.steps if step.event is not None]


@pytest.mark.parametrize("name", WORLDS)
def test_the_log_of_each_process_of_a_simulated_run_replays_to_the_same_actions(name, monkeypatch) -> None:
    world = WORLDS[name]
    for schedule in (INSERTED, *(random_schedule(seed, world) for seed in range(6))):
        for recorded in logs_of(world, schedule, monkeypatch):
            assert difference(recorded, replayed(world, recorded)) == "", (schedule, recorded.beginning.node)


def test_a_log_has_all_that_a_process_was_given_and_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    logs = logs_of(WORLDS["realtime"], INSERTED, monkeypatch)
    assert [process.steps[0].call for process in logs] == ["start"] * 6
    kinds = {type(event).__name__ for event in events(logs)}
    assert kinds >= {"MessageEvent", "EpochEvent", "StopEvent", "HandedInEvent", "DrainEvent", "DrainedEvent"}
    assert kinds >= {"CountsEvent", "PresenceEvent", "RewireEvent"}
    asked = {action[0] for process in logs for step in process.steps for action in step.actions}
    assert asked == {*log.Actions.__abstractmethods__, "sign"} - {"hand_in_part"}
    (rewired, _) = (event for event in events(logs) if isinstance(event, RewireEvent))
    assert rewired.query == 0, "queries are numbered"
    full = Schedule(259, (Disturbance(0.023, "fill", "listener"), Disturbance(0.023, "suspend", "listener", 0.5)))
    dropped = [event for event in events(logs_of(WORLDS["lockstep"], full, monkeypatch)) if type(event) is DroppedEvent]
    assert dropped
    assert all(event.counts for event in dropped)


@pytest.mark.parametrize(
    "plant", [bugs.the_stamp_is_of_an_older_step, bugs.a_node_reports_before_it_has_handled], ids=lambda it: it.__name__
)
def test_the_replay_by_a_protocol_with_a_bug_shows_the_first_action_that_differs(plant, monkeypatch) -> None:
    world = WORLDS["lockstep"]
    (recorded,) = (each for each in logs_of(world, Schedule(1), monkeypatch) if each.beginning.node == "a")
    plant(monkeypatch)
    first, second = difference(recorded, replayed(world, recorded)).splitlines()
    handled = next(number for number, step in enumerate(recorded.steps) if isinstance(step.event, MessageEvent))
    assert int(first.split()[1].rstrip(":")) > handled
    assert first != second


def test_a_file_that_ends_within_a_record_is_a_log_up_to_there(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[bytes] = []
    monkeypatch.setattr(processes, "protocol_of", lambda *its: logged_protocol(written.append, *its))
    play(WORLDS["lockstep"], Schedule(1))
    whole = read(written[0] + written[1])
    assert [len(process.steps) for process in whole] == [1]
    assert [len(process.steps) for process in read((written[0] + written[1])[:-1])] == [0]
    assert [process.whole for process in whole + read((written[0] + written[1])[:-1])] == [True, False]
    with pytest.raises(MessageError, match=r"protocol log.*4"):
        read(b"\x01\x00\x00\x00?")
    for empty in (b"", b"\xdd" * 100, written[0][:50]):
        with pytest.raises(MessageError, match=f"protocol log.*{len(empty)}"):
            read(empty)
    with pytest.raises(MessageError, match=r"first record.*step"):
        read(written[1])


def test_a_log_ends_when_it_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    world, schedule = WORLDS["lockstep"], Schedule(1)
    whole = logs_of(world, schedule, monkeypatch)
    monkeypatch.setattr(log, "MAX_BYTES", 12_000)
    for recorded, complete in zip(logs_of(world, schedule, monkeypatch), whole, strict=True):
        assert 0 < len(recorded.steps) < len(complete.steps)
        assert recorded.steps == complete.steps[: len(recorded.steps)]
        assert difference(recorded, replayed(world, recorded)) == ""
