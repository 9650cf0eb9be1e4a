"""What a driver believed follows from the messages that reached it: its veto is applied to them as it applies it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.driving.motion import CarLimits, Command, RouteAhead
from mast_zenoh.evaluation import Evaluation, RunData, RunScoring
from mast_zenoh.evaluation.effects.passages import FrameSpan, PassageMeter
from mast_zenoh.evaluation.run_data import ArrivedEstimate, Heard, OwnView
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.metrics import Record, Scorer, Series
from mast_zenoh.metrics.record import Snapshot
from mast_zenoh.tracking.view import SensorView
from mast_zenoh.wiring.model import Input, InterposedWire
from mast_zenoh.wiring.received import Overheard
from tests.support.wirings import wiring_of

FRAMES, PERIOD_NS, BRAKES = 30, 100_000_000, 12
GHOST, EGO, REAL = 5, 1, 7
#: m, of the ghost ahead of the beginning of the road.
PLACE = 45.0


def ego() -> tuple[np.ndarray, np.ndarray]:
    """Places (f,) m and speeds (f,) m/s of an ego that drives east at 10 m/s and then brakes with 6 m/s^2."""
    speed = np.maximum(10.0 - 0.6 * np.maximum(np.arange(FRAMES) - BRAKES, 0), 0.0)
    return np.cumsum([0.0, *(0.1 * speed[1:])]), speed


def boxes(*places: float, ids: int, speed: float = 0.0, y: float = 0.0) -> ObjectStates:
    n = len(places)
    return ObjectStates.of(
        np.array([(x, y, 0.75) for x in places]).reshape(n, 3),
        id=np.arange(ids, ids + n),
        size=np.tile([4.5, 1.9, 1.5], (n, 1)),
        velocity=np.tile([speed, 0.0, 0.0], (n, 1)),
    )


def road(x: float) -> RouteAhead:
    return RouteAhead(np.column_stack([x + np.arange(80.0), np.zeros(80)]), np.full(80, 50.0), np.inf)


def around(x: float, free_m: float) -> SweptView:
    """A view from the roof of the ego whose rays end at a distance."""
    limits = (-np.pi, np.pi, -0.5, 0.3, 100.0)
    return SweptView(SensorView(np.array([x, 0.0, 2.0]), np.eye(3), *limits), np.full((8, 120), free_m))


def happened(
    *,
    own: tuple[float, ...] = (),
    free_m: float | None = None,
    veto: bool = True,
    commands_until: int = FRAMES,
    estimates_until: int = FRAMES,
    late: int = 0,
    changed: tuple[int, ...] = (),
    to_mps2: float = -6.0,
    dropped_from: int = FRAMES,
    absurd_from: int = FRAMES,
    beside: Callable[[int], float] | None = None,
    honest: bool = True,
    **settings: Any,
) -> dict[str, Any]:
    """What happened to the ego, whose mission estimate has a ghost.

    own: m, places of its own tracks; late: frames, of its commands; changed: frames of those that an adversary changed,
    to_mps2: to this; dropped_from: frame, from which it drops them;
    absurd_from: frame, from which they are more than the car can do
    beside: m, by frame, how far from the ghost there is a real object; honest: the picture has it there until a liar
    moves it, otherwise it has nothing until the liar inserts the ghost
    """
    data = RunData(Record(("ego",)), roles={"seizer": "adversary", "liar": "adversary"})
    passage = PassageMeter(
        InterposedWire("seizer", "agent/ego/command", "ego", "command", "command", "in", "out"), FrameSpan(0)
    )
    picture = PassageMeter(
        InterposedWire("liar", "cc/picture", "", "picture", "picture", "a", "b", "ego"), FrameSpan(0)
    )
    data.meter.meters.extend([passage, picture])
    data.influences.follow(wiring_of(["ego"]))
    received = Heard(ports={"safety", "mission", "view"} if veto else {"mission"})
    data.heard["ego"] = received
    for frame, (x, speed) in enumerate(zip(*ego(), strict=True)):
        time_ns = frame * PERIOD_NS
        data.times_ns[frame] = time_ns
        truth = boxes(float(x), ids=EGO, speed=float(speed))
        if beside is not None:
            real = boxes(PLACE, ids=REAL, y=beside(frame))
            truth = ObjectStates.of(
                np.concatenate([truth.position, real.position]),
                id=np.array([EGO, REAL]),
                size=np.concatenate([truth.size, real.size]),
                velocity=np.concatenate([truth.velocity, real.velocity]),
            )
            received_picture = boxes(PLACE, ids=GHOST, y=beside(frame)) if honest else boxes(ids=GHOST)
            picture.take_received(of_picture(frame, received_picture))
            picture.take_sent(of_picture(frame, boxes(PLACE, ids=GHOST)))
        data.record.add_truth(frame, truth, np.full((len(truth), 1), 50), truth.position[:1], np.array([EGO]))
        received.routes[frame] = road(float(x))
        estimates = {"safety": boxes(*own, ids=GHOST), "mission": boxes(PLACE, ids=GHOST)}
        for port, name in (("safety", "local"), ("mission", "mission")):
            snapshot = Snapshot.of(estimates[port])
            data.record.add(frame, [Series("ego", name)], snapshot, frame, time_ns)
            if port in received.ports and frame < estimates_until:
                received.add(port, frame, ArrivedEstimate(frame, time_ns, name, snapshot))
        sent = -50.0 if frame >= absurd_from else to_mps2 if frame in changed else 0.0
        received.wanted[frame] = 0.0
        passage.take_received(command(frame, 0.0))
        if frame < dropped_from:
            passage.take_sent(command(frame, sent))
        if frame < min(commands_until, dropped_from):
            received.obey(frame + late, frame, Command(sent, 0.0))
        if free_m is not None:
            received.see(frame, OwnView(frame, time_ns, around(float(x), free_m)))
    evaluation = Evaluation(scorer=Scorer(), skip_first=0, skip_last=0, picture_age_s=0.5, **settings)
    return RunScoring(evaluation, data).results()["metrics"]["driven"]["ego"]


def command(frame: int, acceleration: float) -> Overheard:
    body = {"acceleration": np.array([acceleration]), "curvature": np.zeros(1)}
    header = Header("command", "driver_ego", frame, frame * PERIOD_NS, frame)
    return Overheard("key", Input("everything", "ego", "command", "driver_ego"), codec.conform(header, body), frame)


def of_picture(frame: int, objects: ObjectStates) -> Overheard:
    body = objects.columns() | {"support": np.ones(len(objects), np.int64)}
    header = Header("picture", "command_center", frame, frame * PERIOD_NS, frame)
    return Overheard("key", Input("everything", "", "picture", "command_center"), codec.conform(header, body), frame)


def cause(**facts: Any) -> dict[str, Any]:
    (brake,) = happened(**facts)["brakes"]
    return brake["cause"]


def test_a_brake_is_not_blamed_on_a_ghost_that_the_veto_discarded() -> None:
    assert cause(veto=False, free_m=90.0)["object"] == GHOST
    assert cause(free_m=90.0)["kind"] == "none"


@pytest.mark.parametrize("free_m", [None, 5.0])
def test_a_ghost_that_own_sensors_do_not_refute_is_believed_in_spite_of_a_veto(free_m: float | None) -> None:
    assert cause(free_m=free_m) == {"object": GHOST, "kind": "false", "adversary": None}


def test_an_own_track_is_believed_in_any_case() -> None:
    assert cause(own=(PLACE,), free_m=90.0)["kind"] == "false"


def test_a_car_that_gets_no_commands_brakes_for_want_of_them_once_it_no_longer_holds_the_last_one() -> None:
    for until, hold_s, kind in [
        (BRAKES - 3, 0.3, "no command"),
        (BRAKES - 3, 0.4, "false"),
        (BRAKES + 1, 0.3, "false"),
    ]:
        assert cause(veto=False, commands_until=until, hold_s=hold_s)["kind"] == kind


def test_a_brake_before_drivers_take_over_is_nobodys() -> None:
    facts = {"object": None, "kind": "no command", "adversary": None}
    assert cause(veto=False, take_over_s=2.0, changed=tuple(range(FRAMES))) == facts


def test_a_changed_command_is_blamed_for_the_frame_in_which_it_acts() -> None:
    """The ego brakes in frame 12, by the command of frame 6."""
    for changed, kind, adversary in [(6, "none", "seizer"), (BRAKES, "false", None)]:
        found = cause(veto=False, late=BRAKES - 6, hold_s=1.0, changed=(changed,))
        assert (found["kind"], found["adversary"]) == (kind, adversary)


@pytest.mark.parametrize("to_mps2", [2.0, 0.0001, -0.2])
def test_an_adversary_that_did_not_make_a_command_brake_harder_is_not_blamed_for_it(to_mps2: float) -> None:
    found = cause(veto=False, changed=tuple(range(FRAMES)), to_mps2=to_mps2)
    assert (found["kind"], found["adversary"]) == ("false", None)


def test_who_dropped_the_commands_withheld_them_and_not_who_changed_those_that_did_not_come() -> None:
    for facts, adversary in [
        (dict(dropped_from=BRAKES - 3), "seizer"),
        (dict(commands_until=BRAKES - 3, changed=tuple(range(FRAMES))), None),
    ]:
        assert cause(veto=False, **facts) == {"object": None, "kind": "no command", "adversary": adversary}


def test_a_command_that_the_car_refuses_is_none() -> None:
    for limits, found in [(CarLimits(), ("no command", "seizer")), (CarLimits(braking=50.0), ("none", "seizer"))]:
        told = cause(veto=False, absurd_from=BRAKES - 3, car_limits=limits)
        assert (told["kind"], told["adversary"]) == found


@pytest.mark.parametrize(("moved_m", "liar"), [(1.0, "liar"), (0.0, None)])
def test_a_brake_for_a_real_object_names_who_moved_it(moved_m: float, liar: str | None) -> None:
    assert cause(veto=False, beside=lambda _: moved_m) == {"object": REAL, "kind": "real", "adversary": liar}


def test_a_lie_through_whose_place_a_real_object_passes_is_still_a_lie() -> None:
    """The ego brakes in frame 12, by the estimate of frame 11."""
    passing = cause(veto=False, honest=False, beside=lambda frame: 9.0 * (frame - 11))
    assert passing == {"object": GHOST, "kind": "false", "adversary": "liar"}


def test_a_driver_whose_estimate_is_too_old_brakes_for_want_of_one() -> None:
    """The newest is of frame 5, so it is too old from frame 11 on."""
    assert cause(veto=False, estimates_until=6)["kind"] == "no estimate"
    assert cause(veto=False, estimates_until=6, estimate_ages_s={"ego": 0.8})["kind"] == "false"


def test_frames_are_blind_if_the_command_that_acts_was_given_without_an_estimate() -> None:
    """It has none in frame 0, and in those from frame 11 on; drivers take over in frame 10, or in the first one."""
    for facts, blind in [
        ({}, 0),
        (dict(take_over_s=0.0), 1),
        (dict(estimates_until=6), FRAMES - 11),
        (dict(estimates_until=6, late=2), FRAMES - 13),
        (dict(estimates_until=6, commands_until=15, hold_s=0.0), 15 - 11),
    ]:
        assert happened(veto=False, **facts)["blind_frames"] == blind


def test_commands_that_a_car_obeyed_and_frames_without_a_new_one_are_counted() -> None:
    """Drivers take over in frame 10; the command of the last frame acts after it."""
    driven = FRAMES - 11
    for facts, obeyed, without in [
        ({}, driven, 0),
        (dict(late=2), driven, driven),
        (dict(commands_until=15), 5, driven - 5),
        (dict(commands_until=0), 0, driven),
        (dict(take_over_s=0.0, commands_until=15), 15, FRAMES - 1 - 15),
    ]:
        counts = happened(veto=False, **facts)
        assert (counts["obeyed_commands"], counts["uncommanded_frames"]) == (obeyed, without), facts
