"""Searches for the attack parameters that harm most: attackers that optimise. They need Optuna.

    plan       the section `search` of a study file: parameters with ranges, written as `0.5..4.0`, `1..3` or a list of
               choices, and the number that a search maximises or minimises, of one trial
    searching  carries out a search, then measures its result on seeds that it has not seen
    results    what was found: Optuna's study of the candidates, and each configuration on the other seeds
    report     what a reader sees of it: tables, a figure, files

See docs/how-to-studies.md#search-for-the-worst-attack.
"""

from mast_zenoh.errors import ConfigurationError

try:
    import optuna  # noqa: F401
except ImportError:
    raise ConfigurationError(
        "a search needs Optuna, which is not installed: pip install 'mast-zenoh[search]' (in a checkout: make dev)"
    ) from None
