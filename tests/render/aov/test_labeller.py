"""What is known of every pixel, against closed forms of plates that glide, turn, or are passed."""

import dataclasses

import numpy as np
import plates
import pytest
import toy

from gaussray.camera.aperture import Aperture, Rim
from gaussray.camera.focus_pull import FocusPull
from gaussray.camera.lens.division import Division
from gaussray.camera.shutter import interlaced_row_times
from gaussray.render import picture_programs
from gaussray.render.aov import labeller as labels_of_frames, programs, trace
from gaussray.render.aov.labeller import LABELS, PICTURE_LABELS, Labeller, check_labels
from gaussray.render.list_sizes import default_capacity
from gaussray.render.options import RenderOptions
from gaussray.render.parts import PIXEL, RAY, SAMPLE
from gaussray.scene.scene import Scene
from gaussray.tracer.traverse import Capacity


NOW, NEXT = 0.4, 0.5
READOUT = 0.08
# Pixels. Single precision places a point to 1e-5 of a pixel here; the rest is the thickness of the
# discs, whose peaks lie up to 0.005 units beside the plate where rays meet it aslant.
PIXELS = 0.05
# Scene units, for the same reason.
UNITS = 0.01
# Of the same rays, by another program: single precision.
SAME = 1e-5


# Asked for by several tests, of scenes alike in size, to be compiled once.
WITHOUT_FLOW = [
    name for name in LABELS if name not in PICTURE_LABELS and not name.startswith("flow")
]
SOME = ["depth", "gaussian", "confusion"]
# By its name, so that measuring for labels and for pictures is compiled once.
TRACE = dataclasses.replace(toy.TRACE, backend="array")


@pytest.fixture(autouse=True)
def room(monkeypatch):
    """Lists with room for every plate: scenes alike in numbers share what is compiled."""
    sizes = Capacity((512,) * (TRACE.levels + 1), 2048, 256)
    monkeypatch.setattr(labels_of_frames, "default_capacity", lambda *_: sizes)


def labeller(scene, **options):
    return Labeller(scene, options=RenderOptions(**options), trace=TRACE)


def labels(scene, filmed, names, **others):
    """Labels by a labeller of their own."""
    return labeller(scene, samples=1)(filmed, names, **others)


class World:
    """The same plates and cameras in double precision, by formulas of their own."""

    def __init__(self, *, readout=0.0, fisheye=False, eye=(0, 0, 0), velocity=(0, 0, 0), rate=0.0):
        self.step, self.fisheye = readout / (plates.SIDE - 1), fisheye
        self.eye, self.velocity, self.rate = np.array(eye), np.array(velocity), rate
        self.focal = 1.1 * plates.SIDE
        row, column = np.mgrid[: plates.SIDE, : plates.SIDE]
        self.pixel = np.stack([column + 0.5, row + 0.5], axis=-1)

    def read(self, time, place):
        """When a frame reads a place: rows in the middle of the picture at the frame's time."""
        return time + self.step * (place[..., 1] - plates.SIDE / 2)

    def place(self, point, time):
        """Pixel of points seen from where the camera is at these times."""
        x, y, z = np.moveaxis(point - self.eye * time[..., None], -1, 0)
        off = np.hypot(x, y)
        stretch = np.arctan2(off, z) / off if self.fisheye else 1 / z
        return self.focal * np.stack([x, y], axis=-1) * stretch[..., None] + plates.SIDE / 2

    def carry(self, point, begin, end):
        """Points of the plate some time later: turned about the vertical, then shifted."""
        middle = np.array([0, 0, plates.AWAY])
        rest = point - middle - self.velocity * begin[..., None]
        angle = self.rate * (end - begin)
        cos, sin = np.cos(angle), np.sin(angle)
        x, y, z = np.moveaxis(rest, -1, 0)
        turned = np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)
        return turned + middle + self.velocity * end[..., None]

    def points(self, time):
        """Where the rays of a frame's pixels meet the plate, and when."""
        when = self.read(time, self.pixel)
        xy = (self.pixel - plates.SIDE / 2) / self.focal
        if self.fisheye:
            theta = np.hypot(xy[..., 0], xy[..., 1])
            xy = xy * (np.tan(theta) / theta)[..., None]
        ray = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        origin = self.eye * when[..., None]
        angle = self.rate * when
        normal = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
        on_it = np.array([0, 0, plates.AWAY]) + self.velocity * when[..., None]
        t = np.sum((on_it - origin) * normal, -1) / np.sum(ray * normal, -1)
        return origin + t[..., None] * ray, when

    def flow(self, time, other):
        """Solved by fixed-point steps, many of them, which contract here."""
        point, when = self.points(time)
        then = when + other - time
        for _ in range(60):
            place = self.place(self.carry(point, when, then), then)
            then = self.read(other, place)
        inside = np.all((place > 0) & (place < plates.SIDE), axis=-1)
        return place - self.pixel, inside


