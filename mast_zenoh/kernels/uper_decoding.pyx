# cython: language_level=3, cdivision=True
"""Kernel that decodes V2X messages along a program. The reference in `v2x.codec_kernels` documents it."""

cimport numpy as np
from libc.stdint cimport int64_t, uint8_t, uint64_t
from libc.stdlib cimport free, realloc
from libc.string cimport memcpy, memset

from mast_zenoh.kernels.arrays cimport empty_vector, int_data
from mast_zenoh.kernels.table cimport SOURCE_DIGEST
from mast_zenoh.kernels.uper cimport (
    ABSENT, ADDITIONS, CHOICE, COUNT, DEFAULT, ENUMERATED, FRAGMENTED, INTEGER, LIST, LONGER, MANDATORY,
    NO_ADDITION, NO_MEMORY, OPEN_LENGTH, PADDING, PRESENCE, PRESENT, RANGE, SEQUENCE, SOUND, TRAILING,
    TRUNCATED, WIDE_INTEGER, Walk, allowed, content_of, enter, octets_of, refusal, refuse,
)

np.import_array()
DIGEST = SOURCE_DIGEST.decode()


cdef Py_ssize_t reserve(Walk* walk, Py_ssize_t n) noexcept nogil:
    """The start of n new slots, of value 0; -1 if there is no memory."""
    cdef Py_ssize_t start = walk.n_values, wanted
    cdef void* grown
    if start + n > walk.allocated:
        wanted = max(2 * walk.allocated, start + n, 512)
        grown = realloc(walk.values, wanted * sizeof(int64_t))
        if grown == NULL:
            return -1
        walk.values, walk.allocated = <int64_t*>grown, wanted
    memset(walk.values + start, 0, n * sizeof(int64_t))
    walk.n_values += n
    return start


cdef inline int take(Walk* walk, int bits, uint64_t* number) noexcept nogil:
    cdef Py_ssize_t place = walk.position >> 3
    cdef int used = walk.position & 7, left, step
    cdef uint64_t result = 0
    if bits > walk.end - walk.position:
        return refuse(walk, TRUNCATED, walk.end - walk.position)
    walk.position += bits
    left = bits
    while left > 0:
        step = min(8 - used, left)
        result = (result << step) | ((walk.octets[place] >> (8 - used - step)) & ((1 << step) - 1))
        left -= step
        place += 1
        used = 0
    number[0] = result
    return SOUND


cdef int take_length(Walk* walk, int64_t* result) noexcept nogil:
    cdef uint64_t bits
    cdef int fault = take(walk, 1, &bits)
    if fault:
        return fault
    if not bits:
        fault = take(walk, 7, &bits)
        result[0] = <int64_t>bits
        return fault
    fault = take(walk, 1, &bits)
    if fault:
        return fault
    if bits:
        return refuse(walk, FRAGMENTED, 0)
    fault = take(walk, 14, &bits)
    if fault:
        return fault
    result[0] = <int64_t>bits
    return refuse(walk, LONGER, result[0]) if result[0] < 128 else SOUND


cdef int take_small(Walk* walk, int64_t* result) noexcept nogil:
    cdef uint64_t bits
    cdef int fault = take(walk, 1, &bits)
    if fault:
        return fault
    if bits:
        return refuse(walk, ADDITIONS, 0)
    fault = take(walk, 6, &bits)
    result[0] = <int64_t>bits
    return fault


cdef int take_index(Walk* walk, int64_t n, int bits, bint extensible, int64_t* result) noexcept nogil:
    cdef uint64_t number = 0
    cdef int fault
    if extensible:
        fault = take(walk, 1, &number)
        if fault:
            return fault
        if number:
            fault = take_small(walk, result)
            result[0] += n
            return fault
    fault = take(walk, bits, &number)
    if fault:
        return fault
    result[0] = <int64_t>number
    return refuse(walk, RANGE, result[0]) if result[0] >= n else SOUND


