"""Trust in agents and objects as a DiagnosticArray, for rqt_robot_monitor and Foxglove."""

from __future__ import annotations

from mast_ros2 import type_store
from mast_ros2.spatial import header
from mast_ros2.type_store import TYPES, RosMessage
from mast_zenoh.integrity.base import FAULTY, STATES, SUSPENDED, TRUSTED, UNDECIDED, UNKNOWN
from mast_zenoh.messages.schemas import Body

#: Levels of DiagnosticStatus.
OK, WARN, ERROR = 0, 1, 2

#: An agent about which nothing is known is no reason to warn.
_LEVELS = {UNKNOWN: OK, TRUSTED: OK, FAULTY: WARN, UNDECIDED: WARN, SUSPENDED: ERROR}
#: Columns of numbers about agents, and their units.
_NUMBERS = {"mean": "", "log_odds": "", "fault_turn": " rad", "fault_delay": " s", "fault_loss": ""}

_Status, _KeyValue = TYPES["diagnostic_msgs/msg/DiagnosticStatus"], TYPES["diagnostic_msgs/msg/KeyValue"]


def diagnostic_array(trust: Body, time_ns: int, source: str) -> RosMessage:
    """A DiagnosticArray of the columns of a `trust` message: a status for each agent, and one for all objects.

    source: name of the node that judges; statuses are named `source: agent`, and `source: objects`

    Raises ValueError for a time that ROS cannot express.
    """
    agents = [_agent(trust, row, source) for row in range(len(trust["agents"]))]
    return TYPES[type_store.DIAGNOSTIC_ARRAY](header(time_ns, ""), [*agents, _objects(trust, source)])


def _agent(trust: Body, row: int, source: str) -> RosMessage:
    state, reason, name = (trust[column][row] for column in ("state", "reason", "agents"))
    offset = " ".join(f"{value:.6g}" for value in trust["fault_offset"][row].tolist())
    values = {column: f"{trust[column][row]:.6g}{unit}" for column, unit in _NUMBERS.items()}
    message = STATES[state] + (f": {reason}" if reason else "")
    return _status(_LEVELS[int(state)], f"{source}: {name}", message, name, values | {"fault_offset": f"{offset} m"})


def _objects(trust: Body, source: str) -> RosMessage:
    """A warning if objects are withheld, with their ids."""
    withheld = trust["id"][trust["withheld"] == 1].tolist()
    values = {
        "objects": str(len(trust["id"])),
        "contradicted": str(int((trust["contradicting"] > 0).sum())),
        "withheld": " ".join(map(str, withheld)),
    }
    message = f"{len(withheld)} of {len(trust['id'])} objects withheld"
    return _status(WARN if withheld else OK, f"{source}: objects", message, "", values)


def _status(level: int, name: str, message: str, hardware_id: str, values: dict[str, str]) -> RosMessage:
    return _Status(level, name, message, hardware_id, [_KeyValue(key, value) for key, value in values.items()])
