"""Import of the libraries that are compared with the planner; they are optional."""

from __future__ import annotations

import importlib
from types import ModuleType

from regrasp_gym.errors import BenchError


def import_peer(module: str) -> ModuleType:
    """Import a module of the extra ``bench``.

    Raises:
        BenchError: it cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        message = f"this benchmark needs {module}: pip install 'regrasp-gym[bench]' ({error})"
        raise BenchError(message) from error
