"""What a corpus has: commands of mast whose output tools/corpus.py keeps and compares."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import chromium

_LONGEST_S = 3600.0  # of one command
#: Exit codes from here on are of runs that failed: they are tried again. Lower ones are refusals, which are results.
_FAILED = 20


def _table(lines: str) -> dict[str, tuple[str, ...]]:
    return {name: tuple(words) for name, *words in map(str.split, lines.strip().splitlines())}


#: Settings without which a shipped scenario is refused in lock-step.
NEEDED = {"two_hosts": ("partition_s=0",)}
#: More of the shipped scenarios; attacks begin before the 60 frames are over.
VARIANTS = _table("""
congested_lied      congested n_mobile=3 n_adversaries=1 attack_start_s=2 awareness=true
cut_off_and_killed  attack_during_partition attack_start_s=1 partition_s=1.5 partition_until_s=3 kill_s=3.5
defended_collusion  defended defence=FaultOrLie attack=Collusion knowledge=trust attack_start_s=2
driven_blind        driving attack=hidden_leader attack_start_s=2 defence=FaultOrLie veto=true cars=2
driven_ghost        driving attack=ghost_ahead attack_start_s=2
linked              realistic_network attack=coordinated n_mobile=1
models              baseline agents.*.pipeline.tracker.type=InteractingModelsTracker3D
on_board            two_centres on_board=true n_adversaries=1 attack_start_s=2
peers_cpm           peers codec=cpm rules=CpmGeneration awareness=true
peers_gossip        peers gossip=true n_adversaries=1 n_slanderers=1 attack_start_s=2
peers_lied          peers n_adversaries=1 on=pair defence=FaultOrLie attack_start_s=2
peers_rumours       peers relays=true fusion=InverseCovarianceIntersectionFusion
""")
#: Played on the mesh, too: of these and of the shipped ones. A run that is intercepted live is the tenth.
ON_MESH = ("congested_lied", "cut_off_and_killed", "defended_collusion", "driven_ghost", "linked", "peers_lied")
ON_MESH += ("chaos", "two_centres")
#: Frames of the run that is intercepted live, and when the inserted node begins to lie: it has to be there by then.
LIVE_FRAMES, LIVE_START_S = 500, 40
STUDIES = _table("""
breakdown    preset=quick agents=5 shares=[0.2,0.6] scenes=intersection:8 attack_start_s=2
cooperation  preset=quick agents=5 scenes=intersection:8 attack_start_s=2
defences     defences=KOfN,FaultOrLie adversaries=coordinated,fault:pose counts=1 scenes=intersection:4 attack_start_s=2
drift        preset=quick agents=5 scenes=intersection:8 attack_start_s=2
driving      preset=quick scenes=intersection:6 defences=none,FaultOrLie
matrix       kinds=poles attack_start_s=2
monte_carlo  scenes=intersection:0,intersection:1 adversaries=[1,2] attack_start_s=2
search       candidates=4 batch=2 seeds=1 scenes=intersection:8
""")
FORMATS = ("csv", "parquet", "kitti", "mot", "openlabel", "foxglove", "rosbag2", "rrd", "pcap", "misbehaviour")
#: Of the files of some formats; the others are folders.
ENDINGS = {"csv": ".csv", "parquet": ".parquet", "foxglove": ".mcap", "rrd": ".rrd", "pcap": ".pcap"}


class Failed(Exception):
    """A command failed, so its entry has to be made again; the message says which, and how."""


def start(tree: Path, folder: Path, *arguments: str, **options: Any) -> subprocess.Popen[str]:
    """Python in a folder, with the package of a checkout; its output is a pipe."""
    path = os.pathsep.join(map(str, [tree, *(tree / "plugins").glob("*")]))
    plain = {"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1", "LC_ALL": "C.UTF-8", "PYTHONPATH": path}
    pipes: dict[str, Any] = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.STDOUT,
    } | options
    return subprocess.Popen((sys.executable, *arguments), cwd=folder, env=os.environ | plain, text=True, **pipes)


def ask(tree: Path, folder: Path, words: Iterable[str]) -> tuple[int, str]:
    """(exit code, output) of `mast`."""
    with start(tree, folder, "-m", "mast_zenoh", *words) as process:
        try:
            output, _ = process.communicate(timeout=_LONGEST_S)
        finally:
            process.terminate()
    return process.returncode, output


def note(folder: Path, command: str, code: int, output: str) -> int:
    """The exit code, after appending command and output to output.txt; raises Failed."""
    with (folder / "output.txt").open("a") as file:
        file.write(f"$ mast {command}\n{output}\n")
    if not 0 <= code < _FAILED:
        raise Failed(f"exit code {code}: mast {command}\n{output[-2000:]}")
    return code


#: Makes an entry with a checkout, in a folder; returns exit codes.
Maker = Callable[[Path, Path], list[int]]


def commands(*several: str) -> Maker:
    """Makes an entry by commands of `mast`, one after another."""
    return lambda tree, folder: [note(folder, words, *ask(tree, folder, words.split())) for words in several]


def played(scenario: str, *settings: str, place: str = "inproc", seed: int = 1, frames: int = 60) -> str:
    """The command for a run in lock-step, recorded, into the folder `run`."""
    sets = " ".join(f"--set {setting}" for setting in ("run.record=true", *settings))
    return f"run {scenario} {sets} --runtime {place} --mode lockstep --frames {frames} --seed {seed} --out run"


def helps(tree: Path, folder: Path) -> list[int]:
    """The help of every command, each in a file."""
    waiting: list[tuple[str, ...]] = [()]
    for words in waiting:
        code, text = ask(tree, folder, (*words, "--help"))
        if code:
            raise Failed(f"exit code {code}: mast {' '.join(words)} --help\n{text}")
        (folder / f"{'.'.join(('mast', *words))}.txt").write_text(text)
        waiting += [(*words, name) for name in re.findall(r"(?m)^│ ([a-z]\w*) ", text.partition("─ Commands ─")[2])]
    return [0]


_LISTED = """
import json, sys, mast_zenoh as mast
kinds = {kind: mast.list(kind) for kind in sys.argv[1:]}
print(json.dumps({kind: {name: str(of[name]).splitlines() for name in of.names} for kind, of in kinds.items()}))
"""


def listing(tree: Path, folder: Path) -> list[int]:
    """`mast list` as JSON: lines by kind and name."""
    kinds = re.findall(r"(?m)^(\w+): ", ask(tree, folder, ["list"])[1])
    with start(tree, folder, "-c", _LISTED, *kinds, stderr=None) as process:
        (folder / "list.json").write_text(json.dumps(json.loads(process.communicate()[0]), indent=1))
    return [0]


def intercepted(tree: Path, folder: Path) -> list[int]:
    """A run on the mesh into which a liar is inserted; its lies begin later, so they do not depend on when that is."""
    playing = played("baseline", place="mesh", frames=LIVE_FRAMES)
    lies = f"--with Overconfidence --name mallory --set attack.start_s={LIVE_START_S}"
    inserting = f"intercept run --wire agent/infra_2/tracks {lies}"
    code, inserted = 1, ""
    with (folder / "running.log").open("w+") as log:
        process = start(tree, folder, "-m", "mast_zenoh", *playing.split(), stdout=log)
        try:
            while code and process.poll() is None:
                code, inserted = ask(tree, folder, inserting.split())
            process.wait(_LONGEST_S)
        finally:
            process.terminate()
        log.seek(0)
        codes = [note(folder, playing, process.wait(), log.read()), note(folder, inserting, code, inserted)]
    frame = re.search(r"from frame (\d+) on", inserted)
    if frame is None or int(frame[1]) >= LIVE_START_S * 10:
        raise Failed(f"the node was inserted too late: {inserted}")
    return codes


def pictured(source: Path, tree: Path, folder: Path) -> list[int]:
    """Pictures of an entry's pages, and of its run in the viewer, whose text is kept, too."""
    with chromium.browser() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        for file in sorted(source.rglob("*.html")):
            page.goto(file.resolve().as_uri())
            page.screenshot(path=str(folder / f"{'.'.join(file.relative_to(source).parts)}.png"), full_page=True)
        if (source / "run" / "run.json").is_file():
            with start(tree, folder, *f"-m mast_zenoh view {source / 'run'} --frame 45".split()) as process:
                try:
                    lines = iter(process.stdout or ())
                    page.goto(next(found[0] for line in lines if (found := re.search(r"http://\S+", line))))
                    page.wait_for_selector(".viewer.v-ready", timeout=120_000)
                    (folder / "view.txt").write_text(page.inner_text("body"))
                    page.screenshot(path=str(folder / "view.png"))
                finally:
                    process.terminate()
    return [0]


