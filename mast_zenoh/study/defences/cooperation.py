"""How far a lie reaches where tracks are fused in one centre, in regional ones, or on board of every agent.

Every trial under attack is paired with the one without of the same architecture, number of agents, scene and seed. An
agent is deceived in a frame if its picture has a false or a missed object that an adversary caused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.config.resolved import RECORDING
from mast_zenoh.metrics.causes import ATTACK_CAUSES
from mast_zenoh.metrics.estimates import LOCAL, PICTURE
from mast_zenoh.metrics.study_results import NAN, Row, Statistic, clearest
from mast_zenoh.run_folder.finding import whole_percent
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.show.findings.words import of_study, paragraph
from mast_zenoh.show.number_text import DASH, measured, number, percent
from mast_zenoh.show.tables.text_table import ResultTables, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.defences.kinds import Factors, Kind, few_trials
from mast_zenoh.study.numbers import ego, scored_frames
from mast_zenoh.study.trial import TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.figures.drawing import RenderedFigure

#: Classes of vehicles that could carry sensors.
_VEHICLES = [CLASS_INDEX[name] for name in ("car", "truck", "bus")]
_ROUNDING_S = 1e-6


class Cooperation(Kind):
    """Lies and their reach.

    Its factors: architecture, of the fusion; agents, the ego included; attacked, whether some of them lie;
    attack_start_s, s of scene time, from which trials count, with lies or without
    """

    name = "cooperation"
    drawn = ("cooperation",)
    recorded = True

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        frames_s:    s of scene time of each frame
        deceived:    by frame, the share of the agents that are deceived
        lies_from_s: s, the first frame of which an adversary changed a message; None: nobody lied
        kb_per_s:    kB/s that an agent sends to others, mean
        penetration: share of the vehicles that are agents
        """
        from mast_zenoh.run_folder.recording.reader import read

        recording = Recording.load(run.path / RECORDING)
        times_s = (recording.times_ns - recording.times_ns[0]) * 1e-9
        changes = run.attacks.select(["frame", "role", "effect"])
        lied_in, role, effect = (column.to_numpy(zero_copy_only=False) for column in changes.columns)
        lied_in = lied_in[(role != "link") & (effect != "unsettled") & (lied_in >= 0)]
        objects = run.objects.select(["frame", "agent", "estimator", "outcome", "cause"])
        frame, agent, estimator, outcome, cause = (column.to_numpy(zero_copy_only=False) for column in objects.columns)
        wrong = (estimator == PICTURE) & np.isin(outcome, ("false", "missed")) & np.isin(cause, ATTACK_CAUSES)
        names = sorted(run.files.summary["agents"])
        deceived = np.zeros((len(names), len(times_s)), bool)
        deceived[np.searchsorted(names, agent[wrong].astype(str)), frame[wrong]] = True
        wires = run.estimate_wires
        own = {wire.key for wire in run.wiring.wires if wire.traits.estimate == LOCAL}
        # Peers get the tracks of their own agents only, and send them to others.
        copies = {wire.key for wire in run.wiring.wires if wire.message == "tracks" and wires.tracks_on(wire.key)} - own
        sent = read(run.path, lambda channel: channel.get("wire") in (copies or own))
        bytes_sent = sum(len(message.payload) for message in sent if not message.tap)
        duration_s = len(times_s) * recording.period_ns * 1e-9
        vehicles = len(np.unique(recording.truth.id[np.isin(recording.truth.class_id, _VEHICLES)]))
        sensing = sum(each.kind == "mobile" for each in recording.agents)
        return {
            "frames_s": np.round(times_s, 9).tolist(),
            "deceived": np.round(deceived.mean(axis=0), 9).tolist(),
            "lies_from_s": round(float(times_s[min(lied_in.min(), len(times_s) - 1)]), 9) if len(lied_in) else None,
            "kb_per_s": round(bytes_sent * 1e-3 / (duration_s * len(recording.agents)), 6),
            "penetration": round(sensing / vehicles, 6),
        }

    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """What the table needs of one trial; NaN: it has none.

        From the start of the attack on:
        errors:      missed and false objects per frame in the ego's picture
        From the first message on that an adversary changed, as `pictures.deceived` of metrics.json:
        deceived:    mean share of the agents that are deceived;  deceived_max: the greatest share in a frame
        Over the scored frames:
        nees:        normalised error squared of the positions in a picture, mean over agents; 2 is consistent
        gospa_m:     m, between the pictures of two agents; NaN where all have the same
        busy_ratio:  of the channel; NaN without one
        Over the whole run:
        kb_per_s:    kB/s that an agent sends to others
        penetration: share of the vehicles that are agents
        """
        metrics, part = outcome.metrics, outcome.metrics["defence"]
        first, last = scored_frames(metrics)
        start = max(first, int(np.searchsorted(part["frames_s"], factors["attack_start_s"] - _ROUNDING_S)))
        table = outcome.per_frame
        rows = (table["agent"] == ego(metrics)) & (table["estimator"] == PICTURE)
        rows &= (table["frame"] >= start) & (table["frame"] <= last)
        lies_from_s = part.get("lies_from_s")
        lies_from = start if lies_from_s is None else int(np.searchsorted(part["frames_s"], lies_from_s - _ROUNDING_S))
        deceived = np.array(part["deceived"][max(first, lies_from) : last + 1])
        nees = [agent[PICTURE]["position"]["nees"] for agent in metrics["consistency"].values() if PICTURE in agent]
        channel = metrics.get("channel", {})
        return {
            "errors": float((table["fn"][rows] + table["fp"][rows]).mean()),
            "deceived": float(deceived.mean()) if len(deceived) else NAN,
            "deceived_max": float(deceived.max()) if len(deceived) else NAN,
            "nees": float(np.mean([each for each in nees if each is not None])) if nees else NAN,
            "gospa_m": metrics.get("pictures", {}).get("difference_gospa_m", {}).get("mean", NAN),
            "kb_per_s": part["kb_per_s"],
            "busy_ratio": channel["busy_ratio"]["mean"] if channel else NAN,
            "penetration": part["penetration"],
        }

    def table(self) -> list[Row]:
        """A row for each architecture and number of agents, with the measures of `measures`, and of pairs:

        harm: errors with lies minus those without;  harm_difference: that minus the first architecture's
        """
        cells = sorted((each for each in self.trials if each["attacked"]), key=lambda each: int(each["agents"]))
        first = next(iter(self.several("architecture")), "")
        rows = [self._row(each, self._harm(each), self._harm(each.but(architecture=first))) for each in cells]
        return [row for row in rows if row.trials]

    def _harm(self, factors: Factors) -> Floats:
        return self.values(factors, "errors") - self.values(factors.but(attacked=False), "errors")

    def _row(self, factors: Factors, harm: Floats, of_first: Floats) -> Row:
        honest = factors.but(attacked=False)
        numbers = {
            "errors": self.mean(self.values(honest, "errors")),
            "harm": self.mean(harm, paired=True),
            "harm_difference": self.mean(harm - of_first, paired=True),
        }
        numbers |= {name: self.mean(self.values(factors, name), (0.0, 1.0)) for name in ("deceived", "deceived_max")}
        for name in ("nees", "gospa_m", "kb_per_s", "busy_ratio", "penetration"):
            numbers[name] = self.mean(self.values(honest, name))
        of = {name: factors[name] for name in ("architecture", "agents")}
        return Row(of, int((~np.isnan(harm)).sum()), numbers)

    def tables(self, table: Sequence[Row]) -> ResultTables:
        """The CSV has a row for each architecture, number of agents and measure."""
        summary, title = conclusion(table), "Fusion architectures"
        return ResultTables(
            title,
            f"{self.size}. {summary} {paragraph('cooperation_about')}",
            self.size,
            [
                table_of_rows("Lies", "", table, _LIES),
                table_of_rows("Traffic and consistency, without lies", "", table, _TRAFFIC),
            ],
            numbers_of_rows(table),
            [table_of_rows(title, summary, table, _BRIEF)],
            note=few_trials(row["harm"] for row in table),
            headline=headline(table),
            reading=[summary] if summary else (),
        )

    def figures(self, table: Sequence[Row]) -> Mapping[str, RenderedFigure]:
        if not table:
            return {}
        from mast_zenoh.show.figures.drawing import render  # drawing libraries are slow to load
        from mast_zenoh.show.figures.facets import Axis, facet

        panels = [Axis(*panel) for panel in _PANELS]
        figure = facet(table, "agents", panels, "architecture", columns=2, label="agents", log=True)
        caption = paragraph("figure_cooperation", size=self.size)
        return {self.name: render(self.name, figure, conclusion(table), caption, printed=True)}


