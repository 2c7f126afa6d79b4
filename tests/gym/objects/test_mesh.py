"""Objects from mesh files, good and bad."""

from __future__ import annotations

import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import ConvexHull
from standing import upright

from regrasp_gym.objects.mesh import MeshError, MeshWarning, object_from_mesh
from regrasp_gym.scenes.resting import upright_pose
from regrasp_gym.simulation import physics
from regrasp_planner import GeometryError

Mesh = tuple[np.ndarray, np.ndarray]

pytestmark = pytest.mark.usefixtures("own_cache")

CUBE = trimesh.creation.box((0.04, 0.06, 0.1))


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
def test_files_become_objects(tmp_path: Path, suffix: str) -> None:
    mesh = CUBE.copy()
    mesh.apply_translation([0.3, 0.2, 0.05])
    file = tmp_path / f"tea_box.{suffix}"
    mesh.export(file)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        thing = object_from_mesh(file, 0.24)
    assert (thing.name, thing.label, thing.mass) == ("tea_box", "tea box", 0.24)
    assert thing.size == pytest.approx([0.04, 0.06, 0.1], abs=1e-6)
    assert upright(thing)[6] == pytest.approx(0.05, abs=1e-6)
    assert thing.inertia == pytest.approx(0.02 * np.diag([0.0136, 0.0116, 0.0052]), rel=1e-4, abs=1e-9)
    assert np.concatenate(thing.pieces).mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)


def test_millimetres_are_scaled() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=30.0)
    thing = object_from_mesh((mesh.vertices, mesh.faces), 0.05, name="ball", scale=1e-3)
    assert thing.size == pytest.approx([0.06] * 3, abs=2.5e-3)
    assert len(thing.pieces[0]) == 64
    with pytest.warns(MeshWarning, match=r"'ball' is 59\.4 m long.*scale=0\.001"):
        object_from_mesh((mesh.vertices, mesh.faces), 0.05, name="ball")


def test_the_object_rests_quietly_and_the_planner_takes_it() -> None:
    mesh = trimesh.creation.cylinder(0.03, 0.08, sections=200)
    thing = object_from_mesh((mesh.vertices, mesh.faces), 0.2, name="tin")
    assert thing.body().mass == 0.2
    spec = mujoco.MjSpec()
    physics.configure(spec)
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.02], pos=[0, 0, -0.02])
    thing.add_to(spec, pose=upright(thing))
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(500):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-3
    assert data.qpos[2] == pytest.approx(0.04, abs=1e-3)


def test_holes_are_closed_by_the_hull_and_said(tmp_path: Path) -> None:
    mesh = CUBE.copy()
    mesh.update_faces(np.arange(len(mesh.faces)) >= 2)
    file = tmp_path / "open_box.stl"
    mesh.export(file)
    with pytest.warns(MeshWarning, match="'open_box' is not closed: its convex hull, as a solid"):
        thing = object_from_mesh(file, 0.24)
    closed = object_from_mesh((CUBE.vertices, CUBE.faces), 0.24)
    assert thing.size == pytest.approx(closed.size, abs=1e-6)
    assert thing.inertia == pytest.approx(closed.inertia, rel=1e-4, abs=1e-9)


# Centroid of the L: legs of 0.1 × 0.02 and 0.02 × 0.08.
MIDDLE = (0.002 * 0.05 + 0.0016 * 0.01) / 0.0036


def test_hollows_are_no_part_of_the_object(angle: Mesh) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        thing = object_from_mesh(angle, 0.3, name="angle")
    assert len(thing.pieces) == 2
    assert sum(ConvexHull(piece).volume for piece in thing.pieces) == pytest.approx(0.0036 * 0.05, rel=2e-3)
    legs = sorted(np.ptp(piece, axis=0).round(3).tolist() for piece in thing.pieces)
    assert legs in ([[0.02, 0.08, 0.05], [0.1, 0.02, 0.05]], [[0.02, 0.1, 0.05], [0.08, 0.02, 0.05]])
    corner = np.concatenate(thing.pieces).min(axis=0)
    assert corner == pytest.approx([-MIDDLE, -MIDDLE, -0.025], abs=1e-5)


def test_the_hull_can_be_asked_for_and_its_hollows_are_said(angle: Mesh) -> None:
    with pytest.warns(MeshWarning, match="'angle' is hollow or concave: contacts treat the empty 4[0-9]%"):
        thing = object_from_mesh(angle, 0.3, name="angle", max_pieces=1)
    (piece,) = thing.pieces
    corner = piece[np.argmin(piece.sum(axis=1))]
    assert corner == pytest.approx([-MIDDLE, -MIDDLE, -0.025], abs=1e-6)
    # The mass properties are those of the L all the same.
    assert thing.inertia == pytest.approx(object_from_mesh(angle, 0.3).inertia)
    assert thing.inertia[0, 1] != pytest.approx(0.0, abs=1e-6)


