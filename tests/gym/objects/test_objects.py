"""The stand-ins: sizes, masses, inertias, one shape for physics and planner, and quiet on a table."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from standing import upright

from regrasp_gym.objects import OBJECTS, ObjectModel, solid
from regrasp_gym.simulation import physics

# Mass in kg and upright size in mm from the YCB sheet and scans; None where the scan's extent means nothing (bent).
PUBLISHED = {
    "003_cracker_box": (0.411, (72, 164, 213)),
    "004_sugar_box": (0.514, (48, 93, 176)),
    "005_tomato_soup_can": (0.349, (67.5, 67.5, 102)),
    "006_mustard_bottle": (0.603, (96, 58, 191)),
    "009_gelatin_box": (0.097, (73, 89, 30)),
    "010_potted_meat_can": (0.370, (102, 57, 84)),
    "011_banana": (0.066, (None, 198, 37)),
    "012_strawberry": (0.018, (43.8, 43.8, 46)),
    "013_apple": (0.068, (75, 75, 72)),
    "014_lemon": (0.029, (68, 54, 53)),
    "015_peach": (0.033, (60, 60, 59)),
    "016_pear": (0.049, (66, 66, 97)),
    "017_orange": (0.047, (73, 73, 71)),
    "018_plum": (0.025, (56, 53, 53)),
    "021_bleach_cleanser": (1.131, (102, 68, 251)),
    "025_mug": (0.118, (117, 93, 81)),
    "040_large_marker": (0.0158, (19, 121, 19)),
    "043_phillips_screwdriver": (0.097, (216, 34, 34)),
    "055_baseball": (0.138, (73, 73, 73)),
    "056_tennis_ball": (0.058, (67, 67, 67)),
    "057_racquetball": (0.041, (56, 56, 56)),
    "058_golf_ball": (0.046, (42.6, 42.6, 42.6)),
    "061_foam_brick": (0.028, (52, 78, 51)),
    "065-a_cups": (0.013, (57, 57, 62)),
    "070-b_colored_wood_blocks": (0.0108, (26, 26, 26)),
    "077_rubiks_cube": (0.094, (57, 57, 57)),
}

GRIPPER_OPENING = 0.078


@pytest.fixture(params=sorted(OBJECTS))
def thing(request: pytest.FixtureRequest) -> ObjectModel:
    return OBJECTS[request.param]


def table_model(*things: tuple[ObjectModel, np.ndarray]) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    physics.configure(spec)
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1.5, 1.5, 0.02], pos=[0, 0, -0.02])
    for thing, pose in things:
        thing.add_to(spec, pose=pose)
    model = spec.compile()
    return model, mujoco.MjData(model)


def test_there_are_enough_and_the_table_above_knows_them_all() -> None:
    assert len(OBJECTS) >= 20
    assert set(OBJECTS) == set(PUBLISHED)
    assert all(name == thing.name for name, thing in OBJECTS.items())
    assert len({thing.label for thing in OBJECTS.values()}) == len(OBJECTS)


def test_size_and_mass_are_published_ones(thing: ObjectModel) -> None:
    mass, size = PUBLISHED[thing.name]
    assert thing.mass == mass
    for ours, published in zip(thing.size * 1e3, size, strict=True):
        if published is not None:
            assert ours == pytest.approx(published, abs=3.0)
    assert thing.height == thing.size[2]


def test_the_gripper_can_hold_it(thing: ObjectModel) -> None:
    """As a whole, or, where it is hollow, by a piece."""
    # The narrowest of many horizontal directions.
    points = np.concatenate(thing.pieces)
    angles = np.linspace(0, np.pi, 3600)
    width = np.ptp(points[:, :2] @ np.stack([np.cos(angles), np.sin(angles)]), axis=0).min()
    if thing.name == "025_mug":
        width = min(np.ptp(piece, axis=0).min() for piece in thing.pieces)
    assert width < GRIPPER_OPENING


def test_pieces_are_small_convex_and_apart(thing: ObjectModel) -> None:
    volumes = []
    for piece in thing.pieces:
        hull = ConvexHull(piece)
        assert len(piece) <= 64
        assert len(hull.vertices) == len(piece), "every point is a corner"
        volumes.append(hull.volume)
    if len(thing.pieces) > 1:
        # Pieces may share faces but not volume: sample points and count how many pieces hold each.
        rng = np.random.default_rng(0)
        points = np.concatenate(thing.pieces)
        samples = rng.uniform(points.min(axis=0), points.max(axis=0), (4000, 3))
        inside = sum(
            (samples @ hull.equations[:, :3].T + hull.equations[:, 3] < -1e-4).all(axis=1).astype(int)
            for hull in map(ConvexHull, thing.pieces)
        )
        assert inside.max() == 1


def test_mass_properties_are_those_of_the_solid(thing: ObjectModel) -> None:
    """Against trimesh's integrals over the surfaces of the pieces."""
    meshes = [trimesh.convex.convex_hull(piece) for piece in thing.pieces]
    density = thing.mass / sum(mesh.volume for mesh in meshes)
    center = sum(mesh.volume * mesh.center_mass for mesh in meshes) * density / thing.mass
    assert center == pytest.approx(np.zeros(3), abs=1e-6)
    inertia = np.zeros((3, 3))
    for mesh in meshes:
        mesh.density = density
        inertia += mesh.moment_inertia_frame(np.eye(4))
    assert thing.inertia == pytest.approx(inertia, rel=1e-4, abs=1e-10)


