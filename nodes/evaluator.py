"""The evaluator: receives every message of the run and scores it while it goes on.

It also receives the truth.
It publishes nothing, so it cannot influence the run. It measures instead of trusting reports: estimates are scored as
sent and as received, and the effects of adversaries and links are the differences between their inputs and outputs.
Its results become metrics.json and the tables of the run folder.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_world
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.driving import CarLimits, Command, RouteAhead
from mast_zenoh.driving.motion import HOLD_S, TAKE_OVER_S
from mast_zenoh.errors import MessageError
from mast_zenoh.evaluation import Evaluation, RunData, RunScoring, ego_of
from mast_zenoh.evaluation.driven import PlayedDrivers, check_played, driver_ports, drivers_of
from mast_zenoh.evaluation.driver_on_truth import DriverOnTruth, TrueFrame
from mast_zenoh.evaluation.effects import ReportedPose
from mast_zenoh.evaluation.effects.scans import POINTS
from mast_zenoh.evaluation.estimate_wires import estimates_on
from mast_zenoh.evaluation.from_effects import SENSED
from mast_zenoh.evaluation.run_data import ArrivedEstimate, Heard, OwnView
from mast_zenoh.gather import plausible_rows
from mast_zenoh.integrity.views import check_view, view_of
from mast_zenoh.mesh.hosting import main
from mast_zenoh.mesh.protocol.pacer import SETTLE_EVERY
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics import (
    AttributionLimits,
    Consistency,
    CutOff,
    Driving,
    MessageMetric,
    Metric,
    Record,
    Scorer,
    Series,
)
from mast_zenoh.metrics.estimates import LOCAL, PICTURE, TRUTH
from mast_zenoh.metrics.record import Snapshot
from mast_zenoh.metrics.trust import TrustUpdate
from mast_zenoh.node import Context, Node, Overheard
from mast_zenoh.wiring.model import ANY, Wiring, agent_of, wire_key

#: Number of steps within which a message that is forwarded unchanged is recognised.
RECOGNISED = 32
#: Number of messages of a wire that are kept for that. The keys of a wire may arrive one after the other, each with all
#: messages of as many frames as a listen-only node may lag behind.
REMEMBERED = RECOGNISED + SETTLE_EVERY + 2


#: Points of a driven car's route, and m between two of them, at most.
MAX_POINTS, MAX_STEP_M = 1000, 10.0


class KeyUse(NamedTuple):
    """How the evaluator uses the messages of a key.

    take:   name of the method that handles them
    series: the estimates that they contain
    wire:   key of their wire, if its messages arrive on several keys
    ports:  (agent, port) of the drivers that receive them
    metrics: of the user, of messages
    """

    take: str
    series: tuple[Series, ...] = ()
    wire: str = ""
    ports: tuple[tuple[str, str], ...] = ()
    metrics: tuple[MessageMetric, ...] = ()


class Evaluator(Node):
    """Scores the run.

    agents:  names of all agents
    scorer:  compares estimates with the truth; None: Scorer()
    attribution: rules for the causes of errors, None: AttributionLimits()
    cut_off: rules for objects that disconnected agents alone know, None: CutOff()
    consistency: how errors are compared with covariances, None: Consistency()
    faults:  of the timeline by agent: type, beginning and end in s; None: none
    played_drivers: of a replay, see `driven.driver_ports`; None: none is played
    drivers: by agent, the `driver` and the `limits` of the node that drives its car, where they are known
    The other parameters are described in `evaluation.Evaluation`.
    """

    role = "evaluator"
    inputs = {"everything": ANY}

    def __init__(
        self,
        agents: tuple[str, ...],
        scorer: Scorer | None = None,
        skip_first: int = 6,
        skip_last: int = 10,
        picture_age_s: float = 0.5,
        picture_ages_s: dict[str, float] | None = None,
        estimate_ages_s: dict[str, float] | None = None,
        take_over_s: float = TAKE_OVER_S,
        hold_s: float = HOLD_S,
        car_limits: CarLimits | None = None,
        driving: Driving | None = None,
        metrics: tuple[Metric, ...] = (),
        attribution: AttributionLimits | None = None,
        cut_off: CutOff | None = None,
        consistency: Consistency | None = None,
        faults: dict[str, list[tuple[str, float, float | None]]] | None = None,
        played_drivers: dict[str, list[tuple[str, str]]] | None = None,
        drivers: dict[str, dict[str, Any]] | None = None,
    ) -> None:
        self.agents = agents
        self.drivers = drivers or {}
        self.played_drivers = played_drivers or {}
        check_played(self.played_drivers)
        self.evaluation = Evaluation(
            scorer=scorer or Scorer(),
            skip_first=skip_first,
            skip_last=skip_last,
            picture_age_s=picture_age_s,
            picture_ages_s=picture_ages_s or {},
            estimate_ages_s=estimate_ages_s or {},
            take_over_s=take_over_s,
            hold_s=hold_s,
            car_limits=car_limits or CarLimits(),
            driving=driving or Driving(),
            metrics=metrics,
            attribution=attribution or AttributionLimits(),
            cut_off=cut_off or CutOff(),
            consistency=consistency or Consistency(),
            faults=faults or {},
        )
        self.data = RunData(Record(agents))
        self.scoring = RunScoring(self.evaluation, self.data)
        self.routes: dict[str, KeyUse] = {}
        self.takes: dict[str, Callable[[Overheard, KeyUse], None]] = {}
        self.metered: set[str] = set()
        #: The recently kept messages, by wire and (frame, sequence number).
        self.recent: dict[str, dict[tuple[int, int], list[tuple[Overheard, Snapshot]]]] = defaultdict(dict)

    def start(self, context: Context) -> None:
        """Set up the routes of all keys before the first message."""
        self.follow(context, 0)

    def rewired(self, context: Context) -> None:
        """Follow a changed wiring from the next frame onwards."""
        self.follow(context, context.frame + 1)
        for car in self.played_drivers:  # what live nodes send is no longer what its driver received
            heard = self.data.heard[car]
            heard.left_out |= heard.ports - {"command", "route", "wanted"}

    def joined(self, node: str, role: str, context: Context) -> None:
        """Note that a node is present from the next frame onwards."""
        self.data.roles[node] = role
        self.data.presence.note(node, role, context.frame + 1, True)

    def left(self, node: str, role: str, context: Context) -> None:
        """Note that a node has left."""
        self.data.presence.note(node, role, context.frame + 1, False)

    def follow(self, context: Context, first_frame: int) -> None:
        """Use the current wiring from a frame onwards."""
        wiring = context.wiring
        self.data.meter.follow(wiring, first_frame)
        self.data.influences.follow(wiring)
        own = [metric for metric in self.evaluation.metrics if isinstance(metric, MessageMetric)]
        self.routes = routes(wiring, self.agents, self.played_drivers, own)
        self.takes = {key: getattr(self, route.take) for key, route in self.routes.items()}
        self.metered = set(self.data.meter.keys())
        for car in (*drivers_of(wiring).values(), *self.played_drivers):
            if car not in self.data.heard:
                driver = DriverOnTruth(**self.drivers[car]) if car in self.drivers and car in self.agents else None
                self.data.heard[car] = Heard(on_truth=driver)
        for car, port in driver_ports(wiring, self.played_drivers).get("", ()):
            self.data.heard[car].left_out.add(port)
        for route in self.routes.values():
            for car, port in route.ports:
                self.data.heard[car].ports.add(port)
        self.data.relays = self.data.relays or any(wire.message == "relayed" for wire in wiring.wires)
        for route in self.routes.values():
            self.data.record.expect(route.series)
        for wire in wiring.wires:
            if self.takes.get(wire.legs[0].key) == self.take_detections:
                self.data.detected.setdefault(wire.subject, {})
        context.ignore(set(wiring.keys()) - self.routes.keys() - self.metered)

    def on_everything(self, message: Overheard, context: Context) -> None:
        """Handle a message on any key.

        A message that subscribers refuse is not an estimate, but the meter counts its effect.
        """
        key = message.key
        if key in self.metered:
            self.data.meter.add(message)
        if key in self.routes:
            route = self.routes[key]
            message.check_time()
            self.takes[key](message, route)
            for metric in route.metrics:
                self.measure(metric, message, context)
            if route.take == "take_clock":
                for name, columns in self.scoring.advance(message.header.frame).items():
                    context.append(name, columns)

    def measure(self, metric: MessageMetric, message: Overheard, context: Context) -> None:
        """Store the value of a message."""
        of_wire = self.data.measured.setdefault(wire_key(message.key), {})
        try:
            value = metric.per_message(message.header.frame, message.wire.subject, message.body)
            number = None if value is None else float(value)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # GeneratorExit and CancelledError are not Exceptions
            context.failed(f"metric {metric.label}", error)
            return
        values = of_wire.setdefault(metric.label, [])
        if number is not None and math.isfinite(number):
            values.append(number)

    def take_nothing(self, message: Overheard, route: KeyUse) -> None:
        """A message that only metrics of messages use."""
        message.check()

    def take_clock(self, message: Overheard, route: KeyUse) -> None:
        """Store the time of a frame."""
        message.check()
        self.data.times_ns[message.header.frame] = message.header.time_ns

    def take_truth(self, message: Overheard, route: KeyUse) -> None:
        """Store the truth of a frame."""
        body = message.body
        columns = {name: body[name] for name in ("id", "size", "yaw", "velocity", "class_id")}
        objects, header = ObjectStates.of(body["position"], **columns), message.header
        self.data.record.add_truth(header.frame, objects, body["points"], body["agent_position"], body["agent_object"])
        for car, heard in self.data.heard.items():
            if heard.on_truth is not None:
                own = int(body["agent_object"][self.agents.index(car)])
                heard.on_truth.add(header.frame, "truth", TrueFrame(header.time_ns, objects, own))
        if route.ports:
            self.hear(message, route, TRUTH, Snapshot.of(objects, views=message.encoded))

    def take_pose(self, message: Overheard, route: KeyUse) -> None:
        """Store an agent's pose, to which its detections are relative."""
        pose = ReportedPose(message.body["position"].copy(), message.body["rotation"].copy())
        self.data.poses[message.wire.subject, message.header.frame] = pose

    def take_detections(self, message: Overheard, route: KeyUse) -> None:
        """Store where something was detected in a scan."""
        body = message.body
        position = body["position"] @ rotation_from_quaternion(body["mount_rotation"]).T + body["mount_position"]
        self.data.detected[message.wire.subject][message.header.frame] = position

    def take_estimate(self, message: Overheard, route: KeyUse) -> None:
        """Store an estimate, as sent, as another node received it, or both."""
        first, header = route.series[0], message.header
        if first.estimator == PICTURE:
            self.data.picture_sent.setdefault(header.frame, message.step)
        elif first.estimator == LOCAL and message.step >= 0:
            self.data.tracks_sent.setdefault((message.wire.subject, header.frame), message.step)
        self.keep(message, route)

    def keep(self, message: Overheard, route: KeyUse) -> None:
        """Store an estimate; a message forwarded unchanged is stored only once."""
        objects, header = None, message.header
        if route.wire:
            recent = self.recent[route.wire]
            candidates = recent.setdefault((header.frame, header.seq), [])
            if len(recent) > REMEMBERED:
                del recent[next(iter(recent))]
            for other, kept in candidates:
                if abs(message.step - other.step) <= RECOGNISED and other.same_bytes(message):
                    objects = kept
                    break
        if objects is None or route.ports:
            states = _states(message.body)
        if objects is None:
            objects = Snapshot.of(states, views=message.encoded)
            if route.wire:
                candidates.append((message, objects))
        self.data.record.add(header.frame, route.series, objects, message.step, header.time_ns)
        if route.ports:
            plausible = plausible_rows(states)  # a driver drops all others
            if len(plausible) < len(objects.id):
                objects = Snapshot._make(column[plausible] for column in objects)
            self.hear(message, route, route.series[0].estimator if route.series else "", objects)

    def hear(self, message: Overheard, route: KeyUse, estimate: str, objects: Snapshot) -> None:
        """Store an estimate as drivers received it."""
        header = message.header
        for car, port in route.ports:
            self.data.heard[car].add(
                port, _step(message), ArrivedEstimate(header.frame, header.time_ns, estimate, objects)
            )

    def take_view(self, message: Overheard, route: KeyUse) -> None:
        """Store what an agent's own sensor sees, as drivers received it."""
        try:
            check_view(message.body)
        except ValueError as error:
            raise MessageError(f"view: {error}") from None
        header = message.header
        body = {name: column.copy() for name, column in message.body.items()} if message.encoded else message.body
        for car, _ in route.ports:
            self.data.heard[car].see(_step(message), OwnView(header.frame, header.time_ns, view_of(body)))

    def take_command(self, message: Overheard, route: KeyUse) -> None:
        """Store a command as a driver sent it, or as it reached the car."""
        command = Command(*(float(message.body[name][0]) for name in Command._fields))
        for car, port in route.ports:
            if port == "wanted":
                self.data.heard[car].wanted[message.header.frame] = command.acceleration
            else:
                self.data.heard[car].obey(_step(message), message.header.frame, command)

    def take_route(self, message: Overheard, route: KeyUse) -> None:
        """Store the lane ahead of a driven car, as the world sent it."""
        position, speed, stop = (message.body[name] for name in ("position", "speed", "stop"))
        if not 2 <= len(position) <= MAX_POINTS or np.abs(np.diff(position, axis=0)).max() > MAX_STEP_M:
            raise MessageError(f"route: expected 2 to {MAX_POINTS} points, at most {MAX_STEP_M:g} m apart")
        ahead = RouteAhead(position.copy(), speed.copy(), float(stop.min(initial=np.inf)))
        for car, _ in route.ports:
            heard = self.data.heard[car]
            heard.routes.setdefault(message.header.frame, ahead)
            if heard.on_truth is not None:
                heard.on_truth.add(message.header.frame, "route", ahead)

    def take_reception(self, message: Overheard, route: KeyUse) -> None:
        """Store how busy the channel was at a station, and how many messages it lost."""
        body = message.body
        lost = len(body["lost"]) + len(body["lost_awareness"])
        state = float(body["busy_ratio"][0]), int(body["airtime_ns"][0]), int(body["sent"][0]), lost
        self.data.receptions[message.wire.subject, message.header.frame] = state

    def take_trust(self, message: Overheard, route: KeyUse) -> None:
        """Store the command centre's trust in agents and objects."""
        frame = message.header.frame
        self.data.trust.setdefault(frame, TrustUpdate(frame, message.body))

    def take_attack_report(self, message: Overheard, route: KeyUse) -> None:
        """Store an adversary's report of its changes."""
        header = message.header
        self.data.attack_reports.append((header.source, header.frame, header.seq, message.body))

    def take_link_report(self, message: Overheard, route: KeyUse) -> None:
        """Store a link's report of what it did to messages in the previous step."""
        header = message.header
        self.data.link_reports.append((header.source, header.frame, header.seq, message.body))

    def finish(self, context: Context) -> dict[str, Any]:
        """Metrics and tables of the run, without values of user metrics that failed."""
        results = self.scoring.results()
        for name, error in results.pop("failed_metrics").items():
            context.failed(f"metric {name}", error)
        return results


