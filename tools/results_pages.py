"""The pages of docs/results/: their questions, and the studies that answer them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.study.choices import junctions

#: Scores of the ego's picture, and what an attack adds to them: columns of tables by heading, estimator and metric.
_SCORES = {
    "missed": ("picture", "fn"),
    "false": ("picture", "fp"),
    "RMSE m": ("picture", "rmse_m"),
    "ID switches": ("picture", "id_switches"),
}
_ADDED = {
    "false objects added": ("picture", "fp_iob"),
    "missed objects added": ("picture", "fn_iob"),
    "mission estimate: false added": ("mission", "fp_iob"),
    "mission estimate: missed added": ("mission", "fn_iob"),
    "RMSE added m": ("picture", "rmse_m_iob"),
}


@dataclass(frozen=True)
class Part:
    """A study, and what a page shows of it.

    title:      of its section
    study:      its name;  full, quick: arguments of `mast study`: `trials`, `frames`, `seed`, or of its function
    figure:     one that the study writes
    table:      the title of one of its kind's tables; "": of `columns`, a line for each configuration
    columns:    by heading, estimator and metric of the ego
    measures:   of the kind's rows, which the CSV keeps; (): all
    paths:      arguments that are scenes of files below $MAST_DATA: without these the page stays as it is
    """

    title: str
    study: str
    full: Mapping[str, Any]
    quick: Mapping[str, Any]
    figure: str = "increments"
    table: str = ""
    columns: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    measures: tuple[str, ...] = ()
    paths: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Benchmark:
    """A program that writes values by what they are of, and what a page says of it.

    title: of its section;  about: below its table;  program: its file, from the top;  full, quick: its options
    heading: of the column of medians
    """

    title: str
    about: str
    program: str
    full: tuple[str, ...]
    quick: tuple[str, ...]
    heading: str
    path: str = ""


@dataclass(frozen=True)
class Page:
    """A page of docs/results/. name: of its file;  question: what it answers"""

    name: str
    title: str
    question: str
    parts: tuple[Part | Benchmark, ...]


#: A recorded town: Argoverse 2, and the scene of the paper.
_LOG = "av2_logs/3bffdcff-c3a7-38b6-a0f2-64196d130958"

#: A third of the junctions of the study `driving`: all of them take an hour on two cores.
_DRIVEN = ",".join(f"intersection:{index}" for index in (5, 8, 13, 14, 15, 16, 17, 19, 20, 21))

PAGES = (
    Page(
        "attacks",
        "What attacks add",
        "How many false and missed objects does each shipped attack cause, if nothing defends the picture?",
        (
            Part(
                "Attacks",
                "attacks",
                full=dict(trials=30),
                quick=dict(
                    trials=5,
                    shapes="victim_only,only_hidden,only_moved",
                    paper=(2,),
                    attacks="BlindSpot,OpenDispute,Collusion,Flood,Framing,SlowDrift",
                ),
                columns=_ADDED,
            ),
        ),
    ),
    Page(
        "defences",
        "What defences are worth",
        "What does each defence make of each attack, and what is left to liars that know how they are judged?",
        (
            Part(
                "Every defence against every attack",
                "matrix",
                full=dict(preset="scoreboard", trials=5),
                quick=dict(defences="FaultOrLie", adversaries="OpenDispute", kinds="poles", trials=5),
                figure="defence_matrix",
                table="Scoreboard",
                measures=("damage", "harm", "by_attack"),
            ),
            Part(
                "Liars that know the defence",
                "defences",
                full=dict(
                    preset="adaptive",
                    counts=(2,),
                    placements="random",
                    budgets=(2.0,),
                    scenes=junctions(8, 12),
                    frames=100,
                ),
                quick=dict(
                    preset="adaptive",
                    adversaries="BlindSpot",
                    counts=(2,),
                    placements="random",
                    budgets=(2.0,),
                    scenes=junctions(8, 12),
                    trials=1,
                    frames=100,
                ),
                figure="defence_matrix",
                table="Damage, random",
                measures=("damage", "fn_added", "fp_added", "framed", "lies_detected"),
            ),
        ),
    ),
    Page(
        "delay-and-faults",
        "Late messages and faults",
        "What do late messages and natural faults cost, without an attack?",
        (
            Part(
                "Delay",
                "delay",
                full=dict(trials=40, scenes="", frames=100, seed=40),
                quick=dict(trials=5, scenes="", frames=100, seed=40, delays_s=(0.0, 0.5, 1.0)),
                columns=_SCORES,
            ),
            Part("Faults", "faults", full=dict(trials=30), quick=dict(trials=5), columns=_SCORES | _ADDED),
        ),
    ),
    Page(
        "cooperation",
        "Fusion without a centre, and standard messages",
        "Does fusion without a centre protect from lies, and what do standard V2X messages cost?",
        (
            Part(
                "Architectures under equal lies",
                "cooperation",
                full=dict(preset="full", agents=(5,), scenes=junctions(8, 12), trials=3),
                quick=dict(
                    agents=(5,), architectures="centre,radio", scenes=junctions(8, 12), trials=1, preset="quick"
                ),
                figure="cooperation",
                table="Lies",
            ),
            Part(
                "Limits of standard messages",
                "messages",
                full=dict(trials=20, scenes=0, frames=100, seed=40),
                quick=dict(trials=5, scenes=0, frames=100, seed=40),
                columns=_SCORES,
            ),
            Part(
                "Ways to fuse tracks",
                "fusion",
                full=dict(trials=20),
                quick=dict(trials=5, fusions="ci,ici,naive"),
                columns=_SCORES,
            ),
        ),
    ),
    Page(
        "driving",
        "What attacks do to a car",
        "What happens to a car that drives by an attacked picture, and what do defences and its own sensors spare it?",
        (
            Part(
                "Attacks and defences",
                "driving",
                full=dict(preset="full", scenes=_DRIVEN),
                quick=dict(
                    preset="full",
                    attacks="phantom_queue@picture",
                    defences="none,veto",
                    scenes="intersection:5,intersection:8,intersection:13,intersection:14,intersection:15",
                ),
                figure="driving",
                table="What the attack adds to what the car did",
            ),
        ),
    ),
    Page(
        "sensing",
        "How far attacks on a lidar get",
        "How far do attacks on a lidar get, from their points to the brake of the car, and what do checks change?",
        (
            Part(
                "Links of the chain",
                "sensing",
                full=dict(preset="hour"),
                quick=dict(preset="quick", trials=5),
                figure="sensing",
                table="Links of the chain",
            ),
        ),
    ),
    Page(
        "posepert",
        "Perturbed poses",
        "What do perturbed poses do to a car, beside what PosePert and its authors' repetition report?",
        (
            Part(
                "Theirs and ours",
                "posepert",
                full=dict(preset="full"),
                quick=dict(preset="quick", defences="none", trials=5),
                figure="posepert",
                table="Theirs and ours",
            ),
        ),
    ),
    Page(
        "real-data",
        "Recorded and simulated traffic",
        "What do attacks do on recorded traffic, and how real are generated junctions and their detections?",
        (
            Part(
                "Attacks on an Argoverse 2 log",
                "monte_carlo",
                full=dict(trials=20, frames=80),
                quick=dict(trials=5, adversaries=(2,), frames=80),
                columns=_SCORES | _ADDED,
                paths=dict(scenes=f"av2:{_LOG}"),
            ),
            Benchmark(
                "Detections and traffic of generated junctions",
                "Medians over junctions; in brackets after each name, what real detections and traffic have.",
                "tools/realism.py",
                ("--scenes", *map(str, range(40, 60))),
                ("--scenes", *map(str, range(40, 45))),
                "simulated",
            ),
            Benchmark(
                "A frame of SUMO's traffic with driven cars",
                "Medians over frames, on the wall clock; `frame` is all of it, so about the sum of the others.",
                "benchmarks/sumo.py",
                ("--cars", "20"),
                ("--cars", "20", "--frames", "30"),
                "median",
                path="sumo_bologna_pasubio/run.sumocfg",
            ),
        ),
    ),
    Page(
        "tracking",
        "Trackers",
        "How do the trackers of mast, filterpy and Stone Soup compare on the same detections?",
        (
            Part(
                "Trackers side by side",
                "trackers",
                full=dict(trials=20),
                quick=dict(trials=5, trackers="mast,filterpy"),
                figure="trackers",
                table="Trackers",
            ),
        ),
    ),
    Page(
        "speed",
        "Speed",
        "How fast is a run, by the number of its agents, on a mesh and in one process, and next to other programs?",
        (
            Part(
                "In one process",
                "speed",
                full=dict(trials=10, frames=50),
                quick=dict(trials=5, agents=(5, 20), frames=50),
                figure="speed",
                table="Frames/s in one process",
            ),
            Benchmark(
                "On a mesh",
                "Medians, of runs one after the other. Memory is the proportional set size.",
                "benchmarks/mesh.py",
                ("--times", "10", "--agents", "5", "20", "41"),
                ("--times", "1", "--agents", "5"),
                "median",
            ),
            Benchmark(
                "Ratios",
                "Above 1, mast is faster: medians of ratios, each of two measurements one after the other. `tracker`: "
                "one step with 50 objects; in a whole run its ratio is smaller. `mesh`, `closed loop`: other forms of "
                "the same run.",
                "benchmarks/ratios.py",
                ("--minutes", "10", "--against", "peers"),
                ("--minutes", "0", "--against", "peers", "--frames", "40"),
                "ratio",
            ),
        ),
    ),
)
