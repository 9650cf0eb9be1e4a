"""The data that an evaluator collects from the messages of a run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.driving import Command
from mast_zenoh.driving.motion import RouteAhead
from mast_zenoh.evaluation.driver_on_truth import DriverOnTruth
from mast_zenoh.evaluation.effects import Meter, ReportedPose
from mast_zenoh.evaluation.estimate_wires import Influences
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics import Presence, Record
from mast_zenoh.metrics.record import Snapshot
from mast_zenoh.metrics.trust import AGENT_COLUMNS, TrustUpdate

_PERIOD_S = 0.1  #: assumed frame period of a run with a single frame


class ArrivedEstimate(NamedTuple):
    """An estimate as a driver received it.

    about: the frame that it describes; time_ns: ns, of that frame; estimate: its name among those that are scored
    """

    about: int
    time_ns: int
    estimate: str
    objects: Snapshot


class OwnView(NamedTuple):
    """What an agent's own sensor sees, as its driver received it; about, time_ns: as of an estimate."""

    about: int
    time_ns: int
    view: SweptView


Item = TypeVar("Item", ArrivedEstimate, OwnView)


@dataclass
class Heard:
    """What the driver of one car received.

    ports: on which it receives estimates and views; estimates: by port, those that arrived in each frame of the run
    views: by frame of arrival; routes: by frame
    commands: as they reached the car: the frame of arrival, and the command and its frame
    wanted: m/s^2, by frame, the acceleration of the commands as they left the driver
    left_out: ports whose messages a replay leaves out
    on_truth: its driver as it would drive on the truth; None: not known
    """

    ports: set[str] = field(default_factory=set)
    estimates: dict[str, dict[int, ArrivedEstimate]] = field(default_factory=lambda: defaultdict(dict))
    views: dict[int, OwnView] = field(default_factory=dict)
    routes: dict[int, RouteAhead] = field(default_factory=dict)
    commands: list[tuple[int, int, Command]] = field(default_factory=list)
    wanted: dict[int, float] = field(default_factory=dict)
    left_out: set[str] = field(default_factory=set)
    on_truth: DriverOnTruth | None = None

    def add(self, port: str, step: int, arrival: ArrivedEstimate) -> None:
        """Store an estimate that arrived in a frame of the run; of several the newest counts, as for the driver."""
        _keep_newest(self.estimates[port], step, arrival)

    def see(self, step: int, view: OwnView) -> None:
        """Store a view that arrived in a frame of the run, as estimates are."""
        _keep_newest(self.views, step, view)

    def obey(self, step: int, frame: int, command: Command) -> None:
        """Store a command of a frame that reached the car in a frame of the run."""
        self.commands.append((step, frame, command))

    def forget(self, before: int) -> None:
        """Forget what was received before a frame of the run, except what may still be the newest in it."""
        for port, arrivals in self.estimates.items():
            self.estimates[port] = _since(arrivals, before)
        self.views = _since(self.views, before)
        self.routes = {frame: route for frame, route in self.routes.items() if frame >= before}
        self.wanted = {frame: wanted for frame, wanted in self.wanted.items() if frame >= before}
        self.commands = [command for command in self.commands if command[0] >= before]

    @property
    def has_veto(self) -> bool:
        """Whether the agent's own sensors overrule its mission estimate: only then the driver receives views."""
        return "view" in self.ports


def _since(arrivals: Mapping[int, Item], first: int) -> dict[int, Item]:
    """The arrivals from a frame on, and the one before it that may still be the newest in it."""
    past = [step for step in arrivals if step < first]
    newest = max(past, key=lambda step: (arrivals[step].about, -step), default=first)
    return {step: item for step, item in arrivals.items() if step >= first or step == newest}


def _keep_newest(arrivals: dict[int, Item], step: int, item: Item) -> None:
    kept = arrivals.get(step)
    if kept is None or item.about > kept.about:
        arrivals[step] = item


