"""Heads for making lamps: geometry, lights, a camera, and light on a ball, where it is known."""

import numpy as np
import pytest
from safetensors.numpy import save_file

from making.head.compare import best_match, candidates, left_out
from making.head.geometry import load_heads, normals_of, random_identity
from making.head.light import FACE_CENTRE, WHITE_K, Lamp, Light, Room, colour_of
from making.head.photographs import Development, brightness, face_in
from making.head.rays import Rays
from making.head.render import Camera, View
from making.head.sampled_lights import AZIMUTHS, ELEVATIONS, spread_lights, training_light
from making.head.surface import Surface

RADIUS = 8.0


def ball(steps: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and outward triangles of a ball."""
    polar, around = np.meshgrid(np.linspace(0.01, np.pi - 0.01, steps), np.linspace(0, 2 * np.pi, 2 * steps))
    vertices = np.stack([np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=-1)
    corner = (np.arange(2 * steps - 1)[:, None] * steps + np.arange(steps - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + steps + 1, corner + steps], axis=-1)
    return RADIUS * vertices.reshape(-1, 3), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_heads_are_the_mean_and_displacements(tmp_path, rng):
    mean = rng.normal(size=(6, 3)).astype(np.float32)
    identities = rng.normal(size=(2, 6, 3)).astype(np.float16)
    expressions = rng.normal(size=(2, 6, 3)).astype(np.float16)
    tensors = {
        "vertices": mean,
        "triangles": np.array([[0, 1, 2]], np.int32),
        "identities": identities,
        "expressions": expressions,
        "landmarks_68": np.arange(6, dtype=np.int32),
    }
    save_file(tensors, tmp_path / "heads.safetensors", {"expressions": "jawOpen,smile"})
    heads = load_heads(tmp_path / "heads.safetensors")
    wanted = mean + 0.5 * identities[0].astype(float) - identities[1] + 0.25 * expressions[1].astype(float)
    np.testing.assert_allclose(heads.shaped(np.array([0.5, -1.0]), {"smile": 0.25}), wanted, atol=1e-6)
    np.testing.assert_allclose(heads.shaped(np.zeros(0)), mean)


def test_identities_are_of_people(rng):
    identity = random_identity(rng, 5000)
    assert np.abs(identity).max() == 2.0
    assert 0.8 < identity.std() < 1.0


def test_normals_of_a_ball_are_its_radii():
    vertices, triangles = ball()
    normals = normals_of(vertices, triangles)
    inner = np.abs(vertices[:, 1]) < 0.9 * RADIUS
    assert (np.einsum("nd,nd->n", normals, vertices / RADIUS)[inner] > 0.98).all()


def test_colours_follow_the_temperature():
    np.testing.assert_allclose(colour_of(WHITE_K), 1.0)
    warm = colour_of(2800.0)
    assert warm[0] > 1.0 > warm[2]
    # Wien: the logarithms of the colours of any two lamps are in proportion.
    cold = np.log(colour_of(9000.0))
    assert np.log(warm)[0] / np.log(warm)[2] == pytest.approx(cold[0] / cold[2])


def test_lamps_stand_where_their_angles_say():
    right = Lamp(azimuth=np.pi / 2, elevation=0.0, distance=100.0)
    np.testing.assert_allclose(right.position, FACE_CENTRE + np.array([100.0, 0.0, 0.0]), atol=1e-9)
    above = Lamp(azimuth=0.0, elevation=np.pi / 2, distance=100.0)
    np.testing.assert_allclose(above.position, FACE_CENTRE + np.array([0.0, 100.0, 0.0]), atol=1e-9)


def test_lights_span_what_they_should():
    lights = spread_lights(60)
    azimuths = np.rad2deg([light.lamps[0].azimuth for light in lights])
    elevations = np.rad2deg([light.lamps[0].elevation for light in lights])
    assert (np.abs(azimuths) <= AZIMUTHS[1]).all()
    assert np.ptp(azimuths) > 0.9 * np.ptp(AZIMUTHS)
    assert np.ptp(elevations) > 0.9 * np.ptp(ELEVATIONS)
    assert abs((azimuths > 0).mean() - 0.5) < 0.1
    pairs = [light for light in lights if len(light.lamps) > 1]
    assert 6 <= len(pairs) <= 18
    assert all(light.lamps[0].azimuth * light.lamps[1].azimuth < 0 for light in pairs)
    assert all(lamp.radius < lamp.distance / 2 for light in lights for lamp in light.lamps)
    assert spread_lights(60) == lights


def test_training_lights_come_from_the_front(rng):
    for _ in range(30):
        lamps = training_light(rng).lamps
        mean = np.mean([lamp.strength * np.sin(lamp.azimuth) for lamp in lamps])
        assert abs(mean) < 0.3


def test_stored_values_increase_and_end_at_white(rng):
    linear = np.linspace(0.0, 2.0, 4001)[:, None, None].repeat(3, axis=2).repeat(200, axis=1)
    for development in (Development(), Development(contrast=0.6, black=0.02)):
        stored = development.stored(linear, rng).mean(axis=(1, 2))
        assert (np.diff(stored[::40]) > -0.3).all()
        assert stored[0] == 0.0
        assert stored[-1] == 255.0


def test_brightness_is_that_of_the_face():
    linear = np.full((40, 40, 3), 5.0)
    points = np.array([(10.0, 10.0), (30.0, 10.0), (30.0, 30.0), (10.0, 30.0)])
    linear[10:31, 10:31] = 0.25
    assert face_in(linear.shape, points).sum() == 21 * 21
    assert brightness(linear, face_in(linear.shape, points)) == 0.25


def test_the_most_similar_field_is_found_and_people_are_compared_with_each_other(rng):
    inside = np.zeros((16, 16), bool)
    inside[3:12, 3:12] = True
    fields = rng.normal(size=(len(candidates()), 16, 16))
    persons = fields[40] + 0.1 * rng.normal(size=(5, 16, 16))
    persons[:, ~inside] = rng.normal(size=(5, (~inside).sum()))  # what is beside the face does not count
    match = best_match("03", persons, candidates(), fields, inside)
    assert match.candidate == candidates()[40].name
    assert match.correlation > 0.98
    assert match.left_out == left_out(persons, inside) > 0.98
    assert left_out(rng.normal(size=(5, 16, 16)), inside) < 0.5


@pytest.fixture(scope="module")
def seen():
    """A white ball without gloss, 8 cm in radius, 60 cm before a black wall."""
    pytest.importorskip("embreex", reason="the ray tracer is a tool for making lamps: pip install embreex")
    vertices, triangles = ball()
    n = len(vertices)
    wall = np.array([(-400.0, -400, -60), (400, -400, -60), (400, 400, -60), (-400, 400, -60)])
    surface = Surface(
        np.concatenate([vertices, wall]),
        np.concatenate([vertices / RADIUS, np.tile((0.0, 0.0, 1.0), (4, 1))]),
        np.concatenate([triangles, [(n, n + 1, n + 2), (n, n + 2, n + 3)]]).astype(np.int32),
        np.concatenate([np.ones((n, 3)), np.full((4, 3), 0.0)]).astype(np.float32),
        np.zeros(n + 4, np.float32),
        np.ones(n + 4, np.float32),
        np.zeros(n + 4, np.float32),
    )
    return View(surface, Camera(distance=400.0, width=40.0, size=64), np.random.default_rng(0))


def test_the_camera_sees_points_where_they_are(seen):
    np.testing.assert_allclose(seen.camera.seen_at(np.array([[0.0, 0.0, 0.0]])), [[31.5, 31.5]])
    right_and_up = seen.camera.seen_at(np.array([[5.0, 5.0, 0.0]]))
    np.testing.assert_allclose(right_and_up, [[31.5 + 8.0, 31.5 - 8.0]])
    # A pixel's ray ends where the point on it is seen, but that points lie a little above the surface.
    pixels = seen.camera.seen_at(seen.points.at)
    rows, columns = np.divmod(np.arange(64 * 64), 64)
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=-1), atol=0.04)


def test_a_far_lamp_shines_by_the_cosine(seen):
    lamp = Lamp(azimuth=0.8, elevation=0.0, distance=1e5, radius=1.0)
    picture = seen.under(Light((lamp,), Room(0.0)))[..., 1].ravel()
    towards = lamp.position / np.linalg.norm(lamp.position)
    cosine = np.maximum(seen.points.normals @ towards, 0.0)
    on_ball = np.linalg.norm(seen.points.at, axis=1) < RADIUS + 0.1
    np.testing.assert_allclose(np.pi * picture[on_ball], cosine[on_ball], atol=0.03)


def test_an_open_room_shines_alike_on_all_sides(seen):
    picture = seen.under(Light((), Room(0.7, axis=(0.0, 0.0, 0.0))))[..., 1].ravel()
    front = (np.linalg.norm(seen.points.at, axis=1) < RADIUS + 0.1) & (seen.points.normals[:, 2] > 0.95)
    # At grazing angles, a few rays meet the next facet of the ball.
    np.testing.assert_allclose(np.pi * picture[front], 0.7, atol=0.05)
    assert np.pi * picture[front].mean() == pytest.approx(0.7, abs=0.003)


def test_the_ball_casts_a_shadow_on_the_wall():
    pytest.importorskip("embreex", reason="the ray tracer is a tool for making lamps: pip install embreex")
    rays = Rays(*ball())
    behind = np.array([[0.0, 0.0, -60.0], [30.0, 0.0, -60.0]])
    towards_lamp = np.array([[0.0, 0.0, 200.0], [0.0, 0.0, 200.0]])
    assert rays.are_blocked(behind, towards_lamp).tolist() == [True, False]
    before_the_ball = np.array([[0.0, 0.0, 40.0]])
    assert not rays.are_blocked(behind[:1], before_the_ball)[0]


def test_a_warm_lamp_makes_warm_pictures(seen):
    picture = seen.under(Light((Lamp(0.0, 0.0, temperature=2800.0),), Room(0.0)))
    red, green, blue = picture[28:36, 28:36].mean(axis=(0, 1))
    np.testing.assert_allclose([red / green, blue / green], colour_of(2800.0)[[0, 2]], rtol=1e-5)
