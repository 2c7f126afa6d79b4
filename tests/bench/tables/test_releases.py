"""Drops in MuJoCo, and the benchmarks of releases and stable poses."""

import json

import numpy as np
import pytest

from regrasp_bench.tables.drops import DropTable, Hand, random_hull, stone, stone_of
from regrasp_bench.tables.releases import releases, summarise, within
from regrasp_bench.tables.stable_poses import POINTS, TIMED_POINTS, stable_poses, stands, subject
from regrasp_gym.errors import BenchError
from regrasp_gym.objects import OBJECTS
from regrasp_gym.reports.trials import read_records
from regrasp_planner import stable_poses as stab_pose
from regrasp_planner.placement.basins import DROP, release_cones
from regrasp_planner.placement.stab_pose import rotation_to

BOX = OBJECTS["004_sugar_box"]


def tilted(axis, angle, towards):
    return np.cos(angle) * np.asarray(axis, float) + np.sin(angle) * np.asarray(towards, float)


@pytest.fixture(scope="module")
def table():
    return DropTable(BOX)


# --- drops ------------------------------------------------------------------------------------------------------------


def test_what_is_put_down_in_a_stable_pose_stays_there(table):
    landing = table.drop(rotation_to(np.array([0, 0, -1.0])), 0.002)
    assert landing.rested
    assert landing.settled_into([0, 0, -1.0])
    assert landing.away_from([0, 0, -1.0]) < 0.01
    assert landing.seconds < 0.5


def test_a_box_falls_to_the_side_of_its_edge_that_it_is_let_go_on(table):
    balance = np.arctan(0.024 / 0.088)
    for share, down in ((0.8, [0, 0, -1.0]), (1.2, [1.0, 0, 0])):
        x = tilted([0, 0, -1.0], share * balance, [1.0, 0, 0])
        assert table.drop(rotation_to(x), 0.002).settled_into(down)


def test_drops_repeat_to_the_bit_whatever_was_dropped_before(table):
    x = tilted([0, 0, -1.0], 0.3, [0, 1.0, 0])
    first = table.drop(rotation_to(x), 0.01)
    table.drop(rotation_to(np.array([0, 1.0, 0])), 0.05)
    again = table.drop(rotation_to(x), 0.01)
    np.testing.assert_array_equal(first.down, again.down)
    assert first.seconds == again.seconds


def test_a_gripper_that_lets_go_beside_leaves_the_object_alone_and_one_below_takes_it_along():
    finger = np.array([[x, y, z] for x in (-0.005, 0.005) for y in (-0.005, 0.005) for z in (-0.03, 0.03)])
    side, off = np.array([0, 0.047 + 0.005, 0]), np.array([0, 0.02, 0])
    beside = Hand((finger + side, finger - side), (off, -off), np.array([0, 0, 0.2]))
    x = tilted([0, 0, -1.0], 0.15, [1.0, 0, 0])
    free = DropTable(BOX, beside).drop(rotation_to(x), 0.002)
    assert free.settled_into([0, 0, -1.0])
    # A hook under the raised edge lifts it over as it goes up.
    hook = finger * [2, 8, 0.2] + np.array([-0.026, 0, -0.094])
    lifted = DropTable(BOX, Hand((hook,), (np.zeros(3),), np.array([0, 0, 0.2]))).drop(rotation_to(x), 0.002)
    assert not lifted.settled_into([0, 0, -1.0])


def test_stones_are_what_they_say():
    widths = []
    for seed in range(30):
        thing = stone(seed)
        points = thing.pieces[0]
        assert 10 <= len(points) <= 60
        assert thing.mass == pytest.approx(2600 * volume(points))
        assert 0.03 <= np.ptp(points[:, 0]) <= 0.07
        widths.append(np.ptp(points, axis=0) / np.ptp(points[:, 0]))
    assert np.max(widths) < 3.6
    np.testing.assert_array_equal(stone(3).pieces[0], stone(3).pieces[0])
    assert not np.array_equal(stone(3).pieces[0][0], stone(4).pieces[0][0])


