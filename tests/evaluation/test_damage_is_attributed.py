"""Errors are attributed to an adversary, however it damages the picture."""

from collections.abc import Callable
from pathlib import Path

import pytest
from played import FRAMES, Played

Once = Callable[..., Played]

ADVERSARY = """
import numpy as np

from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message
from mast_zenoh.node import Node


class Vandal(Node):
    role = "adversary"
    inputs = {"clock": "clock", "tracks": "tracks"}
    outputs = {"tracks_out": "tracks"}

    def __init__(self, agent: str, mode: str):
        self.agent, self.mode, self.held = agent, mode, None

    def on_clock(self, received, context):
        pass

    def on_tracks(self, received, context):
        if received.frame < 8:
            context.relay("tracks_out", received)
            return
        header, n = received.message.header, len(received.body["id"])
        if self.mode == "forestall":  # an empty message of the same frame, before the true one
            empty = {k: v[:0] if v.shape[:1] == (n,) and k not in ("origin", "rotation") else v
                     for k, v in received.body.items()}
            forged = Message(header._replace(seq=header.seq + 1000), empty)
            context.relay("tracks_out", received, payload=codec.encode(codec.conform(forged.header, empty)))
            context.relay("tracks_out", received)
        elif self.mode == "restamp":
            context.relay("tracks_out", received, time_ns=max(0, header.time_ns - 500_000_000))
        elif self.mode == "hold":  # one message is late, and excuses no others
            if self.held is None:
                self.held = received
            elif received.frame == 34:
                context.relay("tracks_out", self.held)
        else:
            context.relay("tracks_out", received)


class Spoofer(Node):
    role = "adversary"
    inputs = {"clock": "clock", "gps": "pose"}
    outputs = {"gps_out": "pose"}

    def __init__(self, agent: str, mode: str):
        self.agent = agent

    def on_clock(self, received, context):
        pass

    def on_gps(self, received, context):
        body = dict(received.body)
        if received.frame >= 8:
            body["position"] = body["position"] + np.array([8.0, 8.0, 0.0])
        context.relay("gps_out", received, body)
"""

SCENARIO = """
from mast_zenoh.scenario import load


def scenario(mode="forestall", wire="tracks"):
    port, kind = ("gps", "Spoofer") if wire == "pose" else (wire, "Vandal")
    vandal = dict(file="vandal.py", type=kind, mode=mode)
    return dict(load("baseline")[1]) | dict(
        name="vandals",
        adversaries={f"vandal_{k}": vandal | dict(agent=f"infra_{k}") for k in range(1, 5)},
        keyexpr=dict(map="testbed.toml", rewrites=[
            {"insert": [dict(wire=f"agent/{{agent}}/{wire}", role="adversary", input=port, output=f"{port}_out")]}
        ]),
    )
"""


@pytest.mark.parametrize(
    ("mode", "wire", "effect"),
    [
        ("forestall", "tracks", "forged"),
        ("restamp", "tracks", "restamped"),
        ("hold", "tracks", "dropped"),
        ("pose", "pose", "reframed"),
    ],
)
def test_missed_objects_are_attributed_to_the_interposer_that_withholds_them(once, mode, wire, effect):
    files = {"vandal": ADVERSARY, "vandals": SCENARIO}
    attacked, baseline = once("vandals", f"mode={mode}", f"wire={wire}", **files), once("baseline")
    before, after = (played.agents["ego"]["picture"] for played in (baseline, attacked))
    added = after["fn"]["mean"] - before["fn"]["mean"]
    assert added > 1.5
    assert after["fn_split"]["attack"] > 0.8 * added
    assert after["fp_split"]["attack"] >= 0.8 * (after["fp"]["mean"] - before["fp"]["mean"])
    for verdict in attacked.metrics["interposers"].values():
        assert verdict["agreement"] == "silent"
        assert verdict["effects"][effect] > 10


FILE = str(Path(__file__).with_name("altered_boxes.py"))


@pytest.mark.parametrize("setting", ["length=2.0", "turn_rad=0.5"])
def test_a_false_box_is_blamed_for_no_error_of_place_which_are_those_of_the_twin(once: Once, setting: str) -> None:
    apart = "scene.dense=False"  # in queues, boxes that nearly touch are grouped otherwise if one is longer
    run, twin = once(FILE, apart, setting), once(FILE, apart)
    assert (run.table("attacks")["effect"] == "altered").sum() > FRAMES
    assert run.metrics["interposers"]["mallory"]["effects"].keys() == {"altered"}
    assert run.metrics["interposers"]["mallory"]["agreement"] == "agrees"
    assert not (twin.table("attacks")["effect"] == "altered").any()
    for errors in ("fn", "fp"):
        assert (run.table("metrics")[errors] == twin.table("metrics")[errors]).all(), "no error of place is new"
    assert not (run.table("objects")["cause"] == "altered").any()


def test_false_velocities_are_blamed_for_nothing_in_the_tracks_that_carry_them(once: Once) -> None:
    objects = once(FILE, "velocity=2.0").table("objects")
    blamed = objects["cause"] == "altered"
    assert not (blamed & (objects["estimator"] == "received")).any()