def _states(body: Body) -> ObjectStates:
    """The objects in the columns of an estimate, in the world frame."""
    states = ObjectStates.from_columns(body)
    return states_to_world(states, body["origin"], body["rotation"]) if "origin" in body else states


def _step(message: Overheard) -> int:
    """The frame of the run in which a message was sent on its key."""
    return message.step if message.step >= 0 else message.header.frame


def routes(
    wiring: Wiring,
    agents: Sequence[str],
    played: PlayedDrivers | None = None,
    metrics: Sequence[MessageMetric] = (),
) -> dict[str, KeyUse]:
    """The route of each key of a wiring.

    Keys that the evaluator does not need are left out.

    played: the drivers that are played, see `driven.driver_ports`; metrics: of messages
    """
    series: dict[str, list[Series]] = defaultdict(list)
    takes: dict[str, str] = {}
    shared: dict[str, str] = {}
    ports = driver_ports(wiring, played)
    sensed = {agent_of(wire.subject) for wire in wiring.wires if wire.interposers and wire.message in SENSED}
    scanned = {wire.subject for wire in wiring.wires if wire.message == POINTS}
    for wire in wiring.wires:
        source = wire.legs[0]
        if len(wire.every_leg) > 1:
            shared |= dict.fromkeys((leg.key for leg in wire.every_leg), wire.key)
        if wire.message in ("view", "command", "route"):
            takes |= {leg.key: f"take_{wire.message}" for leg in wire.every_leg if leg.key in ports}
        if wire.message == "trust" and wire.subject not in ("", ego_of(agents)):
            continue  # that of one centre, or one peer, is evaluated
        if wire.message in ("clock", "truth", "trust", "attack_report", "link_report", "reception"):
            takes[source.key] = f"take_{wire.message}"
        elif wire.message == "pose" and wire.subject in sensed:
            takes[source.key] = "take_pose"
        elif wire.message == "detections" and wire.subject in scanned:
            takes[source.key] = "take_detections"
    for carried in estimates_on(wiring, agents):
        series[carried.key].append(carried.series)
        takes[carried.key] = "take_estimate"
    for _, leg in wiring.legs():
        if leg.key in ports:
            takes.setdefault(leg.key, "keep")  # estimates that only drivers receive
    sent = {wire.legs[0].key: wire.message for wire in wiring.wires}
    own = {key: tuple(each for each in metrics if each.message == kind) for key, kind in sent.items()}
    takes = dict.fromkeys((key for key, found in own.items() if found), "take_nothing") | takes
    return {
        key: KeyUse(take, tuple(series[key]), shared.get(key, ""), ports.get(key, ()), own.get(key, ()))
        for key, take in takes.items()
    }


if __name__ == "__main__":
    main(Evaluator)
