"""What a command centre's trust in agents and objects is worth, compared with how they behaved.

    history  the trust of a run by frame and agent
    conduct  whether each agent was honest, faulty or lying at each time
    summary  the part `integrity` of metrics.json
    roc      receiver operating characteristic, and areas under it

Pure: arrays in, arrays and plain dicts out. See docs/metrics.md.
"""

from mast_zenoh.metrics.trust.conduct import CONDUCT, FAULTY, HONEST, LYING, Conduct, Fault, fault_frames, lasting
from mast_zenoh.metrics.trust.history import TrustHistory, TrustUpdate
from mast_zenoh.metrics.trust.roc import Roc, auc, partial_auc, roc
from mast_zenoh.metrics.trust.summary import detection_delay, summary

__all__ = [
    "CONDUCT",
    "FAULTY",
    "HONEST",
    "LYING",
    "Conduct",
    "Fault",
    "Roc",
    "TrustHistory",
    "TrustUpdate",
    "auc",
    "detection_delay",
    "fault_frames",
    "lasting",
    "partial_auc",
    "roc",
    "summary",
]