def compare_flow(scene, world, *, frames=(NOW, NEXT), **filming):
    """Flow there and back against the world's, wherever both land well inside the picture."""
    now, then = (plates.camera(time, **filming) for time in frames)
    made, flows = labeller(scene, samples=1), []
    for filmed, other in ((now, then), (then, now)):
        # The frame before is the one after too: one program serves both ways.
        found = made(filmed, ["flow_forward", "flow_backward"], before=other, after=other)
        np.testing.assert_array_equal(found["flow_backward"], found["flow_forward"])
        flows.append(found["flow_forward"])
    for flow, (a, b) in zip(flows, (frames, frames[::-1]), strict=True):
        expected, inside = world.flow(a, b)
        assert inside.mean() > 0.6
        # Within a twentieth of a pixel of the frame rounding decides.
        edge = np.min(
            np.abs(expected + world.pixel - np.array([[0.0], [plates.SIDE]])[:, None, None]),
            axis=(0, -1),
        )
        np.testing.assert_array_equal(np.isfinite(flow[..., 0])[edge > 0.05], inside[edge > 0.05])
        seen = np.isfinite(flow[..., 0]) & inside
        np.testing.assert_allclose(flow[seen], expected[seen], atol=PIXELS)
    return flows[0]


@pytest.mark.slow
@pytest.mark.parametrize(("fisheye", "readout"), [(False, 0.0), (True, READOUT)])
def test_flow_of_a_plate_that_glides(fisheye, readout):
    velocity = np.array([3.0, 2.0, 0.0])
    scene = plates.moved(plates.plate(3.4), velocity=velocity)
    world = World(readout=readout, fisheye=fisheye, velocity=velocity)
    flow = compare_flow(scene, world, readout=readout, fisheye=fisheye)
    if not fisheye:
        # Closed form: the landing row is read 1 - step f v / z times sooner than at an even pace.
        speed = world.focal * velocity[:2] / plates.AWAY
        expected = speed * (NEXT - NOW) / (1 - world.step * speed[1])
        seen = np.isfinite(flow[..., 0])
        np.testing.assert_allclose(flow[seen] - expected, 0, atol=PIXELS)


def fields(made, apart, late):
    """The same camera, interlaced and released late."""
    table = toy.single(interlaced_row_times(plates.SIDE, apart))
    shutter = dataclasses.replace(made.shutter, row_times=table, trigger=toy.single(late))
    return dataclasses.replace(made, shutter=shutter)


@pytest.mark.slow
def test_flow_of_a_plate_that_glides_goes_from_field_to_field():
    """Closed form: a row is met by the same field of the other frame, as much later as that is."""
    velocity, apart, late = np.array([3.0, 2.0, 0.0]), 0.05, (0.01, 0.015)
    scene = plates.moved(plates.plate(3.4), velocity=velocity)
    now, then = (
        fields(plates.camera(t, readout=READOUT), apart, x)
        for t, x in zip((NOW, NEXT), late, strict=True)
    )
    found = labels(scene, now, ["flow_forward", "time"], after=then)
    world = World(readout=READOUT)
    read = (
        world.read(NOW, world.pixel) + late[0] + interlaced_row_times(plates.SIDE, apart)[:, None]
    )
    np.testing.assert_allclose(found["time"], read, atol=1e-6)
    speed = world.focal * velocity[:2] / plates.AWAY
    gap = NEXT - NOW + late[1] - late[0]
    expected = speed * gap / (1 - world.step * speed[1])
    flow = found["flow_forward"]
    seen = np.isfinite(flow[..., 0])
    assert seen.mean() > 0.6
    np.testing.assert_allclose(flow[seen] - expected, 0, atol=PIXELS)


