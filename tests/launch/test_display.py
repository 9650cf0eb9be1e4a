"""What a terminal shows of a run fits it, and is measured."""

import itertools
from io import StringIO

import pytest
import zenoh
from drawn_statuses import console, drawn_statuses, evaluated
from rich.console import Console

from mast_zenoh import scenario
from mast_zenoh.launch import display, observation, run
from mast_zenoh.launch.display import Display
from mast_zenoh.launch.observation import Activities, Activity, NewestScore, Status, watched_keys
from mast_zenoh.mesh.protocol.traffic import stamp
from mast_zenoh.wiring.model import Wiring

DASH = "\u2013"
SCORE = NewestScore("ego", 99, 3, 12, 27, 0.345, 12.4)


def shown(status: Status, width: int, height: int = 24, title: str = "a_run") -> list[str]:
    """The lines of the live table."""
    return [line.plain for line in Display(console(width), title, 500).lines(status, width, height)]


def status(n: int, **changes: object) -> Status:
    """A run of n nodes, all of them running."""
    names = ["simulator", "command_center", *(f"infra_{k}" for k in range(n - 2))]
    active = {name: Activity(1234.5, 1, 0) for name in names}
    return Status(123, dict.fromkeys(names, "running"), active, ["attack: X adversary_1"], SCORE)._replace(**changes)


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("n", [3, 13, 30, 60])
def test_the_table_fits_the_terminal_and_names_every_node_or_counts_those_left_out(width: int, n: int) -> None:
    long = status(n, events=[f"fault: HostPartition {'infra_1, ' * 20}"] * 9)
    lines = shown(long, width, title="attack_during_partition_with_a_long_name")
    assert max(map(len, lines)) <= width
    assert len(lines) <= 24
    text = "\n".join(lines)
    named = sum(f"{name} " in text for name in long.states)
    left_out = next((int(line.split()[1]) for line in lines if line.startswith("and ") and "events" not in line), 0)
    assert named + left_out == n
    assert (named == n) == (n <= 13 or (width > 60 and n == 30))
    assert "7 more events" in text
    assert "matched 27, RMSE" in " ".join(text.split())


def test_of_many_nodes_those_with_something_to_see_are_shown() -> None:
    many = status(60)
    states, active = dict(many.states), dict(many.activities)
    states["infra_50"] = "dead"
    active["infra_51"], active["infra_52"] = Activity(5.0, 40, 0), Activity(5.0, 0, 123456)
    lines = shown(many._replace(states=states, activities=active), 60)
    rows = {line.split()[0]: line.split()[1:] for line in lines}
    assert rows["infra_50"][0] == "dead"
    assert rows["infra_51"] == ["running", "5.0", "40", "0"]
    assert rows["infra_52"] == ["running", "5.0", "0", "123k"]


def test_what_is_not_known_is_a_dash() -> None:
    lines = shown(status(3, activities={}, score=None, events=()), 80)
    assert lines[2].split() == ["simulator", "running", *3 * [DASH]]
    assert lines[-1] == f"picture: missed {DASH}, false {DASH}, matched {DASH}"


def test_without_a_terminal_there_are_four_lines_and_with_quiet_none() -> None:
    for quiet, expected in ((False, [f"a_run: frame {n} of 40" for n in (10, 20, 30, 40)]), (True, [])):
        file = StringIO()
        with Display(Console(file=file, width=80), "a_run", 40, quiet=quiet) as plain:
            for frame in range(60):  # a simulator of the user may play more than planned
                plain.update(frame, lambda: pytest.fail("nothing is computed"))
        assert [line.strip() for line in file.getvalue().splitlines()] == expected


def test_without_a_terminal_there_is_a_line_every_minute_of_a_slow_run_and_of_the_nodes_that_an_end_waits_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(display.time, "monotonic", lambda: now)
    slow, out = StringIO(), StringIO()
    with Display(Console(file=slow, width=80), "a_run", 10**9) as plain:
        for frame in range(1400):
            now = 0.1 * frame
            plain.update(frame, lambda: pytest.fail("nothing is computed"))
    assert slow.getvalue().splitlines() == ["a_run: frame 601 10/s", "a_run: frame 1201 10/s"]
    now = 0.0
    with Display(Console(file=out, width=80), "a_run", 8) as drawn:
        drawn.update(8, lambda: status(3))
        before = out.getvalue()
        for seconds in range(2, 90):
            now = float(seconds)
            drawn.update(8, lambda: status(3), f"evaluator: finishing, {seconds} s")
    assert out.getvalue() == f"{before}a_run: evaluator: finishing, 2 s\na_run: evaluator: finishing, 62 s\n"


