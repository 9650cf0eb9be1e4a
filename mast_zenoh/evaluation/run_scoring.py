"""The evaluation of a run while it goes on: blocks of frames, each with the frames before and after it. Pure.

What its results can depend on is evaluated with a block, so that they are those of an evaluation of the whole run
(docs/explanation-metrics-and-causes.md names the exceptions). Afterwards its messages are forgotten: what stays are
numbers of each frame, and sums. A run shorter than a block and what follows it is evaluated as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.driving.consequences import DrivenCar, consequences, course
from mast_zenoh.evaluation import trust
from mast_zenoh.evaluation.driven import DrivenCars
from mast_zenoh.evaluation.effects import reports
from mast_zenoh.evaluation.effects.reports import ReportCounts
from mast_zenoh.evaluation.evaluation import Earlier, Evaluation, ScoredFrames, by_agent, own_pictures
from mast_zenoh.evaluation.from_effects import first_change
from mast_zenoh.evaluation.run_data import RunData
from mast_zenoh.metrics import FrameMetric, RunMetric, Table, achievement, causes_of, driving
from mast_zenoh.metrics.achievement import Manipulated
from mast_zenoh.metrics.causes import CauseCounts, cause_counts
from mast_zenoh.metrics.consistency import PairDeviations, counts, deviations
from mast_zenoh.metrics.driving import Drive
from mast_zenoh.metrics.measures import MEASURES, ScoredRun, described, frame_keys, measured
from mast_zenoh.metrics.pictures import (
    consistency_of_pictures,
    deceived_agents,
    differences,
    of_pictures,
    with_pictures,
)
from mast_zenoh.metrics.ranking import mean_ranking, rankings
from mast_zenoh.metrics.scores import FrameScores, ObjectsMatched, mean_and_std
from mast_zenoh.metrics.scoring import Estimate, EstimateColumns, estimates_of
from mast_zenoh.wiring.model import agent_of

#: s; how much later than its frame a message may be sent and still be scored.
LATEST_S = 10.0
#: Frames for which the messages of some keys may arrive later than those of others: see `pacer.SETTLE_EVERY`.
BETWEEN_KEYS = 60
#: Errors are compared with covariances in up to so many frames; of a longer run in every second one, every fourth one
#: and so on. Those of neighbouring frames are much alike.
COMPARED_FRAMES = 4096

#: (agent, estimator)
Name = tuple[str, str]


@dataclass(frozen=True, eq=False)
class Block:
    """What is kept of the frames of a block.

    scores:    per frame, by distinct series;  counted: number of the frames that count in summaries
    matched, ranked, objects, causes: of `scores.series`, over the frames that count; objects: their numbers
    deviations: by distinct series, of estimates that are compared with covariances
    truth_ids: ascending ids of all objects
    own:       by label, values (s, f) of a user's metric, or the error that it raised
    estimates: by distinct series, for users' metrics of whole runs
    pictures:  agents with pictures of their own, and over the frames that count what `of_pictures` needs
    lies, deceived: (f, a), see `trust.integrity`;  withheld: numbers of true and false objects
    """

    scores: FrameScores
    counted: int
    matched: list[ObjectsMatched]
    ranked: list[dict[str, Any]]
    objects: Ints
    causes: CauseCounts
    deviations: Mapping[Name, PairDeviations]
    truth_ids: Ints
    own: Mapping[str, Floats | BaseException]
    estimates: list[EstimateColumns]
    targets: Manipulated
    switched: Mapping[str, Sequence[str]]
    drives: Mapping[Name, Drive]
    driven: Mapping[str, DrivenCar]
    pictures: tuple[Sequence[str], Ints, Bools, Floats]
    lies: Bools
    deceived: Bools
    withheld: tuple[int, int]
    first_change: int | None

    @cached_property
    def rows(self) -> dict[Name, int]:
        """Rows of `scores.series`, by agent and estimator."""
        return self.scores.every_series


class RunScoring:
    """Evaluates a run from data that messages add to.

    `advance` evaluates what is complete and returns rows of tables; `results` returns the rest and the summary.
    """

    #: The longest run that is scored as a whole: its frames, at least and at most, and agents times frames. Blocks of
    #: longer ones are half as long, because what they need is in memory all the time, but as long as the least.
    WHOLE: ClassVar[tuple[int, int, int]] = (200, 1000, 10_000)

    def __init__(self, settings: Evaluation, data: RunData) -> None:
        self.settings, self.data = settings, data
        least, most, agent_frames = self.WHOLE
        self.whole_frames = min(max(agent_frames // max(len(data.record.agents), 1), least), most)
        self.block_frames = max(self.whole_frames // 2, least)
        self._earlier = Earlier()
        self._blocks: list[Block] = []
        self._counts: dict[str, ReportCounts] = {}
        self._next: int | None = None  # first frame of the next block
        self._compared_step = 1

    def advance(self, frame: int) -> dict[str, Table]:
        """Evaluate the next block if everything that belongs to it has arrived with the clock of this frame.

        Returns rows of tables; {} if it has not.
        """
        data = self.data
        if self._next is None:
            if frame < 1:  # two clocks tell the period
                return {}
            latest = self._frames(LATEST_S)
            data.record.latest = latest
            data.meter.allow(latest)
            if not len(frames := data.record.frames()):
                return {}
            self._next = int(frames[0])
        end = self._next + self.block_frames
        limits = self.settings.attribution
        # Messages about the frames of the block and of those that its causes depend on arrive before this frame.
        after = self._frames(LATEST_S) + max(self._frames(2 * limits.coast_s), self.settings.skip_last)
        if frame < max(end, self.whole_frames) + after + BETWEEN_KEYS or not self.settings.settled(self.block_frames):
            return {}
        before = end - self._frames(3 * limits.coast_s + 2 * limits.begin_s + self.settings.cut_off.recovery_s)
        data.meter.settle(end)
        first = -math.inf if not self._blocks else self._next
        assessment = self._assessed(end + after)
        tables = self._add(assessment, first, end)
        self._earlier.matches = assessment.scores.last_matches(before, self._earlier.matches)
        data.forget(before)
        self._next = end
        return tables

    def _frames(self, duration_s: float) -> int:
        return math.ceil(duration_s / self.data.period_s)

    def _assessed(self, until: float) -> ScoredFrames:
        frames = self.data.record.frames()
        return self.settings.assessed(self.data, frames[frames < until], self._earlier, until)

    @property
    def _n_frames(self) -> int:
        return sum(len(block.scores.frames) for block in self._blocks)

    def _add(self, assessment: ScoredFrames, first: float, end: float) -> dict[str, Table]:
        """Add the block of the frames from `first` on, before `end`; returns its rows of tables."""
        data, settings, scores, labels = self.data, self.settings, assessment.scores, assessment.labels
        agents, ego, min_points = data.record.agents, data.ego, settings.scorer.min_points
        frames, effects, blamed = scores.frames, assessment.effects, assessment.blamed
        rows = slice(*np.searchsorted(frames, [first, end]).tolist())
        later = self._n_frames - rows.start  # the numbers of the rows over the run are greater by this
        over_run = settings.scored(rows.stop + later) if end == math.inf else slice(settings.skip_first, None)
        counts_of_run = np.zeros(len(frames), bool)
        counts_of_run[max(over_run.start - later, 0) : None if over_run.stop is None else over_run.stop - later] = True
        counted = np.flatnonzero(counts_of_run[rows]) + rows.start
        scored = slice(int(counted[0]), int(counted[-1]) + 1) if len(counted) else slice(rows.start, rows.start)

        agreement = assessment.agreement(first, end)
        in_block = assessment.counted_effects(first, end)
        last_step = int(frames.max(initial=-1)) if end == math.inf else np.iinfo(np.int64).max
        reports.add_counts(self._counts, effects, agreement, last_step, assessment.from_absence, in_block)
        tables = assessment.tables(first, end, agreement, every_series=end != math.inf or bool(self._blocks))
        victims = self._victims(assessment)
        targets = achievement.targets(
            scores, labels, assessment.manipulations, ego, victims, settings.scorer.range_m, min_points
        )
        targets = targets.select((targets.attacks.frame >= first) & (targets.attacks.frame < end))
        tables["targets"] = targets.table()
        compared = own_pictures(data) or [ego]
        pictures = with_pictures(scores) if len(own_pictures(data)) > 1 else []
        range_m, distance = settings.scorer.range_m, settings.scorer.distance
        block = Block(
            scores=scores.part(rows),
            counted=len(counted),
            matched=scores.objects_matched(scored),
            ranked=rankings(scores, scored),
            objects=(scores.tp + scores.fn)[:, scored].sum(axis=1),
            causes=cause_counts(scores, labels.cause, labels.switch_cause, frames[scored]),
            deviations={
                name: of._replace(frame=of.frame + later).every(self._compared_step)
                for row, name in enumerate(scores.series)
                if counts(*name, compared)
                for of in [deviations(scores.pairs, row, scored)]
            },
            truth_ids=np.unique(scores.truth.boxes.id),
            **self._of_users(assessment, rows, counts_of_run),
            targets=targets,
            switched=achievement.switches(scores, labels.switch_by, ego, scored),
            drives={
                name: Drive._make(column[rows] for column in drive)
                for name, drive in driving.drives(settings.driving, data.record, scores, labels).items()
            },
            driven={car: driven.part(rows, later) for car, driven in DrivenCars(assessment, settings).cars().items()},
            pictures=(
                pictures,
                frames[scored],
                deceived_agents(scores, blamed, pictures)[scored],
                differences(scores, pictures, range_m, distance)[:, scored] if pictures else np.zeros((0, 0)),
            ),
            lies=trust.lies(effects, data.roles, agents, frames, assessment.from_absence, data.influences)[rows],
            deceived=deceived_agents(scores, blamed, agents)[rows],
            withheld=(
                trust.withheld(tables["trust_objects"], scores.truth, frames, scored, min_points)
                if data.trust
                else (0, 0)
            ),
            first_change=first_change(effects, data.roles, assessment.from_absence),
        )
        self._blocks.append(block)
        if self._n_frames > COMPARED_FRAMES * self._compared_step:
            self._compared_step *= 2
            self._blocks = [
                replace(each, deviations={name: of.every(self._compared_step) for name, of in each.deviations.items()})
                for each in self._blocks
            ]
        return tables

    def _of_users(self, assessment: ScoredFrames, rows: slice, counted: Bools) -> dict[str, Any]:
        """What a block keeps for users' metrics; counted: (f,) the frames that count in summaries."""
        scores, labels, metrics = assessment.scores, assessment.labels, self.settings.metrics
        own: dict[str, Floats | BaseException] = {}
        if of_frames := [metric for metric in metrics if isinstance(metric, FrameMetric)]:
            run = ScoredRun(scores, estimates=estimates_of(scores, labels, counted, self.data.period_s))
            for metric in of_frames:
                try:
                    own[metric.label] = run.values(metric)[:, rows]
                except KeyboardInterrupt:
                    raise
                except BaseException as error:  # GeneratorExit and CancelledError are not Exceptions
                    own[metric.label] = error
        estimates: list[EstimateColumns] = []
        if any(isinstance(metric, RunMetric) for metric in metrics):
            estimates = [EstimateColumns.of(row, scores, labels, counted, rows) for row in range(len(scores.series))]
        return {"own": own, "estimates": estimates}

    def _victims(self, assessment: ScoredFrames) -> dict[str, set[int]]:
        """By interposer, the columns of the agents whose wires it intercepts."""
        agents = list(self.data.record.agents)
        victims: dict[str, set[int]] = {}
        for passage in assessment.effects.passages:
            if (agent := agent_of(passage.subject)) in agents:
                victims.setdefault(passage.node, set()).add(agents.index(agent))
        return victims

    def results(self) -> dict[str, Any]:
        """End the run, and evaluate the rest of it.

        Returns {"metrics": contents of metrics.json, "tables": columns of the tables by name, without the rows that
        `advance` has returned, "failed_metrics": errors of failed user-defined metrics by name}.

        Keys:
        frames, scored_frames: number of frames; first and last one that is scored
        settled: False: the run is too short to leave out the frames in which tracks begin
        agents: by agent and estimate, its metrics
        same_as: by agent and estimate, the one of the same messages, whose scores are equal
        achieved: by adversary, and for `all`, what it achieved
        driving: by mobile agent and estimate, what its errors would mean for driving
        driven: by driven car, what happened to it
        consistency: by agent and estimate, for `position` and `velocity`, confidence beside accuracy
        interposers: by node, what it did, and whether its reports agree
        picture_age_s: by agent, `mean` and `max` age of the picture in its mission estimates, and the `frames_without`
            any
        latency_ms: in the run's own time
        late: by agent, tracks that came after the batch of their frame
        messages: by wire, mean and standard deviation of your metrics of messages
        own_metrics: by name, `heading`, `unit`, `digits`, `range` of your metrics, and `per` what they are
        frames_per_second: in the run's own time: scene time in lock-step, the wall clock in real time
        integrity: of a command centre that judges agents, what its trust was worth
        pictures: of agents with pictures of their own, how these differ
        channel: of a radio channel, its load
        recording: of a run that was measured from a part of its recording, `frames` and `played_frames`
        replay: of a replay, what it replays
        """
        data, settings = self.data, self.settings
        last = int(data.record.frames().max(initial=-1))
        data.meter.close(last)
        assessment = self._assessed(math.inf)
        tables = self._add(assessment, -math.inf if not self._blocks else float(self._next or 0), math.inf)
        joined = Joined(self._blocks, settings, data.period_s)
        scored = joined.scored
        frames, times = joined.scores.frames, data.times_ns
        targets = Manipulated.joined([block.targets for block in self._blocks])
        switched = {
            name: [by for block in self._blocks for by in block.switched[name]] for name in self._blocks[-1].switched
        }
        drives = joined.drives()
        summary, per_frame, failed_metrics = self._scored(joined)
        happened, courses = self._happened(joined)
        pictures = own_pictures(data)
        consistency = settings.consistency.of(
            joined.deviations(), joined.truth_ids, pictures or [data.ego], data.period_s * self._compared_step
        )
        received = [(meter.passage, meter.received) for meter in data.meter.meters]
        return {
            "metrics": {
                "frames": len(frames),
                "scored_frames": [int(frame) for frame in frames[scored][[0, -1]]] if len(frames) else [],
                "settled": settings.settled(len(frames)),
                "agents": summary,
                "same_as": by_agent(joined.same_as),
                "achieved": achievement.summary(targets, switched, data.period_s),
                "driving": driving.summary(drives, scored),
                **({"driven": happened} if data.heard else {}),
                "consistency": consistency,
                "interposers": reports.summary(self._counts, received, data.roles),
                "picture_age_s": data.picture_age_s(frames[scored].tolist()),
                "latency_ms": {"sim_to_picture": data.latency_percentiles_ms()},
                **({"messages": self._of_messages()} if data.measured else {}),
                **({"own_metrics": described(settings.metrics)} if settings.metrics else {}),
                "frames_per_second": 1e9 / times[1] if {0, 1} <= times.keys() else None,
                **(self._integrity(joined) if data.trust else {}),
                **(self._pictures(consistency) if len(pictures) > 1 else {}),
                **self._channel(frames[scored]),
            },
            "tables": {
                "metrics": per_frame,
                **tables,
                "driving": driving.table(drives, frames),
                **({"driven": courses} if data.heard else {}),
            },
            "failed_metrics": failed_metrics,
        }

    def _of_messages(self) -> dict[str, dict[str, dict[str, float | None]]]:
        """By wire and metric of its messages: mean and standard deviation."""
        measured = sorted(self.data.measured.items())
        return {
            wire: {name: mean_and_std(np.array(values)) for name, values in by_metric.items()}
            for wire, by_metric in measured
        }

    def _scored(self, joined: Joined) -> tuple[dict[str, dict[str, dict[str, Any]]], Table, dict[str, BaseException]]:
        """The summary by agent and estimator, the table per frame, and errors of user-defined metrics by name.

        Columns:
        scored: whether the frame counts in metrics.json: a mean over these frames equals the one there
        """
        scores = joined.scores
        own = [metric for metric in self.settings.metrics if isinstance(metric, (FrameMetric, RunMetric))]
        summary, columns, failed = measured([*MEASURES.values(), *own], joined)
        causes = causes_of(joined.causes(), sum(block.counted for block in self._blocks))
        for (agent, estimator), row in scores.every_series.items():
            summary[agent][estimator] |= causes[row]
        table = frame_keys(scores) | columns
        table["scored"] = np.tile(joined.counts, len(scores.every_series))
        return summary, table, failed

    def _happened(self, joined: Joined) -> tuple[dict[str, Any], Table]:
        """What happened to each driven car ("driven" of metrics.json), and the columns of driven.parquet."""
        cars = joined.driven(self.settings.take_over_frame(self.data.period_s))
        courses = {car: course(driven) for car, driven in cars.items()}
        table: Table = {
            "agent": np.repeat(np.array([*courses], object), [len(each["frame"]) for each in courses.values()])
        }
        for name in next(iter(courses.values()), {}):
            table[name] = np.concatenate([each[name] for each in courses.values()])
        happened = {car: consequences(driven) | self._on_truth(car) for car, driven in cars.items()}
        return happened, table

    def _on_truth(self, car: str) -> dict[str, str | None]:
        """What is not known of the car's driver.

        Keys:
        on_truth_problem: why it is not known, in some frames, what its driver does on the truth; None: it is known
        """
        driver = self.data.heard[car].on_truth
        return {"on_truth_problem": "its node is a file of your own" if driver is None else driver.problem or None}

    def _pictures(self, consistency: Mapping[str, Any]) -> dict[str, Any]:
        """How the pictures of agents that do not share one differ. consistency: as in metrics.json"""
        blocks = [block for block in self._blocks if block.pictures[0] == self._blocks[-1].pictures[0]]
        lies_from = min((block.first_change for block in self._blocks if block.first_change is not None), default=None)
        frames, deceived = (np.concatenate([block.pictures[column] for block in blocks]) for column in (1, 2))
        apart = np.concatenate([block.pictures[3] for block in blocks], axis=1)
        names = blocks[-1].pictures[0]
        part = of_pictures(names, frames, deceived, apart, self.data.period_s, lies_from)
        return {"pictures": part | {"consistency": consistency_of_pictures(consistency)} if part else part}

    def _channel(self, counted: Ints) -> dict[str, Any]:
        """The load of the channel that stations share, over the frames that count; empty without one.

        Keys:
        stations: number of stations
        busy_ratio: 0 to 1, channel busy ratio, `mean` and `std` over stations and frames
        airtime_share: 0 to 1, share of the time in which a station sends
        sent: 0 to 1, share of the frames in which a station sends
        arrived: 0 to 1, share of the messages that arrive, of all pairs of a sender and another station; None: none was
            sent
        """
        frames, period_ns = set((counted + 1).tolist()), self.data.period_s * 1e9
        receptions = sorted(self.data.receptions.items())  # floating-point sums depend on the order of their terms
        rows = [state for (_, frame), state in receptions if frame in frames]
        if not rows:
            return {}
        busy, airtime_ns, sent, lost = (np.array(column, np.float64) for column in zip(*rows, strict=True))
        stations = len({agent for agent, _ in self.data.receptions})
        expected = float(sent.sum()) * (stations - 1)
        return {
            "channel": {
                "stations": stations,
                "busy_ratio": mean_and_std(busy),
                "airtime_share": float(airtime_ns.mean()) / period_ns,
                "sent": float((sent > 0).mean()),
                "arrived": 1.0 - float(lost.sum()) / expected if expected else None,
            }
        }

    def _integrity(self, joined: Joined) -> dict[str, Any]:
        """The metrics of a command centre that judges agents."""
        data, settings, blocks = self.data, self.settings, self._blocks
        part = trust.integrity(
            [data.trust[frame] for frame in sorted(data.trust)],
            np.concatenate([block.lies for block in blocks]),
            settings.faults,
            data.record.agents,
            joined.scores.frames,
            data.times_ns,
            data.period_s,
            settings.attribution.coast_s,
            np.concatenate([block.deceived for block in blocks]) if data.relays else None,
        )
        n = max(sum(block.counted for block in blocks), 1)
        true, false = (sum(block.withheld[column] for block in blocks) for column in (0, 1))
        part["withheld"] = {"true": true / n, "false": false / n}
        return {"integrity": part}