cdef int take_rows(Walk* walk, const int64_t* node, Py_ssize_t slot, int64_t count) noexcept nogil:
    cdef int64_t row, width = node[7]
    cdef Py_ssize_t start = 0
    cdef int fault
    if count * node[8] > walk.end - walk.position:
        return refuse(walk, TRUNCATED, walk.end - walk.position)
    if count:
        start = reserve(walk, count * width)
        if start < 0:
            return NO_MEMORY
    walk.values[slot], walk.values[slot + 1] = count, start
    for row in range(count):
        enter(walk, row)
        fault = decode(walk, node[6], start + row * width)
        if fault:
            return fault
        walk.depth -= 1
    return SOUND


cdef int take_open(Walk* walk, int64_t address, Py_ssize_t slot) noexcept nogil:
    cdef Py_ssize_t outer = walk.end, first, rest
    cdef int64_t octets = 0
    cdef uint64_t bits = 0
    cdef int fault = take_length(walk, &octets)
    if fault:
        return fault
    if octets == 0:
        return refuse(walk, OPEN_LENGTH, octets)
    if 8 * octets > walk.end - walk.position:
        return refuse(walk, TRUNCATED, walk.end - walk.position)
    if address == walk.program[1]:
        return take_rows(walk, walk.program + address, slot, octets)
    first = walk.position
    walk.end = first + 8 * octets
    fault = decode(walk, address, slot)
    if fault:
        return fault
    rest = walk.end - walk.position
    if rest >= 8 and (rest > 8 or walk.position > first):
        return refuse(walk, OPEN_LENGTH, octets)
    fault = take(walk, <int>rest, &bits)
    if fault:
        return fault
    if bits:
        return refuse(walk, PADDING, rest)
    walk.end = outer
    return SOUND


cdef int decode_integer(Walk* walk, const int64_t* node, Py_ssize_t slot) noexcept nogil:
    cdef uint64_t bits = 0
    cdef int64_t octets = 0, value
    cdef int fault
    if node[4]:
        fault = take(walk, 1, &bits)
        if fault:
            return fault
        if bits:
            fault = take_length(walk, &octets)
            if fault:
                return fault
            if not 1 <= octets <= 8:
                return refuse(walk, WIDE_INTEGER, octets)
            fault = take(walk, <int>(8 * octets), &bits)
            if fault:
                return fault
            if octets < 8 and bits >> (8 * octets - 1):
                bits |= ~<uint64_t>0 << (8 * octets)
            value = <int64_t>bits
            if octets != octets_of(value) or allowed(node, value):
                return refuse(walk, LONGER, value)
            walk.values[slot] = value
            return SOUND
    fault = take(walk, <int>node[3], &bits)
    if fault:
        return fault
    value = node[1] + <int64_t>bits
    if not allowed(node, value):
        return refuse(walk, RANGE, value)
    walk.values[slot] = value
    return SOUND


cdef int decode_list(Walk* walk, const int64_t* node, Py_ssize_t slot) noexcept nogil:
    cdef uint64_t bits = 0
    cdef int64_t count = 0
    cdef int fault
    if node[4]:
        fault = take(walk, 1, &bits)
        if fault:
            return fault
    if bits:
        fault = take_length(walk, &count)
        if fault:
            return fault
        if node[1] <= count <= node[2]:
            return refuse(walk, LONGER, count)
    else:
        fault = take(walk, <int>node[3], &bits)
        if fault:
            return fault
        count = node[1] + <int64_t>bits
        if count > node[2]:
            return refuse(walk, COUNT, count)
    if count > node[5]:
        return refuse(walk, COUNT, count)
    return take_rows(walk, node, slot, count)


cdef int decode_sequence(Walk* walk, const int64_t* node, Py_ssize_t slot) noexcept nogil:
    cdef uint64_t extended = 0, flags = 0
    cdef int64_t field, present, left = node[4]
    cdef const int64_t* place
    cdef int fault
    if node[2] >= 0:
        fault = take(walk, 1, &extended)
        if fault:
            return fault
    if left:
        fault = take(walk, <int>left, &flags)
        if fault:
            return fault
    for field in range(node[1]):
        place = node + 5 + 4 * field
        enter(walk, field)
        present = 1
        if place[0] != MANDATORY:
            left -= 1
            present = (flags >> left) & 1
            if place[0] == DEFAULT:
                walk.values[slot + place[1]] = place[3]
            else:
                walk.values[slot + place[1] - 1] = present
                if (place[0] == PRESENT and not present) or (place[0] == ABSENT and present):
                    return refuse(walk, PRESENCE, present)
        if present:
            fault = decode(walk, place[2], slot + place[1])
            if fault:
                return fault
            if place[0] == DEFAULT and walk.values[slot + place[1]] == place[3]:
                return refuse(walk, LONGER, place[3])
        walk.depth -= 1
    return decode_additions(walk, node, slot) if extended else SOUND


