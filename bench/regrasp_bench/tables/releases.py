"""Non-static releases: whether what is let go tilted settles in MuJoCo into the pose that was predicted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from regrasp_bench.tables.drops import SAME_POSE, DropTable, Hand, random_hull, stone
from regrasp_gym.errors import BenchError
from regrasp_gym.objects import OBJECTS
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.reports.plots import OURS, OURS_TOO, PAPER, check_format, draw
from regrasp_gym.reports.trials import Record, crashes, run_trials, wilson, write_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import Grasp, Gripper
    from regrasp_planner.placement.basins import ReleaseCone
    from regrasp_planner.placement.stab_pose import StablePoses

POSES = 8
"""Stable poses considered of each object, most stable first: as many as the planner tries."""

BEYOND = (1.5, 2.0)
"""Tilts of the control group, as multiples of the cone's half-angle."""

LEAST_TILT = np.deg2rad(1)
"""Less than this is no non-static release, radians."""

RETREAT = 0.1
"""How far the gripper goes back, metres."""

_TRIES = 60
_BATCHES = 4

_GROUPS: tuple[str, ...] = (
    "planned",
    "planned, gripper retreating",
    "… no finger in the way",
    "anywhere in the cone",
    "outside of the cone",
    "paper's cone",
)


def releases(
    trials: int = 500,
    first_trial: int = 0,
    workers: int = 1,
    records: Path = Path("outputs/bench/releases.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    plot_file: Annotated[Path | None, tyro.conf.arg(name="plot")] = None,
) -> None:
    """Release shipped objects and random stones at rest, 2 mm above a table, and let them settle in MuJoCo.

    Half of the releases are what GraspGen⁺ plans where the gripper would hit the ground otherwise, once of the bare
    object and once with the gripper that opens and goes back, the latter also without those where a finger would be in
    the way (`settling_clearance`). The other half are spread evenly over the cones. Beside each, as a control, the
    same object is released outside of its cone, tilted to the same side by 1.5 to 2 times the half-angle; and within
    the cone that the paper's alpha shape of 128 starts gives. An interrupted run goes on where it stopped.

    Args:
        trials: releases.
        first_trial: number of the first one.
        workers: processes.
        records: one JSON line per release, appended as they end.
        json_file: write the summary as JSON.
        plot_file: draw it (.svg, .png or .pdf).
    """
    from regrasp_planner.placement.basins import DROP, ENERGY, MARGIN
    from regrasp_planner.placement.tilted_release import BLOCKED

    check_format(plot_file)
    rule = {"drop": DROP, "energy": ENERGY, "margin": MARGIN, "blocked": BLOCKED, "blocking": "fingers"}
    setting: Record = {"benchmark": "releases", "version": version("regrasp-gym"), "rule": rule}
    numbers = range(first_trial, first_trial + trials)
    done = run_trials(setting, numbers, _prepare, workers=workers, records=records, label="releases")
    report = summarise(done)
    _show(report)
    write_report(json_file, report)
    draw(plot_file, partial(_paint, report), panels=2)


def summarise(done: Sequence[Record]) -> Record:
    """Counts by group and kind of object, from the records of the trials."""
    ended = [record for record in done if "crashed" not in record]
    groups = {name: [record["drops"][name] for record in ended if name in record["drops"]] for name in _GROUPS}
    inside = groups["planned"] + groups["anywhere in the cone"]
    rows = {"in the cone": inside, **groups}
    for kind in ("shipped objects", "stones"):
        rows[f"in the cone, {kind}"] = [drop for drop in inside if drop["stone"] == (kind == "stones")]
    angles = np.array([record["half_angles"] for record in ended]).reshape(-1, 2)
    return {
        "trials": len(done),
        "within_degrees": float(np.rad2deg(SAME_POSE)),
        "groups": {name: _count(drops) for name, drops in rows.items()},
        "half_angle_degrees": {
            "mean": float(np.rad2deg(angles[:, 0].mean())) if len(angles) else None,
            "mean of the paper's, same poses": float(np.rad2deg(angles[:, 1].mean())) if len(angles) else None,
        },
        "share_by_tilt": _by_tilt([*inside, *groups["outside of the cone"]]),
        "misses": [
            {"trial": r["trial"], "thing": r["thing"], "group": name, **drop}
            for r in ended
            for name, drop in r["drops"].items()
            if name in _GROUPS[:4] and not drop["settled"]
        ],
        "without_cone": dict(sorted(Counter(name for record in ended for name in record["without_cone"]).items())),
        "crashed": crashes(done),
    }


def _count(drops: Sequence[Record]) -> Record:
    settled = sum(drop["settled"] for drop in drops)
    return {
        "releases": len(drops),
        "settled": settled,
        "share": settled / len(drops) if drops else None,
        "share_95": wilson(settled, len(drops)),
        "tilt_degrees_mean": float(np.rad2deg(np.mean([drop["tilt"] for drop in drops]))) if drops else None,
    }


def _by_tilt(drops: Sequence[Record]) -> list[Record]:
    """Counts by the tilt's multiple of the half-angle."""
    edges = np.linspace(0, 2, 9)
    place = np.digitize([drop["tilt"] / drop["half_angle"] for drop in drops], edges[1:-1])
    return [
        {
            "multiple": float(0.5 * (edges[k] + edges[k + 1])),
            **_count([d for d, p in zip(drops, place, strict=True) if p == k]),
        }
        for k in range(len(edges) - 1)
    ]


# --- trials -----------------------------------------------------------------------------------------------------------


def _prepare(setting: Record) -> Callable[[int], Record]:
    from regrasp_gym.robots.panda import planner_robot

    return partial(_release, planner_robot().gripper)


def _release(gripper: Gripper, trial: int) -> Record:
    """One planned release, one outside of the cone and one in the paper's."""
    from regrasp_planner.placement.basins import alpha_shape_angles
    from regrasp_planner.placement.tilted_release import BLOCKED, settling_clearance

    rng = np.random.default_rng([trial, 0x5E77])
    planned, is_stone = trial % 2 == 0, trial // 2 % 2 == 1
    without: list[str] = []
    for attempt in range(_TRIES):
        thing = stone(_TRIES * trial + attempt) if is_stone else OBJECTS[str(rng.choice(sorted(OBJECTS)))]
        poses, cones = _cones(thing)
        usable = [k for k in range(min(POSES, len(poses))) if cones[k].half_angle > LEAST_TILT]
        if not usable:
            without.append(thing.name)
            continue
        k = int(rng.choice(usable))
        cone = cones[k]
        if not planned:
            x, hand = within(cone.axis, cone.half_angle, rng), None
            break
        if found := _planned(thing, gripper, cones, k, rng):
            x, hand = found
            break
    else:
        raise BenchError(f"none of {_TRIES} objects has a non-static release (trial {trial})")
    table = _table(thing)
    tilt = _angle(x, cone.axis)
    far = min(float(rng.uniform(*BEYOND)) * cone.half_angle, np.pi)
    side = (x - (x @ cone.axis) * cone.axis) / np.sin(tilt)
    outside = np.cos(far) * cone.axis + np.sin(far) * side
    drops = {
        "planned" if planned else "anywhere in the cone": _drop(table, x, cone.axis, cone.half_angle, rng),
        "outside of the cone": _drop(table, outside, cone.axis, cone.half_angle, rng),
    }
    if hand is not None:
        held = DropTable(thing, hand)
        drops["planned, gripper retreating"] = _drop(held, x, cone.axis, cone.half_angle, rng)
        fingers = [(body + travel)[None] for body, travel in list(zip(hand.bodies, hand.travel, strict=True))[1:]]
        if settling_clearance(thing.pieces, fingers, cone.axis, x[None])[0] >= BLOCKED * float(gripper.max_opening):
            drops["… no finger in the way"] = drops["planned, gripper retreating"]
    sampled = alpha_shape_angles(poses)
    if theirs := [j for j in range(min(POSES, len(poses))) if sampled[j] > LEAST_TILT]:
        j = int(rng.choice(theirs))
        axis, half = poses.directions[j], float(sampled[j])
        drops["paper's cone"] = _drop(table, within(axis, half, rng), axis, half, rng)
    return {
        "thing": thing.name,
        "pose": k,
        "half_angles": [cone.half_angle, float(sampled[k])],
        "without_cone": without,
        "drops": {name: {**drop, "stone": is_stone} for name, drop in drops.items()},
    }


def _planned(
    thing: ObjectModel, gripper: Gripper, cones: Sequence[ReleaseCone], k: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, " 3"], Hand] | None:
    """A tilted release into pose k, and its gripper, that GraspGen⁺ finds for a target that stands otherwise before."""
    from regrasp_planner.grasp.grasp_gen import GraspSearch

    before = cones[int(rng.choice(np.delete(np.arange(min(POSES, len(cones))), k)))] if len(cones) > 1 else None
    search = GraspSearch(thing.body(), (), gripper)
    tilted = [
        (found.release, found.grasp)
        for batch in islice(search.grasps(before, cones[k]), _BATCHES)
        for found in batch
        if found.release is not None and _angle(found.release, cones[k].axis) > LEAST_TILT
    ]
    if not tilted:
        return None
    x, grasp = tilted[int(rng.integers(len(tilted)))]
    return x, _hand(gripper, grasp)


