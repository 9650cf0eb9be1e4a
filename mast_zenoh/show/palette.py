"""Colours of what runs consist of, `#rrggbb`: in figures, films and files, and on the page (sent with its data)."""

from __future__ import annotations

from dataclasses import asdict, dataclass

#: The paper's colour key for boxes (its figures 4 to 6), made bright enough for a dark ground. In drawing order.
OUTCOME_COLOURS = {
    "unevaluated": "#3fd45f",
    "truth matched": "#ffffff",
    "track matched": "#3f8cff",
    "truth missed": "#ffd60a",
    "track false": "#ff3b3b",
}
#: Names of outcomes in legends.
OUTCOME_LABELS = {
    "truth matched": "truth, matched",
    "track matched": "track, matched",
    "truth missed": "missed truth",
    "track false": "false track",
    "unevaluated": "not evaluated",
}
#: Adversaries, their wires and their effects, on dark and on light ground.
ADVERSARY, ADVERSARY_ON_LIGHT = "#ff4fd8", "#b5128f"
#: States of agents at the command centre: on dark panels, and those that light charts mark.
STATES = {
    "unknown": "#9aa7b8",
    "trusted": "#7fe3ff",
    "faulty": "#ffb347",
    "suspended": "#ff7a59",
    "undecided": "#c084fc",
}
STATES_ON_LIGHT = {"faulty": "#f0c75e", "suspended": "#ef8a6a", "undecided": "#8a63d2"}
#: States that need attention: written below the names of agents.
TROUBLES = ("faulty", "suspended", "undecided")
#: Links, faults and their effects.
FAULT_ON_LIGHT = "#8a6100"
#: Dark panels; objects that the command centre withholds.
GROUND, BUILDING, BUILDING_EDGE, FAINT = "#10141b", "#2a313d", "#465062", "#9aa7b8"
AGENT, WITHHELD = "#7fe3ff", "#c9d2de"
#: Light figures. The line colours are Okabe and Ito's, distinguishable under every colour-vision deficiency.
INK, PALE = "#1b1f24", "#d5dae1"
LOCAL = "#6b7280"
RUN_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#e69f00", "#56b4e9", "#cc79a7")


@dataclass(frozen=True)
class Ground:
    """What is behind the objects of moving pictures.

    ink: text;  faint: secondary text and the outlines of sensors;  lines, agents: of charts over time
    """

    ground: str
    building: str
    building_edge: str
    grid: str
    faint: str
    ink: str
    path: str
    sky: str
    withheld: str
    lines: tuple[str, ...]
    agents: tuple[str, ...]


@dataclass(frozen=True)
class Key:
    """Colours with a meaning: outcomes by the keys of OUTCOME_COLOURS, states of judged agents."""

    outcomes: dict[str, str]
    adversary: str
    fault: str
    agent: str
    states: dict[str, str]


GROUNDS = {
    "dark": Ground(
        ground=GROUND,
        building=BUILDING,
        building_edge=BUILDING_EDGE,
        grid="#1d242e",
        faint=FAINT,
        ink="#e8edf4",
        path="#1b222c",
        sky="#1a2230",
        withheld=WITHHELD,
        lines=("#6db3ff", "#ffb000", "#5fd3a5"),
        agents=("#c9d2de", "#8fd3c8", "#c8b0ff", "#d9c48f", "#8f9db3"),
    ),
    "light": Ground(
        ground="#fbfcfd",
        building="#dfe3ea",
        building_edge="#b4bcc9",
        grid="#e9edf2",
        faint="#566070",
        ink=INK,
        path="#eef1f5",
        sky="#e3ebf5",
        withheld="#566070",
        lines=("#0072b2", "#c05a00", "#00795a"),
        agents=("#3d4654", "#1f7a70", "#6a4fc0", "#7d6420", "#8a94a6"),
    ),
}


def _key(outcomes: str, marks: str, states: str) -> Key:
    """A key. outcomes, states: colours in the order of OUTCOME_COLOURS and STATES;  marks: adversary, fault, agent"""
    adversary, fault, agent = marks.split()
    of_outcomes = dict(zip(OUTCOME_COLOURS, outcomes.split(), strict=True))
    return Key(of_outcomes, adversary, fault, agent, dict(zip(STATES, states.split(), strict=True)))


#: By name and ground: the paper's key, on light ground with black for matched truth and darker colours; and a key that
#: is distinguishable under every colour-vision deficiency.
KEYS = {
    "paper": {
        "dark": Key(OUTCOME_COLOURS, ADVERSARY, "#d9a441", AGENT, STATES),
        "light": _key(
            f"#128a37 {INK} #1766e0 #bd8b00 #d31818",
            f"{ADVERSARY_ON_LIGHT} {FAULT_ON_LIGHT} #00728f",
            "#6b7280 #00728f #a86400 #c8401c #4c1fa8",
        ),
    },
    "safe": {
        "dark": _key(
            "#00b386 #ffffff #56b4e9 #f0e442 #ff7a1a",
            "#e79ac6 #d9a441 #b9e2f7",
            "#9aa7b8 #b9e2f7 #f0e442 #ff7a1a #9b6bff",
        ),
        "light": _key(
            f"#00795a {INK} #0072b2 #b88700 #d55e00",
            "#a3497d #7a5c00 #0072b2",
            "#6b7280 #0072b2 #b88700 #d55e00 #4c1fa8",
        ),
    },
}


def page_colours() -> dict[str, dict[str, dict[str, object]]]:
    """By name of a key and of a ground, all colours of the page."""
    return {
        name: {ground: asdict(GROUNDS[ground]) | asdict(key) for ground, key in keys.items()}
        for name, keys in KEYS.items()
    }


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