def test_density_gives_the_mass_of_what_is_filled(angle: Mesh) -> None:
    thing = object_from_mesh(angle, density=2000.0)
    assert thing.mass == pytest.approx(2000.0 * 0.0036 * 0.05)
    assert thing.inertia == pytest.approx(object_from_mesh(angle, thing.mass).inertia)


def test_a_seam_or_an_inside_out_mesh_does_not_matter(angle: Mesh) -> None:
    """As in real scans: one face is missing of thousands, and all of them may face inwards."""
    closed = object_from_mesh(angle, 0.1)
    fine = trimesh.Trimesh(*angle).subdivide().subdivide().subdivide().subdivide()
    for faces in (fine.faces[1:], fine.faces[:, ::-1]):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            thing = object_from_mesh((fine.vertices, faces), 0.1)
        assert len(thing.pieces) == 2
        assert thing.inertia == pytest.approx(closed.inertia, rel=0.01, abs=1e-6)


def test_an_uneven_base_is_made_flat() -> None:
    mesh = trimesh.creation.cylinder(0.03, 0.08, sections=32)
    vertices = np.array(mesh.vertices)
    low = vertices[:, 2] < 0
    vertices[low, 2] += np.random.default_rng(0).uniform(0, 4e-4, low.sum())
    thing = object_from_mesh((vertices, mesh.faces), 0.2)
    upright = upright_pose(thing)
    assert upright is not None
    assert upright.margin == pytest.approx(0.03, abs=1e-3)
    assert -upright.down[2] == pytest.approx(1.0)


def test_a_texture_comes_along(tmp_path: Path) -> None:
    Image.fromarray(np.full((900, 700, 3), (200, 30, 40), np.uint8)).save(tmp_path / "skin.png")
    (tmp_path / "box.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd skin.png\n")
    corners = "\n".join(f"v {x} {y} {z}" for x, y, z in CUBE.vertices)
    faces = "\n".join("f " + " ".join(f"{i + 1}/{i + 1}" for i in face) for face in CUBE.faces)
    coords = "\n".join(f"vt {k / 7} {k % 2}" for k in range(8))
    (tmp_path / "box.obj").write_text(f"mtllib box.mtl\n{corners}\n{coords}\nusemtl skin\n{faces}\n")
    (look,) = object_from_mesh(tmp_path / "box.obj", 0.1).looks
    assert look.texture is not None
    assert max(look.texture.shape[:2]) == 512
    assert look.texture[0, 0].tolist() == [200, 30, 40]
    assert look.texcoords is not None
    assert look.texcoords.shape == (len(look.vertices), 2)
    spec = mujoco.MjSpec()
    object_from_mesh(tmp_path / "box.obj", 0.1).add_to(spec)
    assert spec.compile().ntex == 1


def corrupted(index: int, value: float) -> np.ndarray:
    vertices = np.array(CUBE.vertices)
    vertices[index, 1] = value
    return vertices


SHEET = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (corrupted(3, np.nan), CUBE.faces, "1 of 8 vertices are not finite, the first is 3"),
        (corrupted(5, np.inf), CUBE.faces, "not finite, the first is 5"),
        (SHEET, TWO, "has no volume, not even its convex hull"),
        (np.zeros((8, 3)), CUBE.faces, "has no volume"),
        (CUBE.vertices[:3], np.array([[0, 1, 2]]), "has no volume"),
        (CUBE.vertices, np.zeros((0, 3), int), "has no faces"),
        (CUBE.vertices, np.array([[0, 1, 99]]), "a face names a vertex outside 0…7"),
        (CUBE.vertices[:, :2], CUBE.faces, r"must be \(N, 3\) and \(M, 3\)"),
    ],
)
def test_bad_meshes_are_refused(vertices: np.ndarray, faces: np.ndarray, message: str) -> None:
    with pytest.raises(MeshError, match=message) as caught:
        object_from_mesh((vertices, faces), 0.1, name="culprit")
    assert "'culprit'" in str(caught.value)
    assert isinstance(caught.value, GeometryError)


@pytest.mark.parametrize(
    "options",
    [
        {"mass": 0.0},
        {"mass": -1.0},
        {"mass": np.nan},
        {"density": 0.0},
        {"mass": 0.1, "scale": 0.0},
        {"mass": 0.1, "max_pieces": 0},
        {"mass": 0.1, "density": 1000.0},
        {},
    ],
)
def test_options_must_make_sense(options: dict[str, float]) -> None:
    with pytest.raises(MeshError, match=r"must be|give either a mass"):
        object_from_mesh((CUBE.vertices, CUBE.faces), **options)


def test_bad_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="gone"):
        object_from_mesh(tmp_path / "gone.obj", 0.1)
    for name in ("noise.stl", "noise.obj", "noise.ply", "noise.xyzzy"):
        (tmp_path / name).write_bytes(b"\x00\x01this is no mesh\xff")
        with pytest.raises(MeshError, match="noise"):
            object_from_mesh(tmp_path / name, 0.1)
