"""The part of a workspace that is connected to the home pose.

Across a singularity the margins may hold again, in an aspect that the machine cannot
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

from pincal.model.platform import Platform

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_ROUNDS = 6  # the nearest neighbours first: poses that hang together already are not joined again


class HomeComponent:
    """Decides which poses are connected to home, from poses that count and a test for more."""

    def __init__(self, platform: Platform, poses: Array, counts: Callable[[Array], Mask]) -> None:
        """Join sampled poses.

        Args:
            platform: The platform, whose home pose counts.
            poses: Sampled poses that count, coordinates of shape (M, dof).
            counts: Test for poses, shape (N, dof) to (N,).
        """
        self._platform = platform
        self._home = np.array([platform.home])
        poses = np.concatenate((self._home, poses))
        points = self._points(poses)
        self._scale = np.ptp(points, axis=0)
        self._scale[self._scale == 0.0] = 1.0
        self._tree = KDTree(points / self._scale)
        neighbours = min(len(poses), 4 * poses.shape[1] + 1)
        near = np.asarray(self._tree.query(points / self._scale, neighbours)[1])
        near = near.reshape(len(poses), -1)
        labels, joined = np.arange(len(poses)), np.empty((2, 0), dtype=near.dtype)
        for some in np.array_split(near, _ROUNDS, axis=1):
            pairs = np.stack((np.repeat(np.arange(len(poses)), some.shape[1]), some.ravel()))
            pairs = pairs[:, (pairs[0] < pairs[1]) & (labels[pairs[0]] != labels[pairs[1]])]
            first, second = pairs
            halfway = platform.twists_between(poses[first], poses[second]) / 2
            joined = np.hstack((joined, pairs[:, counts(platform.moved(poses[first], halfway))]))
            graph = coo_array((np.ones(joined.shape[1]), tuple(joined)), [len(poses)] * 2)
            _, labels = connected_components(graph, directed=False)
        self._connected = labels == labels[0]

    def __call__(self, poses: Array) -> Mask:
        """Return which poses, shape (N, dof), belong to the part connected to home."""
        nearest = self._tree.query(self._points(poses) / self._scale)[1]
        return np.asarray(self._connected[nearest])

    def _points(self, poses: Array) -> Array:
        """Return poses as twists from home, in which near poses are near, shape (N, dof)."""
        return self._platform.twists_between(np.repeat(self._home, len(poses), axis=0), poses)
