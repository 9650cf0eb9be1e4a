"""Optuna proposes candidates in batches: the same ones for the same seed and values, whatever computes the values.

Tree-structured Parzen estimator: Bergstra, Bardenet, Bengio, Kégl (2011), Algorithms for hyper-parameter optimization,
NeurIPS 24. Optuna: Akiba, Sano, Yanase, Ohta, Koyama (2019), KDD.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.study.numbers import NAN
from mast_zenoh.study.search.space import Choices, Range, Space

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution
    from optuna.samplers import BaseSampler

INSTALL = "a search needs Optuna, which is not installed: pip install 'mast-zenoh[search]' (in a checkout: make dev)"


@dataclass(frozen=True, slots=True)
class Candidate:
    """One choice of the parameters.

    number: from 0, in the order in which they were proposed;  batch: the one that it was proposed in, from 0
    values: by name of the parameter
    value:  the objective; NaN: none
    """

    number: int
    batch: int
    values: Mapping[str, Any]
    value: float = NAN


#: The objective's values of candidates, in their order; NaN: a candidate has none.
Evaluate = Callable[[Sequence[Candidate]], Sequence[float]]


@dataclass(frozen=True, slots=True)
class Effort:
    """How a space is searched: how many candidates, in batches of how many, from which seed, and by which sampler."""

    candidates: int
    batch: int
    seed: int
    sampler: str = "TPE"
    maximise: bool = True


def require() -> str:
    """The version of Optuna; raises ConfigurationError if it is not installed."""
    try:
        import optuna  # noqa: F401
    except ImportError:
        raise ConfigurationError(INSTALL) from None
    return version("optuna")


def search(space: Space, effort: Effort, evaluate: Evaluate) -> list[Candidate]:
    """All candidates with their values.

    Within a batch, the sampler knows what it has proposed, and the values of earlier batches. So the result depends on
    the size of a batch, but not on what is computed at the same time. A shorter search is the beginning of a longer
    one. Raises ConfigurationError if Optuna is not installed, and what `evaluate` raises.
    """
    require()
    import optuna

    distributions = {name: _distribution(values) for name, values in space.items()}
    done: list[Candidate] = []
    with _quiet():
        study = optuna.create_study(sampler=_sampler(effort), direction="maximize" if effort.maximise else "minimize")
        for first in range(0, effort.candidates, effort.batch):
            count = min(effort.batch, effort.candidates - first)
            asked = [study.ask(distributions) for _ in range(count)]
            batch = [Candidate(trial.number, first // effort.batch, _values(space, trial.params)) for trial in asked]
            for trial, candidate, value in zip(asked, batch, evaluate(batch), strict=True):
                known = math.isfinite(value)
                if known:
                    study.tell(trial, value)
                else:
                    study.tell(trial, state=optuna.trial.TrialState.FAIL)
                done.append(replace(candidate, value=value if known else NAN))
    return done


def best_of(candidates: Sequence[Candidate], *, maximise: bool) -> Candidate | None:
    """The candidate with the best value, the first of equal ones; None: no candidate has a value."""
    known = [candidate for candidate in candidates if not math.isnan(candidate.value)]
    sign = -1.0 if maximise else 1.0
    return min(known, key=lambda candidate: sign * candidate.value, default=None)


def _sampler(effort: Effort) -> BaseSampler:
    from optuna import samplers
    from optuna.exceptions import ExperimentalWarning

    if effort.sampler == "random":
        return samplers.RandomSampler(seed=effort.seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)  # versions are limited to those in which it works
        # Candidates of a batch that have no value yet count as bad, so that a batch does not repeat one candidate.
        return samplers.TPESampler(seed=effort.seed, constant_liar=True)


def _distribution(values: Range | Choices) -> BaseDistribution:
    from optuna import distributions

    if isinstance(values, Choices):
        return distributions.CategoricalDistribution(range(len(values.values)))
    kind = distributions.IntDistribution if values.whole else distributions.FloatDistribution
    return kind(values.low, values.high, log=values.log)  # type: ignore[arg-type]


def _values(space: Space, proposed: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of a proposal: of choices, it has the index."""
    return {
        name: values.values[proposed[name]] if isinstance(values, Choices) else proposed[name]
        for name, values in space.items()
    }


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Optuna from printing each step."""
    import optuna

    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        yield
    finally:
        optuna.logging.set_verbosity(level)
