"""Code blocks of all pages are run, checked, or marked as output.

text, mermaid          output and diagrams
console                commands of `mast`: parsed by the command line itself
toml, json             parsed
python                 run below, by page
python file=…          files of walk-throughs, run by separate tests
python illustration    needs more than a test machine has: only compiled
"""

import ast
import json
import re
import shlex
import socket
import threading
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import typer
from mast_ros2.type_store import decode
from ros2_keys import parse_data_key

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.arrays.states import Detections, ObjectStates
from mast_zenoh.cli.app import app
from mast_zenoh.config import registry
from mast_zenoh.faults import Fault
from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.session import open_client
from mast_zenoh.study import definition
from mast_zenoh.study.search import searching
from mast_zenoh.tracking import SensorView

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("results/*.md")]
)
KINDS = ("text", "mermaid", "console", "toml", "json", "python")


class Block(NamedTuple):
    """A fenced block: its page, language, text after the language, and content."""

    page: str
    language: str
    mark: str
    content: str


def blocks_of(path: Path) -> list[Block]:
    """All fenced blocks of a page; a fence without a language fails."""
    text = path.read_text(encoding="utf-8")
    fences = re.findall(r"^```([^\n]*)\n(.*?)^```$", text, flags=re.S | re.M)
    assert 2 * len(fences) == len(re.findall(r"^ *```", text, flags=re.M)), f"{path.name}: a fence that is not closed"
    return [Block(path.name, *head.partition(" ")[::2], content) for head, content in fences]


BLOCKS = [block for path in PAGES for block in blocks_of(path)]


def blocks(language: str, mark: str = "") -> list[Block]:
    return [block for block in BLOCKS if block.language == language and block.mark.startswith(mark)]


def test_every_block_declares_its_language() -> None:
    for block in BLOCKS:
        assert block.language in KINDS, f"{block.page}: a block of the language {block.language!r}\n{block.content}"


# -- commands ----------------------------------------------------------------------------------------------------------

COMMANDS = [
    (path.name, line.strip())
    for path in PAGES
    for line in re.findall(r"^(?:\$|   ) (mast .*)$", path.read_text(encoding="utf-8"), flags=re.M)
    if not any(line in block.content for block in blocks("text"))
]


def check_command(command: str, group: Any) -> None:
    """Raise UsageError for a command that the command line, a group of commands, does not know as it is written."""
    words = shlex.split(command, comments=True)[1:]
    words = words[: next((k for k, word in enumerate(words) if word in ("||", "&&", "|", ">", "&")), len(words))]
    context = group.make_context("mast", [], resilient_parsing=True)
    while hasattr(group, "commands"):
        name = words.pop(0)
        assert name in group.commands, f"mast has no command {name}"
        group = group.commands[name]
    group.make_context(command, words, parent=context)


def test_commands_have_options_and_arguments_known_to_the_command_line() -> None:
    assert len(COMMANDS) > 100
    failures, root = [], typer.main.get_command(app)
    for page, command in COMMANDS:
        try:
            check_command(command, root)
        except Exception as error:  # Typer brings its own classes of usage errors
            failures.append(f"{page}: {command}: {error}")
    assert not failures, "\n".join(failures)


def test_a_console_block_contains_only_commands() -> None:
    for block in blocks("console"):
        for line in block.content.splitlines():
            assert line.startswith("$ "), f"{block.page}: {line}"


# -- data --------------------------------------------------------------------------------------------------------------


def test_data_blocks_can_be_parsed() -> None:
    for block in (*blocks("toml"), *blocks("json")):
        assert (tomllib.loads if block.language == "toml" else json.loads)(block.content), block


# -- Python ------------------------------------------------------------------------------------------------------------


def executed(block: Block, **names: Any) -> dict[str, Any]:
    """The names defined by a block; `_` is the value of its last expression."""
    tree = ast.parse(block.content, block.page)
    if isinstance(last := tree.body[-1], ast.Expr):
        tree.body[-1] = ast.copy_location(ast.Assign([ast.Name("_", ast.Store())], last.value), last)
    # registered as a module, so that classes of the block can be built
    space = {"__name__": __name__, **names}
    exec(compile(ast.fix_missing_locations(tree), block.page, "exec"), space)
    return space


