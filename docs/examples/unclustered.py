import numpy as np

from mast_zenoh.fusion import Clusterer
from mast_zenoh.scenario import load


class EveryTrackAlone(Clusterer):
    """Makes each track a cluster: the picture then has an object several times, once for each agent that sees it."""

    def cluster(self, states, agent):
        labels = np.empty(len(agent), np.int64)
        labels[np.lexsort((states.id, agent))] = np.arange(len(agent))
        return labels


def scenario():
    _, base = load("baseline")
    base["command_center"]["pipeline"]["clustering"] = dict(type="EveryTrackAlone")
    return base | dict(name="unclustered")