def _hand(gripper: Gripper, grasp: Grasp) -> Hand:
    """The gripper at a grasp: it opens as wide as it can and goes back along its approach axis."""
    from regrasp_planner.robot.gripper import outer_corners, reduce_gripper

    turn = Rotation.from_quat(grasp.pose[:4], scalar_first=True)
    screws = np.concatenate([np.zeros((1, 6)), np.asarray(gripper.screws)])
    if screws[:, 3:].any():
        raise BenchError("the fingers turn about hinges; this benchmark only knows fingers that slide")
    hand = reduce_gripper(gripper).hand
    bodies = [outer_corners(hand[k]) + grasp.theta * screws[k, :3] for k in range(len(screws))]
    opening = float(gripper.upper) - grasp.theta
    return Hand(
        bodies=tuple(turn.apply(body) + grasp.pose[4:] for body in bodies),
        travel=tuple(turn.apply(opening * screw[:3]) for screw in screws),
        back=turn.apply(-RETREAT * np.asarray(gripper.approach_axis)),
    )


def _drop(
    table: DropTable,
    x: Float[np.ndarray, " 3"],
    axis: Float[np.ndarray, " 3"],
    half_angle: float,
    rng: np.random.Generator,
) -> Record:
    from regrasp_planner.placement.basins import DROP
    from regrasp_planner.placement.stab_pose import rotation_to

    turn = rng.uniform(0, 2 * np.pi)
    yaw = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    landing = table.drop(yaw @ rotation_to(x), DROP)
    return {
        "tilt": _angle(x, axis),
        "half_angle": half_angle,
        "settled": landing.settled_into(axis),
        "away_degrees": float(np.rad2deg(landing.away_from(axis))),
        "rested": landing.rested,
        "seconds": landing.seconds,
    }


