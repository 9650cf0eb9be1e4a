# cython: language_level=3
"""Arrays as numbers in memory. A typed memory view costs more to make than most kernels take.

What may not lie in one piece goes through `whole` first, and what that returns is kept for as long as its numbers are
looked at.
"""

cimport numpy as np


cdef inline np.ndarray whole(np.ndarray array):
    """The array, or a copy of it, that lies in one piece."""
    return np.PyArray_GETCONTIGUOUS(array)


cdef inline void* numbers(np.ndarray array, int kind, int axes) except NULL:
    """Where the numbers of an array are; it must be of this kind, have so many axes, and lie in one piece."""
    if np.PyArray_TYPE(array) != kind or np.PyArray_NDIM(array) != axes or not np.PyArray_IS_C_CONTIGUOUS(array):
        raise ValueError(f"found {array.dtype} of {array.ndim} axes, expected type {kind} of {axes} axes in one piece")
    return np.PyArray_DATA(array)


cdef inline const double* floats(np.ndarray array, int axes) except NULL:
    return <const double*>numbers(array, np.NPY_DOUBLE, axes)


cdef inline double* writable(np.ndarray array, int axes) except NULL:
    """The same, to be written to."""
    if not np.PyArray_ISWRITEABLE(array):
        raise ValueError("found a read-only array, expected one that may be written to")
    return <double*>numbers(array, np.NPY_DOUBLE, axes)


cdef inline np.int64_t* ints(np.ndarray array) except NULL:
    return <np.int64_t*>numbers(array, np.NPY_INT64, 1)


cdef inline np.uint8_t* octets(np.ndarray array) except NULL:
    """Of (n,) uint8 or bool."""
    return <np.uint8_t*>numbers(array, np.NPY_BOOL if np.PyArray_TYPE(array) == np.NPY_BOOL else np.NPY_UINT8, 1)


cdef inline Py_ssize_t length(np.ndarray array, int axis=0) noexcept:
    return np.PyArray_DIM(array, axis)


cdef inline np.ndarray made(int kind, Py_ssize_t n):
    """(n,), of any numbers."""
    cdef np.npy_intp[1] shape
    shape[0] = n
    return np.PyArray_EMPTY(1, shape, kind, 0)


cdef inline np.ndarray zeros(int kind, Py_ssize_t n):
    """(n,)"""
    cdef np.npy_intp[1] shape
    shape[0] = n
    return np.PyArray_ZEROS(1, shape, kind, 0)


cdef inline np.ndarray table(Py_ssize_t n, Py_ssize_t m):
    """(n, m) float64, of any numbers."""
    cdef np.npy_intp[2] shape
    shape[0], shape[1] = n, m
    return np.PyArray_EMPTY(2, shape, np.NPY_DOUBLE, 0)


cdef inline np.ndarray squares(Py_ssize_t n, Py_ssize_t m):
    """(n, m, m) float64, of any numbers."""
    cdef np.npy_intp[3] shape
    shape[0], shape[1], shape[2] = n, m, m
    return np.PyArray_EMPTY(3, shape, np.NPY_DOUBLE, 0)
