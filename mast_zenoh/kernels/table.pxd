# cython: language_level=3
"""Constants that the build passes to the C compiler: those of `table_columns.py`, and the digest of the sources."""

cdef extern from *:
    """
    #ifndef SOURCE_DIGEST
    #define SOURCE_DIGEST ""
    #endif
    """
    const char* SOURCE_DIGEST

    enum:
        N_CLASSES "MAST_N_CLASSES"
        P "MAST_P"
        XX "MAST_XX"
        XY "MAST_XY"
        YY "MAST_YY"
        YAW "MAST_YAW"
        YAW_VARIANCE "MAST_YAW_VARIANCE"
        TURN "MAST_TURN"
        LATERAL_RESIDUAL "MAST_LATERAL_RESIDUAL"
        ODDS "MAST_ODDS"
        HITS "MAST_HITS"
        MISSES "MAST_MISSES"
        VOTES "MAST_VOTES"
        CLASS "MAST_CLASS"
        CONFIRMED "MAST_CONFIRMED"
        AGE "MAST_AGE"
        ID "MAST_ID"
        ROW "MAST_ROW"
        SCORE "MAST_SCORE"
        SPAN "MAST_SPAN"
        DUE "MAST_DUE"
        WIDTH "MAST_WIDTH"
        FOLLOWED_VX "MAST_FOLLOWED_VX"
        FOLLOWED_UNSEEN "MAST_FOLLOWED_UNSEEN"
        FOLLOWED_AGE "MAST_FOLLOWED_AGE"
        FOLLOWED_HITS "MAST_FOLLOWED_HITS"
        FOLLOWED_ID "MAST_FOLLOWED_ID"
        FOLLOWED_TARGET "MAST_FOLLOWED_TARGET"
        FOLLOWED_ROW "MAST_FOLLOWED_ROW"
        FOLLOWED_COLUMNS "MAST_FOLLOWED_COLUMNS"
