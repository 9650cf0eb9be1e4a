"""The result in words, made from the numbers: a headline and a paragraph for one run, and for several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mast_zenoh.report.faulted import check_rows
from mast_zenoh.report.runfolder import RunFolder, Table
from mast_zenoh.report.table import SummaryRow

_NUMBERS = ["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]
#: Differences per frame smaller than this are called none, objects.
_NOTHING = 0.05


def count(number: int) -> str:
    """A small number as a word."""
    return _NUMBERS[number] if 0 <= number < len(_NUMBERS) else str(number)


def listed(names: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def compromised(run: RunFolder) -> str:
    """Whose wires adversaries sit on: `two of four roadside sensors`, `all four …`; empty: nobody's."""
    kinds = {agent.name: agent.kind for agent in run.recording.agents} if run.recording else {}
    names = set(kinds) or set(run.metrics.get("agents", {})) | set(run.adversaries)
    told = []
    for kind, noun in (("static", "roadside sensor"), ("mobile", "vehicle")):
        group = {name for name in names if kinds.get(name, "static" if name.startswith("infra") else "mobile") == kind}
        hit = len(group & set(run.adversaries))
        if hit and len(group) == 1:
            told.append(f"the {noun}")
        elif hit:
            told.append(f"{'all' if hit == len(group) else f'{count(hit)} of'} {count(len(group))} {noun}s")
    return " and ".join(told)


def while_attacked(run: RunFolder, column: str, baseline: RunFolder | None = None) -> float | None:
    """Mean per frame of the ego's picture from the first to the last frame in which an adversary changed something.

    column: `fn`, `fp` or `tp`; with `baseline`, less the mean of the baseline's picture over the same frames
    """
    counts = run.counts_of("picture")
    if counts is None or run.attack_frames is None:
        return None
    first, last = run.attack_frames
    mean = _mean(counts, column, first, last)
    if baseline is None or mean is None:
        return mean
    others = baseline.counts_of("picture")
    other = None if others is None else _mean(others, column, first, last)
    return None if other is None else mean - other


def _mean(counts: Table, column: str, first: int, last: int) -> float | None:
    during = (counts["frame"] >= first) & (counts["frame"] <= last)
    return float(counts[column][during].mean()) if np.any(during) else None


def headline(run: RunFolder, row: SummaryRow) -> str:
    """One sentence without a full stop on one run."""
    told, hit = row.picture, compromised(run)
    if told.fp.mean is None or told.fn.mean is None:
        return "No scores: this run did not get as far as its evaluation"
    if hit and run.attack_frames:
        return _capital(f"{hit} compromised: {_objects(told.fp.mean, 'false')} a frame in the common picture")
    if hit:
        return _capital(f"adversaries on the wires of {hit} changed nothing: {_missed(row)}")
    return _capital(_missed(row))


def _missed(row: SummaryRow) -> str:
    alone, told = row.local.fn.mean, row.picture.fn.mean
    start = f"the common picture misses {_objects(told or 0.0)} a frame"
    return start if alone is None else f"{start}, the ego alone {alone:.1f}"


def reading(run: RunFolder, row: SummaryRow) -> list[str]:
    """Sentences on one run."""
    told, alone = row.picture, row.local
    sentences = []
    if told.fn.mean is not None and told.fp.mean is not None:
        if alone.fn.mean is not None and alone.fp.mean is not None:
            sentences.append(
                f"From its own sensors alone the ego misses {_objects(alone.fn.mean)} a frame and reports "
                f"{_objects(alone.fp.mean, 'false')}."
            )
        sentences.append(
            f"The common picture that the command centre sends back misses {told.fn.mean:.1f}, has "
            f"{_objects(told.fp.mean, 'false')} a frame, and places what it matches with an RMSE of {told.rmse} m."
        )
    sentences += _blame(run)
    if run.attack_frames is not None:
        since = run.seconds(np.array(run.attack_frames[:1]))
        when = f"frame {run.attack_frames[0]}" if since is None else f"t = {since[0]:.1f} s"
        during = while_attacked(run, "fp")
        who = listed([name for nodes in run.adversaries.values() for name in nodes]) or "An adversary"
        tail = f"; from then on the picture has {_objects(during, 'false')} a frame" if during is not None else ""
        sentences.append(f"{who} changed messages from {when} on{tail}.")
    failed = [row.name for row in check_rows(run.checks) if row.outcome == "failed"]
    if failed:
        sentences.append(f"Not everything that was checked holds: {listed(failed)}.")
    if run.run.get("status") == "running":
        sentences.append("The run was cut off: its launcher did not live to write down how it ended.")
    elif run.run.get("status", "ok") != "ok":
        sentences.append(f"The run did not end well ({run.run['status']}): read the numbers with that in mind.")
    return sentences


