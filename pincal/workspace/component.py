"""The part of a workspace that is connected to the home pose.

Beyond a singularity the margins may hold again, in an aspect that the machine cannot
enter. Sampled poses are joined to their neighbours where the midpoint counts too; what
hangs together with home is the part that can be driven to, and other poses belong where
their nearest sampled pose does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class HomeComponent:
    """Tells which poses are connected to home, from poses that count and a test for more."""

    def __init__(self, poses: Array, home: Array, counts: Callable[[Array], Mask]) -> None:
        """Join sampled poses.

        Args:
            poses: Sampled poses that count, coordinates of shape (M, dof).
            home: Home pose, shape (dof,).
            counts: Test for poses, shape (N, dof) to (N,).
        """
        poses = np.concatenate((home[None], poses))
        self._scale = np.ptp(poses, axis=0)
        self._scale[self._scale == 0.0] = 1.0
        self._tree = KDTree(poses / self._scale)
        neighbours = min(len(poses), 4 * poses.shape[1] + 1)
        near = np.asarray(self._tree.query(poses / self._scale, neighbours)[1])
        near = near.reshape(len(poses), -1)
        pairs = np.stack((np.repeat(np.arange(len(poses)), near.shape[1]), near.ravel()))
        pairs = pairs[:, pairs[0] < pairs[1]]
        pairs = pairs[:, counts((poses[pairs[0]] + poses[pairs[1]]) / 2)]
        graph = coo_array((np.ones(pairs.shape[1]), (pairs[0], pairs[1])), [len(poses)] * 2)
        _, labels = connected_components(graph, directed=False)
        self._connected = labels == labels[0]

    def __call__(self, poses: Array) -> Mask:
        """Return which poses, shape (N, dof), belong to the part connected to home."""
        return np.asarray(self._connected[self._tree.query(poses / self._scale)[1]])