def resolved(part: dict[str, Any]) -> Any:
    """A scenario with this part, resolved."""
    path, content = scenario.load("baseline")
    return scenario.resolve(path, content | part, frames=120)


def part_of_a_scenario(block: Block, folder: Path) -> None:
    resolved(executed(block)["_"])


def whole_scenario(block: Block, folder: Path) -> None:
    (folder / "mine.py").write_text(block.content)
    path, content = scenario.load(str(folder / "mine.py"))
    assert scenario.resolve(path, content, frames=40).nodes


def played_scenario(block: Block, folder: Path) -> None:
    (folder / "mine.py").write_text(block.content)
    path, content = scenario.load(str(folder / "mine.py"))
    run = launcher.run(scenario.resolve(path, content, frames=14), folder / "played", runtime="inproc")
    assert run.error is None


def random_faults(block: Block, folder: Path) -> None:
    assert all(registry.build(fault, Fault, "faults") for fault in executed(block)["faults"])


def draws_of_the_authors_software(block: Block, folder: Path) -> None:
    (comment,) = re.findall(r"# (\[.*\])$", block.content, flags=re.M)
    assert executed(block)["_"] == ast.literal_eval(comment)


def results_of_a_node(block: Block, folder: Path) -> None:
    node = SimpleNamespace(seen=[1, 2], frames=np.arange(2), counts=np.ones(2))
    assert executed(block)["finish"](node, None)["frames"] == 2


def messages_of_a_run(block: Block, folder: Path) -> None:
    path, content = scenario.load("baseline", ["n_infrastructure=1"])
    settled = scenario.resolve(path, content, frames=3, record=True)
    run = launcher.run(settled, folder / "run", runtime="inproc")
    printed: list[Any] = []
    content_ = block.content.replace("messages.mcap", str(run.folder / "messages.mcap"))
    executed(block._replace(content=content_), print=lambda *words: printed.append(words))
    assert len(printed) == 6  # two agents, three frames


def study_of_ones_own(block: Block, folder: Path) -> None:
    (folder / "mine.py").write_text(block.content.replace("avstack:PATH", "intersection:1"))
    study = definition.load(str(folder / "mine.py"), ["n=3"])
    assert (study.trials, len(study.scenes), len(study.configurations)) == (20, 2, 4)


def kind_of_ones_own(block: Block, folder: Path) -> None:
    (folder / "mine.py").write_text(block.content)
    finished = mast.study(folder / "mine.py", trials=1, frames=5, poles=(1, 2), jobs=1, out=folder / "study")
    assert (finished.path / "misses.md").read_text().splitlines()[-1].startswith("| 2 | ")


def attempts_of_ones_own(block: Block, folder: Path) -> None:
    (folder / "mine.py").write_text(block.content)
    study = definition.load(str(folder / "mine.py"))
    assert (study.security, [attempt.shows for attempt in study.attempts]) == (("open", "acl"), ["nothing", "infra_1"])


def study_with_a_search(block: Block, folder: Path) -> None:
    (folder / "mine.py").write_text(block.content.replace("frames=130", "frames=20"))
    study = definition.load(str(folder / "mine.py"), ["budget=3.0"])
    assert (study.search.run, list(study.search.space)[2:], study.trials) == (
        "colluding",
        ["n_adversaries", "placement"],
        20,
    )
    searching.check_ranges(study)


def tracking_by_hand(block: Block, folder: Path) -> None:
    place = np.array([[20.0, 0.0, 0.8]])
    size, zero = np.array([[4.5, 1.8, 1.5]]), np.zeros(1)
    detections = Detections(place, size, zero, zero + 0.9, np.ones(1, np.uint8), np.zeros((1, 3, 3)))
    view = SensorView(np.zeros(3), np.eye(3), -np.pi, np.pi, -1.0, 1.0, 60.0)
    all_tracks = ObjectStates.of(place, size=size, covariance=np.eye(9)[None])
    names = executed(
        block,
        time_ns=0,
        detections=detections,
        view=view,
        all_tracks=all_tracks,
        agent=zero.astype(int),
        agents=("ego",),
    )
    assert names["tracker"].matched.tolist() == [-1] or len(names["tracker"].matched) <= 1
    assert len(names["picture"]) == len(names["support"])


