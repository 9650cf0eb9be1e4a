"""A compromised node of each role sends on every control key under `--secure`.

`make insiders` sends 200 messages of each kind for each node; otherwise a few are sent in fewer runs.
"""

import json
import os
from collections import Counter
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import pytest
from compromised_run import NODES, RunOutcome, play, resolved
from insider.forgeries import Forgery, all_forgeries, false_results, falsehoods, pack, refused, send
from insider.position import MARKER, Position, position

from mast_zenoh import version
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.control import flow, results
from mast_zenoh.mesh.protocol.traffic import stamp
from mast_zenoh.run_folder.recording.difference import compare

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

#: Messages of each kind that each insider sends.
COUNT = int(os.environ.get("MAST_FORGERIES", "4"))
ALL = COUNT >= 200
only_all = pytest.mark.skipif(not ALL, reason="make insiders")

#: Kinds whose refusals are counted under the key of the sending node.
COUNTED = ("counts", "failed", "result", "fetch", "file")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Resolved:
    return resolved(tmp_path_factory.mktemp("scenario"))


@pytest.fixture(scope="module")
def twin(run: Resolved, tmp_path_factory: pytest.TempPathFactory) -> Path:
    outcome = launcher.run(run, tmp_path_factory.mktemp("twin") / "run", runtime="inproc")
    assert outcome.error is None
    return outcome.folder


def at(run: Resolved, node: str) -> Position:
    return position(run, node, version.version_string())


def sending(messages: Collection[Forgery]) -> Callable[..., int]:
    return lambda session, prefix: send(session, prefix, messages)


def own(control: str, node: str, *values: Any) -> list[Forgery]:
    return [Forgery(control, f"{control}/{node}", pack(value), "false") for value in values]


def metrics(folder: Path, *without: str) -> dict[str, Any]:
    content = json.loads((folder / "metrics.json").read_text())
    return {name: part for name, part in content.items() if name not in without}


def assert_equal_to_twin(twin: Path, ended: RunOutcome, *without: str) -> None:
    """Assert that messages and metrics equal the twin's, except keys in `without`."""
    assert compare(twin, ended.folder, taps=True).first is None
    assert metrics(twin, *without) == metrics(ended.folder, *without)


def is_accepted(node: str, forgery: Forgery) -> bool:
    """Whether a forgery in a node's own name is accepted and may end the run."""
    if forgery.sender != node or refused(forgery.control, node, forgery.payload):
        return False
    if forgery.control == "counts":
        return flow.decode_counts(forgery.payload).epoch == 1
    if forgery.control == "fetch":
        return b"join" in forgery.payload
    if forgery.control == "file":
        return node == "recorder" and b"messages.mcap" in forgery.payload
    return forgery.control in ("failed", "result")


def is_refused(node: str, forgery: Forgery) -> bool:
    """Whether a refusal is counted; the router drops forgeries on foreign keys."""
    if forgery.sender != node or forgery.control not in COUNTED:
        return False
    if refused(forgery.control, node, forgery.payload) or forgery.control == "file":
        return True
    return forgery.control == "fetch" and not any(
        part in forgery.payload for part in (b"clock", b"\xadscenario.json", b"\xabwiring.json")
    )


@pytest.mark.parametrize("nodes", [(node,) for node in NODES] if ALL else [NODES], ids="+".join)
def test_forgeries_on_every_control_key_change_nothing_and_are_counted(
    run: Resolved, twin: Path, tmp_path: Path, nodes: tuple[str, ...]
) -> None:
    forged = {node: [f for f in all_forgeries(at(run, node), COUNT) if not is_accepted(node, f)] for node in nodes}
    expected = Counter(f.key for node, forgeries in forged.items() for f in forgeries if is_refused(node, f))
    outcome = play(tmp_path / "run", {node: sending(forgeries) for node, forgeries in forged.items()})
    assert (outcome.code, outcome.record["status"], outcome.message) == (0, "ok", "")
    assert outcome.refused() == dict(expected)
    assert_equal_to_twin(twin, outcome)
    assert not list(outcome.folder.rglob(f"*{MARKER}*"))
    outcome.sound()


def test_forged_failures_fail_the_run_in_the_name_of_the_forging_node(
    run: Resolved, twin: Path, tmp_path: Path
) -> None:
    values = [value for value in falsehoods("failed", at(run, "infra_1")) if value[1]["handler"] != "start"]
    outcome = play(tmp_path / "run", {node: sending(own("failed", node, *values)) for node in NODES})
    assert (outcome.code, outcome.record["status"]) == (30, "handler_failures")
    for node in NODES:
        assert f"{node}.finish failed" in outcome.message
        assert outcome.record["nodes"][node]["failures"]
    assert not any(outcome.record["nodes"][node]["failures"] for node in outcome.record["nodes"].keys() - {*NODES})
    assert_equal_to_twin(twin, outcome)
    outcome.sound()


@only_all
@pytest.mark.parametrize(
    ("node", "exception", "code"),
    [(node, "KeyError: 'forged'", 21) for node in NODES] + [("infra_1", "DiskFull: forged", 28)],
)
def test_a_node_that_claims_it_cannot_start_ends_the_run_by_name(
    run: Resolved, tmp_path: Path, node: str, exception: str, code: int
) -> None:
    values = [value for value in falsehoods("failed", at(run, node)) if value[1]["handler"] == "start"]
    (value,) = (value for value in values if value[1]["exception"] == exception)
    outcome = play(tmp_path / "run", {node: sending(own("failed", node, value))})
    assert (outcome.code, outcome.record["status"]) == (code, "failed")
    assert outcome.message.startswith(f"{node}.start failed")
    outcome.sound()


