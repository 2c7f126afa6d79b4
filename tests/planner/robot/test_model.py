"""Checks of configurations."""

import numpy as np
import pytest

from regrasp_planner.robot.model import check_configuration


def test_check_configuration_names_the_joint(panda):
    check_configuration(panda, panda.home)
    beyond = panda.home.copy()
    beyond[3] = 0.5
    with pytest.raises(ValueError, match=r"'joint4' is at 0\.5000 rad"):
        check_configuration(panda, beyond)
    with pytest.raises(ValueError, match="not finite"):
        check_configuration(panda, np.full(7, np.nan))
    with pytest.raises(ValueError, match=r"shape \(3,\)"):
        check_configuration(panda, np.zeros(3))
