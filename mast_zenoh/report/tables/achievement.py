"""Table rows of what attacks achieved, per adversary and for all together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from mast_zenoh.report.narrative.explanations import explanations
from mast_zenoh.report.narrative.reach import reaches
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import interposers
from mast_zenoh.report.tables.scores import DASH

ALL = "all"


class AchievedRow(NamedTuple):
    """What one adversary achieved, as text.

    Pairs are for the picture ("centre") and for the ego with the picture, in this order.

    inserted, hidden, moved: number of objects manipulated in this way
    accepted: share of the inserted objects followed by a track;  believed_s: s, mean duration of that
    missed:   share of the hidden objects that were missed
    error_m:  m, mean error of the moved objects' tracks
    first_s:  s, from its first change to its first success
    switches: identity switches due to it
    why:      reasons for limited effects; may be empty
    """

    adversary: str
    inserted: str
    accepted: tuple[str, str]
    believed_s: tuple[str, str]
    hidden: str
    missed: tuple[str, str]
    moved: str
    error_m: tuple[str, str]
    first_s: tuple[str, str]
    switches: tuple[str, str]
    why: tuple[str, ...]


def achieved_rows(run: RunFolder, reference: RunFolder | None = None) -> list[AchievedRow]:
    """A row per interposer other than links, and a total if there are several.

    reference: the run that this one is compared with, see `explanations`
    """
    achieved: Mapping[str, Mapping[str, Any]] = run.metrics.get("achieved", {})
    why = explanations(run, reference)
    names = [each.name for each in interposers(run) if not each.is_link]
    centre = [name for name in names if reaches(run, name, "picture")]
    rows = [
        _row(name, achieved.get(name, {}), why.get(name, ()), in_picture=name in centre)
        for name in names
        if name in achieved or name in why
    ]
    if len(rows) > 1 and ALL in achieved:
        rows.append(_row("all together", achieved[ALL], (), in_picture=bool(centre)))
    return rows


def _row(name: str, each: Mapping[str, Any], why: tuple[str, ...], *, in_picture: bool) -> AchievedRow:
    """in_picture: whether it can affect the command centre's picture."""

    def both(key: str, form: str) -> tuple[str, str]:
        values = [each.get(f"{key}_centre") if in_picture else None, each.get(f"{key}_ego")]
        centre, ego = (DASH if value is None else form.format(value) for value in values)
        return centre, ego

    return AchievedRow(
        adversary=name,
        inserted=str(each.get("inserted", DASH)),
        accepted=both("inserted_share", "{:.0%}"),
        believed_s=both("inserted_s", "{:.1f}"),
        hidden=str(each.get("hidden", DASH)),
        missed=both("hidden_share", "{:.0%}"),
        moved=str(each.get("moved", DASH)),
        error_m=both("moved_error_m", "{:.2f}"),
        first_s=both("first_success_s", "{:.1f}"),
        switches=both("id_switches", "{}"),
        why=why,
    )