@pytest.mark.slow
def test_a_table_of_even_steps_is_a_rolling_shutter():
    scene = plates.moved(plates.plate(3.4), velocity=(3.0, 2.0, 0.0))

    def flow(*pair):
        now, then = pair
        return labels(scene, now, ["flow_forward"], after=then)["flow_forward"]

    by_step = [plates.camera(time, readout=READOUT) for time in (NOW, NEXT)]
    table = toy.single(np.linspace(-READOUT / 2, READOUT / 2, plates.SIDE))
    by_table = [
        dataclasses.replace(
            x, shutter=dataclasses.replace(plates.camera(0).shutter, row_times=table)
        )
        for x in by_step
    ]
    expected, found = flow(*by_step), flow(*by_table)
    assert (np.isfinite(expected) == np.isfinite(found)).mean() > 0.99
    np.testing.assert_allclose(found - expected, 0 * (found - expected), atol=1e-3)


@pytest.mark.ci
def test_flow_of_a_body_that_turns_under_a_fisheye_that_rolls():
    scene = plates.moved(plates.plate(3.4), rate=1.2)
    world = World(readout=READOUT, fisheye=True, rate=1.2)
    compare_flow(scene, world, frames=(0.1, 0.2), readout=READOUT, fisheye=True)


@pytest.mark.ci
def test_flow_of_what_stands_still_under_a_moving_camera_that_rolls():
    eye = np.array([-2.0, 3.0, 0.0])
    scene = Scene(plates.plate(4.0), plates.NOTHING, None, toy.single([0, 1]))
    world = World(readout=READOUT, eye=eye)
    flow = compare_flow(scene, world, readout=READOUT, velocity=eye)
    speed = -world.focal * eye[:2] / plates.AWAY
    seen = np.isfinite(flow[..., 0])
    expected = speed * (NEXT - NOW) / (1 - world.step * speed[1])
    np.testing.assert_allclose(flow[seen] - expected, 0, atol=PIXELS)


@pytest.mark.ci
def test_geometry_of_a_plate_that_turns_while_rows_are_read():
    rate = 1.5
    scene = plates.moved(plates.plate(3.4), rate=rate)
    filmed = plates.camera(NOW, readout=READOUT)
    found = labels(scene, filmed, WITHOUT_FLOW)
    point, when = World(readout=READOUT, rate=rate).points(NOW)
    assert all(np.isfinite(x).all() for x in found.values())
    np.testing.assert_allclose(found["time"], when, atol=1e-6)
    np.testing.assert_allclose(found["origin"], 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found["direction"], axis=-1), 1, atol=1e-6)
    at = found["origin"] + found["depth"][..., None] * found["direction"]
    np.testing.assert_allclose(at, point, atol=3 * UNITS)
    np.testing.assert_allclose(found["z"], point[..., 2], atol=3 * UNITS)
    facing = -np.stack([np.sin(rate * when), 0 * when, np.cos(rate * when)], axis=-1)
    np.testing.assert_allclose(found["normal"], facing, atol=1e-4)
    assert found["alpha"].min() > 0.5 and found["valid"].all() and found["moving"].all()
    np.testing.assert_array_equal(found["group"], 3)
    # The Gaussian that adds most is one whose disc the ray meets.
    mean = np.asarray(scene.moving.mean)[found["gaussian"]]
    middle = np.array([0, 0, plates.AWAY])
    carried = World(rate=rate).carry(mean, 0 * when, when)
    assert np.linalg.norm(carried - point, axis=-1).max() < 0.3
    assert np.ptp(mean - middle, axis=(0, 1))[0] > 1