def outcomes(run: Resolved, node: str) -> list[dict[str, Any]]:
    """The false results that are accepted."""
    accepted = []
    for outcome in false_results(at(run, node)):
        if not refused("result", node, results.pack(outcome)):
            accepted.append(outcome)
    return accepted


N_RESULTS = 60
ROUNDS = range(0, N_RESULTS, len(NODES)) if ALL else (0,)


@pytest.mark.parametrize("first", ROUNDS)
def test_early_false_results_affect_only_the_node_that_sent_them(
    run: Resolved, twin: Path, tmp_path: Path, first: int
) -> None:
    """Each node delivers another one of the false results."""
    sent = {}
    for offset, node in enumerate(NODES):
        taken = outcomes(run, node)
        sent[node] = taken[(first + offset) % len(taken)]
    finished = play(tmp_path / "run", {node: sending(own("result", node, outcome)) for node, outcome in sent.items()})
    failed = sorted(node for node, outcome in sent.items() if outcome["failures"])
    if "problem" in sent["recorder"]["results"].get("recorded", {}):
        assert finished.code == 28
        assert finished.message.startswith("recorder: ")
    else:
        assert finished.code == (30 if failed else 0), finished.message
        assert all(node in finished.message for node in failed)
    assert compare(twin, finished.folder, taps=True).first is None
    late = {key: count for key, (count, _) in finished.record["invalid_control"].items()}
    assert late == {f"result/{node}": 1 for node in NODES}, "the honest nodes' results come too late"
    inside = {path.relative_to(finished.folder).parts[0] for path in finished.folder.rglob("*") if path.is_file()}
    ours = {path.relative_to(twin).parts[0] for path in twin.rglob("*") if path.is_file()}
    assert inside - ours <= {
        *("logs", "report.html", "findings.json", "figures", "results", "metrics.parquet", "checks.json")
    }
    for path in finished.folder.rglob(f"*{MARKER}*"):
        assert path.parent.parent == finished.folder / "results", "its own table"
    finished.sound()


FALSE_COUNTERS = [
    *((node, kind) for node in NODES for kind in ("foreign sent", "much handled", "much sent")),
    *((node, kind) for node in ("infra_1", "link_ego") for kind in ("foreign handled", "nothing")),
]
OVERREPORTING = ("infra_1", "much handled")


@pytest.mark.parametrize(
    ("node", "kind"),
    [case if case == OVERREPORTING else pytest.param(*case, marks=only_all) for case in FALSE_COUNTERS],
)
def test_false_counters_end_the_run_by_name_or_change_nothing(
    run: Resolved, twin: Path, tmp_path: Path, node: str, kind: str
) -> None:
    where = at(run, node)
    sent, handled = {
        "foreign sent": (where.foreign[:1] or where.subscribes[:1], ()),
        "foreign handled": ((), where.foreign[:1] or where.publishes[:1]),
        "much handled": ((), where.subscribes),
        "much sent": (where.publishes, ()),
        "nothing": ((), ()),
    }[kind]
    counts = [1, dict.fromkeys(sent, 10**9), dict.fromkeys(handled, 10**9)]
    if kind.startswith("foreign") and not (sent or handled):
        pytest.skip("every key is its own")
    outcome = play(tmp_path / "run", {}, {node: sending(own("counts", node, counts))})
    if outcome.code:
        assert outcome.code in (23, 31)
        assert outcome.record["status"] == "failed"
        assert node in outcome.message
    else:
        assert not kind.startswith("foreign")
        assert_equal_to_twin(twin, outcome)
    outcome.sound()


def publish_uncounted_message(key: str) -> Callable[..., None]:
    """A message that lock-step counts as handled but not as sent."""

    def insider(session: Any, prefix: str) -> None:
        session.put(f"{prefix}/{key}", b"\xc1", attachment=stamp(key, 1, 3))

    return insider


@only_all
@pytest.mark.parametrize("node", [node for node in NODES if node not in ("evaluator", "recorder", "counter")])
def test_a_message_missing_from_the_honest_nodes_report_ends_the_run_by_name(
    run: Resolved, tmp_path: Path, node: str
) -> None:
    outcome = play(tmp_path / "run", {node: publish_uncounted_message(at(run, node).publishes[0])})
    assert (outcome.code, outcome.record["status"]) == (31, "failed")
    assert outcome.message.startswith(f"{node} reports ")
    outcome.sound()


@only_all
@pytest.mark.parametrize("node", NODES)
def test_a_node_that_claims_another_version_fails_the_run_by_name(run: Resolved, tmp_path: Path, node: str) -> None:
    value = {"do": "join", "version": "0.0.0 (sources forged)", "versions": {}}
    outcome = play(tmp_path / "run", {node: sending(own("fetch", node, value))})
    assert (outcome.code, outcome.record["status"]) == (29, "failed")
    assert outcome.message.startswith(f"{node} runs mast-zenoh 0.0.0")
    outcome.sound()
