# cython: language_level=3, cdivision=True
"""What the kernels that decode and encode V2X messages share: numbers of nodes and faults, and a walk along a program.

As in `v2x.asn1_types`, `v2x.layout` and `v2x.codec_kernels`.
"""

from libc.stdint cimport int64_t, uint8_t, uint64_t

cdef enum:
    LONGEST = 16383
    INTEGER = 0
    ENUMERATED = 1
    LIST = 2
    SEQUENCE = 3
    CHOICE = 4
    MANDATORY = 0
    DEFAULT = 1
    PRESENT = 3
    ABSENT = 4
    SOUND = 0
    TRUNCATED = 1
    TRAILING = 2
    PADDING = 3
    RANGE = 4
    COUNT = 5
    PRESENCE = 6
    LONGER = 7
    FRAGMENTED = 8
    OPEN_LENGTH = 9
    NO_ADDITION = 10
    ADDITIONS = 11
    WIDE_INTEGER = 12
    ROWS = 13
    NO_MEMORY = 14
    DEEPEST = 64

cdef struct Walk:
    #: A decoding or encoding under way. Types do not contain themselves, so the depth has a bound.
    const int64_t* program
    uint8_t* octets  # read or written
    Py_ssize_t position  # in bits
    Py_ssize_t end  # in bits; for reading
    int64_t* values
    Py_ssize_t n_values
    Py_ssize_t allocated  # slots, for reading; octets, for writing
    int64_t found
    int depth
    int64_t[DEEPEST] path


cdef inline int refuse(Walk* walk, int fault, int64_t found) noexcept nogil:
    walk.found = found
    return fault


cdef inline void enter(Walk* walk, int64_t number) noexcept nogil:
    walk.path[walk.depth] = number
    walk.depth += 1


cdef inline bint allowed(const int64_t* node, int64_t value) noexcept nogil:
    cdef int64_t k
    if value < node[1] or value > node[2]:
        return False
    if not node[5]:
        return True
    for k in range(node[5]):
        if node[6 + 2 * k] <= value <= node[7 + 2 * k]:
            return True
    return False


cdef inline int octets_of(int64_t value) noexcept nogil:
    """Octets of the shortest two's complement."""
    cdef uint64_t bits = <uint64_t>(value if value >= 0 else ~value)
    cdef int n = 1
    while bits >= 128:
        bits >>= 8
        n += 1
    return n


cdef inline int64_t content_of(const int64_t* node, int64_t id) noexcept nogil:
    """The number of the contents with an identifier, or of contents if it is unknown."""
    cdef int64_t k
    for k in range(node[2]):
        if node[3 + 2 * k] == id:
            return k
    return node[2]


cdef inline tuple refusal(Walk* walk, int fault):
    """As the references return it."""
    if fault == NO_MEMORY:
        raise MemoryError
    return None, (fault, walk.found, tuple([walk.path[k] for k in range(walk.depth)]))
