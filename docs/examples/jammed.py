from dataclasses import dataclass

from mast_zenoh.faults import Fault
from mast_zenoh.scenario import load


@dataclass(frozen=True, kw_only=True)
class Jam(Fault):
    """Jams the radio: messages are late, and some are lost.

    until:    s of scene time at which it ends
    strength: the fraction of messages that are lost, 0 to 1
    """

    until: float
    strength: float = 0.5

    @property
    def over(self):
        return self.until

    def rules(self, lockstep):
        return [dict(type="Loss", probability=self.strength), dict(type="Delay", mean_s=0.2 * self.strength)]


def scenario(strength=0.5):
    _, base = load("baseline")
    jam = dict(type="Jam", at=1.0, until=3.0, nodes=["infra_1", "infra_2"], strength=strength)
    return base | dict(name="jammed", faults=[jam])
