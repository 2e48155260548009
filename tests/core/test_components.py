"""Connected components against scipy's, whose numbers they share."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from texfcodec.core.components import components


@pytest.mark.parametrize("seed", range(40))
def test_components_have_the_numbers_of_scipy(seed):
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 300))
    a, b = random.integers(0, count, (2, int(random.integers(0, 2 * count))))
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    assert np.array_equal(components(count, a, b), connected_components(graph, directed=False)[1])


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_a_long_chain_is_one_component(order):
    a = np.arange(20_000)[order]
    found = components(20_001, a + 1, a)
    assert found.dtype == np.int64 and (found == 0).all()


def test_nodes_without_edges_are_components_of_their_own():
    none = np.zeros(0, np.int64)
    assert components(3, none, none).tolist() == [0, 1, 2] and len(components(0, none, none)) == 0
