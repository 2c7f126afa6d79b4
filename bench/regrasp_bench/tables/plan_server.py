"""Plans on request, in a process of its own: one JSON object a line on standard input, one on standard output.

The interpreter of any checkout, even an older one, runs this file as a script. It therefore imports nothing of this
package, and uses only what every version has: ``gymnasium.make`` and the environments' ``plan``.
"""

import json
import sys
import time

BEGAN = time.perf_counter()


def main() -> None:
    """Make the environment named on the command line, then plan each requested seed."""
    out, sys.stdout = sys.stdout, sys.stderr
    import gymnasium

    import regrasp_gym  # noqa: F401  # pyright: ignore[reportUnusedImport]

    imported = time.perf_counter()
    env = gymnasium.make(sys.argv[1])
    env.reset(seed=0)
    made = time.perf_counter()
    print(json.dumps({"import": imported - BEGAN, "make and reset": made - imported}), file=out, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        env.reset(seed=request["seed"])
        began = time.perf_counter()
        plan = env.unwrapped.plan(request["strategy"], 0)  # pyright: ignore[reportAttributeAccessIssue]
        seconds = time.perf_counter() - began
        answer = {"success": plan.success, "stages": len(plan.stages), "seconds": seconds}
        answer["modules"] = {name: value for name, value in plan.stats.seconds.items() if name != "total"}
        print(json.dumps(answer), file=out, flush=True)


if __name__ == "__main__":
    main()
