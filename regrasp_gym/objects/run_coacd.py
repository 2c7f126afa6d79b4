"""Run CoACD in its own process: ``python run_coacd.py MESH PIECES OPTIONS``.

MESH is an .npz file with ``vertices`` and ``faces``, PIECES the file to write, OPTIONS CoACD's options as JSON. A
self-intersecting mesh can crash CoACD: it then takes down this process alone.
"""

from __future__ import annotations

import json
import sys

import numpy as np


def main() -> None:
    """Entry point."""
    import coacd

    given, made, options = sys.argv[1:]
    coacd.set_log_level("error")
    with np.load(given) as mesh:
        parts = coacd.run_coacd(coacd.Mesh(mesh["vertices"], mesh["faces"]), **json.loads(options))
    np.savez_compressed(made, **{f"piece_{k}": points for k, (points, _) in enumerate(parts)})


if __name__ == "__main__":
    main()
