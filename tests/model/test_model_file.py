"""Model files: what is written comes back; what is broken is refused by name."""

import json
import os
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from safetensors import safe_open
from safetensors.numpy import save

from liaam.errors import MethodError, ModelFileError
from liaam.fitting import Fitter
from liaam.model import AAM, MESH, SURROUNDINGS, ModelCard, cost, load_model
from liaam.model.file_format import LONGEST_OF_CARD
from liaam.model.shape import diagonal_of, similarity_modes
from liaam.model.views import Reliability, View
from liaam.models import model_file as model_file_of
from liaam.photometry import CameraModel, NoiseModel
from liaam.training import train
from setups import disturb, train_on

FILE = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


@pytest.fixture(scope="session")
def model_file(model, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("models") / "face.liaam"
    replace(model, contours=(((0, 1, 2), True), ((3, 4), False)), name="häd 7").save(path)
    return path


@pytest.fixture(scope="session")
def tiny_file(tmp_path_factory) -> Path:
    """A complete model of a few kilobytes, to be broken in many ways."""
    rng = np.random.default_rng(0)
    shapes = np.array([[20, 20], [50, 20], [50, 50], [20, 50.0]]) + rng.normal(0, 1, (4, 4, 2))
    images = rng.integers(40, 200, (4, 70, 70, 3), dtype=np.uint8)
    path = tmp_path_factory.mktemp("tiny") / "tiny.liaam"
    points = np.concatenate([shapes, shapes[:, :2] + 3.0], axis=1) + rng.normal(0, 1, (4, 6, 2))
    pairs = zip(images, shapes, strict=True)
    train(pairs, diagonal=16, blurs={MESH: (0.0,)}, variance=1, points=points, features=np.square, methods="all").save(
        path
    )
    return path


def parts(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    with safe_open(path, framework="numpy") as file:
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        return json.loads(file.metadata()["liaam"]), tensors


def forge(path: Path, header: dict, tensors: dict[str, np.ndarray]) -> Path:
    path.write_bytes(save(tensors, {"liaam": json.dumps(header)}))
    return path


def assert_refused(path: Path, match: str = "model") -> None:
    with pytest.raises(ModelFileError, match=match) as caught:
        load_model(path)
    assert str(path) in str(caught.value)


# What is written comes back


def test_a_loaded_model_is_the_saved_one(model, model_file):
    loaded = load_model(model_file)
    assert (loaded.theta, loaded.response, loaded.n_images) == (model.theta, model.response, 8)
    assert loaded.contours == (((0, 1, 2), True), ((3, 4), False))
    assert loaded.name == "häd 7"
    assert [level.blur for level in loaded.levels] == [level.blur for level in model.levels]
    assert loaded.levels[0].appearances.keys() == model.levels[0].appearances.keys()
    np.testing.assert_array_equal(loaded.shape_model.basis, model.shape_model.basis)


def test_each_view_keeps_its_own_shapes(model, tmp_path):
    view = model.views[SURROUNDINGS]
    own = replace(view.shape_model, modes=view.shape_model.modes[:2], eigenvalues=np.array([3.0, 1.0]), freedom=5.0)
    model.with_view(SURROUNDINGS, warp=replace(view.warp, shape_model=own)).save(tmp_path / "own.liaam")
    loaded = load_model(tmp_path / "own.liaam")
    assert loaded.views.keys() == {MESH, SURROUNDINGS}
    for name in ("mean", "modes", "eigenvalues", "unexplained", "freedom"):
        np.testing.assert_array_equal(getattr(loaded.views[SURROUNDINGS].shape_model, name), getattr(own, name))
    assert loaded.shape_model.freedom == np.inf
    np.testing.assert_array_equal(loaded.shape_model.modes, model.shape_model.modes)


def test_a_model_of_the_mesh_alone_is_kept(model, tmp_path, lit_scene):
    replace(model, views={MESH: model.views[MESH]}).save(tmp_path / "mesh.liaam")
    loaded = load_model(tmp_path / "mesh.liaam")
    assert list(loaded.views) == [MESH]
    assert Fitter(loaded, "li").fit(lit_scene.image, disturb(lit_scene.landmarks)).status.ok
    with pytest.raises(MethodError, match=r"soft-li: the model has no view surroundings; train it again, or .*'li'"):
        Fitter(loaded)


def test_the_card_is_kept(model, tmp_path):
    card = ModelCard(data="eight heads, häd 7", licence="CC0", limits="only heads")
    replace(model, card=card).save(tmp_path / "card.liaam")
    assert load_model(tmp_path / "card.liaam").card == card
    assert card.missing == ["purpose", "accuracy", "credit"]


def test_older_files_have_the_credit_alone(model_file, tmp_path):
    header, tensors = parts(model_file)
    header.pop("card", None)
    assert load_model(forge(tmp_path / "none.liaam", header, tensors)).card == ModelCard()
    old = forge(tmp_path / "old.liaam", {**header, "credit": "the makers"}, tensors)
    assert load_model(old).card == ModelCard(credit="the makers")


def test_a_card_is_texts_of_limited_length(model_file, tmp_path):
    header, tensors = parts(model_file)
    long = forge(tmp_path / "long.liaam", {**header, "card": {"data": "x" * 10_000, "unknown": 1}}, tensors)
    assert load_model(long).card == ModelCard(data="x" * LONGEST_OF_CARD)
    assert_refused(forge(tmp_path / "list.liaam", {**header, "card": ["CC0"]}, tensors), "card .* is not an object")
    with pytest.raises(ModelFileError, match="data of a card has 4001 characters"):
        ModelCard(data="x" * (LONGEST_OF_CARD + 1))
    with pytest.raises(ModelFileError, match="limits of a card: give a text, not list"):
        ModelCard(limits=["masks"])


@pytest.mark.parametrize("freedom", [0.0, -1.0, float("nan"), "many", None])
def test_degrees_of_freedom_that_make_no_sense_are_refused(model_file, tmp_path, freedom):
    header, tensors = parts(model_file)
    header["views"][MESH]["freedom"] = freedom
    with pytest.raises(ModelFileError, match="contradicts itself"):
        load_model(forge(tmp_path / "forged.liaam", header, tensors))


@pytest.mark.parametrize("method", ["li", "rgb", "li-lit"])
def test_a_loaded_model_fits_identically(model, model_file, lit_scene, method):
    start = disturb(lit_scene.landmarks)
    ours, theirs = (Fitter(m, method).fit(lit_scene.image, start) for m in (model, load_model(model_file)))
    np.testing.assert_array_equal(ours.landmarks, theirs.landmarks)
    assert ours.cost == theirs.cost


def test_a_model_without_modes_is_kept(scenes, tmp_path):
    train_on(scenes[:3], diagonal=40.0, variance=0).save(tmp_path / "rigid.liaam")
    loaded = load_model(tmp_path / "rigid.liaam")
    assert loaded.levels[0].appearances["value"].n_modes == 0
    assert len(loaded.shape_model.modes) == 0


def test_how_far_the_model_errs_is_kept(model, model_file):
    for ours, theirs in zip(model.levels, load_model(model_file).levels, strict=True):
        for name, appearance in ours.appearances.items():
            loaded = theirs.appearances[name].unexplained
            if name in ("illumination", "search"):
                assert appearance.unexplained is None
                assert loaded is None
            else:
                assert np.array_equal(loaded, appearance.unexplained)
                assert loaded.any()


def test_a_file_that_does_not_know_how_far_the_model_errs_is_read(model, model_file, tmp_path, lit_scene):
    header, tensors = parts(model_file)
    older = {key: value for key, value in tensors.items() if not key.endswith("unexplained")}
    assert len(older) < len(tensors)
    loaded = load_model(forge(tmp_path / "older.liaam", header, older))
    start = disturb(lit_scene.landmarks)
    for method in ("li", "grey+huber"):
        ours, theirs = (Fitter(m, method).fit(lit_scene.image, start) for m in (model, loaded))
        assert np.array_equal(ours.landmarks, theirs.landmarks)
    assert Fitter(loaded, "li+noise").fit(lit_scene.image, start).lam.size  # the model's errors then count as none
    with pytest.raises(MethodError, match=r"grey\+learnt: the model has no variances of its errors; train it again"):
        Fitter(loaded, "grey+learnt")


def test_saving_is_deterministic(model_file, tmp_path):
    again = tmp_path / "again.liaam"
    load_model(model_file).save(again)
    assert again.read_bytes() == model_file.read_bytes()


# A save that fails leaves the old file


def test_a_save_that_fails_leaves_the_old_file(model, tmp_path, monkeypatch):
    path = tmp_path / "face.liaam"
    path.write_bytes(b"old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ModelFileError, match=r"face\.liaam.*No space left"):
        model.save(path)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["face.liaam"]


def test_saving_into_a_missing_folder_is_refused(model, tmp_path):
    with pytest.raises(ModelFileError, match=r"gone.*does not exist"):
        model.save(tmp_path / "gone" / "face.liaam")


def test_saving_onto_a_folder_is_refused(model, tmp_path):
    with pytest.raises(ModelFileError, match="folder"):
        model.save(tmp_path)


# What is broken is refused


def test_a_missing_file_is_refused(tmp_path):
    assert_refused(tmp_path / "none.liaam", "does not exist; make one with 'liaam train")


def test_a_folder_is_refused(tmp_path):
    assert_refused(tmp_path, "is a folder")


@FILE
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_file_cut_short_is_refused(tiny_file, tmp_path, share):
    whole = tiny_file.read_bytes()
    path = tmp_path / "cut.liaam"
    path.write_bytes(whole[: int(share * len(whole))])
    assert_refused(path, "truncated")


@FILE
@given(junk=st.binary(max_size=300))
def test_random_bytes_are_refused(tmp_path, junk):
    path = tmp_path / "junk.liaam"
    path.write_bytes(junk)
    assert_refused(path, "not a complete liaam model|is not a liaam model|image, not a model file")


@FILE
@given(data=st.data())
def test_a_damaged_file_is_refused_or_whole(tiny_file, tmp_path, data):
    damaged = bytearray(tiny_file.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, min(len(damaged), 3000) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged.liaam"
    path.write_bytes(bytes(damaged))
    try:
        loaded = load_model(path)
    except ModelFileError as error:
        assert str(path) in str(error)
    else:
        assert isinstance(loaded, AAM)


def test_a_safetensors_file_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "other.safetensors"
    path.write_bytes(save({"weights": np.zeros(4)}))
    assert_refused(path, "is not a liaam model")


def test_a_lamp_file_is_refused_as_such(tmp_path):
    path = tmp_path / "heads.lamps"
    path.write_bytes(save({"mean": np.zeros((3, 2))}, {"liaam": '{"format": "liaam-lamps", "schema": 1}'}))
    assert_refused(path, "is a lamp file, not a model; draw it with 'liaam show'")


@pytest.mark.parametrize("schema", [0, 1, 2, 3, 8, 99, None, "4"])
def test_another_schema_version_is_refused(tiny_file, tmp_path, schema):
    header, tensors = parts(tiny_file)
    path = forge(tmp_path / "old.liaam", header | {"schema": schema}, tensors)
    assert_refused(path, f"schema version {schema}, this liaam reads versions 4 to 7; train the model again")


@pytest.mark.parametrize("size", [10**12, 2**62, 2**64 - 1])
def test_a_forged_size_is_refused_without_asking_for_the_memory(tmp_path, size):
    header = {
        "__metadata__": {"liaam": json.dumps({"format": "liaam-aam", "schema": 4})},
        "mean": {"dtype": "F64", "shape": [size // 16, 2], "data_offsets": [0, size]},
    }
    text = json.dumps(header).encode()
    path = tmp_path / "huge.liaam"
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"\0" * 64)
    tracemalloc.start()
    assert_refused(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10e6


def test_a_sparse_file_of_a_model_is_refused_by_its_size(tmp_path):
    path = tmp_path / "sparse.liaam"
    path.write_bytes(struct.pack("<Q", 16))
    os.truncate(path, 40 * 10**9)
    assert_refused(path, "has 40,000,000,000 bytes, more than the 2,000,000,000 allowed: make a smaller model file")


def test_many_empty_tensors_are_refused_before_they_are_parsed(tmp_path):
    empty = b'"%06d":{"dtype":"F32","shape":[0],"data_offsets":[0,0]}'
    text = b"{" + b",".join(empty % i for i in range(20_000)) + b"}"
    path = tmp_path / "many.liaam"
    path.write_bytes(struct.pack("<Q", len(text)) + text)
    assert_refused(path, "its header has 20,001 entries, more than 10,000")
    path.write_bytes(struct.pack("<Q", len(text) * 30) + text * 30)
    assert_refused(path, r"its header has 3\d,\d+,\d+ bytes, more than the 10,000,000 allowed")


@pytest.mark.parametrize(
    "change",
    [
        lambda header: header.update(schema="x" * 3_000_000),
        lambda header: header["views"].update({"x" * 3_000_000: {}}),
        lambda header: header.update(camera=["x" * 3_000_000]),
        lambda header: header["views"][MESH].update(blurs=[1.0] * 600_000),
        lambda header: header["views"][MESH].update(blurs=["x" * 3_000_000]),
        lambda header: header["views"][MESH].update(n_pixels="x" * 3_000_000),
        lambda header: header.update(n_images="x" * 3_000_000),
        lambda header: header.update(response="x" * 3_000_000),
    ],
)
def test_long_values_are_cut_in_messages(tiny_file, tmp_path, change):
    header, tensors = parts(tiny_file)
    change(header)
    with pytest.raises(ModelFileError) as caught:
        load_model(forge(tmp_path / "forged.liaam", header, tensors))
    assert len(str(caught.value)) < 1000 and str(caught.value).endswith(("train the model again", "that wrote it"))


def test_a_forged_header_length_is_refused(tmp_path):
    path = tmp_path / "huge.liaam"
    path.write_bytes(struct.pack("<Q", 2**63) + b"{}")
    assert_refused(path)


def entry(*path, value):
    """Change an entry of the header."""

    def change(header, tensors):
        for key in path[:-1]:
            header = header[key]
        header[path[-1]] = value

    return change


def tensor(key, make):
    """Put another array in the place of one."""

    def change(header, tensors):
        tensors[key] = np.array(make(tensors[key]))

    return change


def number(key, place, value):
    """Change one number of an array."""

    def change(header, tensors):
        tensors[key][place] = value

    return change


def without(key):
    return lambda header, tensors: (tensors if key in tensors else header).pop(key)


def of_mesh(key, value):
    return entry("views", MESH, key, value=value)


def huge(modes):
    return modes * np.float32(1e30)


def other_pixels(header, tensors):
    header["views"][SURROUNDINGS]["n_pixels"] += 1


def many_appearance_modes(header, tensors):
    tensors["mesh/0/log.modes"] = np.repeat(tensors["mesh/0/log.modes"][:1], 5, axis=0)
    tensors["mesh/0/log.eigenvalues"] = np.zeros(5)


def rigid_shape_modes(header, tensors):
    """A mode that is the mean itself, so that the pose and it trade off."""
    mean = tensors["mean"].ravel()
    tensors["mesh/shape.modes"] = (mean / np.linalg.norm(mean))[None]
    tensors["mesh/shape.eigenvalues"] = np.ones(1)


def flat_surroundings_first(header, tensors):
    tensors["mean"] = tensors["mean"] * [1.0, 0.0]
    header["views"] = dict(reversed(header["views"].items()))


def empty_view(header, tensors):
    for key in [key for key in tensors if key.startswith("surroundings/0/")]:
        del tensors[key]


def few_pixels(header, tensors):
    """A file of a few bytes that asks for a whole frame."""
    tensors["mesh/0/search.known"][:] = 0
    tensors["mesh/0/search.known"][0] = 128


def few_places_of_light(header, tensors):
    tensors["light.mean"] = tensors["mean"] / diagonal_of(tensors["mean"])
    tensors["light.modes"], tensors["light.steps"] = np.zeros((1, 1, 3), np.int8), np.zeros(1, np.float32)
    tensors["light.known"] = np.packbits(np.arange(128 * 128) < 1)


KNOWN, STEPS = "mesh/0/search.known", "mesh/0/search.steps"

ON_SOME_PIXELS = {
    "few pixels": (few_pixels, "0/search has 1 of"),
    "other mask": (tensor(KNOWN, lambda known: known[:-1]), "0/search.known has type uint8 and shape"),
    "negative step": (number(STEPS, 0, -1e-3), "0/search.steps has values out of range"),
    "huge step": (number(STEPS, 0, 3e38), "0/search.steps has values out of range"),
    "long modes": (tensor(STEPS, lambda steps: steps * np.float32(1.2)), "0/search.modes are not of unit length"),
    "lost steps": (without(STEPS), "0/search.steps"),
    "other steps": (tensor(STEPS, lambda steps: steps[1:]), "0/search.steps has type float32 and shape"),
    "few places of light": (few_places_of_light, "light has 1 of 16384 pixels; at least 10% are expected"),
}


def on_some_pixels(path: Path, first: int = 1, last: int | None = None) -> tuple[dict, dict[str, np.ndarray]]:
    """The tiny model with what the search compares at some pixels, without the first by default."""
    model = load_model(path)
    level = model.levels[0]
    known = np.zeros(model.n_pixels, bool)
    known[first:last] = True
    search = level.appearances["search"].only_at(known)
    level = replace(level, appearances={**level.appearances, "search": search})
    model.with_view(MESH, levels=(level,)).save(path.with_name("some.liaam"))
    return parts(path.with_name("some.liaam"))


@pytest.mark.parametrize("last", [None, 3])  # of so few, as of large frames, the others are stored too
def test_pixels_that_are_not_stored_are_zero(tiny_file, tmp_path, last):
    header, tensors = on_some_pixels(tiny_file, 1, last)
    loaded = load_model(forge(tmp_path / "some.liaam", header, tensors))
    found, whole = (each.levels[0].appearances["search"] for each in (loaded, load_model(tiny_file)))
    for axis, field in enumerate(("mean", "modes")):
        ours, theirs = (np.moveaxis(getattr(each, field), axis, 0) for each in (found, whole))
        assert not ours[0].any()
        np.testing.assert_array_equal(ours[1:last], theirs[1:last])


@pytest.mark.parametrize("name", ON_SOME_PIXELS)
def test_a_forged_part_of_the_pixels_is_refused(tiny_file, tmp_path, name):
    header, tensors = on_some_pixels(tiny_file)
    tensors = {key: value.copy() for key, value in tensors.items()}
    change, match = ON_SOME_PIXELS[name]
    change(header, tensors)
    assert_refused(forge(tmp_path / "forged.liaam", header, tensors), match)


WEIGHTS, PROJECTION = "points.weights", "features.projection"


def of_poses(make, count=1):
    """Return a change that adds poses made of the mean shape."""

    def change(_header, tensors):
        tensors["poses"] = np.repeat(make(tensors["mean"])[None], count, axis=0).astype(np.float32)

    return change


FORGERIES = {
    "map of other landmarks": (tensor(WEIGHTS, lambda w: w[1:]), "points.weights has type"),
    "map of as many points": (tensor(WEIGHTS, lambda w: w[:, :4]), "points.weights do not map"),
    "heavy point": (number(WEIGHTS, (0, 0), 1e9), "points.weights do not map"),
    "certain points": (number("points.noise", 0, 0.0), "points.errors or points.noise are out of range"),
    "endless errors": (number("points.errors", (0, 0), 1e30), "points.errors or points.noise are out of range"),
    "nameless features": (entry("features", value="a b"), "features.projection is not a projection"),
    "stretched features": (tensor(PROJECTION, lambda p: 2.0 * p), "features.projection is not a projection"),
    "huge features": (number("features.mean", 0, 1e30), "features.mean is out of range"),
    "unknown features": (without("features.mean"), "features.mean"),
    "other features": (tensor(PROJECTION, lambda p: p[:, :2]), "0/features.modes has type"),
    "many appearance modes": (many_appearance_modes, "0/log has 5 modes; the maximum is 4"),
    "huge shape modes": (tensor("mesh/shape.modes", lambda modes: 1e30 * modes), "shape.modes are not orthonormal"),
    "huge appearance modes": (tensor("mesh/0/log.modes", huge), "0/log.modes are not of unit length"),
    "rigid shape modes": (rigid_shape_modes, "shape.modes are not orthonormal"),
    "flat": (tensor("mean", lambda mean: mean * [1.0, 0.0]), "the mesh is flat"),
    "flat, surroundings first": (flat_surroundings_first, "the mesh is flat"),
    "sliver": (tensor("mean", lambda mean: mean * [1.0, 1e-200]), "contradicts itself"),
    "empty": (tensor("triangles", lambda triangles: triangles[:0]), "the mesh does not match the landmarks"),
    "large frame": (tensor("mean", lambda mean: 80 * mean), "frame of view mesh does not match its number of pixels"),
    "huge number": (of_mesh("blurs", [10**400]), "contradicts itself"),
    "odd camera": (entry("camera", value=[1]), r"camera \[1\]"),
    "odd views": (entry("views", value=[1]), "there is no view mesh"),
    "odd view": (entry("views", SURROUNDINGS, value=[1]), r"view surroundings is described by \[1\]"),
    "other view": (entry("views", "ears", value={}), "view 'ears' is unknown; the views are mesh, surroundings"),
    "no mesh": (lambda header, tensors: header["views"].pop(MESH), "there is no view mesh"),
    "empty view": (empty_view, "view surroundings lacks an appearance"),
    "hole": (number("mesh/0/log.mean", (3, 1), np.nan), "0/log.mean has values that are not finite"),
    "other type": (tensor("mesh/shape.modes", np.float32), "shape.modes has type float32"),
    "other shape": (tensor("mesh/0/log.modes", lambda modes: modes[:, :-1]), "0/log.modes has type"),
    "other covariance": (tensor("mesh/0/log.unexplained", lambda of: of[:, :2]), "0/log.unexplained has type"),
    "lost": (without("mesh/0/value.usable"), "0/value.usable"),
    "beyond": (number("triangles", (0, 0), 4), "the mesh does not match the landmarks"),
    "negative": (number("triangles", (0, 0), -1), "the mesh does not match the landmarks"),
    "turned over": (tensor("triangles", lambda triangles: triangles[:, ::-1]), "folded"),
    "infinite contour": (entry("contours", value=[[[float("inf")], False]]), "infinity"),
    "no level": (of_mesh("blurs", []), "blurs"),
    "missing level": (of_mesh("blurs", [3.0, 0.5]), "view mesh lacks an appearance"),
    "endless blur": (of_mesh("blurs", [float("inf")]), "not a finite number"),
    "no theta": (entry("theta", value=float("nan")), "not a finite number"),
    "odd response": (entry("response", value="film"), "'film' is unknown"),
    "absurd response": (entry("response", value={"stored": [0.1, 1], "linear": [1e-30, 1e30]}), "1e30"),
    "many images": (entry("n_images", value=float("inf")), "infinity"),
    "other pixels": (other_pixels, "0/soft.modes has type int8 and shape"),
    "no name": (without("name"), "name"),
    "odd fingerprints": (entry("fingerprints", value=["abc"]), "fingerprints are not a list of 16 letters"),
    "one fingerprint": (entry("fingerprints", value="abcdefghijklmnop"), "fingerprints are not a list"),
    "few counts": (entry("n_missing", value=[1]), "n_missing has not 4 numbers from 0 to 3"),
    "many missing": (entry("n_missing", value=[0, 0, 4, 0]), "n_missing has not 4 numbers from 0 to 3"),
    "half missing": (entry("n_missing", value=[0, 0.5, 0, 0]), "n_missing has not 4 numbers from 0 to 3"),
    "odd counts": (entry("n_missing", value="many"), "n_missing has not 4 numbers from 0 to 3"),
    "few poses": (of_poses(lambda mean: mean[:-1]), "poses has type float32 and shape"),
    "no pose": (of_poses(lambda mean: mean, count=0), "there are not 1 to 100 poses"),
    "huge pose": (of_poses(lambda mean: 1e9 * mean), "poses"),
    "point as pose": (of_poses(lambda mean: 0.0 * mean), "the landmarks of a pose coincide"),
    "out of the box": (number("in_box", (0, 0), 0.6), "positions in the box are not from -0.5 to 0.5"),
    "few in the box": (tensor("in_box", lambda positions: positions[:-1]), "in_box has type"),
    "bad eigenvalue": (number("mesh/shape.eigenvalues", slice(None), -1.0), "shape.eigenvalues"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forged_model_is_refused(tiny_file, tmp_path, name):
    header, tensors = parts(tiny_file)
    change, match = FORGERIES[name]
    change(header, tensors)
    assert_refused(forge(tmp_path / "forged.liaam", header, tensors), match)


# Where the limits are


def mesh_of(header, tensors, n: int) -> None:
    """So many landmarks on a circle, under the tiny model's two triangles."""
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    tensors["mean"] = 8 * np.column_stack([np.cos(angle), np.sin(angle)])


def complaint(path: Path, header: dict, tensors: dict[str, np.ndarray]) -> str:
    """What a forged file is refused with; empty if it is taken."""
    try:
        load_model(forge(path, header, tensors))
    except ModelFileError as error:
        too_large = str(error).startswith(f"{path}: the model is too large: ")
        assert too_large or str(error).startswith(f"{path}: the model file contradicts itself")
        assert str(error).endswith("or larger blurs" if too_large else "; train the model again")
        return str(error)
    return ""


@pytest.mark.parametrize(("n", "refused"), [(4000, False), (4001, True), (2, True)])
def test_the_number_of_landmarks_is_limited(tiny_file, tmp_path, n, refused):
    header, tensors = parts(tiny_file)
    mesh_of(header, tensors, n)
    words = "the mesh does not match the landmarks" if n == 2 else f"it has {n} landmarks; the maximum is 4000"
    tensors["triangles"] = tensors["triangles"] if n > 2 else np.array([[0, 1, 1]], np.int32)
    assert (words in complaint(tmp_path / "forged.liaam", header, tensors)) == refused


@pytest.mark.parametrize(
    ("diagonal", "refused"), [(7.99, True), (8.01, False), (1999.9, False), (2000.1, True), (2500.0, True)]
)
def test_the_size_of_the_frame_is_limited(tiny_file, tmp_path, diagonal, refused):
    header, tensors = parts(tiny_file)
    tensors["mean"] = tensors["mean"] * (diagonal / diagonal_of(tensors["mean"]))
    message = complaint(tmp_path / "forged.liaam", header, tensors)
    assert ("the diagonal of the reference frame is not between 8 and 2000 pixels" in message) == refused


def test_a_frame_far_away_is_refused(tiny_file, tmp_path):
    header, tensors = parts(tiny_file)
    tensors["mean"] = tensors["mean"] + 2500.0
    assert "not between 8 and 2000" in complaint(tmp_path / "forged.liaam", header, tensors)


@pytest.mark.parametrize(("n", "refused"), [(1, False), (2, False), (3, True), (4, True)])
def test_triangles_that_overlap_are_refused(tiny_file, tmp_path, n, refused):
    header, tensors = parts(tiny_file)
    each = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]], np.int32)
    tensors["mean"] = np.array([[-6, -6], [6, -6], [6, 6], [-6, 6.0]])
    tensors["triangles"] = each[:n]
    assert ("the mesh overlaps itself" in complaint(tmp_path / "forged.liaam", header, tensors)) == refused


@pytest.mark.parametrize(("n", "refused"), [(8, False), (9, True)])
def test_more_triangles_than_a_mesh_can_have_are_refused(tiny_file, tmp_path, n, refused):
    header, tensors = parts(tiny_file)
    tensors["mean"] = np.array([[-6, -6], [6, -6], [0, -5.5], [-6, 6.0]])
    tensors["triangles"] = np.repeat(np.array([[0, 1, 2]], np.int32), n, axis=0)
    assert ("the mesh overlaps itself" in complaint(tmp_path / "forged.liaam", header, tensors)) == refused


@pytest.mark.parametrize(("blurs", "refused"), [(10, False), (11, True)])
def test_the_number_of_levels_is_limited(tiny_file, tmp_path, blurs, refused):
    header, tensors = parts(tiny_file)
    header["views"][MESH]["blurs"] = [1.0] * blurs
    for i in range(1, blurs):
        tensors |= {key.replace("/0/", f"/{i}/"): v for key, v in tensors.items() if key.startswith("mesh/0/")}
    assert ("blurs" in complaint(tmp_path / "forged.liaam", header, tensors)) == refused
    if not refused:
        assert len(load_model(tmp_path / "forged.liaam").levels) == 10


@pytest.mark.parametrize(("blur", "refused"), [(-0.01, True), (0, False), (10, False), (10.01, True)])
def test_the_blur_is_limited(tiny_file, tmp_path, blur, refused):
    header, tensors = parts(tiny_file)
    header["views"][MESH]["blurs"] = [blur]
    assert ("blurs" in complaint(tmp_path / "forged.liaam", header, tensors)) == refused


def test_blurs_fall_from_coarse_to_fine(tiny_file, tmp_path):
    header, tensors = parts(tiny_file)
    header["views"][MESH]["blurs"] = [1.0, 1.5]
    tensors |= {key.replace("/0/", "/1/"): v for key, v in tensors.items() if key.startswith("mesh/0/")}
    assert "blurs [1.0, 1.5] do not fall" in complaint(tmp_path / "forged.liaam", header, tensors)


# What a model costs is known from its size


def test_the_cost_of_a_model_that_comes_with_liaam_is_far_below_the_limits():
    for part in load_model("face").parts:
        assert cost.work_of(part.views.values()) < 0.15 * cost.MOST_WORK
        assert cost.memory_of(part.views.values()) < 0.15 * cost.MOST_MEMORY


def test_levels_that_are_not_blurred_are_refused_by_their_work(tmp_path):
    header, tensors = parts(model_file_of("face"))
    for about in (header, *header["others"]):
        for view in about.get("views", {}).values():
            view["blurs"] = [0.0] * len(view["blurs"])
    message = complaint(tmp_path / "forged.liaam", header, tensors)
    assert "the model is too large: a fit would take 6.8e+09 multiplications a step" in message
    assert "train it with a smaller diagonal, fewer modes" in message


def test_many_modes_are_refused_before_they_take_memory(tiny_file, tmp_path):
    header, tensors = parts(tiny_file)
    header |= {"n_images": 10**9, "n_textures": 10**9}
    header["views"][MESH]["n_pixels"] = 10**6
    key = "mesh/0/log.modes"
    tensors[key] = np.zeros((1000, *tensors[key].shape[1:]), tensors[key].dtype)
    message = complaint(tmp_path / "forged.liaam", header, tensors)
    assert "the model is too large: it would take 12," in message and "MB, more than the 2,000 allowed" in message


def test_work_grows_with_the_square_of_the_modes_and_with_the_starts(tiny_file):
    view = load_model(tiny_file).views[SURROUNDINGS]
    level, n_shape = view.levels[-1], len(view.shape_model.modes)
    (kind, appearance), *_ = level.appearances.items()
    one = View(view.warp, (replace(level, blur=0.0, appearances={kind: appearance}),))
    count = 1 + appearance.n_modes + n_shape + 4
    assert cost.work_of([one]) == appearance.mean.size * count**2
    known = Reliability(np.zeros((4, 2, 2)), np.zeros((4, 2, 2)), 1.0, np.zeros(3), 1.0)
    calibrated = replace(one, reliabilities={"soft-li": known})
    assert cost.work_of([calibrated]) == cost.STARTS[0] * cost.work_of([one])
    sparse = replace(one, levels=(replace(one.levels[0], blur=2.0),))
    assert cost.work_of([sparse]) == pytest.approx(cost.work_of([one]) / 9)


@pytest.mark.parametrize("count", [-1, 10**10, 0.5, float("nan")])
def test_impossible_numbers_of_images_are_refused(tiny_file, tmp_path, count):
    header, tensors = parts(tiny_file)
    assert "contradicts itself" in complaint(tmp_path / "a.liaam", header | {"n_images": count}, tensors)
    assert "contradicts itself" in complaint(tmp_path / "b.liaam", header | {"n_lamps": count}, tensors)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("mesh/0/log.eigenvalues", 1e300, "log.eigenvalues has values beyond"),
        ("mesh/0/value.mean", 3e38, "value.mean has values beyond 1e+06"),
        ("mesh/shape.eigenvalues", 1e300, "shape.eigenvalues has values beyond"),
        ("mesh/shape.unexplained", 1e300, "shape.unexplained has values beyond"),
        ("search_filter", 3e38, "search_filter has values beyond 1e+06"),
    ],
)
def test_numbers_of_files_are_bounded(tiny_file, tmp_path, key, value, words):
    header, tensors = parts(tiny_file)
    kind = np.float32 if tensors[key].dtype == np.float16 else tensors[key].dtype
    tensors[key] = np.full_like(tensors[key], value, dtype=kind)
    assert words in complaint(tmp_path / "forged.liaam", header, tensors)


def spanned(mean: np.ndarray, count: int) -> np.ndarray:
    """So many orthonormal deformations of landmarks that are no similarities."""
    similarities = similarity_modes(mean)
    noise = np.random.default_rng(1).normal(size=(count, mean.size))
    noise -= noise @ similarities.T @ similarities
    return np.linalg.qr(noise.T)[0].T.copy()


@pytest.mark.parametrize(("count", "words"), [(4, ""), (5, "5 shape modes are too many for 4 landmarks")])
def test_there_are_as_many_shape_modes_as_ways_to_deform(tiny_file, tmp_path, count, words):
    header, tensors = parts(tiny_file)
    modes = np.zeros((count, 8))
    modes[: min(count, 4)] = spanned(tensors["mean"], 4)
    tensors["mesh/shape.modes"], tensors["mesh/shape.eigenvalues"] = modes, np.ones(count)
    message = complaint(tmp_path / "forged.liaam", header, tensors)
    assert words in message and bool(message) == bool(words)


@pytest.mark.parametrize("key", ["mesh/shape.modes", "mesh/0/log.modes"])
@pytest.mark.parametrize(("length", "refused"), [(0.93, True), (0.97, False), (1.03, False), (1.07, True)])
def test_modes_may_be_off_their_length_by_rounding_only(tiny_file, tmp_path, key, length, refused):
    header, tensors = parts(tiny_file)
    tensors[key] = tensors[key] * tensors[key].dtype.type(length)
    assert bool(complaint(tmp_path / "forged.liaam", header, tensors)) == refused


def test_as_many_appearance_modes_as_pictures_are_taken(tiny_file, tmp_path):
    header, tensors = parts(tiny_file)
    tensors["mesh/0/log.modes"] = np.repeat(tensors["mesh/0/log.modes"][:1], 4, axis=0)
    tensors["mesh/0/log.eigenvalues"] = np.zeros(4)
    assert not complaint(tmp_path / "forged.liaam", header, tensors)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (number("mesh/0/log.usable", 0, 1.0), ""),
        (number("mesh/0/log.usable", 0, 1.01), "mesh/0/log.usable has values out of range"),
        (number("mesh/0/log.usable", 0, -0.01), "mesh/0/log.usable has values out of range"),
        (number("mesh/0/log.unexplained", (0, [1, 3, 4]), 0.0), ""),
        (number("mesh/0/log.unexplained", (0, 3), 0.0), "mesh/0/log.unexplained has matrices that are not positive"),
        (number("mesh/0/log.unexplained", (0, 3), -1e-3), "mesh/0/log.unexplained has negative variances"),
        (number("mesh/shape.unexplained", (0, 1, 1), -1e-3), "mesh/shape.unexplained has negative variances"),
        (entry("contours", value=[[[0, 3], True]]), ""),
        (entry("contours", value=[[[0, -1], True]]), "names a landmark that does not exist"),
        (entry("contours", value=[[[0, 4], True]]), "names a landmark that does not exist"),
        (entry("contours", value=5), "not iterable"),
        (entry("theta", value=7.0), "theta"),
        (entry("response", value={"stored": [0.5]}), "response curve"),
        (of_mesh("n_pixels", 1.5), "1.5 is not a positive integer"),
        (of_mesh("n_pixels", 0), "0 is not a positive integer"),
        (without("mesh/0/log.mean"), "view mesh lacks an appearance"),
        (without("mesh/0/value.modes"), "value.modes"),
    ],
)
def test_values_at_their_limits(tiny_file, tmp_path, change, words):
    header, tensors = parts(tiny_file)
    tensors = {key: value.copy() for key, value in tensors.items()}
    change(header, tensors)
    message = (
        complaint(tmp_path / "forged.liaam", header, tensors).replace("'0/", "'mesh/0/").replace("(0/", "(mesh/0/")
    )
    assert words.removeprefix("mesh/") in message and bool(message) == bool(words)


# How far fits can be trusted


RELIABILITY = {
    "landmarks": np.tile(np.eye(2), (4, 1, 1)),
    "bias": np.tile(np.diag([2.0, 3.0]), (4, 1, 1)),
    "unit": np.array([0.25]),
    "weights": np.array([-1.0, 4.0, -0.5]),
    "variance_factor": np.array([1.5]),
    "typical": np.array([0.75]),
    "scales": np.tile(np.diag([0.5, 2.0]), (4, 1, 1)),
}


def trusted(path: Path, **changes) -> tuple[dict, dict[str, np.ndarray]]:
    header, tensors = parts(path)
    known = RELIABILITY | {key: np.asarray(value, np.float64) for key, value in changes.items()}
    return header, tensors | {f"surroundings/reliability.{key}": value.copy() for key, value in known.items()}


def test_what_is_known_of_fits_is_kept(tiny_file, tmp_path):
    first = load_model(forge(tmp_path / "first.liaam", *trusted(tiny_file)))
    assert first.views[MESH].reliabilities == {}
    first.save(tmp_path / "second.liaam")
    for path in ("first.liaam", "second.liaam"):
        known = load_model(tmp_path / path).views[SURROUNDINGS].reliabilities["soft-li"]
        assert known is not None
        np.testing.assert_array_equal(known.landmarks, RELIABILITY["landmarks"])
        np.testing.assert_array_equal(known.bias, RELIABILITY["bias"])
        np.testing.assert_array_equal(known.weights, RELIABILITY["weights"])
        np.testing.assert_array_equal(known.scales, RELIABILITY["scales"])
        assert (known.unit, known.variance_factor, known.typical) == (0.25, 1.5, 0.75)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"variance_factor": [1.0], "typical": [0.0]}, ""),
        ({"typical": [1.0]}, ""),
        ({"variance_factor": [0.99]}, "reliability.variance_factor is below 1"),
        ({"typical": [-0.01]}, "reliability.typical is not a probability"),
        ({"typical": [1.01]}, "reliability.typical is not a probability"),
        ({"typical": [0.5, 0.5]}, "reliability.typical has type float64 and shape (2,)"),
        ({"variance_factor": [[1.0]]}, "reliability.variance_factor has type float64 and shape (1, 1)"),
        ({"weights": [1.0, 2.0]}, "reliability.weights has type float64 and shape (2,)"),
        ({"weights": [1.0, 2.0, np.inf]}, "reliability.weights has"),
        ({"landmarks": np.tile(-np.eye(2), (4, 1, 1))}, "reliability.landmarks has negative variances"),
        ({"bias": np.tile(-np.eye(2), (4, 1, 1))}, "reliability.bias has negative variances"),
        ({"scales": np.tile(-np.eye(2), (4, 1, 1))}, "reliability.scales has negative variances"),
        ({"scales": np.tile(101 * np.eye(2), (4, 1, 1))}, "reliability.scales has values beyond 100"),
        ({"unit": [0.0]}, "reliability.unit is not positive"),
        ({"landmarks": np.zeros((3, 2, 2))}, "reliability.landmarks has type float64 and shape (3, 2, 2)"),
        ({"variance_factor": [1e6], "prior": [1e6]}, ""),
        ({"variance_factor": [1.7e308]}, "reliability.variance_factor has values beyond 1e+06"),
        ({"landmarks": np.tile([[0.0, 1e300], [1e300, 0.0]], (4, 1, 1))}, "reliability.landmarks has values beyond"),
        ({"bias": np.tile([[0.0, 1e300], [1e300, 0.0]], (4, 1, 1))}, "reliability.bias has values beyond 4e+06"),
        ({"bias": np.tile([[0.0, 1e-3], [1e-3, 0.0]], (4, 1, 1))}, "reliability.bias has matrices that are not posi"),
        ({"landmarks": np.tile([[1.0, 2.0], [2.0, 1.0]], (4, 1, 1))}, "reliability.landmarks has matrices that are"),
        ({"landmarks": np.tile([[1.0, 0.5], [0.1, 1.0]], (4, 1, 1))}, "landmarks has matrices that are not symmetric"),
        ({"landmarks": np.tile([[1.0, 1.0], [1.0, 1.0]], (4, 1, 1)), "bias": np.zeros((4, 2, 2))}, ""),
        ({"unit": [5e-324]}, "reliability.unit 4.94066e-324 is not between 1e-12 and 1e+12"),
        ({"weights": [1.0, 2.0, 1e300]}, "reliability.weights has values beyond 1e+06"),
        ({"prior": [1e300]}, "reliability.prior 1e+300 is not between 1e-06 and 1e+06"),
        ({"final_prior": [1.5]}, "reliability.final_prior is not between 0 and 1"),
        ({"final_prior": [-0.5]}, "reliability.final_prior is not between 0 and 1"),
        ({"expansion": [0.5]}, "reliability.expansion 0.5 is not between 1 and 2"),
        ({"expansion": [1e9]}, "reliability.expansion 1e+09 is not between 1 and 2"),
    ],
)
def test_what_is_known_of_fits_is_checked(tiny_file, tmp_path, changes, words):
    message = complaint(tmp_path / "forged.liaam", *trusted(tiny_file, **changes))
    assert words in message and bool(message) == bool(words)


