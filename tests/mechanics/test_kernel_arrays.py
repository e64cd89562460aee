"""Arrays that compiled code borrows or copies."""

import sys

import numpy as np

from protochain.core.compilation import njit
from protochain.mechanics.multibody.kernel_arrays import borrow, copy, copy_row, scatter


@njit
def put_sum(arrays, out):
    (first, pair), flag, empty = borrow(arrays)
    table, places = pair
    out[0] = np.sum(first) + table[1, 2] + places[-1] + (10.0 if flag else 0.0) + len(empty)
    first[0] = -1.0


@njit
def keep_borrowed(source):
    return borrow((source,))[0].copy()


@njit
def sum_in_turn(arrays, n):
    """Take arrays from tuples in a loop, so that their counts cannot be removed otherwise."""
    total, borrowed = 0.0, borrow(arrays)
    for i in range(n):
        table, (rows, places) = borrowed
        chosen = rows if places[i % len(places)] > i else table
        total += chosen[i % len(chosen)]
    return total


def test_references_of_borrowed_arrays_are_not_counted():
    assert sum_in_turn((np.arange(3.0), (np.arange(4.0), np.arange(2))), 9) == 9.0
    (code,) = sum_in_turn.inspect_llvm().values()
    assert "call void @NRT_decref" in code  # Of the arguments: these are the names of the functions.
    assert "call void @NRT_incref" not in code


def test_borrowed_arrays_are_the_same_arrays_and_outlive_the_call():
    first, table, places = np.arange(3.0), np.arange(6.0).reshape(2, 3), np.array([3, 7])
    counts = [sys.getrefcount(array) for array in (first, table, places)]
    out = np.zeros(1)
    put_sum(((first, (table, places)), True, np.empty(0)), out)
    assert out[0] == 3.0 + 5.0 + 7.0 + 10.0 and first[0] == -1.0
    assert [sys.getrefcount(array) for array in (first, table, places)] == counts
    assert np.array_equal(keep_borrowed(table[0]), table[0])


def test_copies_fill_a_vector_a_row_and_places_only():
    source, vector, table = np.array([1.0, 2.0]), np.zeros(3), np.zeros((2, 3))
    copy(source, vector)
    assert vector.tolist() == [1.0, 2.0, 0.0]
    copy_row(source, table, 1)
    assert table.tolist() == [[0.0, 0.0, 0.0], [1.0, 2.0, 0.0]]
    scatter(source, np.array([2, 0]), vector)
    assert vector.tolist() == [2.0, 2.0, 1.0]
