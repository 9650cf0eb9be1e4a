# cython: language_level=3, cdivision=True
"""Kernel that encodes V2X messages along a program. The reference in `v2x.codec_kernels` documents it."""

cimport numpy as np
from cpython.bytes cimport PyBytes_FromStringAndSize
from libc.stdint cimport int64_t, uint8_t, uint64_t
from libc.stdlib cimport free, realloc
from libc.string cimport memmove, memset

from mast_zenoh.kernels.arrays cimport contiguous, int_data, length
from mast_zenoh.kernels.table cimport SOURCE_DIGEST
from mast_zenoh.kernels.uper cimport (
    ABSENT, CHOICE, COUNT, DEFAULT, ENUMERATED, FRAGMENTED, INTEGER, LIST, LONGEST, MANDATORY, NO_ADDITION,
    NO_MEMORY, PRESENCE, PRESENT, RANGE, ROWS, SEQUENCE, SOUND, Walk, allowed, content_of, enter, octets_of,
    refusal, refuse,
)

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


cdef int put(Walk* walk, uint64_t number, int bits) noexcept nogil:
    cdef Py_ssize_t wanted = (walk.position + bits + 7) >> 3, place
    cdef int used = walk.position & 7, step
    cdef void* grown
    if wanted > walk.allocated:
        wanted = max(2 * walk.allocated, wanted, 512)
        grown = realloc(walk.octets, wanted)
        if grown == NULL:
            return NO_MEMORY
        walk.octets = <uint8_t*>grown
        memset(walk.octets + walk.allocated, 0, wanted - walk.allocated)
        walk.allocated = wanted
    place = walk.position >> 3
    walk.position += bits
    while bits > 0:
        step = min(8 - used, bits)
        bits -= step
        walk.octets[place] |= <uint8_t>(((number >> bits) & ((1 << step) - 1)) << (8 - used - step))
        used += step
        if used == 8:
            place += 1
            used = 0
    return SOUND


cdef int put_length(Walk* walk, int64_t count) noexcept nogil:
    if count > LONGEST:
        return refuse(walk, FRAGMENTED, count)
    return put(walk, count, 8) if count < 128 else put(walk, 0x8000 | count, 16)


cdef int put_index(Walk* walk, int64_t index, int64_t n, int bits, bint extensible) noexcept nogil:
    if not 0 <= index < n + (64 if extensible else 0):
        return refuse(walk, RANGE, index)
    return put(walk, index, bits + extensible) if index < n else put(walk, 0x80 | (index - n), 8)


cdef int put_rows(Walk* walk, const int64_t* node, Py_ssize_t slot, int64_t count) noexcept nogil:
    cdef int64_t row, start = walk.values[slot + 1], width = node[7]
    cdef int fault
    if count and not 0 <= start <= walk.n_values - count * width:
        return refuse(walk, ROWS, start)
    for row in range(count):
        enter(walk, row)
        fault = encode(walk, node[6], start + row * width)
        if fault:
            return fault
        walk.depth -= 1
    return SOUND


