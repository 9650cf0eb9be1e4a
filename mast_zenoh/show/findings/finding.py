"""A finding: what is worth saying about a run, as data; `words` says it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that was measured of a run and is worth saying.

    kind:  which phrase of templates/phrases.j2 says it
    who:   the nodes, agents or cars that it is about
    what:  which one of its kind: an effect, an error, a state, a reason
    value: how much, in `unit`;  other: the same of the run `than`, or of what the phrase names beside it
    where: an estimate of an agent, or wires
    when:  s, the first and the last moment
    cause: the causes that were measured, or else what explains it
    than:  the name of the run that it is compared with; empty: by the run's own measurements
    """

    kind: str
    who: tuple[str, ...] = ()
    what: str = ""
    value: float | None = None
    other: float | None = None
    unit: str = ""
    where: str = ""
    when: tuple[float, float] | None = None
    cause: tuple[str, ...] = ()
    than: str = ""