PRESENCE = {
    "presence.usual": np.array([1.5, 1.2, 0.9, 0.6]),
    "presence.other": np.array([0.1, 0.0, -0.1, 0.0]),
    "presence.variances": np.array([0.1, 0.1, 0.2, 0.3]),
    "presence.contrasts": np.array([0.0, 0.1, 0.2, 0.3]),
    "presence.spreads": np.full(4, 0.1),
}


def test_what_is_known_of_present_landmarks_is_kept(tiny_file, tmp_path):
    first = load_model(forge(tmp_path / "first.liaam", *trusted(tiny_file, **PRESENCE)))
    first.save(tmp_path / "second.liaam")
    for path in ("first.liaam", "second.liaam"):
        presence = load_model(tmp_path / path).views[SURROUNDINGS].reliabilities["soft-li"].presence
        assert presence is not None
        for key, value in PRESENCE.items():
            np.testing.assert_array_equal(getattr(presence, key.removeprefix("presence.")), value)
    older = load_model(forge(tmp_path / "older.liaam", *trusted(tiny_file)))
    assert older.views[SURROUNDINGS].reliabilities["soft-li"].presence is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"presence.variances": np.array([0.1, 0.1, 0.1, 0.0])}, "presence has values out of range"),
        ({"presence.spreads": np.zeros(4)}, "presence has values out of range"),
        ({"presence.other": np.zeros(3)}, "presence.other has type float64 and shape (3,)"),
        ({"presence.contrasts": np.full(4, 1e300)}, "presence.contrasts has values beyond 1e+06"),
    ],
)
def test_what_is_known_of_present_landmarks_is_checked(tiny_file, tmp_path, changes, words):
    assert words in complaint(tmp_path / "forged.liaam", *trusted(tiny_file, **PRESENCE | changes))


