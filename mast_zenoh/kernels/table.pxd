# cython: language_level=3
"""Columns of the table of tracks, as in `tracking.tracks`: a test compares them. And what the kernels were made from."""

cdef extern from *:
    """
    #ifndef SOURCE_DIGEST
    #define SOURCE_DIGEST ""
    #endif
    """
    const char* SOURCE_DIGEST

cdef enum:
    P = 9
    XX = 9
    XY = 10
    YY = 19
    YAW = 90
    YAW_VARIANCE = 91
    TURN = 92
    ASIDE = 93
    ODDS = 94
    HITS = 95
    MISSES = 96
    VOTES = 97
    N_CLASSES = 7
    CLASS = 104
    CONFIRMED = 105
    AGE = 106
    ID = 107
    ROW = 108
    WIDTH = 109