def entries(tree: Path) -> dict[str, Maker]:
    """Everything but pictures, by name."""
    made: dict[str, Maker] = {"help": helps, "list": listing, "mesh/intercepted": intercepted}
    for name in sorted(file.stem for file in (tree / "scenarios").glob("*.py")):
        for seed in (1, 2):
            made[f"inproc/{name}-{seed}"] = commands(played(name, *NEEDED.get(name, ()), seed=seed))
    made |= {f"inproc/{name}": commands(played(*words)) for name, words in VARIANTS.items()}
    made |= {f"mesh/{name}": commands(played(*VARIANTS.get(name, (name,)), place="mesh")) for name in ON_MESH}
    attacked = played("uncoordinated", "attack_start_s=2")
    made["mesh/secured"] = commands(f"{attacked} --runtime mesh --secure")
    made["inproc/with_twin"] = commands(f"{attacked} --against twin")
    made["inproc/replayed"] = commands(attacked, "replay run --runtime inproc --out again")
    for name, settings in STUDIES.items():
        sets = " ".join(f"--set {setting}" for setting in settings)
        made[f"studies/{name}"] = commands(f"study {name} --trials 3 --frames 60 --jobs 1 {sets} --out study")
    made["studies/once"] = commands("study case_study --frames 60 --runtime inproc --record --out study")
    exports = [f"export run --to {name} -o export_{name}{ENDINGS.get(name, '')}" for name in FORMATS]
    stills = ("snapshot run -o still.svg", "animate run -o film.gif --from 40 --to 44")
    made["exports/centre"] = commands(attacked, *exports, *stills)
    made["exports/peers"] = commands(played("peers", "codec=cpm", "defence=FaultOrLie", "n_adversaries=1"), *exports)
    scene = ("check intersection:3", "convert intersection:3 scene.npz", "detections intersection:3 kitti")
    made["exports/scene"] = commands(*(f"scene {words}" for words in scene))
    return made
