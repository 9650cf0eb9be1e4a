# cython: language_level=3, cdivision=True
"""Kernels that check the columns of messages. The NumPy references in `messages.layout` document them."""

cimport numpy as np
from libc.math cimport INFINITY

import numpy

from mast_zenoh.kernels.table cimport SOURCE_DIGEST

np.import_array()
DIGEST = SOURCE_DIGEST.decode()

cdef double sum_of_squares(const double* values, Py_ssize_t n) noexcept nogil:
    cdef double a = 0.0, b = 0.0, c = 0.0, d = 0.0
    cdef Py_ssize_t k = 0
    while k + 4 <= n:  # four independent sums, which the processor computes in parallel
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


def exact_columns(body, tuple names, tuple dtypes, tuple shapes):
    cdef np.ndarray array
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
        if np.PyArray_NDIM(array) != axes or (array_dtype is not dtype and array_dtype != dtype):
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
        elif kind == np.NPY_DOUBLE:
            column_squares = sum_of_squares(<const double*>np.PyArray_DATA(array), np.PyArray_SIZE(array))
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