def volume(points):
    from scipy.spatial import ConvexHull

    return ConvexHull(points).volume


# --- releases ---------------------------------------------------------------------------------------------------------


def test_directions_in_a_cone_are_spread_over_its_solid_angle():
    rng = np.random.default_rng(0)
    axis = np.array([0.6, 0, -0.8])
    x = np.array([within(axis, 0.7, rng) for _ in range(4000)])
    np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1)
    cosine = x @ axis
    assert cosine.min() > np.cos(0.7)
    # By Archimedes' theorem the cosine is uniform.
    assert cosine.mean() == pytest.approx(0.5 * (1 + np.cos(0.7)), abs=0.005)
    assert np.abs((x - cosine[:, None] * axis).mean(axis=0)).max() < 0.02


def test_releases_within_the_cones_settle_as_predicted_and_those_well_outside_do_not():
    rng = np.random.default_rng(1)
    inside, outside = [], []
    for seed in range(30):
        thing = stone(900 + seed) if seed % 2 else OBJECTS[sorted(OBJECTS)[seed % len(OBJECTS)]]
        body = thing.body()
        cones = release_cones(stab_pose(body.hull_vertices(), body.center_of_mass))[:8]
        usable = [cone for cone in cones if cone.half_angle > 0.02]
        if not usable:
            continue
        drop_table = DropTable(thing)
        for _ in range(4):
            cone = usable[int(rng.integers(len(usable)))]
            x = within(cone.axis, cone.half_angle, rng)
            inside.append(drop_table.drop(rotation_to(x), DROP).settled_into(cone.axis))
            side = np.cross(cone.axis, random_hull(rng, 1)[0])
            y = tilted(cone.axis, 2.5 * cone.half_angle, side / np.linalg.norm(side))
            outside.append(drop_table.drop(rotation_to(y), DROP).settled_into(cone.axis))
    assert len(inside) > 80
    assert np.mean(inside) >= 0.97
    assert np.mean(outside) < 0.5


def test_the_command_writes_what_it_counted_and_resumes(tmp_path):
    files = {"records": tmp_path / "r.jsonl", "json_file": tmp_path / "r.json", "plot_file": tmp_path / "r.svg"}
    releases(trials=1, first_trial=1, **files)
    (record,) = read_records(files["records"])
    assert set(record["drops"]) >= {"anywhere in the cone", "outside of the cone"}
    assert files["plot_file"].read_text().startswith("<?xml")
    report = json.loads(files["json_file"].read_text())
    assert report["groups"]["in the cone"]["releases"] == 1
    assert report["groups"]["planned"] == {**report["groups"]["planned"], "releases": 0, "share": None}
    before = files["records"].read_text()
    releases(trials=1, first_trial=1, **files)
    assert files["records"].read_text() == before
    with pytest.raises(BenchError, match="picture"):
        releases(trials=1, plot_file=tmp_path / "r.txt")


@pytest.mark.slow
def test_planned_releases_are_tilted_and_settle(tmp_path):
    releases(trials=12, records=tmp_path / "r.jsonl", json_file=tmp_path / "r.json")
    drops = [record["drops"] for record in read_records(tmp_path / "r.jsonl")]
    planned = [drop["planned"] for drop in drops if "planned" in drop]
    assert len(planned) == 6
    assert all(np.deg2rad(1) < drop["tilt"] <= drop["half_angle"] + 1e-9 for drop in planned)
    assert all(drop["settled"] for drop in planned)
    assert all(drop["… no finger in the way"]["settled"] for drop in drops if "… no finger in the way" in drop)