def test_blur_is_the_way_on_the_picture_during_the_exposure():
    scene = plates.moved(plates.plate(3.4), velocity=(2.0, 1.0, 0))
    filmed = plates.camera(NOW, exposure=0.05)
    found = labels(scene, filmed, WITHOUT_FLOW)["blur"]
    expected = 1.1 * plates.SIDE * np.hypot(2, 1) / plates.AWAY * 0.05
    np.testing.assert_allclose(found, expected, atol=PIXELS)


def test_what_is_seen_is_told_from_what_is_not_and_neighbours_that_are_not_there():
    # A wall behind the left half, a plate that glides before its middle, nothing to the right.
    wall = plates.plate(2.0, z=4.0, x=-2.1)
    scene = plates.moved(plates.plate(0.3, z=2.0, x=-0.5), velocity=(0.2, 0, 0), still=wall)
    found = labels(
        scene, plates.camera(0.0), [name for name in LABELS if name not in PICTURE_LABELS]
    )
    right = np.s_[:, plates.SIDE * 3 // 4 :]
    for name in ("valid", "group", "moving"):
        assert found[name].dtype.kind in "iu" and not found[name][right].any()
    np.testing.assert_array_equal(found["gaussian"][right], -1)
    for name in ("depth", "z", "normal", "confusion", "blur"):
        shown = np.isfinite(found[name])
        valid = found["valid"].astype(bool)
        shown = shown if shown.ndim == 2 else shown.all(axis=-1)
        np.testing.assert_array_equal(shown, valid)
    for name in ("alpha", "time", "origin", "direction"):
        assert np.isfinite(found[name]).all()
    assert np.isnan(found["flow_forward"]).all() and np.isnan(found["flow_backward"]).all()
    middle, near = plates.SIDE // 2, plates.SIDE // 2 - 6
    assert (found["group"][middle, near], found["moving"][middle, near]) == (3, 1)
    assert found["gaussian"][middle, near] >= wall.count
    assert set(np.unique(found["group"])) == {0, 1, 3}
    standing = found["group"] == 1
    assert standing.any() and (found["gaussian"][standing] < wall.count).all()
    # The upper rows are beyond the reach of the plate's discs, which elsewhere share in the mean.
    np.testing.assert_allclose(found["z"][:2][standing[:2]], 4, atol=UNITS)
    assert standing[:2].any()


def test_confusion_is_the_thin_lens_s_and_nothing_in_focus():
    scene = Scene(plates.plate(3.0), plates.NOTHING, None, toy.single([0, 1]))
    radius = 0.1

    def confusion(focus):
        values = map(toy.single, (radius, focus, 0, 1))
        filmed = dataclasses.replace(plates.camera(0.0), aperture=Aperture(*values))
        return labels(scene, filmed, SOME)["confusion"]

    for focus in (1.5, 3.0, 10.0, np.inf):
        expected = 2 * radius * 1.1 * plates.SIDE * abs(1 / focus - 1 / plates.AWAY)
        np.testing.assert_allclose(confusion(focus), expected, atol=0.01)


def test_confusion_follows_a_focus_that_is_pulled_while_rows_are_read_and_passes_a_rim():
    scene = Scene(plates.plate(3.0), plates.NOTHING, None, toy.single([0, 1]))
    radius, readout, ends = 0.1, 1.0, np.array([1.5, 10.0])
    pull = FocusPull(toy.single([0.0, 1.0]), toy.single(ends))
    radius_, zero, one = map(toy.single, (radius, 0, 1))
    plain = Aperture(radius_, pull, zero, one)
    tight = dataclasses.replace(plain, rim=Rim(toy.single(0.02), toy.single(0.2)))
    clear, clipped = (
        labels(scene, dataclasses.replace(plates.camera(0.5, readout=readout), aperture=x),
               ["confusion", "direction", "origin", "valid"])
        for x in (plain, tight)
    )  # fmt: skip
    way = np.linspace(0, 1, plates.SIDE)[:, None]
    closeness = (1 - way) / ends[0] + way / ends[1]
    expected = 2 * radius * 1.1 * plates.SIDE * np.abs(closeness - 1 / plates.AWAY)
    expected = np.broadcast_to(expected, (plates.SIDE, plates.SIDE))
    np.testing.assert_allclose(clear["confusion"], expected, atol=0.01)
    for name, image in clear.items():
        np.testing.assert_array_equal(clipped[name], image)


def test_only_what_is_asked_for_is_made_and_unknown_names_are_refused():
    scene = Scene(plates.plate(3.0), plates.NOTHING, None, toy.single([0, 1]))
    made = labeller(scene)
    assert made(plates.camera(0.0), ["sharp"]) == {} and made(plates.camera(0.0), []) == {}
    assert set(made(plates.camera(0.0), ["time", "origin"])) == {"time", "origin"}
    with pytest.raises(ValueError, match="labels must be among depth, .*, got 'colour'"):
        check_labels(["depth", "colour"])
    with pytest.raises(ValueError, match="labels must name each label once"):
        made(plates.camera(0.0), ["depth", "depth"])


@pytest.mark.ci
def test_labels_in_strips_are_the_labels(monkeypatch):
    monkeypatch.setattr(labels_of_frames, "default_capacity", default_capacity)
    scene = Scene(plates.plate(1.0), plates.NOTHING, None, toy.single([0, 1]))
    # Eight of so many rows at a time; no row is like the one below it.
    few, filmed = 8 * plates.SIDE * (RAY + SAMPLE + PIXEL) / 1e9, plates.camera(0.0)
    whole = labeller(scene)(filmed, SOME)
    strips = labeller(scene, memory=few)(filmed, SOME)
    for name in SOME:
        np.testing.assert_allclose(strips[name], whole[name], rtol=0, atol=SAME, err_msg=name)


def test_lists_that_are_too_short_grow_until_nothing_is_lost(monkeypatch):
    scene = Scene(plates.plate(3.0), plates.NOTHING, None, toy.single([0, 1]))
    expected = labels(scene, plates.camera(0.0), SOME)
    grown, enlarge = [], trace.enlarge_program_capacity

    def noted(*sizes, **options):
        grown.append(enlarge(*sizes, **options))
        return grown[-1]

    short = Capacity((512,) * (TRACE.levels + 1), 16, 4)
    monkeypatch.setattr(labels_of_frames, "default_capacity", lambda *_: short)
    monkeypatch.setattr(trace, "enlarge_program_capacity", noted)
    again = labels(scene, plates.camera(0.0), SOME)
    assert grown and grown[-1].pairs > short.pairs and grown[-1].slots > short.slots
    for name in SOME:
        np.testing.assert_array_equal(again[name], expected[name])


def test_another_lens_compiles_only_what_knows_the_camera(monkeypatch):
    """View, lens and reading; the search for surfaces, identities and paths are shared."""
    scene = plates.moved(plates.plate(3.4), rate=0.5)
    names, made, make = ["flow_forward", "z", "normal"], [], picture_programs.on_devices
    asked = labeller(scene)
    asked(plates.camera(NOW, readout=READOUT), names, after=plates.camera(NEXT, readout=READOUT))

    def noted(function, *arguments, **options):
        made.append(function.__qualname__.split(".")[0])
        return make(function, *arguments, **options)

    monkeypatch.setattr(picture_programs, "on_devices", noted)
    monkeypatch.setattr(programs, "on_devices", noted)
    lens = Division(*map(toy.single, ([1.1 * plates.SIDE] * 2, [plates.SIDE / 2] * 2, [-0.1], 10)))
    filmed = [
        dataclasses.replace(plates.camera(time, readout=READOUT), lens=lens) for time in (NOW, NEXT)
    ]
    asked(filmed[0], names, after=filmed[1])
    assert sorted(made) == ["lens_program", "timing_program", "view_program"]