def _blame(run: RunFolder) -> list[str]:
    """How much of what the ego's picture misses and has too many is whose doing; nothing without links and faults."""
    told = run.metrics.get("agents", {}).get(run.ego or "", {}).get("picture", {}).get("fn_split") or {}
    if not run.faulted or told.get("fault") is None or told.get("attack") is None:
        return []
    attack = f", {told['attack']:.2f} because of attacks" if told["attack"] > 0.0 else ""
    return [
        f"Of the objects that it misses, {told['fault']:.2f} a frame are missed because of links and faults{attack}, "
        f"and {told['natural']:.2f} would be missed anyway."
    ]


def study_headline(runs: Mapping[str, RunFolder], rows: Sequence[SummaryRow]) -> str:
    """One sentence without a full stop on several runs: the one that adds the most false objects to the baseline."""
    added = {row.run: row.over_baseline[1].mean for row in rows if row.over_baseline and row.run in runs}
    more, worst = max(((mean, label) for label, mean in added.items() if mean is not None), default=(None, ""))
    if more is None:
        return f"{_capital(count(len(rows)))} runs compared"
    hit = compromised(runs[worst])
    subject = f"{hit} compromised" if hit else worst
    if more < _NOTHING:
        return _capital(f"{subject}: no more false objects a frame than unattacked")
    return _capital(f"{subject}: {_objects(more, 'false')} a frame more than unattacked")


def study_reading(runs: Mapping[str, RunFolder], rows: Sequence[SummaryRow]) -> list[str]:
    """Sentences on several runs."""
    sentences = []
    base = next((row for row in rows if row.over_baseline is None), None)
    if base and base.picture.fn.mean is not None and base.picture.fp.mean is not None:
        alone = f", where the ego alone misses {base.local.fn.mean:.1f}" if base.local.fn.mean is not None else ""
        sentences.append(
            f"Unattacked, the common picture misses {_objects(base.picture.fn.mean)} a frame{alone}, "
            f"and has {_objects(base.picture.fp.mean, 'false')}."
        )
    for row in rows:
        if row.over_baseline is None:
            continue
        fn, fp = (value.mean for value in row.over_baseline)
        if fn is None or fp is None:
            continue
        hit = compromised(runs[row.run]) if row.run in runs else ""
        where = f" ({hit} compromised)" if hit else ""
        during = while_attacked(runs[row.run], "fp", runs[base.run]) if base and row.run in runs else None
        lasts = f" ({during:+.1f} while the attack lasts)".replace("-", "\u2212") if during is not None else ""
        more = f"{_change(fp, 'false')} a frame{lasts} and {_change(fn, 'missed')}"
        sentences.append(f"In run {row.run}{where} the picture has {more}.")
    if base and len(rows) > 1 and base.local.fn.mean is not None:
        own = {(row.local.fn, row.local.fp, row.local.tp) for row in rows}
        sentences.append(
            "The ego's own tracks score the same in every run: what comes from outside does not reach them."
            if len(own) == 1
            else "The ego's own tracks do not score the same in every run: see the table."
        )
    return sentences


def _objects(number: float, kind: str = "") -> str:
    """`9.4 false objects`; `no false object` for what rounds to none."""
    noun = f"{kind} object".strip()
    if number < _NOTHING:
        return f"no {noun}" if number == 0.0 else f"hardly any {noun}s"
    return f"{number:.1f} {noun}{'' if f'{number:.1f}' == '1.0' else 's'}"


def _change(number: float, kind: str) -> str:
    if abs(number) < _NOTHING:
        return f"as many {kind} objects"
    return f"{abs(number):.1f} {'more' if number > 0 else 'fewer'} {kind} objects"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
