# cython: language_level=3, cdivision=True
"""Kernels that check the columns of messages. The NumPy references in `messages.layout` document them."""

cimport numpy as np
from cpython.bytes cimport PyBytes_FromStringAndSize
from cpython.unicode cimport PyUnicode_DecodeASCII
from libc.math cimport INFINITY
from libc.string cimport memcmp

import numpy

from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

ctypedef fused real:
    float
    double


cdef double sum_of_squares(const real* values, Py_ssize_t n) noexcept nogil:
    cdef double a = 0.0, b = 0.0, c = 0.0, d = 0.0
    cdef Py_ssize_t k = 0
    while k + 4 <= n:  # four independent sums, which the processor computes in parallel
        a += <double>values[k] * values[k]
        b += <double>values[k + 1] * values[k + 1]
        c += <double>values[k + 2] * values[k + 2]
        d += <double>values[k + 3] * values[k + 3]
        k += 4
    while k < n:
        a += <double>values[k] * values[k]
        k += 1
    return (a + b) + (c + d)


cdef np.ndarray read_only(object owner, void* data, int axes, np.npy_intp* shape, int kind):
    """A read-only array over the data of `owner`."""
    cdef np.ndarray array = np.PyArray_SimpleNewFromData(axes, shape, kind, data)
    np.set_array_base(array, owner)
    np.PyArray_CLEARFLAGS(array, np.NPY_ARRAY_WRITEABLE)
    return array


def packed_columns(body, plan):
    cdef tuple names = plan.names, dtypes = plan.dtypes, shapes = plan.shapes, expected = plan.packed, sizes
    cdef list packed
    cdef dict columns = {}
    cdef Py_ssize_t column, axis
    cdef np.npy_intp[np.NPY_MAXDIMS] shape
    cdef np.dtype dtype
    for column in range(len(names)):
        value = body.get(names[column])
        if type(value) is not list or len(<list>value) != 3:
            return None
        packed, dtype = value, dtypes[column]
        dtype_name, dims, n_bytes = expected[column]
        if packed[0] != dtype_name or type(packed[1]) is not list or packed[1] != dims:
            return None
        for size in <list>packed[1]:
            if type(size) is not int:
                return None
        data = packed[2]
        if dtype.type_num == np.NPY_OBJECT:
            if type(data) is not list or [len(<list>data)] != dims:
                return None
            for text in <list>data:
                if type(text) is not str:
                    return None
            array = numpy.empty(len(<list>data), object)
            array[:] = data
        elif type(data) is not bytes or len(<bytes>data) != <Py_ssize_t>n_bytes:
            return None
        else:
            sizes = shapes[column]
            for axis in range(len(sizes)):
                shape[axis] = sizes[axis]
            array = read_only(data, <char*><bytes>data, <int>len(sizes), shape, dtype.type_num)
        columns[names[column]] = array
    return columns


cdef Py_ssize_t text_at(const unsigned char* begin, Py_ssize_t* place, Py_ssize_t end) noexcept:
    """The length of the short ASCII text at a place, which is moved to its first character; -1 if there is none."""
    cdef Py_ssize_t n_bytes, k
    if place[0] >= end or begin[place[0]] < 0xA0 or begin[place[0]] > 0xBF:
        return -1
    n_bytes = begin[place[0]] - 0xA0
    place[0] += 1
    if end - place[0] < n_bytes:
        return -1
    for k in range(place[0], place[0] + n_bytes):
        if begin[k] >= 128:
            return -1
    return n_bytes


cdef long long number_at(const unsigned char* begin, Py_ssize_t* place, Py_ssize_t end, bytes name) noexcept:
    """The whole number after a name at a place, which is moved behind it; -1 if there is none."""
    cdef Py_ssize_t n_bytes = len(name), k
    cdef unsigned long long number = 0
    if end - place[0] <= n_bytes or memcmp(begin + place[0], <const char*>name, n_bytes) != 0:
        return -1
    place[0] += n_bytes
    cdef unsigned char first = begin[place[0]]
    place[0] += 1
    if first < 128:
        return first
    if first < 0xCC or first > 0xCF:
        return -1
    n_bytes = 1 << (first - 0xCC)
    if end - place[0] < n_bytes:
        return -1
    for k in range(place[0], place[0] + n_bytes):
        number = (number << 8) | begin[k]
    place[0] += n_bytes
    return <long long>number if number < 1ULL << 63 else -1