def test_mujoco_gets_the_same_body(thing: ObjectModel) -> None:
    model, _ = table_model((thing, upright(thing)))
    body = model.body(thing.name).id
    assert model.body_mass[body] == pytest.approx(thing.mass)
    assert model.body_ipos[body] == pytest.approx(np.zeros(3), abs=1e-12)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    turn = turn.reshape(3, 3)
    assert turn @ np.diag(model.body_inertia[body]) @ turn.T == pytest.approx(thing.inertia, rel=1e-6, abs=1e-12)
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    assert sum(model.geom_group[g] == 3 for g in geoms) == len(thing.pieces)
    assert any(model.geom_group[g] == 2 and model.geom_contype[g] == 0 for g in geoms)


def test_physics_and_planner_share_one_shape(thing: ObjectModel) -> None:
    model, data = table_model((thing, upright(thing)))
    mujoco.mj_kinematics(model, data)
    planner = thing.body()
    assert planner is thing.body()
    assert planner.mass == thing.mass
    assert planner.center_of_mass == pytest.approx(np.zeros(3))
    assert len(planner.pieces) == len(thing.pieces)
    rng = np.random.default_rng(0)
    for k, piece in enumerate(planner.pieces):
        geom = model.geom(f"{thing.name}_c{k}").id
        frame = data.geom_xmat[geom].reshape(3, 3)
        if thing.shape == "box":
            corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T * model.geom_size[geom]
        else:
            mesh = model.geom_dataid[geom]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            corners = model.mesh_vert[start : start + count]
        world = corners @ frame.T + data.geom_xpos[geom] - data.body(thing.name).xpos
        directions = rng.normal(size=(200, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        theirs, ours = (world @ directions.T).max(axis=0), (piece.hull_vertices() @ directions.T).max(axis=0)
        assert ours == pytest.approx(theirs, abs=1e-6)
        assert float(piece.radius) == 0.0


def test_what_is_seen_is_what_is_touched(thing: ObjectModel) -> None:
    """Surfaces lie within 3 mm of the pieces, except stems and tips; and they cover every part of the pieces."""
    hulls = [ConvexHull(piece) for piece in thing.pieces]
    points = np.concatenate([look.vertices for look in thing.looks])
    outside = np.min([(points @ h.equations[:, :3].T + h.equations[:, 3]).max(axis=1) for h in hulls], axis=0)
    assert np.quantile(outside, 0.9) < 0.003
    assert outside.max() < 0.011
    corners = np.concatenate(thing.pieces)
    bare = np.array([np.linalg.norm(points - corner, axis=1).min() for corner in corners])
    assert bare.max() < 0.02


def test_all_stand_still_where_they_are_put() -> None:
    places = [(thing, upright(thing, 0.25 * (k % 5), 0.25 * (k // 5))) for k, thing in enumerate(OBJECTS.values())]
    model, data = table_model(*places)
    for _ in range(500):
        mujoco.mj_step(model, data)
    fastest = np.zeros(model.nv)
    for _ in range(250):
        mujoco.mj_step(model, data)
        fastest = np.maximum(fastest, np.abs(data.qvel))
    for thing, pose in places:
        joint = model.joint(f"{thing.name}_joint")
        q = data.qpos[joint.qposadr[0] : joint.qposadr[0] + 7]
        speed = fastest[joint.dofadr[0] : joint.dofadr[0] + 6]
        assert speed[:3].max() < 2e-3, thing.name
        assert speed[3:].max() < 0.01, thing.name
        assert q[:3] == pytest.approx(pose[4:], abs=2e-3), thing.name
        tilt = np.degrees(2 * np.arcsin(np.linalg.norm(q[4:6])))
        assert tilt < 2.0, thing.name


def test_a_second_one_shares_meshes_and_fixed_ones_stay() -> None:
    thing = OBJECTS["005_tomato_soup_can"]
    spec = mujoco.MjSpec()
    thing.add_to(spec, name="first", pose=upright(thing))
    one = spec.copy().compile()
    thing.add_to(spec, name="second", pose=upright(thing, 0.3), free=False)
    two = spec.compile()
    assert (two.nmesh, two.ntex, two.nmat) == (one.nmesh, one.ntex, one.nmat)
    assert two.ngeom == 2 * one.ngeom
    assert two.njnt == 1
    assert two.body("second").pos == pytest.approx(upright(thing, 0.3)[4:])


def test_overlap_free_pieces_weigh_by_volume() -> None:
    """Two unit cubes side by side and one twice as wide are the same solid."""
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    parts = solid("pair", "pair", 3.0, [cube, cube + np.array([1.0, 0, 0])])
    whole = solid("block", "block", 3.0, [cube * [2, 1, 1]])
    assert parts.inertia == pytest.approx(whole.inertia)
    assert whole.inertia == pytest.approx(np.diag([3 / 12 * 2, 3 / 12 * 5, 3 / 12 * 5]))
    assert upright(parts)[6] == pytest.approx(0.5)


def test_objects_without_looks_show_their_pieces() -> None:
    cube = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)], float)
    thing = solid("plain", "plain", 0.1, [cube], rgba=(0.1, 0.8, 0.2, 1.0))
    model, _ = table_model((thing, upright(thing)))
    seen = model.geom("plain_v0")
    assert model.mat_rgba[seen.matid[0]] == pytest.approx([0.1, 0.8, 0.2, 1.0])
