"""docs/ref-classes.md: every class that a scenario can name."""

from __future__ import annotations

from collections.abc import Iterator

from mast_zenoh.api.catalogue import KINDS, Entry, list_kind
from reference import linked, page, parameter_table, table
from reference.docstrings import sources

#: Kinds that have a page of their own: docs/ref-messages.md.
_ELSEWHERE = ("messages",)
#: The packages whose classes are listed: other packages may be loaded, too.
_SHIPPED = ("mast_zenoh", "mast_datasets", "mast_ros2")


def classes_page() -> str:
    """Every class, profile, codec, scenario and study by kind, with its parameters."""
    kinds = [kind for kind in KINDS if kind not in _ELSEWHERE]
    introduction = (
        "Look up here what a scenario or a study can name, by kind as `mast list KIND` prints it: each parameter with\n"
        'its default, unit and meaning. Write a class as `dict(type="Name", parameter=…)`. `mast list` also has\n'
        "classes of your own, which you name in the same way.\n\n"
        f"Kinds: {', '.join(f'[{kind}](#{kind})' for kind in kinds)}."
    )
    return page("Classes", "the docstrings of the classes", introduction, map(_section, kinds))


def shipped(kind: str) -> Iterator[tuple[str, list[Entry]]]:
    """Yield (group, its entries) of a kind: classes by name, because they may have been loaded in any order."""
    for group, entries in list_kind(kind).groups():
        own = (each for each in entries if each.cls is None or each.cls.__module__.partition(".")[0] in _SHIPPED)
        yield group, sorted(own, key=lambda entry: entry.name if entry.cls else "")


def _section(kind: str) -> str:
    """The section of a kind: by group, a table of what has no parameters, and a part for each other entry."""
    parts = [f"## {kind}\n"]
    for group, entries in shipped(kind):
        parts.append(f"### {group[0].upper()}{group[1:]}\n")
        plain = [(f"`{each.name}`", _about(each)) for each in entries if not each.parameters]
        parts.append(table(("name", "what it does"), plain))
        for entry in entries:
            if entry.parameters:
                parts += [f"#### {entry.name}\n", f"{linked(_about(entry))}\n", parameter_table(entry.parameters)]
    return "\n".join(filter(None, parts))


def _about(entry: Entry) -> str:
    """What an entry does, and where it was published."""
    return " ".join([f"{entry.description}.", *(sources(entry.cls) if entry.cls else ())])
