from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
import time

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import regrasp_gym  # noqa: F401  registers the environments
from regrasp_gym.envs.panda_ycb import PANDA_YCB
from regrasp_gym.errors import DisplayError, OptionError
from regrasp_gym.rendering.materials import MATERIALS
from regrasp_gym.rendering.renderer import SceneRenderer, halved
from regrasp_gym.rendering.setting import Camera
from regrasp_gym.scenes.table_shelf import make_scene
from regrasp_gym.simulation.world import World, base_spec


@pytest.fixture(scope="module")
def env():
    made = gym.make("regrasp_gym/PandaYCB-v0", render_mode="rgb_array").unwrapped
    yield made
    made.close()


@pytest.fixture(scope="module")
def renderer():
    made = SceneRenderer(128, 128)
    yield made
    made.close()


@pytest.fixture(scope="module")
def worlds():
    base = base_spec(PANDA_YCB, buffer_width=128, buffer_height=128)
    return [World(base, PANDA_YCB.robot, make_scene(seed)) for seed in range(3)]


def picture(renderer, world, camera="front", **options):
    return renderer.render(world.model, world.data, camera, 128, 128, **options)


def test_pictures_differ_between_cameras_and_scenes(renderer, worlds):
    views = [picture(renderer, world, camera) for world in worlds for camera in ("front", "wrist", "overview")]
    for i, a in enumerate(views):
        assert a.std() > 15, "a picture of something"
        for b in views[:i]:
            assert (a != b).any()


def test_a_model_looks_the_same_whatever_was_drawn_before(renderer, worlds):
    first = picture(renderer, worlds[0])
    picture(renderer, worlds[1])
    picture(renderer, worlds[0], "wrist")
    np.testing.assert_array_equal(picture(renderer, worlds[0]), first)
    fresh = SceneRenderer(128, 128)
    np.testing.assert_array_equal(picture(fresh, worlds[0]), first)
    fresh.close()


def test_rendering_goes_on_after_close(renderer, worlds):
    first = picture(renderer, worlds[0])
    renderer.close()
    renderer.close()
    np.testing.assert_array_equal(picture(renderer, worlds[0]), first)


def test_unknown_cameras_are_named(renderer, worlds):
    with pytest.raises(KeyError, match="ceiling"):
        picture(renderer, worlds[0], "ceiling")


def test_the_goal_is_seen_by_people_only(renderer, worlds):
    without = picture(renderer, worlds[0])
    shown = picture(renderer, worlds[0], show_goal=True)
    assert (without != shown).any()
    np.testing.assert_array_equal(picture(renderer, worlds[0]), without)


def test_the_front_camera_sees_every_object(renderer):
    base = base_spec(PANDA_YCB, buffer_width=128, buffer_height=128)
    unseen = 0
    for seed in range(4):
        world = World(base, PANDA_YCB.robot, make_scene(seed))
        before = picture(renderer, world).astype(int)
        for thing in (world.scene.target, *world.scene.others):
            saved = world.get_state()
            world.set_object_pose(thing.name, np.array([1, 0, 0, 0, 0.0, 0.0, -5.0]))
            changed = np.abs(picture(renderer, world).astype(int) - before).max(axis=2) > 8
            unseen += changed.sum() < 6
            world.set_state(saved)
    assert unseen <= 1, "one may hide behind another"


def test_the_wrist_camera_sees_the_fingers(renderer, worlds):
    world = worlds[0]
    saved = world.get_state()
    command = np.append(PANDA_YCB.robot.home, 0.04)
    open_fingers = picture(renderer, world, "wrist").astype(int)
    closed = command.copy()
    closed[-1] = 0.0
    world.run(closed, closed, 200)
    assert (np.abs(picture(renderer, world, "wrist").astype(int) - open_fingers).max(axis=2) > 20).mean() > 0.03
    world.set_state(saved)


def test_a_renderer_may_be_collected_while_another_one_draws(renderer, worlds, monkeypatch):
    expected = picture(renderer, worlds[0])
    doomed = [SceneRenderer(128, 128)]
    picture(doomed[0], worlds[1])
    draw = mujoco.mjr_render

    def drop_and_draw(*arguments):
        doomed.clear()
        gc.collect()
        draw(*arguments)

    monkeypatch.setattr(mujoco, "mjr_render", drop_and_draw)
    np.testing.assert_array_equal(picture(renderer, worlds[0]), expected)
    assert not doomed
    np.testing.assert_array_equal(picture(renderer, worlds[0]), expected)


def test_a_new_model_takes_no_context_of_its_own(renderer, worlds):
    def seconds(draw) -> float:
        took = []
        for world in worlds * 3:
            start = time.process_time()
            draw(world)
            took.append(time.process_time() - start)
        return float(np.median(took))

    def draw_afresh(world) -> None:
        fresh = SceneRenderer(128, 128)
        picture(fresh, world)
        fresh.close()

    for world in worlds:
        picture(renderer, world)
    assert seconds(lambda world: picture(renderer, world)) < 0.5 * seconds(draw_afresh)


