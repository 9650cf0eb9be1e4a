"""What papers report of the methods that our stages and attacks follow, and why our numbers differ.

The only place of these texts. A figure is one that was found in an abstract or in others' notes (then it says so, and
was not checked), in the authors' code, or in the paper. Ours are computed from the trials of a study (`field_matrix`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    figure: str
    basis: str
    quantities: tuple[str, ...]
    why: str
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


#: How a figure, or the method without one, is known.
ABSTRACT = "abstract only, not checked"
NOTES = "abstract and others' notes, not checked"
CODE = "the authors' code"
PAPER = "the paper's table"
TITLE = "title and mentions only"


#: Attacks that move what is reported, so that there is nothing to withhold: only a suspension detects them.
BY_SUSPENSION = frozenset({"PosePert"})


_MATE = "MATE, ACM CCS 2025"
_CAD = "CAD, Zhang et al., USENIX Security 2024"
_ROBOSAC = "ROBOSAC, ICCV 2023, arXiv:2303.09495"
_PASAC = "CP-Guard, AAAI 2025; CP-uniGuard, arXiv:2506.22890"
_MADE = "MADE, IROS 2024, arXiv:2310.11901"
_PRBI = "PRBI, CVPR 2026, arXiv:2603.08498"
_POSE = "PosePert and PoseGuard, arXiv:2605.01301"
_FLIP = "TrustFlip and TrustReflect, arXiv:2605.22122"
_GCP = "GCP, arXiv:2501.02450"
_BENIGN = "Pretend Benign, ICCV 2025"
_FREEZER = "CP-FREEZER, AAAI 2026, arXiv:2508.01062"
_MAST = "arXiv:2401.09387"


def _stage(method: str, *texts: str, quantities: tuple[str, ...], attacks: tuple[str, ...] = ()) -> Published:
    source, figure, basis, why = texts
    return Published(method, source, figure, basis, quantities, why, (method,), attacks)


def _attack(method: str, *texts: str, quantities: tuple[str, ...], defences: tuple[str, ...] = ()) -> Published:
    source, figure, basis, why = texts
    return Published(method, source, figure, basis, quantities, why, defences, (method,))


#: Stages, then attacks.
PUBLISHED = (
    _stage(
        "Mate",
        *(_MATE, "", CODE),
        "The rule is that of the code, but here phantoms often have one witness, which leaves them at the prior, and "
        "no agent is ever excluded.",
        quantities=("harm_removed", "lies_detected"),
    ),
    _stage(
        "FreeSpace",
        *(_CAD, "91.5 % true positives at 3 % false positives, per box", ABSTRACT),
        "Only the idea is CAD's: agents vote with tolerances, and a lie counts once, however many frames it lasts.",
        quantities=("lies_detected", "fn_added_alone"),
    ),
    _stage(
        "Cad",
        *(_CAD, "91.5 % true positives at 3 % false positives, per box", ABSTRACT),
        "The paper counts boxes of spoofing and removal in dense point clouds; here a lie counts once, views hold the "
        "nearest return in each direction, and lies that displace or hide objects leave no box to withhold.",
        quantities=("lies_detected", "fn_added_alone"),
    ),
    _stage(
        "Robosac",
        *(_ROBOSAC, "", CODE),
        "Each agent sees only a part of a junction, so that honest agents' tracks often fail the index of agreement "
        "that was chosen for detections fused in one area.",
        quantities=("harm_removed", "honest_suspended_time"),
    ),
    _stage(
        "Pasac",
        *(_PASAC, "", CODE),
        "CP-Guard compares class maps and CP-uniGuard boxes after fusion of features; tracks have neither, and the "
        "adaptive threshold climbs past honest agents.",
        quantities=("harm_removed", "honest_suspended_time"),
    ),
    _stage(
        "Made",
        *(_MADE, "5 % of the rejected agents may be honest: the nominal rate, a parameter", CODE),
        "The second loss, of an autoencoder on features, cannot be carried over, and the first counts no boxes in "
        "excess, so that hardly anybody is rejected, honest or not.",
        quantities=("honest_suspended_time", "lies_detected"),
    ),
    _stage(
        "Prbi",
        *(_PRBI, "attackers excluded after 2.3 to 4.3 frames", ABSTRACT),
        "Attacks on features change most boxes of a frame; a few false tracks leave the index above its limit, so that "
        "groups with a liar look normal.",
        quantities=("median_delay_s", "lies_detected"),
    ),
    _stage(
        "Prbi",
        *(_PRBI, "0 to 6 % of the honest agents excluded", ABSTRACT),
        "Agents here see different parts of a junction, so that honest groups can differ from the last picture, too, "
        "and an exclusion is never taken back. Ours is a share of time.",
        quantities=("honest_suspended_time",),
    ),
    _stage(
        "Prbi",
        *(_PRBI, "79 to 87 % restored of what the attack took", NOTES),
        "The paper restores the perception of neural networks; ours is damage to tracks, by attacks that it did not "
        "play.",
        quantities=("harm_removed",),
    ),
    _stage(
        "PoseGuard",
        *(_POSE, "57 to 84 % of shifts below 1 m found", ABSTRACT),
        "The stage corrects positions and suspends nobody, and only a suspension counts as the detection of a shift; "
        "its work shows in OSPA, near the ego alone.",
        quantities=("lies_detected", "ospa_vs_undefended_m"),
        attacks=("PosePert",),
    ),
    _stage(
        "SequentialConsistency",
        *(_FLIP, "TrustReflect takes away 35 to 100 % of the effect", NOTES),
        "The stage settles all disputes together: it believes several against one only if they are more than may be "
        "lying; until then, all of them are undecided.",
        quantities=("targets_suspended",),
        attacks=("TrustFlip",),
    ),
    _attack(
        "TrustFlip",
        *(_FLIP, "an honest victim is distrusted in up to 88 % of the cases", ABSTRACT),
        "Objects are made invisible to the sensors of random agents; where fewer than two others see what they miss, "
        "nobody contradicts them. Stages that suspend many agents anyway suspend these, too.",
        quantities=("targets_suspended",),
    ),
    _attack(
        "PosePert",
        *(_POSE, "CAD, MATE, MADE and ROBOSAC find less than 13 %", ABSTRACT),
        "The shift is written into tracks, not made by a perturbation of features, and only a suspension counts as "
        "detection: of these four, only those that suspend agents can have any.",
        quantities=("lies_detected",),
        defences=("Cad", "Mate", "Made", "Robosac"),
    ),
    _attack(
        "BlindAreaConfusion",
        *(_GCP, "", ABSTRACT),
        "Only the idea is known: vehicles where the ego cannot see. Other agents may look there.",
        quantities=("damage",),
        defences=("NoIntegrity",),
    ),
    _attack(
        "PretendBenign",
        *(_BENIGN, "", TITLE),
        "Only the idea is known. The attack lies in short bursts, so that its damage per frame is small.",
        quantities=("damage",),
        defences=("NoIntegrity",),
    ),
    _attack(
        "Flood",
        *(_FREEZER, "latency 90 times as long; 780 times with ROBOSAC", ABSTRACT),
        "Receivers cut messages at a limit of rows before anything is computed, and a run has other costs besides "
        "those of fusion.",
        quantities=("cpu_growth",),
        defences=("NoIntegrity", "Robosac"),
    ),
    _attack(
        "coordinated",
        *(_MAST, "5.65 false objects added per frame with 2 adversaries (3.21 with 1, 5.74 with 3)", PAPER),
        "Apparently one run in CARLA; here false objects are in the victims' view, move and are "
        "replaced, and the first frames are not attacked.",
        quantities=("fp_added",),
        defences=("NoIntegrity",),
    ),
    _attack(
        "uncoordinated",
        *(_MAST, "15.67 false objects added per frame with 2 adversaries (7.92 with 1, 23.30 with 3)", PAPER),
        "Apparently one run in CARLA. In the authors' public code every adversary adds nine false objects, because an "
        "import sets NumPy's seed; here their number is drawn for each seed, and the first frames are not attacked.",
        quantities=("fp_added",),
        defences=("NoIntegrity",),
    ),
)
