"""What the light tree keeps of lights and of clusters of them: kinds of nodes, and the columns of their values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

CLUSTER, LAMP, TRIANGLE, SUN, WORLD = range(5)  # kinds of nodes

# columns of LightTree.values
# box: centre, half sides, half diagonal; axis of the cone
CX, CY, CZ, HX, HY, HZ, RADIUS, AX, AY, AZ = range(10)
# the cone of the lights' axes: cos and sin of its half angle; cos of that plus the angle of emission; the share of
# importance against the axis; radiance times area
COS_O, SIN_O, COS_OE, BEHIND, ENERGY = range(10, 15)
KIND = 15  # as LightTree.kind
# how a lamp's intensity falls off with the cosine c to its axis: smoothstep((c - EDGE) * STEEP), and a factor
# LAMBERT ? c : 1, and a factor 1 - GRID * tan
EDGE, STEEP, LAMBERT, GRID = range(16, 20)
COLUMNS = 20
ALWAYS = -2  # in place of a light's node: it is not in the tree, for every point samples it


class LightTree(NamedTuple):
    """Nodes over all lights: near lights in the order of the tree, distant ones, then clusters.

    A cluster has two children, side by side, or none: then it is a bucket of few lights, all weighed.
    """

    kind: np.ndarray  # (M,) uint8
    item: np.ndarray  # (M,) int32: lamp or emitter; a cluster's first child, -1: it is a bucket
    span: np.ndarray  # (M, 2) int32: first and behind-last light of a cluster
    parent: np.ndarray  # (M,) int32, -1 where none
    top: np.ndarray  # (M,) int32: place in `tops`, -1 below and above them
    tops: np.ndarray  # (K,) int32: the nodes among which a light is first chosen; they cover each light once
    values: np.ndarray  # (M, COLUMNS) float64
    leaf_of_lamp: np.ndarray  # (L,) int32, or ALWAYS, here and below
    leaf_of_emitter: np.ndarray  # (E,) int32
    leaf_of_world: int  # -1: not sampled