def test_render(env):
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (480, 640, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(env.render(), first)
    assert env.picture("front", 240, 320).shape == (240, 320, 3)
    env.reset(seed=1)
    assert (env.render() != first).any()


def test_pictures_larger_than_the_buffer_are_refused(env):
    env.reset(seed=0)
    with pytest.raises(OptionError, match="960×1280"):
        env.picture("front", 960, 1280)
    bare = gym.make("regrasp_gym/PandaYCB-v0").unwrapped
    bare.reset(seed=0)
    with pytest.raises(OptionError, match="render_mode"):
        bare.picture("front", 128, 128)


def test_no_render_mode_renders_nothing():
    bare = gym.make("regrasp_gym/PandaYCB-v0").unwrapped
    bare.reset(seed=0)
    assert bare.render() is None


def test_image_and_render_sizes_are_as_asked():
    env = gym.make(
        "regrasp_gym/PandaYCB-v0",
        obs_type="pixels_agent_pos",
        image_size=(96, 160),
        render_mode="rgb_array",
        render_size=(40, 60),
        render_camera="front",
    ).unwrapped
    obs, _ = env.reset(seed=0)
    assert obs["pixels"]["front"].shape == (96, 160, 3)
    assert env.render().shape == (40, 60, 3)
    env.close()


def test_halved_takes_the_mean_of_four():
    rng = np.random.default_rng(0)
    large = rng.integers(0, 256, (6, 8, 3), np.uint8)
    small = halved(large)
    assert small.shape == (3, 4, 3)
    np.testing.assert_allclose(small[1, 2], large[2:4, 4:6].reshape(4, 3).mean(axis=0), atol=1)


def test_cameras_look_at_their_target():
    camera = Camera("c", (1.0, -2.0, 1.5), (0.2, 0.1, 0.3))
    right, up = camera.axes()[:3], camera.axes()[3:]
    assert right @ up == pytest.approx(0, abs=1e-12)
    assert right[2] == pytest.approx(0, abs=1e-12)
    assert up[2] > 0
    back = np.cross(right, up)
    toward = np.array(camera.position) - np.array(camera.target)
    np.testing.assert_allclose(back, toward / np.linalg.norm(toward))


def test_textures_are_the_same_every_time():
    for name, material in MATERIALS.items():
        if material.texture is not None:
            a, b = (material.texture(np.random.default_rng(1)) for _ in range(2))
            np.testing.assert_array_equal(a, b)
            assert a.dtype == np.uint8, name


@pytest.mark.skipif(sys.platform != "linux", reason="displays are told from environment variables on Linux only")
def test_a_window_without_a_display_is_refused(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(DisplayError, match="render_mode='rgb_array'"):
        gym.make("regrasp_gym/PandaYCB-v0", render_mode="human")


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="needs a virtual display")
def test_a_window_shows_episodes_in_real_time_and_closes():
    server = subprocess.Popen(["Xvfb", "-displayfd", "1"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    code = (
        "import time, gymnasium, regrasp_gym;"
        "e = gymnasium.make('regrasp_gym/PandaYCB-v0', render_mode='human'); e.reset(seed=0); e.reset(seed=1);"
        "start = time.monotonic(); [e.step(e.unwrapped.command) for _ in range(10)];"
        "print(time.monotonic() - start); e.close()"
    )
    try:
        assert server.stdout is not None
        done = run_python(code, DISPLAY=f":{server.stdout.readline().strip()}")
    finally:
        server.terminate()
        server.wait()
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) > 0.4


def run_python(code, **environment):
    kept = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=kept | environment)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems need no choice")
@pytest.mark.parametrize(
    ("environment", "expected"),
    [({}, ("egl", "osmesa")), ({"MUJOCO_GL": "osmesa"}, ("osmesa",)), ({"DISPLAY": ":0"}, ("None",))],
)
def test_the_backend_is_chosen_where_there_is_no_display(environment, expected):
    done = run_python("import regrasp_gym, os; print(os.environ.get('MUJOCO_GL'))", **environment)
    assert done.stdout.strip() in expected


@pytest.mark.skipif(sys.platform != "linux", reason="EGL is for Linux")
def test_pictures_work_even_if_mujoco_was_imported_first():
    code = (
        "import mujoco, gymnasium, regrasp_gym;"
        "e = gymnasium.make('regrasp_gym/PandaYCB-v0', render_mode='rgb_array', render_size=(48, 64));"
        "e.reset(seed=0); print(e.render().shape)"
    )
    done = run_python(code)
    assert done.stdout.strip() == "(48, 64, 3)", done.stderr


def test_no_opengl_gives_one_clear_message():
    code = (
        "import gymnasium, regrasp_gym\n"
        "e = gymnasium.make('regrasp_gym/PandaYCB-v0', render_mode='rgb_array')\n"
        "e.reset(seed=0)\n"
        "try:\n    e.render()\n"
        "except regrasp_gym.errors.DisplayError as error:\n    print(error)\n"
    )
    done = run_python("import regrasp_gym.errors\n" + code, MUJOCO_GL="off")
    assert "MUJOCO_GL=off" in done.stdout, done.stderr
    assert "libegl1" in done.stdout
