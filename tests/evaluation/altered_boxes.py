"""An attack that makes the objects of one agent longer, turns them, or makes them faster, where they are."""

import numpy as np

from mast_zenoh.arrays.states import canonical_order
from mast_zenoh.attacks import Attack, Tampering, alter
from mast_zenoh.scenario import load


class Reshape(Attack):
    """Multiplies lengths and velocities, and turns headings."""

    def __init__(self, *, length: float = 1.0, turn_rad: float = 0.0, velocity: float = 1.0) -> None:
        self.length, self.turn_rad, self.velocity = length, turn_rad, velocity

    def step(self, frame, time_ns, objects, agent_position, directive=None):
        rows = canonical_order(objects)
        if not len(rows):
            return Tampering.nothing(len(objects))
        chosen = objects.select(rows)
        claims = chosen.with_(
            size=chosen.size * np.array([self.length, 1.0, 1.0]),
            yaw=chosen.yaw + self.turn_rad,
            velocity=chosen.velocity * self.velocity,
        )
        return alter(objects, change=rows, claims=claims)


def scenario(length=1.0, turn_rad=0.0, velocity=1.0):
    _, base = load("baseline")
    attack = dict(type="Reshape", length=length, turn_rad=turn_rad, velocity=velocity)
    rewrites = dict(map="testbed.toml", rewrites=["on_tracks.toml"])
    return base | dict(adversaries=dict(mallory=dict(agent=["infra_1"], attack=attack)), keyexpr=rewrites)
