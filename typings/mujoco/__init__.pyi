# MuJoCo's bindings are compiled and come without type information: everything in them is taken as Any.
from typing import Any

def __getattr__(name: str) -> Any: ...
