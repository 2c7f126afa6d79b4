"""How the commands of this package end: done, wrong use, or interrupted."""

from __future__ import annotations

import sys
from collections.abc import Callable

from regrasp_gym.errors import EnvError
from regrasp_train.errors import TrainError


def ended(command: str, work: Callable[[], int], interrupted: str) -> int:
    """Do the work of a command, and say in one line what stopped it.

    Args:
        command: its name, for messages.
        work: returns the exit status.
        interrupted: what to tell after Ctrl-C.

    Returns:
        Exit status: that of ``work``; 2 for wrong use; 130 for Ctrl-C.
    """
    # These need no more than the core, but load what the commands' --help does not need.
    from regrasp_datasets.records import DatasetError
    from regrasp_datasets.rollout import RolloutError

    try:
        return work()
    except (TrainError, DatasetError, RolloutError, EnvError) as error:
        print(f"{command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{command}: interrupted; {interrupted}", file=sys.stderr)
        return 130