# -- what readers see --------------------------------------------------------------------------------------------------


def _share(each: Statistic) -> str:
    return whole_percent(each.value) if each.known else DASH


def _traffic(each: Statistic) -> str:
    return number(each.value, 1)


_LIES = {
    "trials": lambda row: str(row.trials),
    "vehicles with sensors (%)": shown("penetration", _share),
    "errors without lies": shown("errors"),
    "added by lies": shown("harm"),
    "difference from the first": shown("harm_difference"),
    "agents deceived at a time (%)": shown("deceived", percent),
    "at most (%)": shown("deceived_max", percent),
}
_TRAFFIC = {
    "kB/s an agent sends": shown("kb_per_s", _traffic),
    "channel busy (%)": shown("busy_ratio", _share),
    "between pictures (m, GOSPA)": shown("gospa_m"),
    "NEES of positions (2 expected)": shown("nees"),
}
_BRIEF = {
    "errors": shown("errors", lambda each: number(each.value)),
    "added by lies": shown("harm"),
    "deceived (%)": shown("deceived", percent),
    "kB/s": shown("kb_per_s", _traffic),
}
#: `facets.Axis` of each panel.
_PANELS = (
    ("harm", "errors per frame that lies add"),
    ("deceived", "agents deceived at a time (%)", 100.0),
    ("errors", "errors per frame without lies"),
    ("kb_per_s", "kB/s that an agent sends", 1.0, True),
)


def headline(rows: Sequence[Row]) -> str:
    """The clearest effect of lies; without a full stop. Empty: none, or too few trials for a test."""
    for at in clearest({at: row["harm"] for at, row in enumerate(rows)}):
        place, harm = "{architecture} and {agents} agents".format(**rows[at].of), measured(rows[at]["harm"])
        return f"The clearest effect: with {place}, lies add {harm} errors a frame"
    return ""


def conclusion(rows: Sequence[Row]) -> str:
    """What lies do with most agents, by architecture, and whether that differs from the first one; "" without rows."""
    if not rows:
        return ""
    agents = rows[-1].of["agents"]
    by_name = {str(row.of["architecture"]): row.numbers for row in rows if row.of["agents"] == agents}
    first, *others = by_name
    clear = clearest({name: by_name[name]["harm_difference"] for name in others})
    return " ".join(of_study("cooperation", agents=agents, first=first, rows=by_name, clear=clear))