def test_the_table_is_drawn_at_most_four_times_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    times = itertools.count(100.0, 0.001)
    monkeypatch.setattr(display.time, "monotonic", lambda: next(times))
    drawn: list[int] = []
    with Display(console(80), "a_run", 500) as live:
        for frame in range(1000):
            live.update(frame, lambda frame=frame: drawn.append(frame) or status(30))
    assert 3 <= len(drawn) <= 5


class Ring:
    """A session, and the ring of each of its subscribers."""

    def __init__(self) -> None:
        self.samples: dict[str, list[bytes | None]] = {}

    def declare_subscriber(self, key: str, handler: object) -> object:
        samples = self.samples.setdefault(key, [])

        class Subscriber:
            def try_recv(self) -> object:
                return Sample(samples.pop(0)) if samples else None

            def undeclare(self) -> None:
                samples.append(b"undeclared")

        return Subscriber()


class Sample:
    def __init__(self, attachment: bytes | None) -> None:
        self.attachment = None if attachment is None else zenoh.ZBytes(attachment)


def wiring_of(name: str, *settings: str) -> Wiring:
    return Wiring.from_json(scenario.resolve(*scenario.load(name, settings), frames=2).wiring)


def test_frames_without_a_message_are_counted_and_forged_stamps_are_not_believed() -> None:
    ring, frame = Ring(), [0]
    activities = Activities(ring, "mast/r", wiring_of("baseline", "n_infrastructure=1"), lambda: frame[0])
    tracks = ring.samples["mast/r/agent/ego/tracks"]

    def arrive(now: int, *steps: int) -> Activity:
        frame[0] = now
        tracks.extend(stamp("agent/ego/tracks", 1, step) for step in steps)
        activities.read()
        return activities.of("ego")

    assert activities.of("ego") == Activity()
    assert arrive(3, 3)[1:] == (0, 0)
    assert arrive(6, 4, 5, 6)[1:] == (0, 0)
    assert arrive(10, 8, 8, 10)[1:] == (0, 2)
    assert arrive(12)[1:] == (2, 2)
    tracks.extend([None, b"short", b"XXXX" + bytes(12)])
    assert arrive(14, 1 << 40, 13, 2)[1:] == (1, 4)
    assert arrive(114, *range(50, 114))[1:] == (1, 4), "more than the ring holds: nobody knows what is missing"
    assert activities.of("evaluator") == Activity(), "it sends nothing"
    activities.close()
    assert tracks == [b"undeclared"]


def test_a_leg_before_an_adversary_is_heard_only_where_a_node_sends_nothing_else_in_every_frame() -> None:
    keys = watched_keys(wiring_of("coordinated", "n_adversaries=1"))
    assert keys["adversary_1"] == ("agent/infra_1/tracks", True)
    assert keys["infra_1"] == ("agent/infra_1/tracks/@tap/0", True)
    assert keys["simulator"] == ("clock", True)
    assert [key for key, _ in keys.values() if "@tap" in key] == ["agent/infra_1/tracks/@tap/0"]


def test_current_events_are_those_of_the_timeline_and_interceptions_those_that_last() -> None:
    resolved = scenario.resolve(*scenario.load("coordinated", ("attack_start_s=0.5",)), frames=20)
    assert observation.current_events(resolved, -1) == observation.current_events(resolved, 4) == []
    assert [event["type"] for event in observation.current_events(resolved, 5)] == ["CoordinatedAttack"]
    changes = [
        {"action": "intercept", "node": "eve_1", "wires": ["cc/picture"]},
        {"action": "intercept", "node": "eve_2", "wires": ["agent/ego/tracks"]},
        {"action": "release", "node": "eve_1", "wires": ["cc/picture"]},
    ]
    assert observation.interceptions(changes) == ["interception: eve_2 on agent/ego/tracks"]
    assert observation.interceptions([*changes, {"action": "heal", "node": "eve_2", "wires": []}]) == []


def test_the_score_on_the_terminal_is_that_of_the_evaluator(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    drawn = drawn_statuses(monkeypatch)
    resolved = scenario.resolve(*scenario.load("coordinated", ("attack_start_s=0.4",)), frames=12)
    ended = run.run(resolved, tmp_path / "run", runtime="inproc", console=console(80))
    assert ended.error is None
    scores = {each.score.frame: each.score[2:5] for each in drawn if each.score is not None}
    assert scores == evaluated(ended.folder)
    assert len(scores) == 12
    assert max(sum(counts) for counts in scores.values()) > 10
    assert drawn[-1].states["adversary_1"] == "attack"
    assert drawn[-1].frame == 12
