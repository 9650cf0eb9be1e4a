"""The formats of exports, by name, and what each needs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

FormatName = Literal[
    "csv", "parquet", "kitti", "mot", "openlabel", "foxglove", "rosbag2", "rrd", "pcap", "misbehaviour"
]


class Format(NamedTuple):
    """A format.

    writer: module and function (run, path) that creates the file or folder `path`, and perhaps others next to it
    extra:  the optional packages that it needs, "": none
    """

    writer: str
    extra: str = ""


#: By name.
FORMATS: Mapping[str, Format] = {
    "csv": Format("tables.write_csv"),
    "parquet": Format("tables.write_parquet"),
    "kitti": Format("kitti.write"),
    "mot": Format("mot.write"),
    "openlabel": Format("openlabel.write"),
    "foxglove": Format("foxglove.write", "foxglove"),
    "rosbag2": Format("rosbag2.write", "rosbag2"),
    "rrd": Format("rrd.write", "rerun"),
    "pcap": Format("pcap.write"),
    "misbehaviour": Format("misbehaviour.write"),
}