def split_header(bytes payload, bytes prefix):
    cdef const unsigned char* begin = payload
    cdef Py_ssize_t end = len(payload), place = len(prefix), n_bytes
    cdef long long frame, time_ns, seq
    if end < place or memcmp(begin, <const char*>prefix, place) != 0:
        return None
    n_bytes = text_at(begin, &place, end)
    if n_bytes < 0:
        return None
    source = PyUnicode_DecodeASCII(<const char*>begin + place, n_bytes, NULL)
    place += n_bytes
    frame = number_at(begin, &place, end, b"\xa5frame")
    time_ns = number_at(begin, &place, end, b"\xa7time_ns")
    seq = number_at(begin, &place, end, b"\xa3seq")
    if frame < 0 or time_ns < 0 or seq < 0:
        return None
    return source, frame, time_ns, seq, place


def split_columns(bytes payload, Py_ssize_t place, plan):
    cdef tuple names = plan.names, dtypes = plan.dtypes, shapes = plan.shapes, prefixes = plan.prefixes
    cdef tuple packed = plan.packed, sizes
    cdef bytes prefix, data
    cdef const char* begin = payload
    cdef Py_ssize_t end = len(payload), column, axis, n_bytes, row
    cdef np.npy_intp[np.NPY_MAXDIMS] shape
    cdef np.dtype dtype
    cdef np.ndarray array
    cdef dict columns = {}
    for column in range(len(names)):
        prefix, dtype, sizes = prefixes[column], dtypes[column], shapes[column]
        n_bytes = len(prefix)
        if end - place < n_bytes or memcmp(begin + place, <const char*>prefix, n_bytes) != 0:
            return None
        place += n_bytes
        if dtype.type_num == np.NPY_OBJECT:
            array = numpy.empty(sizes, object)
            for row in range(len(array)):
                n_bytes = text_at(<const unsigned char*>begin, &place, end)
                if n_bytes < 0:
                    return None
                array[row] = PyUnicode_DecodeASCII(begin + place, n_bytes, NULL)
                place += n_bytes
        else:
            n_bytes = (<tuple>packed[column])[2]
            if end - place < n_bytes:
                return None
            data = PyBytes_FromStringAndSize(begin + place, n_bytes)
            for axis in range(len(sizes)):
                shape[axis] = sizes[axis]
            array = read_only(data, <char*>data, <int>len(sizes), shape, dtype.type_num)
            place += n_bytes
        columns[names[column]] = array
    return columns if place == end else None


def exact_columns(body, tuple names, tuple dtypes, tuple shapes):
    cdef np.ndarray array
    cdef np.dtype dtype
    cdef tuple sizes
    cdef dict columns = {}
    cdef Py_ssize_t column, axis, axes
    for column in range(len(names)):
        value = body.get(names[column])
        if not np.PyArray_CheckExact(value):
            return None
        array, sizes, dtype = value, shapes[column], dtypes[column]
        axes = len(sizes)
        array_dtype = array.dtype
        if np.PyArray_NDIM(array) != axes or np.PyArray_TYPE(array) != dtype.type_num:
            return None
        if array_dtype is not dtype and array_dtype != dtype:  # another byte order
            return None
        for axis in range(axes):
            if np.PyArray_DIM(array, axis) != <Py_ssize_t>sizes[axis]:
                return None
        if np.PyArray_TYPE(array) != np.NPY_OBJECT:
            if not np.PyArray_IS_C_CONTIGUOUS(array):
                return None
            if np.PyArray_ISWRITEABLE(array):
                array = read_only(
                    array, np.PyArray_DATA(array), <int>axes, np.PyArray_DIMS(array), np.PyArray_TYPE(array)
                )
        columns[names[column]] = array
    return columns


def sound_values(dict columns, tuple names, tuple limits):
    cdef np.ndarray array
    cdef double squares = 0.0, column_squares, limit
    cdef Py_ssize_t column, k
    cdef int kind
    cdef np.uint8_t highest
    cdef const np.uint8_t* octets
    for column in range(len(names)):
        array, limit = columns[names[column]], limits[column]
        kind = np.PyArray_TYPE(array)
        if kind == np.NPY_OBJECT:
            for text in array:
                if not isinstance(text, str) or len(<str>text) > limit:
                    return INFINITY
        elif kind == np.NPY_DOUBLE or kind == np.NPY_FLOAT:
            if kind == np.NPY_DOUBLE:
                column_squares = sum_of_squares(<const double*>np.PyArray_DATA(array), np.PyArray_SIZE(array))
            else:
                column_squares = sum_of_squares(<const float*>np.PyArray_DATA(array), np.PyArray_SIZE(array))
            squares += column_squares
            if column_squares < limit:
                return INFINITY
        elif kind == np.NPY_UINT8:
            highest, octets = 0, <const np.uint8_t*>np.PyArray_DATA(array)
            for k in range(np.PyArray_SIZE(array)):
                highest = max(highest, octets[k])
            if np.PyArray_SIZE(array) and highest >= limit:
                return INFINITY
    return squares
