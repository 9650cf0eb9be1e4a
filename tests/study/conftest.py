"""A small study, carried out once for all tests."""

from __future__ import annotations

import pytest
from painting import leave_unpainted
from small_study import write_small

from mast_zenoh.study import definition, trials


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> definition.Study:
    return definition.load(str(write_small(tmp_path_factory.mktemp("study"))))


@pytest.fixture(scope="session")
def whole(small: definition.Study, tmp_path_factory: pytest.TempPathFactory) -> trials.StudyResult:
    """The study, run in this process without interruption, with the recorded run of each trial."""
    with pytest.MonkeyPatch.context() as patch:
        leave_unpainted(patch)
        return trials.run(small, tmp_path_factory.mktemp("whole") / "out", count=2, record=True)
