"""Each false or missed object has a cause; one due to an attack, an adversary."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from metric_worlds import (
    LOCAL,
    NOTHING,
    PICTURE,
    Row,
    cars,
    effects,
    explained,
    influences,
    labelled,
    passage,
    recorded,
)

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.evaluation.from_effects import without_unseen
from mast_zenoh.metrics import ESTIMATORS, Record, Series, causes_of
from mast_zenoh.metrics.attributor import Withheld
from mast_zenoh.metrics.causes import cause_counts
from mast_zenoh.metrics.trust import TrustUpdate

Place = tuple[float, float]
Error = tuple[int, str, str, str]


def run_of(truth, picture, local=None, points: Any = 50) -> Record:
    """A run of the ego alone; local: its own tracks, by default those of the picture within 1 m of a true object."""
    own = [good(*each) for each in zip(truth, picture, strict=True)] if local is None else local
    return recorded(truth, {PICTURE: picture, LOCAL: own}, points=points)


def good(objects: ObjectStates, tracks: ObjectStates) -> ObjectStates:
    """The tracks within 1 m of a true object."""
    apart = np.linalg.norm(tracks.position[:, None] - objects.position, axis=2)
    return tracks.select((apart <= 1.0).any(axis=1))


def causes(table, estimator: str = "picture") -> list[Error]:
    """Frame, kind, cause and adversary of the rows of an estimate that have a cause."""
    selected = {name: column[table["estimator"] == estimator] for name, column in table.items()}
    names = ("frame", "kind", "cause", "by")
    return [tuple(row) for row in zip(*(selected[name].tolist() for name in names), strict=True) if row[2]]


def lies(
    effect: str, frames: Iterable[int], at: Place | Callable[[int], Place], more: Place = (0.0, 0.0), by: str = "eve"
) -> list[Row]:
    """What an adversary does to an object in some frames."""
    return [(by, frame, effect, 0, at(frame) if callable(at) else at, more) for frame in frames]


def errors(frames: Iterable[int], kind: str, cause: str, by: str = "") -> list[Error]:
    return [(frame, kind, cause, by) for frame in frames]


@dataclass
class Case:
    """A run of the ego alone, what adversaries did, and the causes of the errors of the picture."""

    truth: list[ObjectStates]
    picture: list[ObjectStates]
    expected: list[Error]
    lies: list[Row] = field(default_factory=list)
    points: Any = 50
    local: list[ObjectStates] | None = None


CAR = cars((0.0, 0.0), id=[1])
HERE, FAR = (0.0, 0.0), (40.0, 0.0)
FALSE = cars(HERE, FAR, id=[5, 6])
#: A track that follows an object which an adversary shows driving away from the car, from frame 12 on.
DIVERTED = [cars((0.0 if frame < 12 else 2.0 * (frame - 10), 0.0), id=[5]) for frame in range(16)]
AWAY = lies("inserted", range(12, 16), lambda frame: (2.0 * (frame - 11), 0.0), (20.0, 0.0))

CASES = {
    "a false track of nothing is clutter": Case([CAR], [FALSE], errors([0], "track", "clutter")),
    "correct tracks have no cause": Case([CAR] * 12, [CAR] * 12, []),
    "a second track of an object is a duplicate": Case(
        [CAR], [cars(HERE, (2.9, 0.0), id=[5, 6])], errors([0], "track", "duplicate")
    ),
    "a third track farther away is clutter": Case(
        [CAR], [cars(HERE, (3.1, 0.0), id=[5, 6])], errors([0], "track", "clutter")
    ),
    "new objects have no track yet, and departed ones still have one": Case(
        [NOTHING] * 3 + [CAR] * 5 + [NOTHING] * 2,
        [NOTHING] * 5 + [CAR] * 5,
        errors([3, 4], "truth", "lag") + errors([8, 9], "track", "lag"),
    ),
    "an object has no track yet for a second": Case(
        [NOTHING] + [CAR] * 12,
        [NOTHING] * 13,
        errors(range(1, 11), "truth", "lag") + errors([11, 12], "truth", "occlusion or range"),
    ),
    "a track too far from its object lags, and the object is missed": Case(
        [CAR] * 12, [*[CAR] * 11, cars((5.9, 0.0), id=[1])], errors([11], "truth", "lag") + errors([11], "track", "lag")
    ),
    "one farther away is a missed object, and a track of something else": Case(
        [CAR] * 12,
        [*[CAR] * 11, cars((6.1, 0.0), id=[1])],
        errors([11], "truth", "occlusion or range") + errors([11], "track", "lag"),
    ),
    "a track of an unseen object is due to occlusion or range": Case(
        [CAR, CAR], [CAR, CAR], errors([1], "track", "occlusion or range"), points=[[50], [0]]
    ),
    "so is a track that was of it and coasts": Case(
        [CAR, CAR],
        [CAR, cars((20.0, 0.0), id=[1])],
        errors([1], "track", "occlusion or range"),
        points=[[50], [0]],
    ),
    "an object that no agent tracks is missed due to occlusion or range": Case(
        [CAR] * 12, [*[CAR] * 11, NOTHING], errors([11], "truth", "occlusion or range"), local=[*[CAR] * 11, NOTHING]
    ),
    "one that an agent tracks, due to the fusion": Case(
        [CAR] * 12, [*[CAR] * 11, NOTHING], errors([11], "truth", "fusion"), local=[CAR] * 12
    ),
    "a track of an inserted object is attributed to its adversary, others are not": Case(
        [CAR],
        [cars(HERE, (38.1, 0.0), (-40.0, 1.9), (0.0, 60.0), (42.1, 0.0), id=[5, 6, 7, 8, 9])],
        [
            *errors([0], "track", "inserted", "eve"),
            *errors([0], "track", "inserted", "mallory"),
            *errors([0, 0], "track", "clutter"),
        ],
        [*lies("inserted", [0], FAR), *lies("inserted", [0], (-40.0, 0.0), by="mallory")],
    ),
    "an object that two adversaries insert is attributed to both": Case(
        [CAR],
        [FALSE],
        errors([0], "track", "inserted", "eve+mallory"),
        [*lies("inserted", [0], FAR, by="mallory"), *lies("inserted", [0], (40.2, 0.0))],
    ),
    "of two inserted objects the nearer one is the cause": Case(
        [CAR],
        [FALSE],
        errors([0], "track", "inserted", "eve"),
        [*lies("inserted", [0], (41.0, 0.0), by="mallory"), *lies("inserted", [0], FAR)],
    ),
    "the false track of an object that ends and curves away is attributed to its adversary": Case(
        [CAR] * 30,
        [cars(HERE, (60.0 + frame, 0.5 * max(frame - 9, 0)), id=[5, 6]) for frame in range(30)],
        errors(range(30), "track", "inserted", "eve"),
        lies("inserted", range(10), lambda frame: (60.0 + frame, 0.0), (10.0, 0.0)),
    ),
    "a false track that was there before the first insertion is natural, until a second after it": Case(
        [CAR] * 20,
        [FALSE] * 20,
        errors(range(15), "track", "clutter") + errors(range(15, 20), "track", "inserted", "eve"),
        lies("inserted", range(5, 20), FAR),
    ),
    "a false track is not attributed before the first insertion": Case(
        [CAR] * 10,
        [FALSE] * 4 + [CAR] + [FALSE] * 5,
        errors(range(4), "track", "clutter") + errors(range(5, 10), "track", "inserted", "eve"),
        lies("inserted", range(5, 10), FAR),
    ),
    "an object that was missed before it was hidden is not missed because of the attack": Case(
        [CAR] * 30,
        [CAR if frame < 14 or frame == 20 else NOTHING for frame in range(30)],
        errors(range(14, 20), "truth", "occlusion or range") + errors(range(21, 28), "truth", "removed", "eve")
        + errors([28, 29], "truth", "occlusion or range"),
        lies("removed", [16, 17], (3.9, 0.0)),
    ),
    "a false track is not attributed for more than four seconds after its extrapolation": Case(
        [CAR] * 100,
        [FALSE] * 100,
        errors(range(81), "track", "inserted", "eve") + errors(range(81, 100), "track", "clutter"),
        lies("inserted", [0], FAR),
    ),
    "a false track is not attributed after it has matched a real object": Case(
        [CAR, cars(HERE, (55.0, 0.0), id=[1, 2]), CAR],
        [cars(HERE, (x, 0.0), id=[5, 6]) for x in (40.0, 55.0, 70.0)],
        errors([0], "track", "inserted", "eve") + errors([2], "track", "lag"),
        lies("inserted", [0], FAR),
    ),
    "a hidden object is missed because of the attack, for a second after it": Case(
        [CAR] * 28,
        [CAR if frame < 14 else NOTHING for frame in range(28)],
        errors(range(14, 26), "truth", "removed", "eve") + errors([26, 27], "truth", "occlusion or range"),
        lies("removed", [14, 15], (3.9, 0.0)),
    ),
    "an object is not hidden by the removal of something farther away": Case(
        [CAR] * 17,
        [CAR if frame < 14 else NOTHING for frame in range(17)],
        errors(range(14, 17), "truth", "occlusion or range"),
        lies("removed", [14, 15], (4.1, 0.0)),
    ),
    "a displaced object is a false track and a missed object": Case(
        [CAR],
        [cars((30.0, 0.5), id=[5])],
        errors([0], "truth", "moved", "eve") + errors([0], "track", "moved", "eve"),
        lies("moved", [0], (30.0, 0.0), HERE),
    ),
    "a displacement of less than half a metre is none": Case(
        [CAR], [cars((3.0, 0.0), id=[5])], errors([0], "truth", "lag") + errors([0], "track", "lag"),
        lies("moved", [0], (0.4, 0.0), HERE),
    ),
    "the track of a false object that is moved is false without the move too": Case(
        [CAR], [FALSE], errors([0], "track", "clutter"), lies("moved", [0], (41.0, 0.0), FAR)
    ),
    "a track that is as near the true position as the false one is not due to the move": Case(
        [CAR],
        [cars(HERE, (1.5, 0.0), id=[5, 6])],
        errors([0], "track", "duplicate"),
        lies("moved", [0], (3.0, 0.0), HERE),
    ),
    "an object whose track is diverted is attributed to the adversary": Case(
        [CAR] * 16,
        DIVERTED,
        [each for frame in range(12, 16) for kind in ("truth", "track") for each in
         errors([frame], kind, "inserted", "eve")],
        AWAY,
    ),
    "the track of a hidden object becomes inaccurate because of the attack": Case(
        [CAR] * 2,
        [CAR, cars((20.0, 0.0), id=[1])],
        errors([1], "truth", "removed", "eve") + errors([1], "track", "removed", "eve"),
        lies("removed", [1], HERE),
    ),
    "that of an unseen object does not": Case(
        [CAR] * 2,
        [CAR, cars((20.0, 0.0), id=[1])],
        errors([1], "track", "occlusion or range"),
        lies("removed", [1], HERE),
        points=[[50], [0]],
    ),
    "a false track at the false position of an unseen object is not due to the move": Case(
        [CAR], [cars((30.0, 0.0), id=[5])], errors([0], "track", "clutter"), lies("moved", [0], (30.0, 0.0), HERE), 0
    ),
    "there are no causes without frames": Case([], [], []),
    "there are no causes without objects": Case([NOTHING], [NOTHING], []),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_each_error_of_the_picture_has_its_cause(case: Case) -> None:
    table = explained(run_of(case.truth, case.picture, case.local, case.points), effects(*case.lies))
    assert Counter(causes(table)) == Counter(case.expected)


def test_estimates_have_their_own_causes() -> None:
    table = explained(run_of([CAR], [FALSE], local=[cars((0.1, 0.0), id=[5])]), effects())
    assert causes(table, "local") == []
    table = explained(run_of([CAR] * 12, [CAR] * 12, local=[CAR] * 11 + [cars((0.0, 40.0), id=[6])]), effects())
    assert causes(table) == []
    assert causes(table, "local") == [(11, "truth", "tracking", ""), (11, "track", "clutter", "")]


def test_the_order_of_the_effects_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    truth = [cars(*rng.uniform(-50, 50, (6, 2))) for _ in range(8)]
    picture = [cars(*rng.uniform(-50, 50, (9, 2))) for _ in range(8)]
    done = [
        (str(rng.choice(["eve", "mallory"])), int(rng.integers(8)), str(rng.choice(["inserted", "removed"])), k,
         tuple(rng.uniform(-50, 50, 2)), (1.0, 0.0))
        for k in range(40)
    ]  # fmt: skip
    one, other = (causes(explained(run_of(truth, picture), effects(*rows))) for rows in (done, done[::-1]))
    assert one == other


def test_causes_are_counted_by_estimate_in_the_scored_frames() -> None:
    picture = [FALSE if frame >= 5 else CAR for frame in range(9)]
    record = run_of([CAR] * 9, picture, local=[CAR] * 9)
    scores, _, labels, _ = labelled(record, effects(*lies("inserted", range(2, 9), FAR)))
    counted = causes_of(cause_counts(scores, labels.cause, labels.switch_cause, np.arange(8)), 8)
    by_series = dict(zip(scores.series, counted, strict=True))
    assert by_series["ego", "picture"]["causes"] == {"fp": {"inserted": 3}, "fn": {}, "id_switches": {"tracking": 1}}
    assert by_series["ego", "picture"]["fp_split"] == {"fault": 0.0, "attack": 3 / 8, "withheld": 0.0, "natural": 0.0}
    assert by_series["ego", "local"]["causes"] == {"fp": {}, "fn": {}, "id_switches": {}}


def test_an_attack_on_one_agents_detections_does_not_affect_another_agents_own_tracks() -> None:
    series = (PICTURE, LOCAL, Series("infra_1", "local"))
    record = recorded([NOTHING] * 3, dict.fromkeys(series, [cars(FAR, id=[7])] * 3), agents=["ego", "infra_1"])
    measured_effects = effects(
        *lies("inserted", range(3), FAR), passages=[passage("eve", "detections", "infra_1")], of=[0, 0, 0]
    )
    table = explained(record, measured_effects)

    def cause(agent: str, estimator: str) -> set[str]:
        return set(table["cause"][(table["agent"] == agent) & (table["estimator"] == estimator)])

    assert cause("infra_1", "local") == {"inserted"}
    assert cause("ego", "picture") == {"clutter"}  # the ego reports it too, without the attack
    assert cause("ego", "local") == {"clutter"}


CENTRE = ["picture", "picture_received", "picture_on_arrival", "mission"]


#: Agents with a centre, with peers, and with peers that relay what they hear.
OF_CENTRE = influences(["ego", "other", "infra_9"])
OF_PEERS, OF_RELAYS = (influences(["ego", "other", "third"], *maps, peers=True) for maps in ([], ["relays.toml"]))


@pytest.mark.parametrize(
    ("port", "subject", "before", "is_link", "affected", "known"),
    [
        ("broadcast", "other", "", False, CENTRE, OF_PEERS),
        ("broadcast", "other", "peer_ego", False, CENTRE, OF_PEERS),
        ("broadcast", "other", "peer_third", False, [], OF_PEERS),
        ("broadcast", "other", "peer_third", False, CENTRE, OF_RELAYS),
        ("broadcast", "ego", "peer_third", False, [], OF_RELAYS),
        ("detections", "ego", "", False, ["local", "received", *CENTRE], OF_CENTRE),
        ("pose", "other", "", True, CENTRE, OF_CENTRE),
        ("tracks", "ego", "", False, ["received", *CENTRE], OF_CENTRE),
        ("tracks", "ego", "", True, ["received"], OF_CENTRE),
        ("tracks", "other", "", False, CENTRE, OF_CENTRE),
        ("collated", "centre", "", False, CENTRE, OF_CENTRE),
        ("collated", "centre", "", True, [], OF_CENTRE),
        ("picture", "centre", "", False, CENTRE[1:], OF_CENTRE),
        ("picture", "centre", "ego", True, CENTRE[1:], OF_CENTRE),
        ("picture", "centre", "other", False, [], OF_CENTRE),
        ("mission", "ego", "", False, [], OF_CENTRE),
        ("clock", "ego", "", False, ["local", "received", *CENTRE], OF_CENTRE),
        ("of_nobody", "ego", "", False, [], OF_CENTRE),
    ],
)
def test_an_interposer_affects_the_estimates_behind_its_wire(port, subject, before, is_link, affected, known):
    """Before one peer, it affects others only through relays, and never its own agent."""
    series = [("ego", estimator) for estimator in ESTIMATORS]
    (mask,), _ = known.reach([passage("eve", port, subject, before)], series, np.array([is_link]))
    assert [estimator for estimator, each in zip(ESTIMATORS, mask, strict=True) if each] == affected


@pytest.mark.parametrize(
    ("port", "subject", "before", "relays", "frames"),
    [
        ("broadcast", "other", "", False, 1),
        ("awareness", "other", "peer_ego", True, 1),
        ("broadcast", "other", "peer_third", True, 2),
        ("detections", "other", "", False, 1),
        ("detections", "ego", "", False, 0),
    ],
)
def test_a_peer_uses_what_it_hears_a_frame_later_and_what_another_relays_two_frames_later(
    port: str, subject: str, before: str, relays: bool, frames: int
) -> None:
    series = [("ego", estimator) for estimator in ESTIMATORS]
    maps = ["awareness.toml", *["relays.toml"] * relays]
    each = [passage("eve", port, subject, before)]
    _, (of_peer,) = influences(["ego", "other", "third"], *maps, peers=True).reach(each, series, np.array([False]))
    assert dict(zip(ESTIMATORS, of_peer.tolist(), strict=True)) == {
        estimator: frames if estimator in CENTRE else 0 for estimator in ESTIMATORS
    }
    _, of_centre = influences(["ego", "other"]).reach(each, series, np.array([False]))
    assert not of_centre.any(), "a centre has no such delay"


@pytest.mark.parametrize(
    ("seen", "removed", "hidden"), [(8, 3, True), (7, 3, False), (8, 2, False)], ids=["enough", "unseen", "too few"]
)
def test_removed_detections_hide_an_object_only_from_an_agent_that_would_track_it(seen, removed, hidden):
    """Of the last second it has to see the object in most frames, and three detections make a track."""
    n = 30
    points = [[4 if n - 10 <= frame < n - seen else 5] for frame in range(n)]
    record = run_of([CAR] * n, [CAR] * n, points=points)
    done = effects(*lies("removed", [9, *range(n - removed, n)], HERE), passages=[passage("eve", "detections", "ego")])
    scores, _, _, manipulations = labelled(record, done)
    left = without_unseen(manipulations, done, scores, 5, 10)
    assert (left.object[left.frame == n - 1] >= 0).tolist() == [hidden]


def test_an_object_that_the_broker_receives_is_not_hidden_by_a_removal_before_it() -> None:
    record = run_of([CAR] * 12, [*[CAR] * 11, NOTHING], local=[CAR] * 12)
    removed = effects(*lies("removed", [11], HERE), passages=[passage("eve", "detections", "ego")])
    assert causes(explained(record, removed)) == errors([11], "truth", "fusion")


@pytest.mark.parametrize(("points", "cause"), [(4, "occlusion or range"), (5, "tracking")])
def test_an_agents_own_miss_is_due_to_its_tracking_if_its_sensor_sees_the_object(points: int, cause: str) -> None:
    own = [*[CAR] * 11, NOTHING]
    record = recorded([CAR] * 12, {LOCAL: own}, agents=["ego", "infra_1"], points=np.array([[points, 50]]))
    assert causes(explained(record, effects()), "local") == errors([11], "truth", cause)


def test_objects_moved_by_a_link_are_faults_without_an_adversary() -> None:
    moved = effects(
        *lies("moved", [0], (30.0, 0.0), HERE, by="link_1"), passages=[passage("link_1", "detections", "ego")]
    )
    table = explained(run_of([CAR], [cars((30.0, 0.5), id=[5])]), moved, {"link_1": "link"})
    assert causes(table) == [(0, "truth", "link or fault", ""), (0, "track", "link or fault", "")]


@pytest.mark.parametrize(("hidden", "cause"), [(HERE, "removed"), ((50.0, 0.0), "tracking")])
def test_an_identity_switch_after_hiding_is_attributed_to_the_adversary(hidden: Place, cause: str) -> None:
    picture = [cars(HERE, id=[5 if frame < 6 else 6]) for frame in range(12)]
    record = run_of([CAR] * 12, picture, local=[CAR] * 12)
    scores, _, labels, _ = labelled(record, effects(*lies("removed", range(4, 8), hidden)))
    assert scores.series[int(scores.switches.series[0])] == ("ego", "picture")
    assert [(int(f), int(i)) for f, i in zip(scores.switches.frame, scores.switches.truth_id, strict=True)] == [(6, 1)]
    counted = causes_of(cause_counts(scores, labels.cause, labels.switch_cause, np.arange(12)), 12)
    assert counted[0]["causes"]["id_switches"] == {cause: 1}
    assert labels.switch_by.tolist() == ["eve" if cause == "removed" else ""]


def trust(frame: int, withheld: tuple[Place, ...] = (), suspended: bool = False) -> TrustUpdate:
    """A message about trust in infra_1 and infra_2, of whom the second may be suspended."""
    n = len(withheld)
    return TrustUpdate(
        frame,
        {
            "agents": ["infra_1", "infra_2"],
            "state": np.array([1, 3 if suspended else 1], np.uint8),
            "log_odds": np.zeros(2),
            "reason": ["", ""],
            "position": np.array([(*place, 0.0) for place in withheld]).reshape(n, 3),
            "withheld": np.ones(n, np.uint8),
        },
    )


WITHHELD = [trust(frame, ((0.4, 0.0), (30.0, 0.0))) for frame in range(12)]
SUSPENDED = [trust(frame, suspended=True) for frame in range(12)]


@pytest.mark.parametrize(
    ("reporting", "updates", "cause", "by"),
    [
        (("infra_1", "infra_2"), WITHHELD, "withheld", "infra_1+infra_2"),
        (("infra_2",), SUSPENDED, "withheld", "infra_2"),
        (("infra_1", "infra_2"), SUSPENDED, "removed", "eve"),
        ((), SUSPENDED, "removed", "eve"),
    ],
    ids=["withheld", "reported by a suspended agent alone", "reported by another too", "hidden by an adversary"],
)
def test_a_missed_object_that_the_command_centre_has_is_not_attributed_to_the_attack(reporting, updates, cause, by):
    agents = ("infra_1", "infra_2")
    tracks = {Series(agent, "local"): [CAR if agent in reporting else NOTHING] * 12 for agent in agents}
    record = recorded([CAR] * 12, {PICTURE: [NOTHING] * 12} | tracks, agents=agents)
    withheld = Withheld.of(updates, agents, np.arange(12), 3)
    table = explained(record, effects(*lies("removed", range(12), (0.5, 0.0))), withheld=withheld)
    assert causes(table)[:2] == errors([0, 1], "truth", cause, by)


def test_the_defence_of_one_peer_does_not_explain_what_another_misses() -> None:
    agents = ("infra_1", "infra_2")
    local = {Series(agent, "local"): [CAR] * 12 for agent in agents}
    pictures = {Series(agent, "picture"): [NOTHING] * 12 for agent in agents}
    record = recorded([CAR] * 12, local | pictures, agents=agents)
    withheld = Withheld.of(WITHHELD, agents, np.arange(12), 3)
    table = explained(record, effects(), withheld=withheld, judged=["infra_2"])
    missed = (table["outcome"] == "missed") & (table["estimator"] == "picture")
    assert set(table["cause"][missed & (table["agent"] == "infra_2")]) == {"withheld"}
    assert "withheld" not in set(table["cause"][missed & (table["agent"] == "infra_1")])