class Joined(ScoredRun):
    """The blocks of a run one after the other.

    scores:  per frame. Those of several blocks have a row for every series, because series that have the same messages
             in one block may differ in another; and a series that begins later has no messages in earlier blocks.
    same_as: series that have the same messages in every block, as in `FrameScores`
    """

    def __init__(self, blocks: Sequence[Block], settings: Evaluation, period_s: float) -> None:
        self._blocks = blocks
        self.truth_ids = np.unique(np.concatenate([block.truth_ids for block in blocks]))
        self.same_as = {
            name: twin
            for name, twin in blocks[-1].scores.same_as.items()
            if all(block.scores.same_as.get(name) == twin for block in blocks)
        }
        scores = blocks[0].scores if len(blocks) == 1 else self._joined_scores(settings)
        estimates = _Estimates(self, period_s) if blocks[0].estimates else ()
        super().__init__(scores, settings.scored(len(scores.frames)), estimates)
        self.names = scores.series

    def _joined_scores(self, settings: Evaluation) -> FrameScores:
        names = tuple(self._blocks[-1].rows)
        parts = [{name: _row(block, name, settings) for name in names} for block in self._blocks]
        arrays = {
            column: np.stack([np.concatenate([part[name][column] for part in parts]) for name in names])
            for column in parts[0][names[0]]
        }
        frames = np.concatenate([block.scores.frames for block in self._blocks])
        return FrameScores(series=names, frames=frames, same_as={}, **arrays)

    def of_name(self, name: Name) -> list[tuple[Block, int]]:
        """The blocks that have a series, each with its row."""
        return [(block, block.rows[name]) for block in self._blocks if name in block.rows]

    @cached_property
    def completeness(self) -> Sequence[float | None]:
        """Of each series; see `ScoredRun.completeness`."""
        return [
            ObjectsMatched.joined([block.matched[row] for block, row in self.of_name(name)]).completeness
            for name in self.names
        ]

    @cached_property
    def ranked(self) -> Sequence[dict[str, Any]]:
        """Of each series the means over the blocks, weighted with their objects."""
        return [
            mean_ranking([(block.ranked[row], int(block.objects[row])) for block, row in self.of_name(name)])
            for name in self.names
        ]

    def causes(self) -> CauseCounts:
        """Of each series the numbers of its errors by cause."""
        return {
            error: np.stack([sum(block.causes[error][row] for block, row in self.of_name(name)) for name in self.names])
            for error in self._blocks[0].causes
        }

    def deviations(self) -> dict[Name, PairDeviations]:
        """By series, those of every frame that is compared."""
        result = {}
        for name in self.names:
            of_blocks = [(block, block.scores.series[row]) for block, row in self.of_name(name)]
            parts = [block.deviations[twin] for block, twin in of_blocks if twin in block.deviations]
            if parts:
                result[name] = PairDeviations.joined(parts)
        return result

    def drives(self) -> dict[Name, Drive]:
        """The behaviour of each vehicle that there is in all blocks."""
        every = [block.drives for block in self._blocks]
        return {
            name: Drive(*(np.concatenate(column) for column in zip(*(of[name] for of in every), strict=True)))
            for name in every[-1]
            if all(name in of for of in every)
        }

    def driven(self, take_over: int) -> dict[str, DrivenCar]:
        """The driven cars that there are in all blocks. take_over: frame from which on they are driven"""
        every = [block.driven for block in self._blocks]
        return {
            car: DrivenCar.joined([of[car] for of in every], take_over) if len(every) > 1 else every[0][car]
            for car in every[-1]
            if all(car in of for of in every)
        }

    def values(self, metric: FrameMetric) -> Floats:
        """Values (s, f) of a user's metric, NaN before a series begins. Raises what the metric raised."""
        values: list[list[Floats]] = [[] for _ in self.names]
        for block in self._blocks:
            own = block.own[metric.label]
            if isinstance(own, BaseException):
                raise own
            for row, name in enumerate(self.names):
                missing = np.full(len(block.scores.frames), np.nan)
                values[row].append(own[block.rows[name]] if name in block.rows else missing)
        return np.array([np.concatenate(row) for row in values]).reshape(self.scores.fn.shape)

    def columns(self, name: Name) -> EstimateColumns:
        """An estimate from the block on in which it begins."""
        return EstimateColumns.joined([block.estimates[row] for block, row in self.of_name(name)])