def within(axis: Float[np.ndarray, " 3"], half_angle: float, rng: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """A random direction in a cone, (3,): every solid angle of it is as likely."""
    cosine = rng.uniform(np.cos(half_angle), 1.0)
    side = np.cross(axis, random_hull(rng, 1)[0])
    return cosine * axis + np.sqrt(1 - cosine**2) * side / np.linalg.norm(side)


@lru_cache(maxsize=32)
def _cones(thing: ObjectModel) -> tuple[StablePoses, tuple[ReleaseCone, ...]]:
    from regrasp_planner import stable_poses
    from regrasp_planner.placement.basins import release_cones

    body = thing.body()
    poses = stable_poses(body.hull_vertices(), body.center_of_mass)
    return poses, release_cones(poses)


@lru_cache(maxsize=32)
def _table(thing: ObjectModel) -> DropTable:
    return DropTable(thing)


def _angle(a: Float[np.ndarray, " 3"], b: Float[np.ndarray, " 3"]) -> float:
    return float(2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(report: Record) -> None:
    console = Console()
    title = (
        f"{report['trials']} releases at rest, 2 mm above the table; settled: within {report['within_degrees']:.0f}°"
    )
    table = Table("released", "releases", "settled as predicted", "% (95 %)", "mean tilt", title=title)
    for name, row in report["groups"].items():
        if row["releases"]:
            low, high = (100 * end for end in row["share_95"])
            share = f"{100 * row['share']:.1f} ({low:.1f}–{high:.1f})"
            tilt = f"{row['tilt_degrees_mean']:.0f}°"
            table.add_row(name, str(row["releases"]), str(row["settled"]), share, tilt)
    console.print(table)
    ours, paper = report["half_angle_degrees"].values()
    if ours is not None:
        console.print(
            f"mean half-angle {ours:.1f}°, of the paper's cones of the same poses {paper:.1f}°", highlight=False
        )
    if report["without_cone"]:
        names = [name for name in report["without_cone"] if name in OBJECTS]
        stones = len(report["without_cone"]) - len(names)
        listed = ", ".join([*names, *([f"{stones} stones"] if stones else [])])
        console.print(f"no pose with a cone, so never released non-statically: {listed}", highlight=False)
    for error, numbers in report["crashed"].items():
        console.print(f"crashed: {error}, trials {numbers}", style="red", markup=False, highlight=False)


def _paint(report: Record, left: Axes, right: Axes) -> None:
    rows = {name: report["groups"][name] for name in _GROUPS if report["groups"][name]["releases"]}
    shares = [100 * row["share"] for row in rows.values()]
    ends = np.array([[100 * end for end in row["share_95"]] for row in rows.values()]).reshape(-1, 2).T
    colours: dict[str, str] = dict(zip(_GROUPS, (OURS, OURS, OURS, OURS, OURS_TOO, PAPER), strict=True))
    names = [f"{name}\n({row['releases']})" for name, row in rows.items()]
    error = np.abs(ends - np.array(shares))
    drawn = left.barh(names, shares, color=[colours[name] for name in rows], xerr=error)
    left.bar_label(drawn, [f" {share:.1f} %" for share in shares], fontsize=7, padding=8)
    left.set_xlim(0, 115)
    left.invert_yaxis()
    left.set_xlabel("settled as predicted (%)")
    bins = [row for row in report["share_by_tilt"] if row["releases"]]
    middles = [row["multiple"] for row in bins]
    spans = np.abs(np.array([row["share_95"] for row in bins]).T - np.array([row["share"] for row in bins]))
    right.errorbar(middles, [100 * row["share"] for row in bins], 100 * spans, marker="o", color=OURS, capsize=2)
    right.axvline(1.0, color=PAPER, linestyle="--")
    right.set_ylim(0, 105)
    right.set_xlabel("tilt as a multiple of the cone's half-angle")
    right.set_ylabel("settled as predicted (%)")
