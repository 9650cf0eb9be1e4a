"""A synthetic matrix of defences: two defences, with all kinds of numbers."""

import math
from typing import Any

import numpy as np

from mast_zenoh.metrics.study_results import BINOMIAL, BOOTSTRAP, POISSON, Row, Statistic
from mast_zenoh.metrics.trust import AgentTrustSeries, TrustPanel, roc
from mast_zenoh.study.defences.matrix_table import DEFENCE_MEASURES, MatrixTable
from mast_zenoh.study.statistics import Survival

DELAY = Survival(np.array([0.0, 0.3, 11.0]), np.array([1.0, 0.4, 0.4]), 3, 5)
RUNS = Statistic(0.0, 0.0, 0.07, 48, 0, BINOMIAL)
ALARMS = Statistic(0.4, 0.0, 1.2, 180, 0, POISSON)
ATTACKED = Statistic(1.0, 0.93, 1.0, 48, 0, BINOMIAL)
SHARE = Statistic(0.97, 0.95, 0.99, 48, 0, BOOTSTRAP)


def row(defence: str, attack: str, **measures: Statistic) -> Row:
    values = {"damage": Statistic(4.2, 3.9, 4.6, 48, 0, BOOTSTRAP), "honest_suspended_per_hour": ALARMS}
    values |= {"framed": RUNS if attack == "Ghost" else Statistic(), "lies_detected": SHARE}
    values |= {"attacked": ATTACKED} if attack == "Ghost" else {}
    values |= {"wrongly_suspended": RUNS} if attack != "Ghost" else {}
    counts = {"liars_watched": 0.0, "liars_suspended": 0.0, "suspended_before": 0.0}
    if attack == "Ghost" and defence == "Wall":
        counts |= {"liars_watched": 5.0, "liars_suspended": 3.0}
    if attack.startswith("fault:"):
        counts |= {"seconds faulty trusted": 3.0, "seconds faulty suspended": 1.0}
    numbers = dict.fromkeys(DEFENCE_MEASURES, Statistic())
    numbers |= {name: Statistic(count, trials=48) for name, count in counts.items()}
    of = {
        "defence": defence,
        "attack": attack,
        "n_adversaries": 1 if attack else 0,
        "placement": "worst" if attack else "",
        "budget": 4.0 if attack == "Ghost" else None,
        "budgets": 2,
    }
    return Row(of, 48, numbers | values | measures)


def summary(defence: str = "Wall", **changes: Statistic) -> Row:
    values = dict(
        lies_detected=SHARE,
        median_delay_s=Statistic(0.3, 0.2, 0.5, 48, 0, BOOTSTRAP),
        identifiable_removed=SHARE,
        alarms_per_hour=ALARMS,
        frames=Statistic(108_000.0, trials=180),
        fn_added=Statistic(0.01, 0.0, 0.02, 180, 0, BOOTSTRAP),
        fp_added=Statistic(-0.1, -0.2, -0.05, 180, 0, BOOTSTRAP),
        faults_suspended=RUNS,
        framed_by_minority=RUNS,
        auc=Statistic(0.9, 0.85, 0.95, 48, 0, BOOTSTRAP),
        partial_auc=Statistic(0.5, math.nan, math.nan, 4),
        hours=Statistic(1.5),
    )
    return Row({"defence": defence}, 48, values | changes)


def agent(name: str, **conduct: Any) -> AgentTrustSeries:
    """Trust over 15 s that falls at 5 s."""
    times = np.arange(0.0, 15.0, 0.2)
    nothing = dict(states={"faulty": [], "suspended": []}, lies=[], faults=[])
    return AgentTrustSeries(name, times, np.where(times < 5.0, 4.5, -30.0), **(nothing | conduct))


def panel(title: str) -> TrustPanel:
    liar = agent("infra_1", states={"faulty": [], "suspended": [(5.0, 15.0)]}, lies=[(4.0, 9.0), (11.0, 15.0)])
    faulty = agent("infra_2", states={"faulty": [(5.0, 15.0)], "suspended": []}, faults=[("PoseError", 4.0, 15.0)])
    return TrustPanel(title, [agent("ego"), liar, faulty, agent("infra_3"), agent("infra_4")], 0, 15.0)


def matrix(panels: int = 1, unshown: int = 0) -> MatrixTable:
    rows = [row(defence, attack) for defence in ("Open", "Wall") for attack in ("", "Ghost", "fault:pose")]
    titles = [f"Wall against Ghost{number} (1, worst)" for number in range(panels)]
    size = "6 seeds \u00d7 8 scenes"
    return MatrixTable(
        rows=rows,
        rocs={"Wall": roc([1.0, 0.0], [True, False])},
        delays={"Wall": DELAY},
        summaries=[summary()],
        size=size,
        states=[Row({"defence": "Wall", "conduct": "lying"}, 0, {"trusted": SHARE, "suspended": SHARE})],
        panels=[panel(each) for each in titles],
        unshown=unshown,
    )
