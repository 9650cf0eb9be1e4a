"""Files of a run folder: names, bounded reading, and writing that never follows a link.

A run folder is data, and may come from anybody: what is in it neither runs, nor hangs or fills its reader, nor makes it
write elsewhere. JSON and plain files of a run folder are read and rewritten through this package.

shapes   names, and the types in JSON files
files    JSON and plain files: read within bounds, and written never through a link
"""

from mast_zenoh.run_files.files import (
    check_plain,
    open_plain,
    parse_json,
    read_json,
    read_object,
    reading,
    replacing,
    subfolder,
    write_bytes,
)
from mast_zenoh.run_files.shapes import EXPECTED_NAME, MAX_NAME, REFUSED, check_shape, is_name

__all__ = [
    "EXPECTED_NAME",
    "MAX_NAME",
    "REFUSED",
    "check_plain",
    "check_shape",
    "is_name",
    "open_plain",
    "parse_json",
    "read_json",
    "read_object",
    "reading",
    "replacing",
    "subfolder",
    "write_bytes",
]
