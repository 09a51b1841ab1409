"""Motions of n EEs, each made by the generator of its sub-goal."""

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.execution import SubgoalMotion
from kinfeas.core.checks import CheckedMotion
from kinfeas.core.motion import Rows, State, merged, of_rows, with_rows
from kinfeas.core.spatial import Array

_STATES = "motion."


class Motions(NamedTuple):
    """The motions of r rows, which one generator makes."""

    number: int  # of the generator
    generator: CheckedMotion  # of these motions
    rows: Rows  # which of the n motions they are, shape (r,)
    state: State  # state of the generator for them


class EeMotions:
    """n motions, each made by the generator of its sub-goal.

    Arrays are replaced, never written into, since others may hold them.

    Attributes:
        generators: Generators of the sub-goals, each once.
        states: State of each generator for all n motions; empty before its first one.
        which: Index in `generators` of the one that makes each motion, shape (n,).
    """

    def __init__(self, subgoals: Sequence[SubgoalMotion]) -> None:
        distinct = {
            id(subgoal.generator): CheckedMotion(subgoal.generator, subgoal.name)
            for subgoal in subgoals
        }
        self.generators, order = tuple(distinct.values()), list(distinct)
        self._of_subgoal = np.array([order.index(id(subgoal.generator)) for subgoal in subgoals])
        self.clear(np.empty(0, dtype=np.intp))

    def clear(self, subgoal: NDArray[np.intp]) -> None:
        """Forget the states, and `assign` motions to the generators of sub-goals, shape (n,)."""
        self.states: list[State] = [{} for _ in self.generators]
        self.assign(subgoal)

    def assign(self, subgoal: NDArray[np.intp]) -> None:
        """Let the generators of sub-goals of these numbers, shape (n,), make the motions."""
        self.which: NDArray[np.intp] = self._of_subgoal[subgoal]

    def of(self, rows: Rows | None = None) -> list[Motions]:
        """Return the motions in some ascending rows, all by default, grouped by generator."""
        rows = np.arange(len(self.which)) if rows is None else rows
        groups = [rows]
        if len(self.generators) > 1:
            which = self.which[rows]
            groups = [rows[which == number] for number in range(len(self.generators))]
        return [self._made_by(number, group) for number, group in enumerate(groups) if group.size]

    def put(self, motions: Motions, state: State) -> None:
        """Replace the state of motions that `of` returned."""
        number, _, rows, _ = motions
        self.states[number] = merged(self.states[number], rows, state, len(self.which))

    def ask(self, question: Callable[[Motions], Array]) -> Array:
        """Return the generators' answers about their motions, in the order of all n, (n, ...)."""
        groups = self.of()
        answers = [question(group) for group in groups]
        if len(answers) == 1:
            return answers[0]
        order = np.concatenate([group.rows for group in groups]).argsort()
        return np.concatenate(answers)[order]

    def twist(self, poses: Array, targets: Array, seconds: Array) -> tuple[Array, list[State]]:
        """Return the world twists of the next step, shape (n, 6), and the states after it.

        Motions of 0 seconds rest. The motions themselves do not advance; see `move`.

        Args:
            poses: World poses of the frames that move, shape (n, 7).
            targets: World poses of their targets, shape (n, 7).
            seconds: Duration of each step, shape (n,).
        """
        if len(self.generators) == 1 and seconds.all():  # nothing to copy
            twist, after = self.generators[0].twist(self.states[0], poses, targets, seconds)
            return twist, [after]
        twist, states = np.zeros((len(poses), 6)), list(self.states)
        for number, generator, rows, state in self.of(np.flatnonzero(seconds)):
            twist[rows], after = generator.twist(state, poses[rows], targets[rows], seconds[rows])
            states[number] = merged(states[number], rows, after, len(poses))
        return twist, states

    def move(self, states: Sequence[State], paused: NDArray[np.bool_] | None = None) -> None:
        """Go on to `states`, except for motions that are `paused`, shape (n,)."""
        if paused is not None:
            rows, pairs = np.flatnonzero(paused), zip(states, self.states, strict=True)
            states = [
                {key: with_rows(new, rows, old[key][rows]) for key, new in state.items()}
                for state, old in pairs
            ]
        self.states = list(states)

    def at(self, states: Sequence[State]) -> "EeMotions":
        """Return a copy of the motions in other states, which advances independently."""
        other = copy.copy(self)
        other.states = list(states)
        return other

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the states as arrays by name."""
        return {
            f"{_STATES}{number}.{key}": values
            for number, state in enumerate(self.states)
            for key, values in state.items()
        }

    def restore(self, snapshot: Mapping[str, NDArray[Any]], subgoal: NDArray[np.intp]) -> None:
        """Continue from states that `snapshot` returned."""
        self.clear(subgoal)
        for name, values in snapshot.items():
            if name.startswith(_STATES):
                number, _, key = name.removeprefix(_STATES).partition(".")
                self.states[int(number)][key] = values.copy()

    def _made_by(self, number: int, rows: Rows) -> Motions:
        state = self.states[number]
        if len(rows) < len(self.which):
            state = of_rows(state, rows)
        return Motions(number, self.generators[number], rows, state)
