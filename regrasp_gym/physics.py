"""Simulation options under which friction alone holds a grasped object."""

from __future__ import annotations

import mujoco

TIMESTEP = 0.002
"""Physics step, seconds (500 Hz)."""


def configure(spec: mujoco.MjSpec) -> None:
    """Set the integrator, the contact model and the rendering quality of ``spec``, in place.

    Elliptic friction cones with a high ``impratio`` keep grasped objects from creeping, and the no-slip pass removes
    what is left of it. Flat faces of meshes need several contact points (``multiccd``) or they rock. Smaller shadow
    maps and fewer samples make software rendering several times faster.
    """
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0
    option.noslip_iterations = 3
    option.iterations = 50
    option.tolerance = 1e-9
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    # Several contacts per pair of convex meshes: on by default since MuJoCo 3.5, an enable flag before.
    option.enableflags |= getattr(mujoco.mjtEnableBit, "mjENBL_MULTICCD", 0)
    spec.visual.quality.shadowsize = 1024
    spec.visual.quality.offsamples = 2
    spec.visual.global_.offwidth = 1280
    spec.visual.global_.offheight = 960