def test_quality_is_a_probability_of_the_evidence():
    known = Reliability(**{**RELIABILITY, "unit": 0.25, "variance_factor": 1.5, "typical": 0.8})
    assert known.errors(0.5)[0] == pytest.approx(np.diag([5.0, 7.0]))
    assert known.quality(np.array([0.25, 0.0])) == 0.5
    assert known.quality(np.array([0.5, 1.0])) == pytest.approx(1 / (1 + np.exp(-0.5)))
    assert known.quality(np.array([1e9, 0.0])) == pytest.approx(1.0)
    assert 0 < known.quality(np.array([-1e9, 0.0])) < 1e-20
    assert known.quality(np.array([np.nan, 0.0])) == 0.0
    assert known.low == pytest.approx(4 ** (2 / 3) / (1 + 4 ** (2 / 3)))  # two thirds of the log odds of 4 to 1
    assert replace(known, typical=1.0).low == pytest.approx(1.0, abs=1e-5)
    assert replace(known, typical=0.0).low == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("prior", [1e-6, 1e-5, 0.3, 1.0, 9.0, 1e6])
def test_a_quality_near_the_object_is_a_probability(prior, rng):
    known = Reliability(**{**RELIABILITY, "unit": 0.25, "variance_factor": 1.5, "typical": 0.8, "prior": prior})
    qualities = [0.0, 1.0, *(1.0 - 10.0 ** rng.uniform(-16, 0, 200))]
    assert all(0.0 <= known.with_prior(quality) <= 1.0 for quality in qualities)