cdef int decode_additions(Walk* walk, const int64_t* node, Py_ssize_t slot) noexcept nogil:
    cdef int64_t addition, n = 0, known = node[2], address
    cdef uint64_t flags = 0
    cdef Py_ssize_t unknown = 0, place
    cdef int fault = take_small(walk, &n)
    if fault:
        return fault
    n += 1
    fault = take(walk, <int>n, &flags)
    if fault:
        return fault
    if not flags:
        return refuse(walk, NO_ADDITION, n)
    if n > known:
        unknown = reserve(walk, 3 * (n - known))
        if unknown < 0:
            return NO_MEMORY
    walk.values[slot + node[3]], walk.values[slot + node[3] + 1] = n, unknown
    for addition in range(n):
        if not (flags >> (n - 1 - addition)) & 1:
            continue
        enter(walk, node[1] + addition)
        if addition < known:
            address = node[5 + 4 * (node[1] + addition) + 2]
            place = slot + node[5 + 4 * (node[1] + addition) + 1]
        else:
            address, place = walk.program[1], unknown + 3 * (addition - known) + 1
        walk.values[place - 1] = 1
        fault = take_open(walk, address, place)
        if fault:
            return fault
        walk.depth -= 1
    return SOUND


cdef int decode(Walk* walk, int64_t address, Py_ssize_t slot) noexcept nogil:
    """Decode the type at an address into the row that begins at a slot."""
    cdef const int64_t* node = walk.program + address
    cdef int64_t index = 0
    cdef int fault
    if node[0] == INTEGER:
        return decode_integer(walk, node, slot)
    if node[0] == SEQUENCE:
        return decode_sequence(walk, node, slot)
    if node[0] == LIST:
        return decode_list(walk, node, slot)
    if node[0] == ENUMERATED:
        fault = take_index(walk, node[1], <int>node[2], True, &index)
        walk.values[slot] = index
        return fault
    if node[0] == CHOICE:
        fault = take_index(walk, node[1], <int>node[2], node[3] >= 0, &index)
        if fault:
            return fault
        walk.values[slot] = index
        enter(walk, index)
        if index < node[1]:
            fault = decode(walk, node[4 + index], slot + 1)
        else:
            fault = take_open(walk, node[4 + index] if index < node[1] + node[3] else walk.program[1], slot + 1)
    else:
        fault = decode(walk, node[1], slot)
        if fault:
            return fault
        index = content_of(node, walk.values[slot])
        enter(walk, index)
        fault = take_open(walk, node[4 + 2 * index] if index < node[2] else walk.program[1], slot + 1)
    if fault:
        return fault
    walk.depth -= 1
    return SOUND


def decode_values(program, bytes data):
    cdef Walk walk
    cdef Py_ssize_t rest
    cdef int fault
    cdef uint64_t bits = 0
    memset(&walk, 0, sizeof(Walk))
    walk.program, walk.octets, walk.end = <const int64_t*>int_data(program), <uint8_t*>data, 8 * len(data)
    try:
        with nogil:
            fault = NO_MEMORY if reserve(&walk, walk.program[2]) < 0 else decode(&walk, walk.program[0], 0)
            if not fault:
                rest = walk.end - walk.position
                if rest >= 8 and (rest > 8 or walk.position):
                    fault = refuse(&walk, TRAILING, rest // 8)
                else:
                    fault = take(&walk, <int>rest, &bits)
                    if bits:
                        fault = refuse(&walk, PADDING, rest)
        if fault:
            return refusal(&walk, fault)
        values = empty_vector(np.NPY_INT64, walk.n_values)
        memcpy(int_data(values), walk.values, walk.n_values * sizeof(int64_t))
        return values, None
    finally:
        free(walk.values)
