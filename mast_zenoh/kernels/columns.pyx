# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""Checks of the columns of messages. The references, in `codec`, say what each function does."""

import numpy as np

from cpython.buffer cimport (
    PyBUF_SIMPLE, PyBUF_STRIDES, PyBuffer_IsContiguous, PyBuffer_Release, PyObject_GetBuffer,
)
from libc.math cimport INFINITY

from mast_zenoh.kernels.table cimport SOURCE_DIGEST

DIGEST = SOURCE_DIGEST.decode()

cdef object ndarray = np.ndarray

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


def packed_columns(dict body, list plan):
    cdef tuple planned
    cdef list packed, dims
    cdef dict columns = {}
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
            array = np.empty(len(<list>data), object)
            array[:] = data
        elif type(data) is not bytes or len(<bytes>data) != <Py_ssize_t>planned[N_BYTES]:
            return None
        else:
            array = ndarray(planned[SHAPE], planned[DTYPE], data)
        columns[planned[NAME]] = array
    return columns


def exact_columns(body, list plan):
    cdef Py_buffer view
    cdef bint contiguous, locked
    cdef tuple planned
    cdef dict columns = {}
    for entry in plan:
        planned = <tuple>entry  # of a subclass
        array = body.get(planned[NAME])
        if type(array) is not ndarray or array.shape != planned[SHAPE]:
            return None
        dtype, found = planned[DTYPE], array.dtype
        if found is not dtype and found != (object if dtype is None else dtype):
            return None
        if dtype is not None:
            PyObject_GetBuffer(array, &view, PyBUF_STRIDES)
            contiguous, locked = PyBuffer_IsContiguous(&view, b"C"), view.readonly
            PyBuffer_Release(&view)
            if not contiguous:
                return None
            if not locked:
                array = array.view()
                array.setflags(False)
        columns[planned[NAME]] = array
    return columns


def sound_values(dict columns, list plan):
    cdef Py_buffer view
    cdef tuple planned
    cdef str kind
    cdef double squares = 0.0, own, limit
    cdef Py_ssize_t k
    cdef unsigned char highest
    for entry in plan:
        planned = <tuple>entry  # of a subclass
        array, kind, limit = columns[planned[NAME]], planned[DTYPE_NAME], planned[LIMIT]
        if planned[DTYPE] is None:
            for text in array:
                if not isinstance(text, str) or len(<str>text) > limit:
                    return INFINITY
        elif kind == "<f8":
            PyObject_GetBuffer(array, &view, PyBUF_SIMPLE)
            own = sum_of_squares(<const double*>view.buf, view.len // 8)
            PyBuffer_Release(&view)
            squares += own
            if own < limit:
                return INFINITY
        elif kind == "|u1":
            highest = 0
            PyObject_GetBuffer(array, &view, PyBUF_SIMPLE)
            for k in range(view.len):
                highest = max(highest, (<const unsigned char*>view.buf)[k])
            k = view.len
            PyBuffer_Release(&view)
            if k and highest >= limit:
                return INFINITY
    return squares
