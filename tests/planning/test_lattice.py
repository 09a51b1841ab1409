import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from kinfeas.planning.lattice import UNSEEN, path_to, search_grid

CELL, LEVEL = 0.2, 0.3


def graph(free, cost):
    """Return the costs of moves between neighbouring nodes of a grid, shape (n, n)."""
    nodes = np.argwhere(free)
    number = np.full(free.shape, -1)
    number[free] = np.arange(len(nodes))
    edges = []
    moves = [(i, j, 0) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j] + [(0, 0, 1), (0, 0, -1)]
    for move in moves:
        ends = nodes + move
        inside = np.all((ends >= 0) & (ends < free.shape), axis=1)
        inside[inside] = free[tuple(ends[inside].T)]
        a, b = nodes[inside], ends[inside]
        length = np.linalg.norm(move * np.array([CELL, CELL, LEVEL]))
        metre = 0.5 * (cost[a[:, 0], a[:, 1]] + cost[b[:, 0], b[:, 1]])
        edges.append([number[tuple(a.T)], number[tuple(b.T)], length * metre])
    start, end, weight = np.concatenate(edges, axis=1)
    pairs = start.astype(int), end.astype(int)
    return number, coo_array((weight, pairs), shape=(len(nodes), len(nodes)))


@pytest.mark.parametrize("heights", [1, 4])
def test_costs_are_those_of_dijkstra_and_a_goal_ends_the_search_early(heights):
    rng = np.random.default_rng(heights)
    free, cost = rng.random((20, 15, heights)) > 0.3, rng.uniform(1.0, 5.0, (20, 15))
    sources = rng.choice(np.flatnonzero(free), 2, replace=False)
    begin = np.array([0.4, 0.0])
    number, edges = graph(free, cost)
    exact = (dijkstra(edges, indices=number.flat[sources]) + begin[:, np.newaxis]).min(axis=0)
    everywhere = search_grid(free, cost, CELL, LEVEL, sources, begin, -1)
    reached = everywhere.slot != UNSEEN
    np.testing.assert_array_equal(reached[free.ravel()], np.isfinite(exact))
    assert not reached[~free.ravel()].any()
    np.testing.assert_allclose(everywhere.cost[reached], exact[number.flat[reached]], rtol=1e-12)
    goal = int(np.flatnonzero(reached)[-1])
    early = search_grid(free, cost, CELL, LEVEL, sources, begin, goal)
    assert early.cost[goal] == pytest.approx(everywhere.cost[goal], rel=1e-12)
    assert (early.slot != UNSEEN).sum() < reached.sum()
    path = path_to(early, goal)
    assert path[0] in sources and path[-1] == goal
