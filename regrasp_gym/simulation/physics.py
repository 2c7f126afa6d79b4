"""Simulation options under which friction alone holds a grasped object."""

from __future__ import annotations

import mujoco

TIMESTEP = 0.002
"""Physics step, seconds (500 Hz)."""

IMPRATIO = 100.0
"""How much harder contacts are along the surface than across it: what keeps a held object from creeping."""


def configure(spec: mujoco.MjSpec) -> None:
    """Set the integrator, the contact model and the rendering quality of ``spec``, in place.

    Elliptic friction cones with a high ``impratio`` hold a grasped object: over 20 s it creeps less than 0.2 mm,
    without the no-slip pass, which would cost as much as the rest of the step. What is left is MuJoCo's velocity-level
    friction, which loses about 1 mm per second while the hand turns at 2 rad/s, in proportion to the time constant of
    the pads' contacts; these are therefore as stiff as the time step allows. Shadow maps of 1024 texels make software
    rendering several times faster.
    """
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = IMPRATIO
    option.iterations = 50
    option.tolerance = 1e-9
    # MuJoCo 4.0.0 factors the Hessian wrongly where the constraint Jacobian is sparse, its default above 60 velocities
    # (fixed in 4.0.1); at the size of these scenes dense is as fast.
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    # Several contacts per pair of convex meshes: a default in recent versions, an enable flag before.
    option.enableflags |= getattr(mujoco.mjtEnableBit, "mjENBL_MULTICCD", 0)
    spec.visual.quality.shadowsize = 1024
    spec.visual.quality.offsamples = 2
    spec.visual.global_.offwidth = 1280
    spec.visual.global_.offheight = 960