def _row(block: Block, name: Name, settings: Evaluation) -> dict[str, NDArray[Any]]:
    """The arrays (f,) of a series in a block; of one that begins later, those without any message."""
    scores = block.scores
    columns = {each.name: getattr(scores, each.name) for each in fields(FrameScores)}
    arrays = {column: array for column, array in columns.items() if isinstance(array, np.ndarray) and array.ndim == 2}
    if name in block.rows:
        return {column: array[block.rows[name]] for column, array in arrays.items()}
    of_agent = [row for (agent, _), row in block.rows.items() if agent == name[0]]
    objects = (scores.fn + scores.tp)[of_agent[0]] if of_agent else np.zeros(len(scores.frames), np.int64)
    distance = settings.scorer.distance
    nothing = {
        column: np.zeros(len(objects), array.dtype) if array.dtype.kind == "i" else np.full(len(objects), np.nan)
        for column, array in arrays.items()
    }
    return nothing | {
        "fn": objects,
        "squared_error": np.zeros(len(objects)),
        "ospa_m": np.where(objects > 0, distance.c, 0.0),
        "gospa_m": (distance.c**distance.p / distance.alpha * objects) ** (1.0 / distance.p),
    }


class _Estimates(Iterable[Estimate]):
    """The estimates of a run, each made when its turn has come, for each metric anew."""

    def __init__(self, joined: Joined, period_s: float) -> None:
        self._joined, self._period_s = joined, period_s

    def __iter__(self) -> Iterator[Estimate]:
        for name in self._joined.names:
            yield self._joined.columns(name).estimate(*name, self._period_s)
