"""Axes along which the fingers close, from the width function of the target."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from regrasp_planner.geometry.hull import facets, qhull


def closing_axes(
    hull: Float[np.ndarray, "N 3"], max_width: float, max_axes: int, lean: float = 0.0
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Axes along which two parallel pads can hold a convex body: the local minima of its width function.

    At a critical direction of w(x) = h(x) + h(−x) the support points s(x) and s(−x) differ by a multiple of x: they
    are antipodal, with normals ±x. w is the support function of the difference body {a − b}. As for stable poses, its
    minima are the facets of that body that contain the foot of its centre. They are exact and need no iteration. Where
    minima crowd (around a can, all over a ball), a diverse subset is chosen.

    Friction also holds a body if the line between the contacts leans against their normals. So facets that do not
    contain the foot follow the minima, if the line to the edge that the foot lies farthest beyond leans by less than
    ``lean``.

    Args:
        hull: (N, 3) the body's vertices.
        max_width: widest graspable width, metres.
        max_axes: most axes to return.
        lean: largest angle between an axis and that line, radians; 0 for the minima alone.

    Returns:
        (m, 3) unit axes, the minima narrowest first, and (m,) widths, metres. Empty if the body is too wide everywhere.
    """
    corners = hull[qhull(hull).vertices]
    differences = (corners[:, None] - corners[None]).reshape(-1, 3)
    faces = facets(qhull(differences), np.zeros(3))
    leaning = np.maximum(np.arctan2(-faces.margins, faces.heights), 0.0)
    usable = np.flatnonzero(((faces.margins > 0) | (leaning < lean)) & (faces.heights <= max_width))
    # Sorted by width to the micrometre, so that rounding decides nothing.
    order = usable[np.lexsort((*faces.normals[usable].T, np.round(faces.heights[usable], 6), leaning[usable].round(3)))]
    axes, widths = faces.normals[order], faces.heights[order]
    chosen: list[int] = []
    along = np.abs(axes @ axes.T)
    # Coarser groups if there are more axes than wanted; each group contributes one.
    for degrees in (3.0, 8.0, 15.0, 25.0, 40.0):
        chosen, left = [], np.ones(len(axes), bool)
        while left.any():
            chosen.append(int(left.argmax()))
            left &= along[chosen[-1]] < np.cos(np.radians(degrees))
            left[chosen[-1]] = False
        if len(chosen) <= max_axes:
            break
    chosen = chosen[:max_axes]
    return axes[chosen], widths[chosen]