@dataclass
class RunData:
    """Data collected from the messages of a run; of a long one, of its latest frames.

    record:   the truth and all estimates;  meter: effects of the interposers
    roles:    of the nodes;  presence: joining and leaving of nodes
    times_ns: by frame, its clock time
    poses:    by (agent, frame)
    detected: by subject whose points have a wire, and frame: (n, 3) m, frame of the agent, what was detected in a scan
    picture_sent: by frame, the frame in which its picture was sent
    tracks_sent: by (agent, frame), the frame in which the agent's tracks were sent
    attack_reports, link_reports: (interposer, frame, sequence number, columns)
    trust:    by frame, the first message about it
    receptions: by (agent, frame), busy ratio of the channel, ns and number of its own messages, and number of
        those that it lost, all of the frame before
    relays:   whether peers relay their pictures
    influences: what can affect which estimate
    measured: by wire and metric, the values of its messages
    heard:    what drivers received, by the agent whose car they drive
    """

    record: Record
    meter: Meter = field(default_factory=Meter)
    roles: dict[str, str] = field(default_factory=dict)
    presence: Presence = field(default_factory=Presence)
    times_ns: dict[int, int] = field(default_factory=dict)
    poses: dict[tuple[str, int], ReportedPose] = field(default_factory=dict)
    detected: dict[str, dict[int, Floats]] = field(default_factory=dict)
    picture_sent: dict[int, int] = field(default_factory=dict)
    tracks_sent: dict[tuple[str, int], int] = field(default_factory=dict)
    attack_reports: list[tuple[str, int, int, Body]] = field(default_factory=list)
    link_reports: list[tuple[str, int, int, Body]] = field(default_factory=list)
    trust: dict[int, TrustUpdate] = field(default_factory=dict)
    receptions: dict[tuple[str, int], tuple[float, int, int, int]] = field(default_factory=dict)
    relays: bool = False
    heard: dict[str, Heard] = field(default_factory=dict)
    influences: Influences = field(init=False)
    measured: dict[str, dict[str, list[float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.influences = Influences(self.record.agents)

    def forget(self, before: int) -> None:
        """Forget what is not needed for frames from this one on: all but times, counts and the trust in agents."""
        self.record.forget(before)
        self.meter.forget(before)
        for heard in self.heard.values():
            heard.forget(before)
        for by_agent in (self.poses, self.tracks_sent):
            for key in [key for key in by_agent if key[1] < before]:
                del by_agent[key]
        for subject, by_frame in self.detected.items():
            self.detected[subject] = {frame: position for frame, position in by_frame.items() if frame >= before}
        for reports in (self.attack_reports, self.link_reports):
            reports[:] = [report for report in reports if report[1] >= before]
        for frame in [frame for frame, update in self.trust.items() if frame < before and "position" in update.columns]:
            columns = self.trust[frame].columns
            self.trust[frame] = TrustUpdate(frame, {name: columns[name] for name in AGENT_COLUMNS})

    @property
    def period_s(self) -> float:
        """Frame period, s."""
        first, second = self.times_ns.get(0), self.times_ns.get(1)
        return _PERIOD_S if first is None or second is None else (second - first) * 1e-9

    @property
    def ego(self) -> str:
        """The main agent of the evaluation."""
        return ego_of(self.record.agents)

    def picture_age_s(self, frames: Sequence[int]) -> dict[str, dict[str, float | int | None]]:
        """By agent: mean and maximum age in s of the picture in its mission estimates, and the `frames` without any.

        Known after `record.hold_pictures`; None without pictures.
        """
        summary: dict[str, dict[str, float | int | None]] = {}
        for agent, ages_ns in self.record.picture_ages_ns.items():
            ages_s = [ages_ns[frame] * 1e-9 for frame in frames if frame in ages_ns]
            mean, most = (sum(ages_s) / len(ages_s), max(ages_s)) if ages_s else (None, None)
            summary[agent] = {"mean": mean, "max": most, "frames_without": len(frames) - len(ages_s)}
        return summary

    def latencies_ns(self) -> list[int]:
        """ns of scene time between each frame and the one in which its picture was sent."""
        times = self.times_ns
        return [
            times[sent] - times[frame]
            for frame, sent in sorted(self.picture_sent.items())
            if {frame, sent} <= times.keys()
        ]

    def latency_percentiles_ms(self) -> dict[str, float | None]:
        """p50, p95 and p99 in ms of `latencies_ns`; None without latencies."""
        latencies = self.latencies_ns()
        names = (50, 95, 99)
        if not latencies:
            return {f"p{p}": None for p in names}
        return {f"p{p}": float(np.percentile(np.array(latencies) * 1e-6, p)) for p in names}


def ego_of(agents: Sequence[str]) -> str:
    """The main agent of an evaluation: "ego" if there is one, else the first."""
    return "ego" if "ego" in agents else next(iter(agents), "")
