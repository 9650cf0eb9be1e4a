"""When a run was attacked, and what its scores were in these frames, in words. Only scored frames count."""

from __future__ import annotations

import numpy as np

from mast_zenoh.report.files import Table, rows
from mast_zenoh.report.narrative import changes, phrases
from mast_zenoh.report.narrative.changes import DISPLACED, FALSE, IDENTITY, MISSED, Change, scored
from mast_zenoh.report.narrative.phrases import listed, objects
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.driving import braking_by_attack
from mast_zenoh.report.tables.interposers import interposers


def attack_sentences(run: RunFolder, change: Change | None) -> list[str]:
    """When adversaries changed messages, the scores from their first to their last change, and needless braking.

    change: the one in the headline, whose kind and estimate the scores are of
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
    sentences = [f"{listed(active)} changed messages {when}{f'; {did}, {scores}' if scores else ''}."]
    attacked, total = _attacked_frames(run)
    if total and 2 * attacked < total:
        sentences.append(f"{attacked} of the {total} scored frames {'is' if attacked == 1 else 'are'} attacked.")
    braking = braking_by_attack(run)
    return sentences + ([f"Because of attacks, {braking}."] if braking else [])


def _attacked_frames(run: RunFolder) -> tuple[int, int]:
    """In how many of the scored frames an adversary changed something, and how many there are; 0: not known."""
    if run.attacks is None or run.scored_frames is None:
        return 0, 0
    frames = np.unique(run.attacks["frame"])
    return int(scored(run, frames).sum()), run.scored_frames[1] - run.scored_frames[0] + 1


def _scores(run: RunFolder, change: Change | None) -> str:
    """What an estimate of the ego scored while the attack lasted: of the change's kind, by default false objects."""
    mine = change is not None and change.agent == run.ego
    kind, estimate = (change.kind, change.estimate) if change is not None and mine else (FALSE, "picture")
    counts = _during(run, estimate, run) if run.metrics else None  # without them, no frame is known to be scored
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
    """Mean per frame of an estimate of the ego, over the scored frames from the first to the last attacked one.

    column: `fn`, `fp` or `tp`; with `baseline`, less the mean of the baseline's estimate over the same frames
    """
    counts = _during(run, estimate, run)
    if counts is None:
        return None
    mean = float(counts[column].mean())
    if baseline is None:
        return mean
    others = _during(baseline, estimate, run)
    return None if others is None else mean - float(others[column].mean())


def _during(run: RunFolder, estimate: str, attacked: RunFolder) -> Table | None:
    """The counts of a run in the scored frames between the first and the last change in `attacked`; None: no such."""
    counts = run.counts_of(estimate) or run.counts_of(run.original(estimate))
    if counts is None or attacked.attack_frames is None:
        return None
    first, last = attacked.attack_frames
    inside = (counts["frame"] >= first) & (counts["frame"] <= last) & scored(attacked, counts["frame"])
    return rows(counts, inside) if inside.any() else None
