"""What runs CoACD in a process of its own: ``python run_coacd.py MESH PIECES OPTIONS``.

MESH is an .npz file with ``vertices`` and ``faces``, PIECES the one to write, OPTIONS those of CoACD as JSON. Meshes
that run through themselves may crash CoACD, and this process with it, but not the one that asked.
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
