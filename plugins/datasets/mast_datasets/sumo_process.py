"""The process in which SUMO runs: one simulation, answering one request after another.

SUMO is one global simulation per process, its library brings an Arrow of its own that does not agree with pyarrow, and
nobody knows what a damaged network makes it do. So it has a process of its own: it ends when its pipe closes, when a
request takes too long, or when it needs too much memory, and it can write nothing but a few messages.

Started with the number of the pipe's descriptor. Imports nothing of this project, which would bring pyarrow.
"""

from __future__ import annotations

import contextlib
import resource
import signal
import sys
from multiprocessing.connection import Connection
from typing import Any

import msgpack
import numpy as np

#: Bytes of a message in either direction.
MAX_MESSAGE = 200_000_000
_MAX_MEMORY = 8_000_000_000
_END_S = 3
_MAX_OUTPUT = 1_000_000  # bytes of each file that SUMO writes: its messages are in one
#: Of moveToXY: the car stays on its route, or is beside the road, where nobody sees it.
_KEEP_ROUTE_OR_LEAVE_ROAD = 3
_NO_LANE_CHANGES = 0


class RunningSumo:
    """What can be asked of SUMO; all names are SUMO's."""

    def __init__(self) -> None:
        import libsumo

        self.sumo = libsumo
        self._known: set[str] = set()

    def start(self, arguments: list[str]) -> None:
        """Load the network."""
        self.sumo.start(["sumo", *arguments])

    def advance(self, until_s: float) -> None:
        """Simulate up to a time, without moving anything."""
        self.sumo.simulationStep(until_s)

    def step(self, steps: int, moves: list[Any], watched: dict[str, list[str]]) -> dict[str, Any]:
        """Simulate some steps, and return what is there then, the shapes of what is new, and `around` of some vehicles.

        moves: (vehicle, edge, row of its lane, places), the latter x, y m of its front and its angle, degrees clockwise
               from north, after each step
        watched: by vehicle, lanes
        """
        vehicle, person = self.sumo.vehicle, self.sumo.person
        present = set(vehicle.getIDList())
        for row in range(steps):
            for name, edge, lane, places in moves:
                if name in present:
                    vehicle.moveToXY(name, edge, lane, *places[row], _KEEP_ROUTE_OR_LEAVE_ROAD)
            self.sumo.simulationStep()
            present = set(vehicle.getIDList())
        vehicles = vehicle.getIDList()
        persons = [name for name in person.getIDList() if not person.getVehicle(name)]  # riders are no objects
        state = [
            *((*vehicle.getPosition(name), vehicle.getAngle(name), vehicle.getSpeed(name)) for name in vehicles),
            *((*person.getPosition(name), person.getAngle(name), person.getSpeed(name)) for name in persons),
        ]
        shapes = {
            name: (part.getLength(name), part.getWidth(name), part.getHeight(name), part.getVehicleClass(name))
            for part, names in ((vehicle, vehicles), (person, persons))
            for name in names
            if name not in self._known
        }
        self._known.update(shapes)
        values = np.array(state, np.float64).tobytes()
        around = {name: self.around(name, lanes) for name, lanes in watched.items()}
        return {"vehicles": vehicles, "persons": persons, "state": values, "shapes": shapes, "around": around}

    def around(self, name: str, lanes: list[str]) -> tuple[Any, Any]:
        """The foes of a vehicle at the next junctions, each with whether it is on one, and the states of links.

        lanes: the links are those at their ends
        """
        vehicle = self.sumo.vehicle
        foes = vehicle.getJunctionFoes(name, FOES_M) if name in vehicle.getIDList() else ()
        foes = [(*foe[:6], foe[7], vehicle.getLaneID(foe[0]).startswith(":")) for foe in foes]
        return foes, [[link[5] for link in self.sumo.lane.getLinks(lane)] for lane in lanes]

    def car(self, name: str) -> list[Any]:
        """Of a vehicle: lane, m along it, edges of its route, row of the present one, factor of limits, limit m/s."""
        parts = "LaneID", "LanePosition", "Route", "RouteIndex", "SpeedFactor", "MaxSpeed"
        return [getattr(self.sumo.vehicle, f"get{part}")(name) for part in parts]

    def lane(self, name: str) -> Any:
        """Of a lane: its shape, limit m/s, and (next lane, lane of the junction or "", direction) of each link."""
        lane = self.sumo.lane
        return (
            lane.getShape(name),
            lane.getMaxSpeed(name),
            [(link[0], link[4], link[6]) for link in lane.getLinks(name)],
        )

    def keep_lanes(self, name: str, edges: list[str]) -> bool:
        """Give a vehicle a route on which it never changes lanes from now on; returns whether SUMO takes it.

        edges: of the route, from the present one or the next one on
        """
        vehicle = self.sumo.vehicle
        try:
            present = vehicle.getRoute(name)[vehicle.getRouteIndex(name)]
            vehicle.setRoute(name, edges if edges[:1] == [present] else [present, *edges])
            vehicle.setLaneChangeMode(name, _NO_LANE_CHANGES)
        except self.sumo.TraCIException:  # it is beside the road
            return False
        return True


#: m, how far ahead of a car foes are asked for.
FOES_M = 80.0


def main(descriptor: int) -> None:
    """Answer requests (method, arguments, s that it may take) until the pipe closes."""
    pipe = Connection(descriptor)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal; the pipe ends this one
    for limit, value in ((resource.RLIMIT_FSIZE, _MAX_OUTPUT), (resource.RLIMIT_AS, _MAX_MEMORY)):
        with contextlib.suppress(OSError, ValueError):  # a lower limit is there already
            resource.setrlimit(limit, (value, value))
    simulation: RunningSumo | None = None
    while True:
        try:
            method, arguments, limit_s = msgpack.unpackb(pipe.recv_bytes(MAX_MESSAGE), raw=False)
        except (EOFError, OSError):
            break
        signal.alarm(limit_s)  # whose default is to end the process, also within SUMO
        try:
            simulation = simulation or RunningSumo()
            answer = True, getattr(simulation, method)(*arguments)
        except Exception as error:
            answer = False, f"{error}"
        signal.alarm(0)
        try:
            pipe.send_bytes(msgpack.packb(answer, use_bin_type=True))
        except OSError:
            break
    if simulation is not None:
        signal.alarm(_END_S)
        with contextlib.suppress(Exception):
            simulation.sumo.close()


if __name__ == "__main__":
    main(int(sys.argv[1]))
