"""A plaza without buildings, with sensors on poles that see a full circle, for the tests of attacks."""

import numpy as np
from attack_worlds import SECOND

from mast_zenoh.arrays.states import Bools, Floats, ObjectStates
from mast_zenoh.attacks import Attack, Surroundings, Tampering
from mast_zenoh.attacks.knowledge import Trust
from mast_zenoh.integrity import STATES

PERIOD = SECOND // 10
MOUNT_M = 8.0
LEVEL = np.eye(3).ravel().tolist()


def plaza(victims: tuple[str, ...], **routes: list[tuple[float, ...]]) -> Surroundings:
    """Agents by name; routes: rows (s, x m, y m, range m) of each, the ego first."""
    return Surroundings(
        scene="plaza",
        agents={
            name: dict(
                limits_deg=[-180.0, 180.0, -89.0, 30.0],
                max_range_m=rows[0][3],
                mount_position=[0.0, 0.0, MOUNT_M],
                mount_rotation=LEVEL,
                route=[[time_s, x, y, 0.0, 1.0, 0.0, 0.0, 0.0] for time_s, x, y, _ in rows],
            )
            for name, rows in routes.items()
        },
        victims=victims,
    )


def within(known: Surroundings, name: str, position: Floats, time_s: float, margin_m: float = 0.0) -> Bools:
    """(n,) whether positions (n, 3) m are in an agent's range, by its distance alone."""
    sensor = known.sensors[name]
    eye = sensor.route.position_at(time_s) + np.array([0.0, 0.0, MOUNT_M])
    return np.asarray(np.linalg.norm(position - eye, axis=1) <= sensor.max_range_m + margin_m)


def honest_in_range(known: Surroundings, position: Floats, time_s: float, margin_m: float = 0.0) -> Floats:
    """(n,) number of honest agents in whose range positions (n, 3) m are."""
    honest = [name for name in known.sensors if name not in known.victims]
    return np.sum([within(known, name, position, time_s, margin_m) for name in honest], axis=0)


class Played:
    """An attack on one agent of a plaza, message by message at 10 Hz."""

    def __init__(self, attack: Attack, known: Surroundings, victim: str, seed: int = 0, *, fused: bool = False) -> None:
        self.attack, self.known, self.victim, self.fused = attack, known, victim, fused
        self.frame = -1
        attack.inform(known)
        attack.bind(seed, "adversary_1")

    def step(self, objects: ObjectStates) -> Tampering:
        self.frame += 1
        sensor = self.known.sensors[self.victim]
        pose = sensor.route.at(self.time_s)
        self.attack.look(sensor.view(*pose), fused=self.fused)
        return self.attack.step(self.frame, self.frame * PERIOD, objects, pose[0])

    @property
    def time_s(self) -> float:
        return self.frame * PERIOD / SECOND


def trust_in(state: str = "unknown", mean: float = 1.0, **agents: float) -> Trust:
    """The trust in the agents with these means; without any, in infra_1, with a state and a mean."""
    means = agents or {"infra_1": mean}
    return Trust(
        tuple(means),
        np.array(list(means.values())),
        np.full(len(means), STATES.index(state), np.uint8),
        np.zeros((0, 3)),
        np.zeros(0),
        np.zeros(0, np.uint8),
    )
