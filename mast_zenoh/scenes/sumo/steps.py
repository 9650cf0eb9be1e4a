"""Time steps of SUMO's floating-car data, one after the other, from XML or CSV."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.text_elements import TextElement
from mast_zenoh.scenes.files.xml_elements import read_xml
from mast_zenoh.scenes.sumo.csv_rows import csv_rows

_MAX_NAMES = 12  # in a message
_MAX_OBJECTS = 100_000  # at one time

#: Values of one object by SUMO's names; looking up one that is missing raises SceneError.
Row = Mapping[str, TextElement]
#: A time, and for each object whether it is a person, and its values.
Step = tuple[TextElement, Iterator[tuple[bool, Row]]]


def read_steps(file: Path) -> Iterator[Step]:
    """The time steps of a trace, in the order of the file. Raises SceneError with file, line and reason."""
    return _csv_steps(file) if file.name.removesuffix(".gz").endswith(".csv") else _xml_steps(file)


def _xml_steps(file: Path) -> Iterator[Step]:
    for step in read_xml(file, "fcd-export", ("timestep",)):
        if step.tag == "timestep":
            rows = (
                (
                    part.tag == "person",
                    _Row(
                        {
                            name: TextElement(value, file, f"{part.place}: {name}")
                            for name, value in part.attributes.items()
                        },
                        f"{file}: {part.place}: attribute",
                    ),
                )
                for part in step.children
                if part.tag in ("vehicle", "person")
            )
            yield step.attribute("time"), rows


def _csv_steps(file: Path) -> Iterator[Step]:
    """The rows of a table, grouped by equal times."""
    group: list[tuple[bool, Row]] = []
    time: TextElement | None = None
    for now, person, row in csv_rows(file):
        if time is not None and now.value != time.value:
            yield time, iter(group)
            group = []
        time = now
        if len(group) >= _MAX_OBJECTS:
            now.fail(f"at most {_MAX_OBJECTS} objects at one time")
        if row:
            group.append((person, _Row(row, f"{file}: {now.place.rpartition(':')[0]}: column")))
    if time is not None:
        yield time, iter(group)


class _Row(dict[str, TextElement]):
    """Values by name; a missing one is refused. place: for the message."""

    def __init__(self, values: Mapping[str, TextElement], place: str) -> None:
        super().__init__(values)
        self._place = place

    def __missing__(self, name: str) -> TextElement:
        raise SceneError(f"{self._place} {name} is missing; found {', '.join(list(self)[:_MAX_NAMES]) or 'none'}")
