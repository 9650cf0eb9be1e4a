"""The files of a run folder: bytes and columns, not what they mean.

A run folder is data, and may come from anybody: what is in it neither runs, nor hangs or fills its reader, nor makes it
write elsewhere. What is in a run folder is read and written through this package.

files       JSON and plain files: read within bounds, and written whole, never through a link; types in JSON; a new
            folder or file: room for it, and what it is made with
tables      columns by name, as Parquet files;  unpacking  reads tables up to a limit on their unpacked size
finding     what is worth saying about a run, as data, and the sentences for it, from phrases.j2
recording/  messages.mcap: the bytes that were sent, by key
"""

from mast_zenoh.run_folder.files import (
    check_free,
    check_plain,
    create,
    finish,
    finite,
    json_or_empty,
    open_plain,
    parse_json,
    read_json,
    read_object,
    reading,
    release,
    replacing,
    reserve,
    reserved,
    subfolder,
    versions,
    write_bytes,
    write_json,
    write_new,
)

__all__ = ["check_free", "create", "finish", "release", "reserve", "reserved", "versions", "write_new"]
__all__ += ["check_plain", "finite", "json_or_empty", "open_plain", "parse_json", "read_json", "read_object", "reading"]
__all__ += ["replacing", "subfolder", "write_bytes", "write_json"]
