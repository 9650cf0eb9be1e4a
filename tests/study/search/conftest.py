"""Searches need Optuna: without it, their tests are not collected."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("optuna") else ["test_*.py"]
