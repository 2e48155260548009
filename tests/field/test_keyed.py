"""What a support keeps for the planes on it."""

import numpy as np

from texfcodec.codecs.raht.attribute_coder import octree_of
from texfcodec.codecs.raht.transform.octree import Octree
from texfcodec.field.voxels import VoxelSupport


def test_what_is_kept_is_made_once_and_again_after_it_was_let_go():
    support, made = VoxelSupport(4, np.arange(8)), []
    for _ in range(2):
        assert support.kept("a", lambda: made.append(1) or len(made)) == 1
    assert support.kept("b", lambda: 7) == 7
    support.forget()
    assert support.kept("a", lambda: made.append(1) or len(made)) == 2


def test_the_octree_of_a_support_is_one_and_no_other_support_has_it():
    support = VoxelSupport(4, np.arange(8))
    assert octree_of(support) is octree_of(support) and octree_of(support).levels[-1].weight.tolist() == 8 * [1]
    assert octree_of(support.coarser(1)) is not octree_of(support)
    assert isinstance(octree_of(support), Octree) and "_kept" not in vars(support.coarser(1))
