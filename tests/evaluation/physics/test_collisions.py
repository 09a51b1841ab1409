import pytest

from kinfeas.evaluation.physics.collisions import Encounters


def count(dt, *touched):
    encounters = Encounters(dt)
    for things in touched:
        encounters.add(things)
    return encounters.count


def test_nothing_touched_is_no_encounter():
    assert count(0.02) == count(0.02, (), ()) == 0


def test_contacts_that_flicker_are_one_encounter():
    assert count(0.02, *[(1,), ()] * 100) == 1


def test_a_second_thing_counts_beside_a_first():
    assert count(0.02, (1,), (1, 2), (1,), (1, 2), (2,)) == 2


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_a_thing_counts_again_after_half_a_second(dt):
    alone = round(0.5 / dt)
    assert count(dt, (1,), *[()] * (alone - 1), (1,)) == 1
    assert count(dt, (1,), *[()] * alone, (1,)) == 2
    # What touches another thing meanwhile has left the first one alone all the same.
    assert count(dt, (1,), *[(2,)] * alone, (1,)) == 3
