"""The formats of exports, by name, and what each needs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from mast_zenoh.config import plugins
from mast_zenoh.errors import ExportError, nearest


class Format(NamedTuple):
    """A format.

    writer: module and function (run, path) that creates the file or folder `path`, and perhaps others next to it
    extra:  the optional packages that it needs, "": none
    plugin: our plugin to which the module belongs, "": it is in mast_zenoh.show.export
    """

    writer: str
    extra: str = ""
    plugin: str = ""


#: By name.
FORMATS: Mapping[str, Format] = {
    "csv": Format("tables.write_csv"),
    "parquet": Format("tables.write_parquet"),
    "kitti": Format("kitti.write"),
    "mot": Format("mot.write"),
    "foxglove": Format("foxglove.write", "foxglove"),
    "rosbag2": Format("mast_ros2.run_messages.write", plugin=plugins.ROS2_PLUGIN),
    "rrd": Format("rrd.write", "rerun"),
    "pcap": Format("pcap.write"),
}

#: What serves instead of a format that there is no more.
GONE = {
    "openlabel": "--to kitti, mot, csv or parquet",
    "misbehaviour": "run.trust (trust.parquet) says whom the command centre or the ego's peer suspected, when and why; "
    'run.messages("agent/*/trust") has what every peer said',
}


def check(name: str) -> None:
    """Raise ExportError for a name that no format has."""
    if name in GONE:
        raise ExportError(f"--to {name} is gone: {GONE[name]}")
    if name not in FORMATS:
        raise ExportError(f"unknown format {name!r}: expected one of {', '.join(FORMATS)}{nearest(name, FORMATS)}")
