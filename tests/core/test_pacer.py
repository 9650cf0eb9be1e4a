"""The next frame begins when nothing is under way, and not before."""

from mast_zenoh.runtime.pacer import Pacer
from mast_zenoh.wiring import Endpoint, Leg, Wire, Wiring


def wire(key: str, publisher: str, *subscribers: str) -> Wire:
    leg = Leg(key, Endpoint(publisher, "out"), tuple(Endpoint(name, "in") for name in subscribers))
    return Wire(key, "", "clock", (leg,))


WIRING = Wiring(
    (
        wire("clock", "simulator", "agent", "broker", "evaluator"),
        wire("tracks", "agent", "broker"),
        wire("collated", "broker", "evaluator"),
    )
)
MEMBERS = {name: name for name in ("simulator", "agent", "broker")}


def pacer() -> Pacer:
    made = Pacer(WIRING)
    made.begin_epoch(MEMBERS)
    return made


def test_it_is_not_quiet_until_everyone_has_reported() -> None:
    made = pacer()
    made.report("simulator", 1, {}, {})
    made.report("agent", 1, {}, {})
    assert not made.quiet()
    assert made.silent == {"broker"}
    made.report("broker", 1, {}, {})
    assert made.quiet()


def test_a_message_under_way_is_not_quiet_whoever_reports_first() -> None:
    made = pacer()
    made.report("simulator", 1, {"clock": 1}, {})
    made.report("broker", 1, {}, {"clock": 1})
    made.report("agent", 1, {"tracks": 1}, {"clock": 1})
    assert not made.quiet()
    assert list(made.owing()) == ["broker has handled 0 of 1 messages of agent on tracks"]
    made.report("broker", 1, {}, {"clock": 1, "tracks": 1})
    assert made.quiet()


def test_reports_of_another_epoch_or_of_strangers_say_nothing() -> None:
    made = pacer()
    made.begin_epoch(MEMBERS)
    for name in MEMBERS:
        made.report(name, 1, {}, {})
    made.report("stranger", 2, {"clock": 5}, {})
    assert made.silent == set(MEMBERS)


def test_the_dead_are_not_waited_for() -> None:
    made = pacer()
    made.report("simulator", 1, {"clock": 1}, {})
    made.report("broker", 1, {}, {"clock": 1})
    made.drop(["agent"])
    assert made.quiet()


def test_who_only_listens_is_waited_for_only_when_everyone_is() -> None:
    made = Pacer(WIRING)
    made.begin_epoch({**MEMBERS, "evaluator": "evaluator"})
    made.report("simulator", 1, {"clock": 1}, {})
    made.report("agent", 1, {}, {"clock": 1})
    made.report("broker", 1, {"collated": 1}, {"clock": 1})
    assert made.quiet()
    assert not made.quiet(everyone=True)
    made.report("evaluator", 1, {}, {"clock": 1, "collated": 1})
    assert made.quiet(everyone=True)