# What the header says


def test_a_file_without_relit_copies_says_nothing_of_them(tiny_file, tmp_path):
    header, tensors = parts(tiny_file)
    del header["n_textures"]
    loaded = load_model(forge(tmp_path / "old.liaam", header, tensors))
    assert (loaded.n_images, loaded.n_textures) == (4, 0)
    assert repr(loaded) == f"AAM('', 4 landmarks, {loaded.n_pixels} pixels, 4 images)"


def test_the_camera_is_kept_to_the_last_digit(tiny_file, tmp_path):
    camera = CameraModel(theta=2.1234567890123456, response=2.2, vignetting=(-0.1,), noise=NoiseModel(1e-3, 1e-6))
    replace(load_model(tiny_file), camera=camera).save(tmp_path / "face.liaam")
    assert load_model(tmp_path / "face.liaam").camera == camera


def test_names_of_landmarks_are_as_many_as_landmarks(tiny_file, tmp_path):
    header, tensors = parts(tiny_file)
    del header["landmark_names"]
    assert load_model(forge(tmp_path / "old.liaam", header, tensors)).landmark_names == ()
    named = header | {"landmark_names": ["a", "b", "c", "d"]}
    assert load_model(forge(tmp_path / "a.liaam", named, tensors)).landmark_names == ("a", "b", "c", "d")
    for names in (["a"], "abcd", {}, None, 4):
        with pytest.raises(ModelFileError, match="there are not 4 names of landmarks"):
            load_model(forge(tmp_path / "b.liaam", header | {"landmark_names": names}, tensors))