def simulated_run(block: Block, folder: Path) -> None:
    printed: list[Any] = []
    fewer = block.content.replace("schedules=20", "schedules=2").replace("range(20)", "range(2)")
    names = executed(block._replace(content=fewer), print=printed.append)
    for test in [value for name, value in names.items() if name.startswith("test_")]:
        test()
    for events, comment in zip(printed, re.findall(r"^print\(.*?\)  # (.*)$", block.content, flags=re.M), strict=True):
        assert events == ast.literal_eval(comment)


def router_of_ros(block: Block, folder: Path) -> None:
    """Two clients hear each other through the router while it waits for Enter."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    heard = threading.Event()

    def wait(prompt: str) -> str:
        with open_client(endpoint) as hearing, open_client(endpoint) as speaking:
            hearing.declare_subscriber("0/mast/picture", lambda sample: heard.set())
            for _ in range(100):  # until the subscription has reached the router
                speaking.put("0/mast/picture", b"objects")
                if heard.wait(0.3):
                    break
        return ""

    executed(block._replace(content=block.content.replace("tcp/[::]:7447", endpoint)), input=wait)
    assert heard.is_set()


def message_of_ros(block: Block, folder: Path) -> None:
    names = executed(block)
    key = parse_data_key(names["key"])
    assert (key.domain, key.topic) == (0, "/mast/picture")
    assert decode(key.type_name, names["payload"]).header.frame_id == "map"


def points_of_a_scan(block: Block, folder: Path) -> None:
    names = executed(block)
    assert 0 < (names["source"] == 0).sum() < len(names["points"])


#: By page the function that runs its Python blocks in order; None: another test runs them.
RUN: dict[str, list[Callable[[Block, Path], None] | None]] = {
    "explanation-determinism.md": [simulated_run] * 3,
    "explanation-driving.md": [whole_scenario, played_scenario],
    "explanation-metrics-and-causes.md": [None],  # test_facts_of_pages.py
    "explanation-points.md": [points_of_a_scan],
    "explanation-security.md": [attempts_of_ones_own],
    "explanation-threat-model.md": [draws_of_the_authors_software],
    "explanation-tracking-and-fusion.md": [tracking_by_hand, whole_scenario],
    "explanation-v2x.md": [whole_scenario],
    "how-to-export.md": [None],  # test_export_labels.py
    "how-to-hosts.md": [whole_scenario],
    "how-to-python.md": [None] * 13,  # test_page_examples.py
    "how-to-record-and-replay.md": [messages_of_a_run],
    "how-to-ros2.md": [router_of_ros, part_of_a_scenario, message_of_ros],
    "how-to-scenarios.md": [
        whole_scenario,
        part_of_a_scenario,
        None,  # test_page_examples.py
        part_of_a_scenario,
        random_faults,
        results_of_a_node,
    ],
    "how-to-sensors.md": [None] * 3,  # test_page_examples.py
    "how-to-studies.md": [study_of_ones_own, kind_of_ones_own, study_with_a_search],
    "ref-detections-and-arrays.md": [None] * 2,  # test_page_examples.py
}


#: Pages whose files are run by tests of their own.
_WALK_THROUGHS = """
    how-to-export how-to-intercept how-to-record-and-replay how-to-ros2 how-to-stone-soup how-to-write-a-part
    tutorial-defence tutorial-driving tutorial-first-attack tutorial-own-data tutorial-own-detector
"""
WALK_THROUGHS = [f"{name}.md" for name in _WALK_THROUGHS.split()]


def test_every_python_block_is_run_by_a_test() -> None:
    for path in PAGES:
        plain = [block for block in blocks("python") if block.page == path.name and not block.mark]
        assert len(plain) == len(RUN.get(path.name, [])), f"{path.name}: say in RUN how its Python blocks are run"
    for block in blocks("python", "file="):
        assert block.page in WALK_THROUGHS, f"{block.page}: no test runs this file"


@pytest.mark.parametrize("page", RUN)
def test_python_blocks_of_a_page_run(page: str, tmp_path: Path) -> None:
    plain = [block for block in blocks("python") if block.page == page and not block.mark]
    for block, run in zip(plain, RUN[page], strict=True):
        if run is not None:
            run(block, tmp_path)


def test_illustrations_compile() -> None:
    for block in blocks("python", "illustration"):
        compile(block.content, block.page, "exec")