def test_the_summary_counts_by_group_and_kind():
    def drop(tilt, settled, stone):
        more = {"away_degrees": 0.0, "rested": True, "seconds": 1.0}
        return {"tilt": tilt, "half_angle": 0.4, "settled": settled, "stone": stone, **more}

    records = [
        {
            "trial": 0,
            "thing": "a",
            "half_angles": [0.4, 0.2],
            "without_cone": ["ball"],
            "drops": {"planned": drop(0.31, True, False), "outside of the cone": drop(0.71, False, False)},
        },
        {
            "trial": 1,
            "thing": "b",
            "half_angles": [0.2, 0.2],
            "without_cone": ["ball", "pin"],
            "drops": {"anywhere in the cone": drop(0.1, False, True), "paper's cone": drop(0.1, True, True)},
        },
        {"trial": 2, "crashed": "ValueError: no"},
    ]
    report = summarise(records)
    counts = {name: (row["settled"], row["releases"]) for name, row in report["groups"].items()}
    assert counts == {
        "in the cone": (1, 2),
        "planned": (1, 1),
        "planned, gripper retreating": (0, 0),
        "… no finger in the way": (0, 0),
        "anywhere in the cone": (0, 1),
        "outside of the cone": (0, 1),
        "paper's cone": (1, 1),
        "in the cone, shipped objects": (1, 1),
        "in the cone, stones": (0, 1),
    }
    assert [(row["multiple"], row["releases"]) for row in report["share_by_tilt"] if row["releases"]] == [
        (0.375, 1),
        (0.875, 1),
        (1.875, 1),
    ]
    assert [miss["trial"] for miss in report["misses"]] == [1]
    assert report["without_cone"] == {"ball": 2, "pin": 1}
    assert report["crashed"] == {"ValueError: no": [2]}
    assert report["half_angle_degrees"]["mean"] == pytest.approx(np.rad2deg(0.3))


# --- stable poses -----------------------------------------------------------------------------------------------------


def test_standing_is_told_from_balancing():
    box = np.concatenate(BOX.pieces)
    directions = np.array([[0, 0, -1.0], [1, 0, 0], [1, 1, 0], [0.1, 0, -1]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_array_equal(stands(box, directions), [True, True, False, False])
    # With its centre of mass beyond the facet it topples.
    np.testing.assert_array_equal(stands(box - [-0.03, 0, 0], directions[:2]), [False, True])


def test_subjects_are_shipped_objects_then_random_hulls():
    assert subject(0, 10)[1] is OBJECTS[sorted(OBJECTS)[0]]
    kinds = [subject(trial, 10) for trial in range(len(OBJECTS), len(OBJECTS) + 20)]
    counts = [len(thing.pieces[0]) for _, thing in kinds]
    assert all(POINTS[0] <= count <= POINTS[1] for count in counts[:10])
    assert len(set(counts[:10])) > 5
    assert counts[10:] == [TIMED_POINTS] * 10
    assert len({kind for kind, _ in kinds}) == 2


def test_a_hull_of_many_vertices_is_dropped_as_it_is():
    """MuJoCo is not to simplify it: it lands on facets of the hull given."""
    rng = np.random.default_rng(5)
    thing = stone_of(0.05 * random_hull(rng, 200) * [1.0, 0.5, 0.7], "many")
    poses = stab_pose(thing.pieces[0], np.zeros(3))
    drop_table = DropTable(thing)
    for x in random_hull(rng, 5):
        landing = drop_table.drop(rotation_to(x), 0.002)
        assert min(landing.away_from(direction) for direction in poses.directions) < 0.02


def test_the_command_finds_all_and_invents_none(tmp_path):
    files = {"records": tmp_path / "s.jsonl", "json_file": tmp_path / "s.json", "plot_file": tmp_path / "s.png"}
    stable_poses(hulls=2, drops=2, repeats=1, **files)
    report = json.loads(files["json_file"].read_text())
    row = report["kinds"]["all"]
    assert row["objects"] == len(OBJECTS) + 22
    assert row["invented"] == 0
    assert row["probability_found_least"] > 0.995
    assert row["drops"]["count"] == 2 * row["objects"]
    assert row["drops"]["into_a_pose_found"] > 0.97
    assert files["plot_file"].stat().st_size > 1000
    assert not report["crashed"]