def test_long_names_are_cut(tiny_file, tmp_path):
    header, tensors = parts(tiny_file)
    assert load_model(forge(tmp_path / "a.liaam", header | {"name": "x" * 1000}, tensors)).name == "x" * 1000
    assert load_model(forge(tmp_path / "b.liaam", header | {"name": "x" * 1001}, tensors)).name == "x" * 1000


def test_a_pipe_is_refused_instead_of_waiting(tmp_path):
    if not hasattr(os, "mkfifo"):
        pytest.skip("this system has no named pipes")
    os.mkfifo(tmp_path / "face.liaam")
    assert_refused(tmp_path / "face.liaam", "the model file is not a regular file; make one with 'liaam train FOLDER")


@pytest.mark.parametrize("name", ["\ud800", "x" * 100_000, "\u00e9"])
def test_a_models_name_can_be_written(tiny_file, tmp_path, name):
    header, tensors = parts(tiny_file)
    header["name"] = name
    loaded = load_model(forge(tmp_path / "named.liaam", header, tensors))
    assert 1 <= len(loaded.name.encode()) <= 2000


def test_a_small_frame_under_a_wide_blur_still_fits(tiny_file, tmp_path, rng):
    header, tensors = parts(tiny_file)
    header["views"][MESH]["blurs"] = [10.0]
    loaded = load_model(forge(tmp_path / "blurred.liaam", header, tensors))
    result = Fitter(loaded, "grey").fit(rng.integers(0, 256, (60, 60, 3), dtype=np.uint8), (15, 15, 45, 45))
    assert np.isfinite(result.landmarks).all()


