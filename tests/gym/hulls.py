"""Exact distances of convex hulls, by Coal: the oracle of the scenes' gaps."""

from __future__ import annotations

import numpy as np
import pytest

coal = pytest.importorskip("coal")


def coal_hull(points):
    cloud = coal.StdVec_Vec3s()
    cloud.extend(list(np.asarray(points)))
    return coal.Convex.convexHull(cloud, False, "")


def hull_distance(a, b):
    result = coal.DistanceResult()
    pose = coal.Transform3s()
    return coal.distance(coal_hull(a), pose, coal_hull(b), pose, coal.DistanceRequest(), result)
