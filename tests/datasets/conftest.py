"""The scripted experts are imported by name in worker processes, which take over this process's module path."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