def test_an_unforged_model_is_not_refused(tiny_file, tmp_path):
    assert isinstance(load_model(forge(tmp_path / "same.liaam", *parts(tiny_file))), AAM)


@pytest.mark.parametrize("text", ["[" * 100_000, "null", "3", '"liaam-aam"', '{"format": "liaam-aam"', ""])
def test_a_header_that_is_no_header_is_refused(tmp_path, text):
    path = tmp_path / "forged.liaam"
    path.write_bytes(save({"mean": np.zeros((3, 2))}, {"liaam": text}))
    assert_refused(path, "is not a liaam model")


@pytest.mark.parametrize("dtype", ["BF16", "F8_E4M3"])
def test_types_that_numpy_lacks_are_refused(tmp_path, dtype):
    n_bytes = 12 if dtype == "BF16" else 6
    header = {
        "__metadata__": {"liaam": json.dumps({"format": "liaam-aam", "schema": 4})},
        "mean": {"dtype": dtype, "shape": [3, 2], "data_offsets": [0, n_bytes]},
    }
    text = json.dumps(header).encode()
    path = tmp_path / "forged.liaam"
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"\0" * n_bytes)
    assert_refused(path)


def test_numbers_that_overflow_are_refused(tiny_file, tmp_path):
    header, tensors = parts(tiny_file)
    tensors["mean"][0] = 1e308
    tensors["mean"][1] = -1e308
    assert_refused(forge(tmp_path / "forged.liaam", header, tensors))
