import numpy as np

from kinfeas.core.motion import merged, of_rows, with_rows

ROWS = np.array([2, 0])


def test_rows_are_replaced_in_a_copy():
    array = np.arange(6.0).reshape(3, 2)
    changed = with_rows(array, ROWS, np.array([[7.0, 8.0], [9.0, 10.0]]))
    assert changed.tolist() == [[9.0, 10.0], [2.0, 3.0], [7.0, 8.0]]
    assert array.tolist() == [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]


def test_a_state_of_rows_goes_back_to_where_it_came_from():
    state = {"a": np.arange(3.0), "b": np.arange(6).reshape(3, 2)}
    again = merged(state, ROWS, of_rows(state, ROWS), 3)
    assert again.keys() == state.keys()
    for key, values in again.items():
        np.testing.assert_array_equal(values, state[key])
        assert values.dtype == state[key].dtype


def test_an_empty_state_is_zero_in_all_other_rows():
    fresh = merged({}, ROWS, {"a": np.array([5, 6])}, 4)
    assert fresh["a"].tolist() == [6, 0, 5, 0]
    assert fresh["a"].dtype == np.dtype(int)


def test_a_state_of_all_rows_is_taken_as_it_is():
    values = {"a": np.array([5.0, 6.0])}
    assert merged({}, np.array([0, 1]), values, 2) is values
