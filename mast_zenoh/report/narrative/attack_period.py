"""Describes when a run was attacked and its scores in these (scored) frames."""

from __future__ import annotations

import numpy as np

from mast_zenoh.report.files import Table, rows
from mast_zenoh.report.narrative import changes, phrases
from mast_zenoh.report.narrative.changes import DISPLACED, FALSE, IDENTITY, MISSED, Change, scored
from mast_zenoh.report.narrative.phrases import join_names, objects
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.driving import braking_by_attack
from mast_zenoh.report.tables.interposers import interposers


def attack_sentences(run: RunFolder, change: Change | None) -> list[str]:
    """When adversaries changed messages, the scores in that period, needless braking.

    change: the headline's change; its kind and estimate select the scores
    """
    if run.attacks is None or run.attack_frames is None:
        return []
    first, last = run.attack_frames
    times = run.seconds(np.array(run.attack_frames))
    start, end = (
        (f"frame {first}", f"frame {last}") if times is None else (f"t = {times[0]:.1f} s", f"{times[1]:.1f} s")
    )
    active = [each.description for each in interposers(run) if each.changed and not each.is_link]
    if not active:  # metrics.json is damaged
        active = sorted(set(run.attacks["interposer"].tolist()))
    when = f"from {start} to {end}" if first != last else f"{'in' if times is None else 'at'} {start}"
    did = f"while {'it' if len(active) == 1 else 'they'} did"
    scores = _scores(run, change)
    sentences = [f"{join_names(active)} changed messages {when}{f'; {did}, {scores}' if scores else ''}."]
    attacked, total = _attacked_frames(run)
    if total and 2 * attacked < total:
        sentences.append(f"{attacked} of the {total} scored frames {'is' if attacked == 1 else 'are'} attacked.")
    braking = braking_by_attack(run)
    return sentences + ([f"Because of attacks, {braking}."] if braking else [])


def _attacked_frames(run: RunFolder) -> tuple[int, int]:
    """Numbers of scored frames with an adversary's change, and of all; 0: not known."""
    if run.attacks is None or run.scored_frames is None:
        return 0, 0
    frames = np.unique(run.attacks["frame"])
    return int(scored(run, frames).sum()), run.scored_frames[1] - run.scored_frames[0] + 1


def _scores(run: RunFolder, change: Change | None) -> str:
    """The ego's score during the attack, of the change's kind or else false objects."""
    is_ego = change is not None and change.agent == run.ego
    kind, estimate = (change.kind, change.estimate) if change is not None and is_ego else (FALSE, "picture")
    counts = (
        _counts_during_attack(run, estimate, run) if run.metrics else None
    )  # without metrics, the scored frames are not known
    if counts is None:
        return ""
    if kind in (FALSE, MISSED):
        text = f"{objects(float(counts[changes.KEYS[kind]].mean()), kind)} a frame"
    elif kind == IDENTITY:
        switches = int(counts["id_switches"].sum())
        text = f"{switches or 'no'} identity switch{'' if switches == 1 else 'es'}"
    else:
        matched = counts["tp"].astype(np.float64)
        squared = np.nan_to_num(counts["rmse_m"].astype(np.float64)) ** 2
        if kind != DISPLACED or not matched.sum():
            return ""
        text = f"an RMSE of {float(np.sqrt((squared * matched).sum() / matched.sum())):.2f} m"
    return f"{phrases.OWNERS.get(estimate, f'{estimate} has')} {text}"


def while_attacked(
    run: RunFolder, column: str, baseline: RunFolder | None = None, *, estimate: str = "picture"
) -> float | None:
    """Mean per frame of the ego's estimate over the scored frames of the attack.

    column: `fn`, `fp` or `tp`; with `baseline`, less the mean of the baseline's estimate over the same frames
    """
    counts = _counts_during_attack(run, estimate, run)
    if counts is None:
        return None
    mean = float(counts[column].mean())
    if baseline is None:
        return mean
    baseline_counts = _counts_during_attack(baseline, estimate, run)
    return None if baseline_counts is None else mean - float(baseline_counts[column].mean())


def _counts_during_attack(run: RunFolder, estimate: str, attacked: RunFolder) -> Table | None:
    """Counts of a run in the scored frames of an attack; None: no such frames.

    attacked: the run whose first and last change define the attack
    """
    counts = run.counts_of(estimate) or run.counts_of(run.original(estimate))
    if counts is None or attacked.attack_frames is None:
        return None
    first, last = attacked.attack_frames
    in_attack = (counts["frame"] >= first) & (counts["frame"] <= last) & scored(attacked, counts["frame"])
    return rows(counts, in_attack) if in_attack.any() else None
