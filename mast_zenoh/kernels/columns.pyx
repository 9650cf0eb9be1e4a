# cython: language_level=3, cdivision=True
"""Checks of the columns of messages. The references, in `columns`, say what each function does."""

cimport numpy as np
from libc.math cimport INFINITY

import numpy

from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef enum:  # places in the planned columns
    NAME, DTYPE, DTYPE_NAME, SHAPE, DIMS, N_BYTES, LIMIT


cdef double sum_of_squares(const double* values, Py_ssize_t n) noexcept nogil:
    cdef double a = 0.0, b = 0.0, c = 0.0, d = 0.0
    cdef Py_ssize_t k = 0
    while k + 4 <= n:  # four sums, none of which has to wait for another
        a += values[k] * values[k]
        b += values[k + 1] * values[k + 1]
        c += values[k + 2] * values[k + 2]
        d += values[k + 3] * values[k + 3]
        k += 4
    while k < n:
        a += values[k] * values[k]
        k += 1
    return (a + b) + (c + d)


cdef np.ndarray read_only(object owner, void* data, int axes, np.npy_intp* shape, int kind):
    """An array of the numbers at `data`, which belong to `owner`."""
    cdef np.ndarray array = np.PyArray_SimpleNewFromData(axes, shape, kind, data)
    np.set_array_base(array, owner)
    np.PyArray_CLEARFLAGS(array, np.NPY_ARRAY_WRITEABLE)
    return array


def packed_columns(dict body, list plan):
    cdef tuple planned, sizes
    cdef list packed, dims
    cdef dict columns = {}
    cdef Py_ssize_t axis
    cdef np.npy_intp[np.NPY_MAXDIMS] shape
    for entry in plan:
        planned = <tuple>entry  # of a subclass
        found = body.get(planned[NAME])
        if type(found) is not list or len(<list>found) != 3:
            return None
        packed = found
        if packed[0] != planned[DTYPE_NAME] or type(packed[1]) is not list or packed[1] != planned[DIMS]:
            return None
        dims, data = packed[1], packed[2]
        for size in dims:
            if type(size) is not int:
                return None
        if planned[DTYPE] is None:
            if type(data) is not list or [len(<list>data)] != dims:
                return None
            for text in data:
                if type(text) is not str:
                    return None
            array = numpy.empty(len(<list>data), object)
            array[:] = data
        elif type(data) is not bytes or len(<bytes>data) != <Py_ssize_t>planned[N_BYTES]:
            return None
        else:
            sizes = planned[SHAPE]
            for axis in range(len(sizes)):
                shape[axis] = sizes[axis]
            array = read_only(data, <char*><bytes>data, <int>len(sizes), shape, (<np.dtype>planned[DTYPE]).type_num)
        columns[planned[NAME]] = array
    return columns


def exact_columns(body, list plan):
    cdef np.ndarray array
    cdef tuple planned, sizes
    cdef dict columns = {}
    cdef Py_ssize_t axis, axes
    for entry in plan:
        planned = <tuple>entry  # of a subclass
        found = body.get(planned[NAME])
        if not np.PyArray_CheckExact(found):
            return None
        array, sizes, dtype = found, planned[SHAPE], planned[DTYPE]
        axes = len(sizes)
        own = array.dtype
        if np.PyArray_NDIM(array) != axes or (own is not dtype and own != (object if dtype is None else dtype)):
            return None
        for axis in range(axes):
            if np.PyArray_DIM(array, axis) != <Py_ssize_t>sizes[axis]:
                return None
        if dtype is not None:
            if not np.PyArray_IS_C_CONTIGUOUS(array):
                return None
            if np.PyArray_ISWRITEABLE(array):
                array = read_only(
                    array, np.PyArray_DATA(array), <int>axes, np.PyArray_DIMS(array), np.PyArray_TYPE(array)
                )
        columns[planned[NAME]] = array
    return columns


def sound_values(dict columns, list plan):
    cdef np.ndarray array
    cdef tuple planned
    cdef str kind
    cdef double squares = 0.0, own, limit
    cdef Py_ssize_t k
    cdef np.uint8_t highest
    cdef const np.uint8_t* octets
    for entry in plan:
        planned = <tuple>entry  # of a subclass
        array, kind, limit = columns[planned[NAME]], planned[DTYPE_NAME], planned[LIMIT]
        if planned[DTYPE] is None:
            for text in array:
                if not isinstance(text, str) or len(<str>text) > limit:
                    return INFINITY
        elif kind == "<f8":
            own = sum_of_squares(<const double*>np.PyArray_DATA(array), np.PyArray_SIZE(array))
            squares += own
            if own < limit:
                return INFINITY
        elif kind == "|u1":
            highest, octets = 0, <const np.uint8_t*>np.PyArray_DATA(array)
            for k in range(np.PyArray_SIZE(array)):
                highest = max(highest, octets[k])
            if np.PyArray_SIZE(array) and highest >= limit:
                return INFINITY
    return squares
