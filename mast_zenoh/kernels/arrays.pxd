# cython: language_level=3
"""Raw data of NumPy arrays: creating a typed memory view takes longer than most kernels do.

Arrays that may not be C-contiguous go through `contiguous` first; keep its result for as long as the data is used.
"""

cimport numpy as np


cdef inline np.ndarray contiguous(np.ndarray array):
    """The array, or a C-contiguous copy of it."""
    return np.PyArray_GETCONTIGUOUS(array)


cdef inline void* data_pointer(np.ndarray array, int kind, int axes) except NULL:
    """The data of a C-contiguous array of this type and number of axes; ValueError for any other array."""
    if np.PyArray_TYPE(array) != kind or np.PyArray_NDIM(array) != axes or not np.PyArray_IS_C_CONTIGUOUS(array):
        raise ValueError(f"found {array.dtype} of {array.ndim} axes, expected C-contiguous type {kind} of {axes} axes")
    return np.PyArray_DATA(array)


cdef inline const double* float_data(np.ndarray array, int axes) except NULL:
    return <const double*>data_pointer(array, np.NPY_DOUBLE, axes)


cdef inline double* writable_data(np.ndarray array, int axes) except NULL:
    """As `float_data`, for an array that is written to."""
    if not np.PyArray_ISWRITEABLE(array):
        raise ValueError("found a read-only array, expected a writable one")
    return <double*>data_pointer(array, np.NPY_DOUBLE, axes)


cdef inline np.int64_t* int_data(np.ndarray array) except NULL:
    return <np.int64_t*>data_pointer(array, np.NPY_INT64, 1)


cdef inline np.uint8_t* byte_data(np.ndarray array) except NULL:
    """The data of an (n,) array of uint8 or bool."""
    return <np.uint8_t*>data_pointer(array, np.NPY_BOOL if np.PyArray_TYPE(array) == np.NPY_BOOL else np.NPY_UINT8, 1)


cdef inline Py_ssize_t length(np.ndarray array, int axis=0) noexcept:
    return np.PyArray_DIM(array, axis)


cdef inline np.ndarray empty_vector(int kind, Py_ssize_t n):
    """(n,), uninitialised."""
    cdef np.npy_intp[1] shape
    shape[0] = n
    return np.PyArray_EMPTY(1, shape, kind, 0)


cdef inline np.ndarray zero_vector(int kind, Py_ssize_t n):
    """(n,) zeros."""
    cdef np.npy_intp[1] shape
    shape[0] = n
    return np.PyArray_ZEROS(1, shape, kind, 0)


cdef inline np.ndarray empty_matrix(Py_ssize_t n, Py_ssize_t m):
    """(n, m) float64, uninitialised."""
    cdef np.npy_intp[2] shape
    shape[0], shape[1] = n, m
    return np.PyArray_EMPTY(2, shape, np.NPY_DOUBLE, 0)


cdef inline np.ndarray empty_matrices(Py_ssize_t n, Py_ssize_t m):
    """(n, m, m) float64, uninitialised."""
    cdef np.npy_intp[3] shape
    shape[0], shape[1], shape[2] = n, m, m
    return np.PyArray_EMPTY(3, shape, np.NPY_DOUBLE, 0)