cdef int put_open(Walk* walk, int64_t address, Py_ssize_t slot) noexcept nogil:
    cdef Py_ssize_t first, size, place
    cdef int64_t count
    cdef int fault
    if address == walk.program[1]:
        count = walk.values[slot]
        if not 1 <= count <= LONGEST:
            return refuse(walk, COUNT, count)
        fault = put_length(walk, count)
        return fault if fault else put_rows(walk, walk.program + address, slot, count)
    first = walk.position
    fault = put(walk, 0, 16)
    if not fault:
        fault = encode(walk, address, slot)
    if not fault:
        size = max(<Py_ssize_t>1, (walk.position - first - 16 + 7) // 8)
        fault = put(walk, 0, <int>(first + 16 + 8 * size - walk.position))
    if fault:
        return fault
    if size > LONGEST:
        return refuse(walk, FRAGMENTED, size)
    place = walk.position
    if size < 128:  # the length takes one octet, not two: the contents move by one
        memmove(walk.octets + (first >> 3) + 1, walk.octets + (first >> 3) + 2, ((place + 7) >> 3) - (first >> 3) - 2)
        walk.octets[((place + 7) >> 3) - 1] = 0
        place -= 8
    walk.position = first
    fault = put_length(walk, size)
    walk.position = place
    return fault


cdef int encode_integer(Walk* walk, const int64_t* node, Py_ssize_t slot) noexcept nogil:
    cdef int64_t value = walk.values[slot]
    cdef int octets, fault
    if allowed(node, value):
        return put(walk, <uint64_t>(value - node[1]), <int>(node[3] + node[4]))
    if not node[4]:
        return refuse(walk, RANGE, value)
    octets = octets_of(value)
    fault = put(walk, 1, 1)
    if not fault:
        fault = put_length(walk, octets)
    return fault if fault else put(walk, <uint64_t>value, 8 * octets)


cdef int encode_list(Walk* walk, const int64_t* node, Py_ssize_t slot) noexcept nogil:
    cdef int64_t count = walk.values[slot]
    cdef bint in_root = node[1] <= count <= node[2]
    cdef int fault
    if not 0 <= count <= node[5] or not (node[4] or in_root):
        return refuse(walk, COUNT, count)
    if in_root:
        fault = put(walk, <uint64_t>(count - node[1]), <int>(node[3] + node[4]))
    else:
        fault = put(walk, 1, 1)
        if not fault:
            fault = put_length(walk, count)
    return fault if fault else put_rows(walk, node, slot, count)


cdef inline int flag(Walk* walk, Py_ssize_t slot) noexcept nogil:
    """A slot of presence, which is 0 or 1; -1 if it is not."""
    cdef int64_t value = walk.values[slot]
    if 0 <= value <= 1:
        return <int>value
    walk.found = value
    return -1


cdef int encode_sequence(Walk* walk, const int64_t* node, Py_ssize_t slot) noexcept nogil:
    cdef int64_t field
    cdef uint64_t flags = 0, left
    cdef const int64_t* place
    cdef int fault, present
    for field in range(node[1]):
        place = node + 5 + 4 * field
        if place[0] == MANDATORY:
            continue
        enter(walk, field)
        if place[0] == DEFAULT:
            present = walk.values[slot + place[1]] != place[3]
        else:
            present = flag(walk, slot + place[1] - 1)
            if present < 0:
                return PRESENCE
            if (place[0] == PRESENT and not present) or (place[0] == ABSENT and present):
                return refuse(walk, PRESENCE, present)
        flags = (flags << 1) | <uint64_t>present
        walk.depth -= 1
    if node[2] >= 0:
        fault = put(walk, walk.values[slot + node[3]] != 0, 1)
        if fault:
            return fault
    fault = put(walk, flags, <int>node[4])
    if fault:
        return fault
    left = node[4]
    for field in range(node[1]):
        place = node + 5 + 4 * field
        if place[0] != MANDATORY:
            left -= 1
            if not (flags >> left) & 1:
                continue
        enter(walk, field)
        fault = encode(walk, place[2], slot + place[1])
        if fault:
            return fault
        walk.depth -= 1
    return encode_additions(walk, node, slot) if node[2] >= 0 else SOUND


cdef int encode_additions(Walk* walk, const int64_t* node, Py_ssize_t slot) noexcept nogil:
    cdef int64_t addition, n = walk.values[slot + node[3]], known = node[2], address
    cdef int64_t unknown = walk.values[slot + node[3] + 1]
    cdef uint64_t flags = 0
    cdef Py_ssize_t place
    cdef int fault, present
    if not 0 <= n <= 64:
        return refuse(walk, COUNT, n)
    if n > known and not 0 <= unknown <= walk.n_values - 3 * (n - known):
        return refuse(walk, ROWS, unknown)
    for addition in range(max(n, known)):
        enter(walk, node[1] + addition)
        if addition < known:
            place = slot + node[5 + 4 * (node[1] + addition) + 1]
        else:
            place = unknown + 3 * (addition - known) + 1
        present = flag(walk, place - 1)
        if present < 0:
            return PRESENCE
        if present:
            if addition >= n:
                return refuse(walk, PRESENCE, 1)
            flags |= <uint64_t>1 << (n - 1 - addition)
        walk.depth -= 1
    if not n:
        return SOUND
    if not flags:
        return refuse(walk, NO_ADDITION, n)
    fault = put(walk, <uint64_t>(n - 1), 7)
    if not fault:
        fault = put(walk, flags, <int>n)
    if fault:
        return fault
    for addition in range(n):
        if not (flags >> (n - 1 - addition)) & 1:
            continue
        enter(walk, node[1] + addition)
        if addition < known:
            address = node[5 + 4 * (node[1] + addition) + 2]
            place = slot + node[5 + 4 * (node[1] + addition) + 1]
        else:
            address, place = walk.program[1], unknown + 3 * (addition - known) + 1
        fault = put_open(walk, address, place)
        if fault:
            return fault
        walk.depth -= 1
    return SOUND


cdef int encode(Walk* walk, int64_t address, Py_ssize_t slot) noexcept nogil:
    """Encode the row that begins at a slot as the type at an address."""
    cdef const int64_t* node = walk.program + address
    cdef int64_t index = walk.values[slot]
    cdef int fault
    if node[0] == INTEGER:
        return encode_integer(walk, node, slot)
    if node[0] == SEQUENCE:
        return encode_sequence(walk, node, slot)
    if node[0] == LIST:
        return encode_list(walk, node, slot)
    if node[0] == ENUMERATED:
        return put_index(walk, index, node[1], <int>node[2], True)
    if node[0] == CHOICE:
        fault = put_index(walk, index, node[1], <int>node[2], node[3] >= 0)
        if fault:
            return fault
        enter(walk, index)
        if index < node[1]:
            fault = encode(walk, node[4 + index], slot + 1)
        else:
            fault = put_open(walk, node[4 + index] if index < node[1] + node[3] else walk.program[1], slot + 1)
    else:
        fault = encode(walk, node[1], slot)
        if fault:
            return fault
        index = content_of(node, index)
        enter(walk, index)
        fault = put_open(walk, node[4 + 2 * index] if index < node[2] else walk.program[1], slot + 1)
    if fault:
        return fault
    walk.depth -= 1
    return SOUND


def encode_values(program, values):
    cdef Walk walk
    cdef int fault
    values = contiguous(values)
    memset(&walk, 0, sizeof(Walk))
    walk.program = <const int64_t*>int_data(program)
    walk.values, walk.n_values = <int64_t*>int_data(values), length(values)
    try:
        with nogil:
            if walk.n_values < walk.program[2]:
                fault = refuse(&walk, ROWS, walk.n_values)
            else:
                fault = encode(&walk, walk.program[0], 0)
                if not fault and not walk.position:
                    fault = put(&walk, 0, 8)
        if fault:
            return refusal(&walk, fault)
        return PyBytes_FromStringAndSize(<char*>walk.octets, (walk.position + 7) >> 3), None
    finally:
        free(walk.octets)
