import numpy as np

from mast_zenoh.arrays.states import canonical_order
from mast_zenoh.attacks import Attack, Surroundings, Tampering, alter
from mast_zenoh.scenario import load


class Ambush(Attack):
    """Hides all objects of the victim while the ego is near it.

    near_m: m, distance between the ego's route and the victim
    """

    def __init__(self, *, near_m: float = 40.0) -> None:
        self.near_m = near_m
        self.surroundings = Surroundings()

    def inform(self, surroundings: Surroundings) -> None:
        self.surroundings = surroundings

    def step(self, frame, time_ns, objects, agent_position, directive=None):
        ego = self.surroundings.ego_sensor
        if ego is None:
            return Tampering.nothing(len(objects))
        ego_position, _ = ego.route.at(time_ns * 1e-9)
        if np.hypot(*(ego_position - agent_position)[:2]) > self.near_m:
            return Tampering.nothing(len(objects))
        return alter(objects, hide=canonical_order(objects))


def scenario(near_m=40.0):
    _, base = load("uncoordinated", ["n_adversaries=1"])
    for adversary in base["adversaries"].values():
        adversary["attack"] = dict(type="Ambush", near_m=near_m)
    return base | dict(name="ambushed")
