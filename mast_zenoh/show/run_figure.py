"""The base class of figures in the report of a run."""

from __future__ import annotations

import inspect
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:  # scenarios' files import this module, also in the processes of nodes, which do not draw
    from matplotlib.figure import Figure

    from mast_zenoh.runs.frame import Frame
    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.comparison import Reference

#: The sections of a report that a figure can follow, in their order on the page.
SECTIONS = (
    *("scores", "confidence", "pictures", "trust", "achieved", "driven", "driving", "camera", "time", "blame"),
    *("checks", "interposers", "latency", "wiring", "nodes", "results"),
)


@dataclass(frozen=True, eq=False)
class FigureContext:
    """The run that a figure shows.

    run:        its folder as the report has read it
    view:       the boxes of the frame that pictures show; None: no pictures
    frame_note: how the frame was chosen, in a sentence; may be empty
    reference:  the run that it is compared with; None: with none
    estimate:   of the ego, the one that charts of several runs show
    """

    run: Run
    view: Frame | None
    frame_note: str = ""
    reference: Reference | None = None
    estimate: str = "picture"

    @property
    def folder(self) -> Path:
        """The run folder; `mast_zenoh.open(folder)` reads its tables and messages."""
        return self.run.path

    @property
    def frame(self) -> int | None:
        """Index of the frame that pictures show; None: no pictures."""
        return None if self.view is None else self.view.index


class RunFigure(ABC):
    """A figure in the report of a run.

    A subclass in a scenario's file, or imported by it, is drawn for all runs of the scenario.

    name:    of its file under figures/; by default the class's, in lower case with underscores
    heading: of its section; by default made from the name
    after:   the section that it follows, one of SECTIONS
    vector:  the page shows it as SVG, not as PNG
    """

    name: ClassVar[str] = ""
    heading: ClassVar[str] = ""
    after: ClassVar[str] = "time"
    vector: ClassVar[bool] = False

    @abstractmethod
    def draw(self, context: FigureContext) -> Figure | None:
        """The figure; None if the run has nothing to draw."""

    def caption(self, context: FigureContext) -> str:
        """How to read it: by default the docstring of the class."""
        return " ".join(inspect.cleandoc(type(self).__doc__ or "").split())

    def alt(self, context: FigureContext) -> str:
        """What it shows, for readers who cannot see it: by default the caption."""
        return self.caption(context)

    @classmethod
    def label(cls) -> str:
        """Its name."""
        return cls.name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
