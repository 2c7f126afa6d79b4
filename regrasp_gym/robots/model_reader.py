"""Look-ups in a compiled MuJoCo model, with messages that name what is missing."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from regrasp_planner import RegraspError


class RobotModelError(RegraspError, ValueError):
    """The model has no serial arm with a two-finger gripper under the given names."""


class ModelReader:
    """Finds the parts of one robot in a model."""

    def __init__(self, model: mujoco.MjModel, robot: str) -> None:
        self.model = model
        self.robot = robot

    def find(self, kind: mujoco.mjtObj, name: str) -> int:
        """Id of the object with this name.

        Raises:
            RobotModelError: the model has no such object.
        """
        index = mujoco.mj_name2id(self.model, kind, name)
        if index < 0:
            what = mujoco.mju_type2Str(kind)
            raise RobotModelError(f"the model has no {what} {name!r}, which robot {self.robot!r} names")
        return index

    def chain(self, base: int, joints: Sequence[int]) -> list[int]:
        """Bodies that the joints move.

        Raises:
            RobotModelError: the joints are not a serial chain of limited hinges from ``base``.
        """
        model, bodies, parent = self.model, [], base
        for joint in joints:
            body, name = int(model.jnt_bodyid[joint]), model.joint(joint).name
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
                raise RobotModelError(f"joint {name!r} of robot {self.robot!r} is not a hinge")
            if model.body_jntnum[body] != 1 or np.abs(model.jnt_pos[joint]).max() > 1e-9:
                raise RobotModelError(f"joint {name!r} must be the only joint of its body and sit at the body's origin")
            if not model.jnt_limited[joint]:
                raise RobotModelError(f"joint {name!r} of robot {self.robot!r} has no range")
            if self.ancestor(int(model.body_parentid[body]), [*bodies, base]) != parent:
                raise RobotModelError(
                    f"joint {name!r} of robot {self.robot!r} does not follow the joint named before it"
                )
            bodies.append(body)
            parent = body
        return bodies

    def ancestor(self, body: int, among: Sequence[int]) -> int | None:
        """The first of ``among`` on the way from ``body``, inclusive, to the world; None if there is none."""
        while body not in among:
            if body == 0:
                return None
            body = int(self.model.body_parentid[body])
        return body

    def parent_link(self, body: int, links: Sequence[int]) -> int | None:
        """Index in ``links`` of the nearest link above ``body``."""
        found = self.ancestor(int(self.model.body_parentid[body]), links)
        return None if found is None else links.index(found)

    def may_touch(self, a: int, b: int) -> bool:
        """Whether MuJoCo's contact masks and excluded body pairs let geoms ``a`` and ``b`` touch."""
        model = self.model
        masks = model.geom_contype[a] & model.geom_conaffinity[b] | model.geom_contype[b] & model.geom_conaffinity[a]
        low, high = sorted((int(model.geom_bodyid[a]), int(model.geom_bodyid[b])))
        return bool(masks) and (low << 16) + high not in model.exclude_signature
