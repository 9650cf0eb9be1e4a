"""Reads tables up to a limit on their unpacked size.

A compressed file claims how large its content is, and a few bytes can stand for gigabytes. So nothing here allocates
what a file claims before the sum of all claims is known to be within the limit. A claim that is too low is found while
decompressing, because the content does not fit into it.

    parquet   Parquet tables, by the headers of their pages
    feather   Arrow IPC files, by the lengths of their buffers
    text      columns of text, which grow when they are expanded
"""
