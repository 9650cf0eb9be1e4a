"""What papers report of the methods that our stages and attacks follow, and why our numbers differ.

published.toml is the only place of these texts. A figure is one that was found in an abstract or in others' notes
(then it says so, and was not checked), in the authors' code, or in the paper. Ours are computed from the trials of a
study (`field_matrix`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mast_zenoh.metrics.study_results import Statistic


@dataclass(frozen=True, slots=True)
class Published:
    """A published figure of a method, or a method without one.

    method: our stage or attack;  source: citation
    figure: of the paper, "" if none is known;  basis: how figure and method are known
    quantities: names in `field_tables.QUANTITIES`, nearest to the figure;  why: ours differs
    defences, attacks: names in the matrix, of which one is the method; (): all
    """

    method: str
    source: str
    basis: str
    quantities: tuple[str, ...]
    why: str
    figure: str = ""
    defences: tuple[str, ...] = ()
    attacks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PublishedNumber:
    """One of our numbers next to a published figure.

    quantity: name in `field_tables.QUANTITIES`
    attacks:  those of the runs that it is from, none: of runs without an attack
    """

    quantity: str
    defence: str
    attacks: Sequence[str]
    value: Statistic


#: Attacks that move what is reported, so that there is nothing to withhold: only a suspension detects them.
BY_SUSPENSION = frozenset({"PosePert"})


def _published(**content: Any) -> Published:
    values: Any = {name: tuple(each) if isinstance(each, list) else each for name, each in content.items()}
    return Published(**values)


#: Stages, then attacks.
PUBLISHED = tuple(
    _published(**each) for each in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))["method"]
)
