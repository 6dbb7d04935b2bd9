"""What cannot be meant is refused where it is given, by the name of the argument."""

import json
import subprocess
import sys

import pytest


# In a process of its own, and single precision: here the type checker of the tests would answer.
PREPARED = """
import json, pickle, sys
import jax
import numpy as np
import gaussray as g
from gaussray.camera.sensor.sensor import SensorOptions

m, q, o, h = np.zeros((5, 3)), np.ones((5, 4)), np.full(5, 0.5), np.zeros((5, 1, 3))
s, nan, inf = m + 1, np.nan, np.inf
colored = g.Gaussians.colored
scene = g.Scene(colored([0, 0, 4], [1, 0, 0]))
lens, ray = g.Pinhole(9, (4, 4)), g.Rays([0, 0, 0], [0, 0, 1], 0)
camera, rolling = g.Camera((8, 8), lens), g.rolling_shutter(0.03, 4)
wide, whole = g.Fisheye(4, (4, 4), 1.6), g.Equirectangular((20, 20), (50, 50))
said = []
for expression in json.loads(sys.stdin.read()):
    try:
        said.append(f"accepted: {eval(expression)!r}")
    except (ValueError, FileNotFoundError) as error:
        said.append(str(error))
    except Exception as error:
        said.append(f"{type(error).__name__}: {error}")
print(json.dumps(said))
"""
# An expression, and how the message begins.
REFUSED = {
    "g.Gaussians(m, q, s, o[:, None], h)": "gaussians.opacity must be one number for each",
    "g.Gaussians(m, q, s, o, np.zeros((5, 5, 3)))": "gaussians.harmonics must be 5 x 1, 4, 9",
    "g.Gaussians(m, q, s, o, m)": "gaussians.harmonics must be 5 x 1, 4, 9 or 16 x 3 numbers, got",
    "g.Gaussians(m, q, s, o, h[:4])": "gaussians.harmonics must be 5 x 1, 4, 9 or 16 x 3",
    "g.Gaussians(m, q, s, o, 'red')": "gaussians.harmonics must be numbers, n x 1, 4, 9 or 16 x 3",
    "g.Gaussians(m[:4], q, s, o, h)": "gaussians.mean must be one for each",
    "g.Gaussians(m, q[:4], s, o, h)": "gaussians.quat must be one for each of the 5 Gaussians",
    "g.Gaussians(m, q, s[:4], o, h)": "gaussians.scale must be one for each of the 5 Gaussians",
    "g.Gaussians(m[:4], q[:4], s[:4], o, h)": "gaussians.mean must be one for each",
    "g.Gaussians(m, q, s, o, h, m[:4])": "gaussians.tint must be one for each of the 5 Gaussians",
    "g.Gaussians(m[None], q, s, o, h)": "gaussians.quat must be one for each of the 5 Gaussians",
    "colored([0, 0, nan], [1, 0, 0])": "gaussians.mean must be finite, got",
    "colored(m, [1, 0, inf])": "gaussians.color must be finite, got",
    "colored(m, 'red')": "gaussians.color must be numbers, got 'red'.",
    "colored(m, [1, 0, 0], scale=inf)": "gaussians.scale must be finite, got",
    "colored(m, [1, 0, 0], quat=[nan, 0, 0, 0])": "gaussians.quat must be finite, got nan among",
    "colored(m, [1, 0, 0], quat=[0, 0, 0, 0])": "gaussians.quat must be not zero, got 0 among 20",
    "g.Scene(scene.static, time_range=(1, 0))": "scene.time_range must be a finite first time",
    "g.Scene(scene.static, time_range=(0, nan))": "scene.time_range must be a finite first time",
    "g.render(scene, g.Camera((8, 8), wide, g.Aperture(0.1)))": "aperture.focus must be sphere for",
    "g.render(scene, g.Camera((100, 100), whole))": "lens.focal must be at least [49.5, 99] for",
    "g.Camera((8, 4), lens, shutter=rolling, time=1.7e9 + 0.37)": (
        "camera.time must be so near 0 that its float32 tells 12 parts of the shutter's readout "
        "(0.03) apart, got 1700000000, where numbers are 128 apart. Subtract the first time"
    ),
    "g.Camera((8, 4), lens, shutter=g.Shutter(exposure=0.01), time=1.7e9)": (
        "camera.time must be so near 0 that its float32 tells 4 parts of the shutter's exposure"
    ),
    "g.Camera((8, 4), lens, shutter=g.Shutter(row_times=[0] * 5))": (
        "shutter.row_times must be one time for each of the picture's 4 rows, got 5."
    ),
    "g.Camera((8, 4), lens, shutter=g.Shutter(row_times=[0] * 3), time=1)": (
        "shutter.row_times must be one time for each of the picture's 4 rows, got 3."
    ),
    "g.Camera((3, 4, 5), lens)": "camera.film must be (width, height) or a gaussray.Film, got (3,",
    "g.Film(3, 4, filter_width='a')": "film.filter_width must be a number, got 'a'.",
    "g.Film(3, '4')": "film.height must be a whole number from 1, got '4'.",
    "g.Aperture(blades=5.5)": "aperture.blades must be a whole number from 0, got 5.5.",
    "g.Aperture(blades='5')": "aperture.blades must be a whole number from 0, got '5'.",
    "g.Aperture('1')": "aperture.radius must be a number, got '1'.",
    "g.rolling_shutter(0.1, rows=2.5)": "rows must be a whole number from 1, got 2.5.",
    "g.TraceOptions(k=2.5)": "trace.k must be a whole number, got 2.5.",
    "g.TraceOptions(bundle=2.5)": "trace.bundle must be a whole number, got 2.5.",
    "g.RenderOptions(memory='a')": "render.memory must be a number, got 'a'.",
    "SensorOptions(bits=2.5, white=1.0)": "sensor.bits must be a whole number, got 2.5.",
    "SensorOptions(seed=1.5)": "sensor.seed must be a whole number, got 1.5.",
    "SensorOptions(white='1')": "sensor.white must be a number, got '1'.",
    "SensorOptions(chromatic=1)": "sensor.chromatic must be 3 numbers above 0, got 1.",
    "SensorOptions(tone='table', table=1)": "sensor.table must be at least 2 numbers that never",
    "g.Rays(m, m[:4], o)": "rays.direction must be one for each ray, got the shape (4, 3) where",
    "g.Rays(m, m, 0)": "rays.time must be one for each ray, got the shape (1,) where rays.origin",
    "g.Rays(m, m, o, o[:4])": "rays.weight must be one for each ray, got the shape (4,)",
    "g.render(scene, camera, key=3)": "key must be one key, such as jax.random.key(3), or None",
    "g.render(scene, camera, trace=g.RenderOptions())": "trace must be gaussray.TraceOptions(...)",
    "g.render(scene, camera, plan=3)": "plan must be a gaussray.Plan, which gaussray.plan(scene,",
    "g.render(scene, camera, plan=g.plan(scene, ray))": "plan must be of a camera, got one of rays",
    "g.load('nope.spz')": "scene=nope.spz: no such file or folder. Give the output folder of",
    "g.load('nope.ply')": "scene=nope.ply: no such file or folder. Give the output folder of",
    "g.load(None)": "load(path): path must be the name of a file or folder, got None.",
    "g.Pinhole('20', (1, 1))": "lens.focal must be 2 numbers, got '20'.",
    "g.Pinhole(20, ('1', '1'))": "lens.center must be 2 numbers, got ('1', '1').",
    "g.Pinhole(20, [None, 1])": "lens.center must be 2 numbers, got [None, 1].",
    "g.Pinhole(20, np.array(['1', '1']))": "lens.center must be 2 numbers, got array(['1', '1']",
}
ACCEPTED = (
    "g.Gaussians(m.tolist(), q.tolist(), s.tolist(), o.tolist(), h.tolist())",
    "g.Gaussians(m[None], q[None], s[None], o, h, s[None])",
    "jax.vmap(g.Gaussians)(m, q, s, o, h)",
    "jax.eval_shape(lambda x: g.Gaussians(x, q, s, o, h), m)",
    "g.Gaussians(*(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in (m, q, s, o, h)))",
    "g.Camera((8, 8), wide, g.Aperture(0.1, focus='sphere'))",
    "g.Camera((8, 8), wide)",
    "jax.tree.map(lambda *x: np.stack(x), scene.static, scene.static)",
    "pickle.loads(pickle.dumps(g.evaluate))",
    "jax.jit(lambda r: g.Camera((8, 8), wide, g.Aperture(r)).time)(0.1)",
    "jax.vmap(lambda t: g.Shutter(row_times=t))(m)",
    "g.Camera((100, 100), g.Equirectangular((50, 100), (50, 50)))",
    "g.Camera((8, 4), lens, time=1.7e9)",
    "g.Camera((8, 1080), lens, shutter=g.rolling_shutter(0.01, 1080), time=600)",
    "g.Camera((8, 4), lens, shutter=rolling, time=jax.numpy.float32(1.7e9))",
    "g.Aperture(blades=np.int64(5))",
    "g.Rays(m, m, o, o, o)",
    "jax.vmap(g.Rays)(m, m, o)",
    "g.render(scene, camera, key=jax.random.PRNGKey(3)).color.shape",
)


@pytest.fixture(scope="module")
def said():
    """What is said to each expression."""
    expressions = [*REFUSED, *ACCEPTED]
    command = [sys.executable, "-c", PREPARED]
    asked = json.dumps(expressions)
    done = subprocess.run(command, input=asked, capture_output=True, text=True, check=True)
    return dict(zip(expressions, json.loads(done.stdout), strict=True))


@pytest.mark.parametrize("expression", REFUSED)
def test_what_cannot_be_meant_is_refused_by_its_name(said, expression):
    assert said[expression].startswith(REFUSED[expression])


@pytest.mark.parametrize("expression", ACCEPTED)
def test_what_is_meant_or_not_known_is_accepted(said, expression):
    assert said[expression].startswith("accepted: ")
