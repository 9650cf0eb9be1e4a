import numpy as np

from mast_zenoh.fusion import Fusion
from mast_zenoh.scenario import load


class SurestMember(Fusion):
    """Takes the member with the highest score."""

    def fuse(self, states, labels, weights=None):
        trusted = np.ones(len(labels), bool) if weights is None else weights > 0.0
        rows = np.flatnonzero(trusted)
        position, score = states.position[rows], states.score[rows]
        rows = rows[np.lexsort((states.id[rows], *position.T, -score, labels[rows]))]
        label, first = np.unique(labels[rows], return_index=True)
        return states.select(rows[first]).with_(id=label)


def scenario():
    _, base = load("baseline")
    base["command_center"]["pipeline"]["group_tracking"]["fusion"] = dict(type="SurestMember")
    return base | dict(name="surest")
