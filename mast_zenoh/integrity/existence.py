"""Which objects exist, given which agents must be lying, and which may be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch, ClusterBoxes, ObjectTrust
from mast_zenoh.integrity.deviations import column_medians
from mast_zenoh.integrity.disputes import Evidence, Explanations
from mast_zenoh.integrity.memory import NOW, VOTE_MEMORY_S, AgentMemory, VoteMemory
from mast_zenoh.integrity.visibility import FAR_M, silent_about

#: Agents that must confirm an object at one time, so that it is believed when only suspended agents report it later.
CONFIRMING = 2
#: s, for which it is believed then; and for which what was refuted is not, unless another agent confirms it.
ESTABLISHED_S = 10.0
#: Objects that an agent alone may report: so many, and this many times what is usual for the agents now; and as many
#: above this many times its own mean until now.
ALONE, ALONE_TIMES = 10, 2.0
SUDDEN, SUDDEN_TIMES = 5, 1.5
#: Objects that an agent may report with fewer than half of all: so many above this many times its own mean until now.
#: Of what is beyond, the objects that others see through are withheld.
FEW, FEW_TIMES = 2, 1.25
#: s, after which an object that is contradicted is evidence against the agent that reports it: by then, most false
#: detections of honest detectors are gone, and a fault, whose contradictions begin all at once, has been found. And s,
#: for which it is evidence: it is withheld meanwhile. One object adds less than any alarm takes.
BRIEF_S, COUNTED_S = 1.5, 2.5
#: s, for which an agent that reported something attached to an object is not believed about what touches one.
ATTACHED_S = 30.0
#: s, over which these numbers are averaged for each agent, and s after which its mean is known.
USUAL_S, KNOWN_S = 30.0, 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """The votes of `a` agents about `c` objects.

    voter: (a,) agents whose votes count
    clear: (c, a) rays of the agent pass the place of the object
    supports: (c, a) votes for it: reports it where its own rays end
    occupied: (c, a) votes for it: its rays end there, though it does not report it
    opposes: (c, a) votes against it: its rays pass there, even if it reports it
    """

    voter: Bools
    clear: Bools
    supports: Bools
    occupied: Bools
    opposes: Bools

    @classmethod
    def of(cls, evidence: Evidence, voter: Bools) -> Votes:
        """The votes about the objects of a batch. voter: (a,) agents whose votes count"""
        batch, clear = evidence.batch, evidence.rays.mostly_clear | evidence.passed
        impossible = evidence.testimonies.impossible | evidence.out_of_view
        silent = silent_about(batch, evidence.boxes, evidence.seen, evidence.rays, FAR_M)
        return cls(
            voter,
            clear,
            supports=batch.reported & ~clear & ~impossible & voter,
            occupied=silent & ~evidence.passed & voter,
            opposes=clear & voter,
        )

    def refuted(self, explanations: Explanations) -> Bools:
        """(c,) objects that are false in every explanation of the disputes."""
        result = np.zeros(len(self.supports), np.bool_)
        denied = np.flatnonzero(self.supports.any(axis=1) & self.opposes.any(axis=1))
        for_it = self.supports[denied] | self.occupied[denied]
        result[denied] = explanations.false(for_it, self.opposes[denied])
        return result


class ExistenceVotes:
    """Decides which objects exist, with a short memory.

    An agent that reports an object, or whose rays end at it, votes for it; one that sees through its place votes
    against it, even if it reports it.

    An object is withheld while it is false in every explanation of the disputes, or while only suspended agents report
    it, unless an agent that is not suspended has confirmed it together with another one, or it was known before the
    agents began to lie: then it stays for ESTABLISHED_S. What was false in every explanation is withheld for as long,
    unless another agent reports it.

    An agent is heard only about what may be in its own view. Objects where no other sensor looks can be neither
    confirmed nor refuted. Of a suspended agent, as many of them are believed as it had on average before, the oldest:
    disbelieving all would cost more than it saves. Objects that fewer than half of the agents report, and others see
    through, are open as long as either may be lying. They are believed unless the agent reports many more with few
    others than it did before.

    An agent that is suspended for how its objects look or move still votes on whether they exist, and its tracks count
    where nobody else reports the object.

    agents: the memory of agents, with columns `suspended` and `misdescribes`, which the caller updates, and COLUMNS
    """

    #: Of each agent: mean numbers of objects that it reports and nobody else looks at, of those that it reports alone,
    #: and of those that it reports with fewer than half of all; s, over which they are averaged; ns, until when what it
    #: reports close to other objects is doubted.
    COLUMNS: ClassVar = dict(unwatched=0.0, alone=0.0, few=0.0, averaged_s=0.0, attached_until_ns=0)

    def __init__(self, agents: AgentMemory) -> None:
        self._agents = agents
        # known: whether nobody lied yet when it appeared
        # supported_ns: time, ns, at which a believed agent reported it last
        self._votes = VoteMemory(VOTE_MEMORY_S, known=False, supported_ns=NOW)
        self._of = self._votes.objects.of
        self._rows: Ints = np.zeros(0, np.int64)  # of the clusters of the last batch
        # (m, k) which agents confirmed an object with another one, and the ids of their tracks of it
        self._witnessed: Bools = np.zeros((0, 0), np.bool_)
        self._track: Ints = np.zeros((0, 0), np.int64)
        self._contradicted_s = np.zeros((0, 0))  # (m, k) for how long what each agent reports was contradicted
        self._false_until_ns = np.zeros((0, 0), np.int64)  # (m, k) ns, until when it is false by what was known
        self._time_ns: int | None = None

    def follow(self, time_ns: int, boxes: ClusterBoxes) -> Ints:
        """(c,) numbers of the objects of a batch's clusters, which they keep, see `ObjectMemory`."""
        self._rows = self._votes.follow(time_ns, boxes)
        objects = self._votes.objects
        self._witnessed = self._agents.carry(objects.carry(self._witnessed, False), False, axis=1)
        self._track = self._agents.carry(objects.carry(self._track, 0), 0, axis=1)
        self._contradicted_s = self._agents.carry(objects.carry(self._contradicted_s, 0.0), 0.0, axis=1)
        self._false_until_ns = self._agents.carry(objects.carry(self._false_until_ns, 0), 0, axis=1)
        return np.asarray(objects.of.number[self._rows])

    def counted(self, contradicted: Bools, dt: float) -> Bools:
        """(c, a) reports of a batch that have been contradicted for more than BRIEF_S, and COUNTED_S more at most.

        contradicted: (c, a) those that are now; dt: s, for which the batch stands
        """
        place = np.ix_(self._rows, self._agents.rows)
        self._contradicted_s[place] += dt * contradicted
        contradicted_s = self._contradicted_s[place]
        return np.asarray((contradicted_s > BRIEF_S) & (contradicted_s <= BRIEF_S + COUNTED_S))

    def settle(self, evidence: Evidence, explanations: Explanations) -> tuple[ObjectTrust, Floats]:
        """The trust in the objects of a batch, which are followed, and the weights (n,) of its tracks.

        explanations: of the disputes of its agents
        """
        batch, agents, rows = evidence.batch, self._agents.of, self._rows
        believed = ~agents.suspended | agents.misdescribes
        votes = Votes.of(evidence, believed[self._agents.rows])
        confirming, contradicting = (votes.supports | votes.occupied).sum(axis=1), votes.opposes.sum(axis=1)
        refuted = votes.refuted(explanations)
        false = refuted | (~votes.supports.any(axis=1) & (contradicting > confirming))
        self._note_witnesses(batch, votes.supports)
        confirmed = self._confirmed(believed)
        supported, beyond = self._limited(evidence, votes, confirmed, false)
        balance = self._votes.vote(rows, np.where(false | beyond, -1.0, 1.0))
        lasting = (balance < 0.0) & (batch.time_ns - self._of.first_ns[rows] >= VOTE_MEMORY_S * 1e9)
        doubtful = self._doubtful(batch.time_ns, votes.supports, refuted & lasting)
        withheld = (balance < 0.0) | ~self._stays(batch.time_ns, supported, confirmed)
        withheld |= doubtful | self._attached(evidence)
        objects = ObjectTrust(
            (1.0 + confirming) / (2.0 + confirming + contradicting),
            (evidence.seen.in_view | batch.reported).sum(axis=1),
            votes.supports.sum(axis=1),
            contradicting,
            withheld,
        )
        trusted = votes.supports & ~agents.suspended[self._agents.rows]
        return objects, batch.weights(trusted | (votes.supports & ~trusted.any(axis=1, keepdims=True)))

    def _limited(self, evidence: Evidence, votes: Votes, confirmed: Bools, false: Bools) -> tuple[Bools, Bools]:
        """(c,) objects that agents support, or a suspended one alone as often as before; (c,) those beyond the usual.

        confirmed: (c,) see `_confirmed`; false: (c,) in every explanation
        """
        batch, of, agents = evidence.batch, self._agents.of, self._agents.rows
        reported, supports, voter = batch.reported, votes.supports, votes.voter
        one = (reported.sum(axis=1) == 1)[:, None]  # what a suspended agent reports, too, is not reported alone
        watched = (evidence.seen.in_view & voter & ~reported).any(axis=1, keepdims=True)
        unwatched = reported & ~votes.clear & ~evidence.testimonies.impossible & ~watched & one
        alone = supports & one & ~confirmed[:, None]
        few = supports & ((2 * supports.sum(axis=1) < len(batch.agents)) & ~false)[:, None]
        contested = few.any(axis=1) & votes.opposes.any(axis=1)
        most_alone, most_few = self._most_alone(alone.sum(axis=0), voter), self._most_of_few(few.sum(axis=0), voter)
        supported = supports.any(axis=1) | self._oldest(unwatched & ~voter, np.rint(of.unwatched[agents]))
        beyond = alone.any(axis=1) & ~self._oldest(alone, most_alone)
        beyond |= contested & ~self._oldest(few, most_few)
        self._average(
            batch.time_ns,
            voter,
            unwatched=unwatched.sum(axis=0),
            alone=np.minimum(alone.sum(axis=0), most_alone),
            few=np.minimum(few.sum(axis=0), most_few),
        )
        return supported, beyond

    def _doubtful(self, time_ns: int, supports: Bools, refuted: Bools) -> Bools:
        """(c,) objects that only those support whose support of it was refuted lately, though they may be open now.

        supports: (c, a); refuted: (c,) false in every explanation, now and for most of the last half second
        """
        place = np.ix_(self._rows, self._agents.rows)
        until_ns = self._false_until_ns[place]
        until_ns[supports & refuted[:, None]] = time_ns + round(ESTABLISHED_S * 1e9)
        self._false_until_ns[place] = until_ns
        return np.asarray(supports.any(axis=1) & ~(supports & (until_ns <= time_ns)).any(axis=1))

    def _attached(self, evidence: Evidence) -> Bools:
        """(c,) objects that drive as one with another one, or touch one by the word of those who said that before."""
        batch, rows, until_ns = evidence.batch, self._agents.rows, self._agents.of.attached_until_ns
        saying = (batch.reported & evidence.attached[:, None]).any(axis=0)
        until_ns[rows[saying]] = batch.time_ns + round(ATTACHED_S * 1e9)
        others = batch.reported & (batch.time_ns >= until_ns[rows])
        return np.asarray(evidence.attached | (evidence.touching & ~others.any(axis=1)))

    def _note_witnesses(self, batch: Batch, supports: Bools) -> None:
        """Note which agents confirm an object together. supports: (c, a)

        An object is not confirmed any more once a witness's track of it is of another one: a liar that leaves a real
        object with a false velocity would take its number along.
        """
        agent_rows, track = self._agents.rows, batch.states.id
        row, column = self._rows[batch.labels], agent_rows[batch.agent]
        same = self._witnessed[:, column] & (self._track[:, column] == track)
        self._witnessed[(same & (np.arange(len(same))[:, None] != row)).any(axis=1)] = False
        cluster, agent = np.nonzero(supports & (supports.sum(axis=1) >= CONFIRMING)[:, None])
        place = self._rows[cluster], agent_rows[agent]
        self._witnessed[place], self._track[place] = True, track[batch.member[cluster, agent]]

    def _confirmed(self, believed: Bools) -> Bools:
        """(c,) objects that an agent confirmed together with another one. believed: (k,) agents that count"""
        return np.asarray((self._witnessed[self._rows] & believed).any(axis=1))

    def _stays(self, time_ns: int, supported: Bools, confirmed: Bools) -> Bools:
        """(c,) objects that are supported (c,), or were until lately and were known, or confirmed (c,), before."""
        rows = self._rows
        self._of.supported_ns[rows] = np.where(supported, time_ns, self._of.supported_ns[rows])
        recent = time_ns - self._of.supported_ns[rows] <= ESTABLISHED_S * 1e9
        return np.asarray(supported | ((self._of.known[rows] | confirmed) & recent))

    def _most_alone(self, alone: Ints, voter: Bools) -> Floats:
        """(a,) objects that each agent may report alone. alone: (a,) that it does; voter: (a,) agents that count"""
        of, rows = self._agents.of, self._agents.rows
        own = np.where(of.averaged_s[rows] >= KNOWN_S, SUDDEN + SUDDEN_TIMES * of.alone[rows], np.inf)
        return np.asarray(np.minimum(ALONE + ALONE_TIMES * _middle(alone[voter]), own))

    def _most_of_few(self, few: Ints, voter: Bools) -> Floats:
        """(a,) objects that each agent may report with few others. few: (a,) that it does; voter: as above"""
        of, rows = self._agents.of, self._agents.rows
        return FEW + FEW_TIMES * np.where(of.averaged_s[rows] >= KNOWN_S, of.few[rows], _middle(few[voter]))

    def _average(self, time_ns: int, voter: Bools, **numbers: Floats | Ints) -> None:
        """Average the numbers (a,) of a batch, by column. voter: (a,) agents that count; those of others stay"""
        elapsed_s = 0.0 if self._time_ns is None else (time_ns - self._time_ns) * 1e-9
        self._time_ns = time_ns
        of, rows = self._agents.of, self._agents.rows[voter]
        seconds = of.averaged_s[rows] = np.minimum(of.averaged_s[rows] + elapsed_s, USUAL_S)
        step = np.minimum(elapsed_s / np.maximum(seconds, 1e-9), 1.0)
        for name, number in numbers.items():
            mean = getattr(of, name)
            mean[rows] += step * (number[voter] - mean[rows])

    def _oldest(self, objects: Bools, most: Floats) -> Bools:
        """(c,) the oldest of each agent's objects (c, a), at most (a,) so many."""
        chosen = np.zeros(len(objects), np.bool_)
        for column in np.flatnonzero(objects.any(axis=0)).tolist():
            own = np.flatnonzero(objects[:, column])
            oldest = np.argsort(self._of.first_ns[self._rows[own]], kind="stable")
            chosen[own[oldest[: int(most[column])]]] = True
        return chosen

    def keep_known(self, before_ns: int) -> None:
        """Believe the objects that were known before a time, regardless of which agents report them later.

        For the moment in which an agent is suspended: what it reported before it began to lie is no lie.
        """
        self._of.known |= self._of.first_ns < before_ns


def _middle(values: Floats | Ints) -> float:
    """The median of values (n,); 0 without any."""
    return float(column_medians(values[:, None])[0]) if len(values) else 0.0
