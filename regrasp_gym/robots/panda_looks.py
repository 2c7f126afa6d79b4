"""The Panda's outer shape."""

from __future__ import annotations

import mujoco


def add_looks(spec: mujoco.MjSpec) -> None:
    """Add the geoms that are seen (group 2) to the Panda's bodies."""
    white = spec.add_material(name="panda_white", rgba=[0.93, 0.94, 0.95, 1], specular=0.4, shininess=0.4)
    for geom in list(spec.geoms):
        if geom.group == 3:
            look = geom.parent.add_geom(
                type=geom.type,
                size=geom.size,
                pos=geom.pos,
                quat=geom.quat,
                group=2,
                contype=0,
                conaffinity=0,
                material=white.name,
            )
            look.fromto = geom.fromto
            look.alt.euler = geom.alt.euler
