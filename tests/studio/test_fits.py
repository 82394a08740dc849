"""Fits for the page: what they say, what they show, what they are given away as, and requests that make no sense."""

import io
import json
import shutil
import threading
from collections import deque
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path
from threading import Thread
from urllib.parse import quote, unquote

import cv2
import numpy as np
import pytest
from contract_checks import check_answer, faults as differences
from PIL import Image

from liaam.datasets import load_face
from liaam.errors import MethodError, StartError
from liaam.fitting import FitStatus, Fitter
from liaam.fitting.methods import DEFAULT_METHOD
from liaam.fitting.solution import residual_at
from liaam.fitting.specimens import FittedSpecimens
from liaam.io import Landmarks, decode_image, read_image, read_landmarks, write_image, write_landmarks
from liaam.model import AAM, SURROUNDINGS, load_model
from liaam.model.shape import diagonal_of
from liaam.morphometry import read_specimens
from liaam.photometry import linear_to_srgb, srgb_to_linear, to_linear
from liaam.relighting import Lamp
from liaam.relighting.lamp import AMBIENT
from liaam.studio import contract, layers
from liaam.studio.app import Studio, make_app
from liaam.studio.background import proposal_of
from liaam.studio.fits import FILES, Fits, error_of, example, found_nothing, numbers, truth_of
from liaam.studio.model_store import ModelInUse, ModelStore
from liaam.studio.pictures import Kept, Pictures, averaged, fitted_size, source_of
from liaam.studio.project import Project
from liaam.studio.refusal import Refusal
from liaam.studio.routes import attachment, light_of, parse_start
from liaam.studio.settings import StudioSettings
from liaam.tracking.motion import rescaled
from liaam.trays import Named, crop_box
from scenes import Scene
from setups import moving_scene

SETTINGS = StudioSettings(fits_kept=5)
ONE_LAMP = '{"direction":[0,0,1]}'
FRONT = [Lamp((0.0, 0.0, 1.0))]
LIGHT = quote(json.dumps({"lamps": [{"direction": [-1, 0, 0.5]}], "ambient": 0.2}))


@pytest.fixture(scope="session")
def scene() -> Scene:
    """Give a picture between those that the model was trained on."""
    return moving_scene(0.4)


@pytest.fixture(scope="session")
def folder(scene, tmp_path_factory) -> Path:
    """Give a folder with a picture in colour and its landmarks, in grey, and in the dark."""
    folder = tmp_path_factory.mktemp("pictures")
    write_image(folder / "face.png", scene.image)
    write_landmarks(folder / "face.pts", scene.landmarks)
    grey = np.repeat(scene.image.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)
    write_image(folder / "grey.png", grey)
    write_image(folder / "dark.png", scene.image // 20)
    write_image(folder / "Bild ä 1.png", scene.image)
    return folder


@pytest.fixture(scope="session")
def fits(folder, head_model) -> Fits:
    """Give a service with a model in use."""
    return make_fits(folder, head_model)


def make_fits(folder: Path, model: AAM | None, settings: StudioSettings = SETTINGS) -> Fits:
    pictures, models = Pictures(), ModelStore()
    fits = Fits(settings, models, pictures)
    fits.project = Project(folder, settings)
    models.listeners.clear()  # tests do not wait for what is made ready beside them
    if model is not None:
        models.publish(model, {})
    return fits


def fit(fits: Fits, name: str = "face.png", **options):
    source = source_of(fits.project.root / name, 10**6)
    return fits.fit(source, ("picture", name), truth=truth_of(fits.project.landmarks(name)), **options)


def wait_for_any(futures: list[Future], seconds: float) -> None:
    if not wait(futures, seconds, FIRST_COMPLETED).done:
        raise TimeoutError


@pytest.fixture(scope="session")
def fitted(fits):
    return fit(fits)


@pytest.fixture(scope="session")
def lit(fits, fitted, head_model, tmp_path_factory):
    """Give the service of a picture of the same head under a lamp from the left, and the fit to it."""
    folder = tmp_path_factory.mktemp("lit")
    write_image(folder / "lit.png", fits.draw(fitted, "relit", None, ([Lamp((-1.0, 0.0, 0.3))], 0.1))[0])
    of_lit = make_fits(folder, head_model)
    return of_lit, fit(of_lit, "lit.png")


class TestFit:
    def test_is_what_the_library_gives(self, fits, scene, head_model):
        expected = Fitter(head_model).fit(scene.image)
        seen = fit(fits).as_json()
        assert np.allclose(seen["shape"], expected.landmarks, atol=6e-4)
        assert (seen["status"], seen["ok"], seen["method"]) == (str(expected.status), True, DEFAULT_METHOD)
        assert np.allclose(seen["covariances"], expected.landmark_covariances, atol=6e-5)
        assert len(seen["iterations"]) == len(expected.history)
        assert np.allclose(seen["iterations"][-1]["shape"], expected.registered, atol=6e-3)
        assert seen["found"]["score"] == round(expected.found.score, 4)
        assert seen["n_found"] == expected.n_found == 1
        assert (seen["width"], seen["height"]) == (120, 160)

    def test_says_which_landmarks_are_absent(self, fitted):
        assert fitted.as_json()["absent"] == []
        present = np.full(len(fitted.result.landmarks), 0.99)
        present[[2, 5]] = 0.1
        seen = replace(fitted, result=replace(fitted.result, present=present)).as_json()
        assert seen["absent"] == [2, 5]
        assert "Absent: 3, 6." in seen["message"]
        assert seen["shape"][2] is not None  # drawn as a ring

    def test_files_have_no_positions_of_absent_landmarks(self, fits, fitted):
        present = np.full(len(fitted.result.landmarks), 0.99)
        present[2] = 0.1
        damaged = replace(fitted, result=replace(fitted.result, present=present))
        facts = json.loads(fits.export(damaged, "json", (FRONT, 0.3))[2])
        assert (facts["landmarks"][2], facts["sd"][2]) == ([None, None], None)
        assert facts["landmarks"][3] == fitted.result.landmarks[3].tolist()
        for what in ("ljson", "csv"):
            assert fits.export(damaged, what, (FRONT, 0.3))[2] != fits.export(fitted, what, (FRONT, 0.3))[2]
        assert b"nan nan" in fits.export(damaged, "pts", (FRONT, 0.3))[2].lower()

    def test_says_that_nothing_was_found_if_neither_search_nor_fit_are_sure(self, fitted):
        assert fitted.as_json()["nothing_found"] is False
        bad = replace(fitted.result, status=FitStatus.DOUBTFUL, quality=0.1)
        unsure = replace(bad.found, score=0.3)
        for result, expected in (
            (replace(bad, found=unsure), True),
            (bad, False),  # of an object that was found
            (replace(bad, found=None), False),  # where a person said that it is
            (replace(bad, found=unsure, status=FitStatus.TOO_DARK), False),  # its message says more
        ):
            assert found_nothing(result) is expected
            assert replace(fitted, result=result).as_json()["nothing_found"] is expected
            assert proposal_of(result)["nothing_found"] is expected

    def test_has_the_verdict_of_the_proposal_also_on_a_small_object(self, head_model, scene, tmp_path):
        picture = np.full((500, 500, 3), 90, np.uint8)
        picture[170:330, 190:310] = scene.image
        write_image(tmp_path / "far.png", picture)
        fits = make_fits(tmp_path, head_model)
        seen = fit(fits, "far.png").as_json()
        expected = Fitter(head_model).fit(picture)  # which weighs that there are many small places
        assert (seen["status"], seen["quality"]) == (
            str(expected.status),
            pytest.approx(expected.quality, abs=5e-5),
        )  # rounded

    def test_says_where_further_objects_are(self, fitted):
        result = fitted.result
        assert fitted.as_json()["objects"] == []  # there is only one
        other = replace(result.found, landmarks=result.landmarks + 500.0)
        seen = replace(fitted, result=replace(result, found=replace(result.found, others=(other,)))).as_json()
        first, second = seen["objects"]
        assert seen["n_found"] == 2
        assert first == pytest.approx([*result.landmarks.min(axis=0), *result.landmarks.max(axis=0)], abs=0.06)
        assert np.subtract(second, first) == pytest.approx(500.0, abs=0.11)

    def test_all_specimens_are_named_cropped_and_in_one_table(self, head_model, scene, fitted, tmp_path, monkeypatch):
        """What the library fits is given, since the small model also finds a third head between the two."""
        tray = tmp_path / "tray"
        tray.mkdir()
        write_image(tray / "tray.png", np.concatenate([scene.image, scene.image], axis=1))
        there = fitted.result.landmarks + np.array([120.0, 0.0])
        results = [fitted.result, replace(fitted.result, landmarks=there)]
        named = [Named("tray#1"), Named("tray#2", fault="it touches tray#1")]
        given = FittedSpecimens(results, named, ["both touch"])
        monkeypatch.setattr("liaam.studio.fits.fit_specimens", lambda *_, **options: given)
        fits = make_fits(tray, head_model)
        both, faults = fits.fit_all(source_of(tray / "tray.png", 10**6), ("picture", "tray.png"), DEFAULT_METHOD)
        assert [fit.as_json()["specimen"] for fit in both] == [
            {"number": 1, "name": "tray#1", "fault": ""},
            {"number": 2, "name": "tray#2", "fault": "it touches tray#1"},
        ]
        assert faults == ["both touch"]
        assert fits.get(both[1].id) is both[1]  # as layers and files of it are asked for
        name, _, data = fits.export(both[1], "crop", (FRONT, 0.3))
        left, top, right, bottom = crop_box(there, (240, 160))
        assert name == "tray_2_crop.png"
        assert np.array_equal(decode_image(data), fits.pictures.pixels(both[1].source)[top:bottom, left:right])
        assert fits.export(both[0], "pts", (FRONT, 0.3))[0] == "tray_1.pts"

        (tray / "table.csv").write_bytes(fits.table(both, (0.05, "mm")))
        specimens = read_specimens(tray / "table.csv")
        assert [each.name for each in specimens] == ["tray#1", "tray#2"]
        assert np.asarray(specimens[1].points) == pytest.approx(there, abs=1e-3)
        assert {each.scale for each in specimens} == {0.05}

    def test_where_no_specimen_is_found_it_is_said(self, fits, tmp_path):
        write_image(tmp_path / "wall.png", np.full((160, 200, 3), 90, np.uint8))
        with pytest.raises(Refusal, match=r"no object was found .*\. Draw a box around each"):
            fits.fit_all(source_of(tmp_path / "wall.png", 10**6), ("picture", "wall.png"), DEFAULT_METHOD)

    def test_where_no_specimen_is_certain_the_likeliest_place_is_fitted(self, fits, folder):
        source = source_of(folder / "dark.png", 10**6)
        (likeliest,), _ = fits.fit_all(source, ("picture", "dark.png"), DEFAULT_METHOD)
        assert likeliest.as_json()["status"] == fit(fits, "dark.png").as_json()["status"] == "doubtful"

    def test_is_json_whatever_happens(self, fits, fitted):
        lost = fit(fits, start=(-20.0, -20.0, 60.0, 40.0), method="grey-plain")
        for one in (fitted, lost, fit(fits, "dark.png")):
            again = json.loads(json.dumps(one.as_json(), allow_nan=False))
            assert differences(again, contract.Fit) == []
            assert len(again["shape"]) == one.model.n_points
            assert set(again["layers"]) <= set(layers.LAYERS)

    def test_advises_nothing_that_the_page_has_no_control_for(self, fitted):
        result = replace(fitted.result, status=FitStatus.MAX_ITERATIONS)
        message = replace(fitted, result=result).as_json()["message"]
        assert message == "The fit did not converge within its iterations; start nearer to the object."

    def test_compares_with_the_picture_s_own_landmarks(self, fitted, scene):
        expected = np.linalg.norm(fitted.result.landmarks - scene.landmarks, axis=1).mean()
        error = fitted.as_json()["error"]
        assert error["pixels"] == pytest.approx(expected)
        assert error["percent"] == pytest.approx(100 * expected / diagonal_of(scene.landmarks))
        assert error["percent"] < 5

    def test_says_whether_the_model_was_trained_on_the_picture(self, folder, head_model):
        fits = make_fits(folder, None)
        facts = {"source": "studio", "trained": None, "pictures": {"face.png": "1", "grey.png": "2"}}
        fits.models.publish(head_model, {**facts, "left_out": {"grey.png": "the picture is grey"}})
        trained_on = {name: fit(fits, name).as_json()["trained_on"] for name in ("face.png", "grey.png", "dark.png")}
        assert trained_on == {"face.png": True, "grey.png": False, "dark.png": False}

    def test_searches_once_for_all_methods(self, folder, head_model, monkeypatch):
        calls, find = [], Fitter.find
        monkeypatch.setattr(Fitter, "find", lambda self, *given, **more: calls.append(1) or find(self, *given, **more))
        fits = make_fits(folder, head_model)
        starts = [fit(fits, method=method).result.start for method in ("soft-li", "li", "grey")]
        assert len(calls) == 1
        assert np.allclose(starts[0], starts[1], atol=0.5)

    def test_starts_where_it_is_told(self, fits, scene):
        box = (*scene.landmarks.min(axis=0), *scene.landmarks.max(axis=0))
        from_box, from_shape = fit(fits, start=box), fit(fits, start=scene.landmarks)
        assert from_box.result.found is from_shape.result.found is None
        assert np.allclose(from_shape.as_json()["iterations"][0]["shape"], scene.landmarks, atol=1.0)
        assert np.abs(from_box.result.landmarks - from_shape.result.landmarks).max() < 2.0

    def test_keeps_the_newest_few(self, fits):
        made = [fit(fits) for _ in range(7)]
        assert [fits.get(one.id) for one in made[2:]] == made[2:]
        with pytest.raises(Refusal, match="fit again") as refused:
            fits.get(made[0].id)
        assert refused.value.status == 404

    def test_ten_at_a_time_are_equal(self, folder, head_model):
        fits = make_fits(folder, head_model, StudioSettings())
        methods = ["soft-li", "li"] * 5
        with ThreadPoolExecutor(10) as pool:
            made = list(pool.map(lambda method: fit(fits, method=method), methods))
            shown = list(pool.map(lambda one: fits.layer(one, "flat", 100), made))
        for i in (2, 4, 6, 8):
            assert np.array_equal(made[i].result.landmarks, made[0].result.landmarks)
            assert np.array_equal(made[i + 1].result.landmarks, made[1].result.landmarks)
            assert shown[i] == shown[0]

    def test_needs_a_model(self, folder):
        with pytest.raises(Refusal, match="train one first") as refused:
            fit(make_fits(folder, None))
        assert refused.value.status == 409

    def test_goes_with_the_model_in_use(self, folder, head_model):
        fits = make_fits(folder, head_model)
        before = fit(fits)
        other = replace(head_model, name="other")
        fits.models.publish(other, {})
        after = fit(fits)
        assert (before.model, after.model) == (head_model, other)
        assert fits.layer(before, "flat", 100)  # still by the model it was made with

    def test_of_former_models_are_forgotten_with_all_that_was_made_for_them(self, folder, head_model):
        fits, made = make_fits(folder, None), []
        for i in range(4):
            current = fits.models.publish(replace(head_model, name=str(i)), {})
            fits.forget_former(current)
            made.append(fit(fits))
            fits.layer(made[-1], "flat", 100)
        fits.forget_former(None)  # a template that is changed leaves what is shown
        assert {number for number, *_ in fits._fitters._values} == {id(made[2].model), id(made[3].model)}
        assert {number for *_, number in fits._found._values} == {3, 4}
        assert {number for number, _ in fits._lights._values} == {made[2].id, made[3].id}
        assert fits.get(made[2].id) is made[2]
        with pytest.raises(Refusal, match="fit again"):
            fits.get(made[1].id)

    def test_models_are_published_by_two_threads_at_once(self, folder, head_model):
        fits = make_fits(folder, None)
        threads = []

        class Slow(deque):
            def __iter__(self):
                for item in super().__iter__():
                    if not threads:
                        second = ModelInUse(head_model, 2, {})
                        threads.append(Thread(target=fits.forget_former, args=(second,)))
                        threads[0].start()
                        threads[0].join(0.2)  # it has to wait until the first is done
                    yield item

        fits._recent = Slow(maxlen=2)
        fits.forget_former(ModelInUse(head_model, 1, {}))
        threads[0].join(60)
        assert [model.number for model in fits._recent] == [1, 2]

    def test_large_pictures_wait_for_each_other(self, folder, head_model):
        fits = make_fits(folder, head_model)
        made, room = fit(fits), fits.pictures.work_room
        source = made.source
        works = (
            lambda: fit(fits),
            lambda: fits.layer(made, "flat", 100),
            lambda: fits.draw(made, "relit", 90, (FRONT, 0.3)),
            lambda: fits.export(made, "overlay", (FRONT, 0.3)),
            lambda: fits.pictures.chroma(source, 60, "srgb"),
        )
        with ThreadPoolExecutor(len(works)) as pool:
            with room.of(room.size):
                under_way = [pool.submit(work) for work in works]
                with pytest.raises(TimeoutError):
                    wait_for_any(under_way, 0.3)
            for one in under_way:
                one.result(60)
        assert room.left == room.size

    def test_warming_up_makes_everything_ready(self, folder, head_model):
        fits = make_fits(folder, head_model)
        started = []
        starter = threading.Thread(target=lambda: started.append(fits.warm_up_soon(fits.models.current)), daemon=True)
        starter.start()  # as the studio's background does
        starter.join()
        assert not started[0].daemon  # the end of the interpreter would abort it in compiled code
        started[0].join()
        assert len(fits._fitters) == 1  # that fits and searches
        searcher = fits._fitters.peek((id(head_model), "soft-li", False, "auto"))
        assert searcher is not None
        assert "templates" in searcher.finder.__dict__

    @pytest.mark.parametrize(("factor", "sizes"), [(6, [(480, 360)]), (2, [(160, 120), (320, 240)])])
    def test_a_large_picture_is_fitted_on_a_copy_if_the_object_is_large_there(
        self, factor, sizes, scene, head_model, tmp_path, monkeypatch
    ):
        monkeypatch.setattr("liaam.studio.pictures.COPIED_FROM", 60_000)
        monkeypatch.setattr("liaam.studio.pictures.COPY_SIDE", 40 * factor)
        large = cv2.resize(scene.image, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        write_image(tmp_path / "large.jpg", large)
        seen, fit_image = [], Fitter.fit_where_found
        remember = lambda self, image, *more: seen.append(image.shape[:2]) or fit_image(self, image, *more)  # noqa: E731
        monkeypatch.setattr(Fitter, "fit_where_found", remember)
        fits = make_fits(tmp_path, head_model)
        seen.clear()
        fitted = fit(fits, "large.jpg")
        assert seen == sizes
        whole = Fitter(head_model).fit(large)
        close = 0.002 * diagonal_of(whole.landmarks)
        assert np.abs(fitted.result.landmarks - whole.landmarks).max() < close
        assert np.allclose(fitted.result.sd, whole.sd, rtol=0.2)
        assert fitted.result.found.scale == pytest.approx(whole.found.scale, rel=0.05)
        assert fitted.as_json()["width"] == 120 * factor

    def test_the_example_shows_the_object(self, head_model):
        image = example(head_model, (240, 320))
        assert (image.shape, image.dtype) == ((240, 320, 3), np.uint8)
        assert not Fitter(head_model).find(image)[0].doubtful


@pytest.fixture(scope="session")
def fitted_without_lamps(folder, head_model):
    """Give the fit of a model without lamps, whose shading ends with its mesh, and its service."""
    fits = make_fits(folder, replace(head_model, light=None))
    return fits, fit(fits)


class TestLayers:
    @pytest.mark.parametrize("what", ["residual", "shading"])
    @pytest.mark.parametrize("size", [320, 160, 80])
    def test_lie_over_the_picture_and_are_clear_outside_the_mesh(self, fitted_without_lamps, what, size):
        fits, fitted = fitted_without_lamps
        fits._fits.put(fitted.id, fitted)
        drawn = np.array(Image.open(io.BytesIO(fits.layer(fitted, what, size)[0])))
        width, height = fitted_size(120, 160, size)
        assert drawn.shape == (height, width, 4)
        inside = mesh_mask(fitted, (width, height))
        clear = drawn[..., 3] == 0
        assert set(np.unique(drawn[..., 3])) == {0, 255}
        assert clear[~inside].mean() > 0.98
        assert not drawn[clear][:, :3].any()
        if what == "shading":
            # The mask's corners are rounded, and pixels on the mesh's border are half covered.
            assert not clear[mesh_mask(fitted, (width, height), grow=-5)].any()

    def test_normals_lie_on_the_object(self, fits, fitted):
        drawn = decode_image(fits.layer(fitted, "normals", 320)[0]).astype(float)
        left, top, width, height = fits.layer(fitted, "normals", 320)[1]["box"]
        middle = (fitted.result.landmarks.mean(axis=0) / (120, 160) - (left, top)) / (width, height)
        x, y, share = drawn[tuple((middle[::-1] * drawn.shape[:2]).astype(int))]
        assert share == 255
        assert np.hypot(x - 128, y - 128) < 60  # the middle faces the viewer
        half = drawn[:, : drawn.shape[1] // 2], drawn[:, drawn.shape[1] // 2 :]
        left_x, right_x = (part[part[..., 2] > 250][:, 0].mean() for part in half)
        assert left_x < 118 < 138 < right_x

    def test_flat_is_the_whole_picture(self, fits, fitted, scene):
        drawn = decode_image(fits.layer(fitted, "flat", 320)[0])
        assert drawn.shape == scene.image.shape
        far = ~mesh_mask(fitted, (120, 160), grow=25)
        assert np.array_equal(drawn[far], scene.image[far])

    def test_residual_shows_the_row_that_tells_most(self, fits, fitted):
        image = fits.pictures.pixels(fitted.source)
        values, facts = layers.residual_of(fitted.fitter, image, fitted.result)
        assert fits.layer(fitted, "residual", 100)[1] == facts
        residual, _ = residual_at(fitted.fitter, image, fitted.result)
        power = np.square(residual).sum(axis=0)
        assert facts["what"] == ("gradient across", "gradient down", "invariant")[int(power.argmax())]
        whole = fitted.model.views[SURROUNDINGS].warp.frame.picture(residual[:, int(power.argmax())])
        own = fitted.model.frame.picture(values[:, 0])
        offset = (fitted.model.frame.origin - fitted.model.views[SURROUNDINGS].warp.frame.origin)[::-1].astype(int)
        rows, columns = fitted.model.frame.pixels.T
        assert np.array_equal(own[rows, columns], whole[rows + offset[0], columns + offset[1]])
        for method in ("grey", "rgb", "li", "chroma", "igo"):
            made = fit(fits, method=method)
            values, facts = layers.residual_of(made.fitter, image, made.result)
            assert values.shape == (fitted.model.n_pixels, 2)
            assert facts["limit"] > 0

    def test_colours_have_their_middle_at_nothing(self):
        values, everywhere = np.array([[-5.0, -1.0, 0.0, 1.0, np.nan]]), np.ones((1, 5), bool)
        drawn = layers.coloured(values, layers.SHADING_COLOURS, everywhere)[..., :3]
        low, middle, high = layers.SHADING_COLOURS
        assert [tuple(colour) for colour in drawn[0].tolist()] == [low, low, middle, high, middle]

    def test_points_go_to_the_same_place_of_another_size(self):
        corners = np.array([[-0.5, -0.5], [639.5, 479.5], [0.0, 0.0]])
        there = rescaled(corners, (480, 640), (240, 320))
        assert there.tolist() == [[-0.5, -0.5], [319.5, 239.5], [-0.25, -0.25]]

    @pytest.mark.parametrize(
        ("name", "method", "text"),
        [
            ("face.png", "grey", "method grey does not separate colour from shading"),
            ("face.png", "igo", "method igo does not separate"),
            ("face.png", "li-lit", "method li-lit does not separate"),
            ("grey.png", "soft-li", "the picture is grey"),
        ],
    )
    def test_that_make_no_sense_are_left_out_and_say_why(self, fits, name, method, text):
        made = fit(fits, name, method=method)
        assert made.as_json()["layers"] == ["residual"]
        for what in ("flat", "shading"):
            with pytest.raises(MethodError, match=text):
                fits.layer(made, what, 100)
        assert fits.layer(made, "residual", 100)

    def test_a_large_picture_is_put_under_another_light_smaller(self, fits, fitted, monkeypatch):
        monkeypatch.setattr("liaam.studio.fits.LAYER_SIZE", 40)
        monkeypatch.setattr("liaam.studio.fits.LIGHT_SIZE", 80)
        fits._lights = Kept(2)
        for what, channels in (("flat", 3), ("shading", 4)):
            assert fits.draw(fitted, what, 160)[0].shape == (80, 60, channels)
            assert fits.draw(fitted, what, 20)[0].shape == (20, 15, channels)
        assert fits.draw(fitted, "residual", 160)[0].shape == (160, 120, 4)

    def test_are_drawn_once(self, fits, fitted, monkeypatch):
        first = fits.layer(fitted, "shading", 90)
        monkeypatch.setattr(layers, "shading_layer", lambda *given: pytest.fail("it is kept"))
        assert fits.layer(fitted, "shading", 90) is first


class TestLight:
    def test_a_very_large_picture_is_saved_with_fewer_pixels(self, folder, head_model):
        fits = make_fits(folder, head_model, replace(SETTINGS, whole_pixels=120 * 160 // 4))
        fitted = fit(fits)
        for what in ("flat", "shading", "relit"):
            assert decode_image(fits.export(fitted, what, (FRONT, 0.25))[2]).shape[:2] == (80, 60), what
        assert fits.draw(fitted, "flat", 100)[0].shape == (100, 75, 3)  # to look at it is still there

    def test_says_whether_there_is_anything_to_take_off(self, fits, fitted, lit):
        of_lit, fitted_lit = lit
        for what in ("flat", "shading"):
            assert (fits.layer(fitted, what, 320)[1] or {}).get("even") is True, what  # the light is that of training
            assert (of_lit.layer(fitted_lit, what, 320)[1] or {}).get("even") is False, what
        light, _ = fits._relighter(fitted, None)
        assert layers.is_even(light, light.picture)
        assert layers.is_even(light, np.minimum(light.picture, 252) + np.uint8(3))  # nobody sees that
        assert not layers.is_even(light, np.minimum(light.picture, 240) + np.uint8(15))

    @pytest.mark.parametrize("what", ["flat", "relit"])
    def test_a_saved_picture_has_the_strength_that_is_shown(self, lit, what):
        fits, fitted = lit

        def saved(opacity: float) -> np.ndarray:
            light = [Lamp((1.0, 0.0, 0.5))], 0.2
            return decode_image(fits.export(fitted, what, light, opacity=opacity)[2]).astype(float)

        whole, picture = saved(1.0), saved(0.0)
        assert np.array_equal(picture, decode_image((fits.project.root / "lit.png").read_bytes()))
        assert np.abs(whole - picture).max() > 20
        assert np.abs(saved(0.35) - (picture + 0.35 * (whole - picture))).max() <= 0.5

    def test_the_colour_of_the_light_is_corrected_or_kept_in_the_whole_picture(self, tmp_path):
        photograph = read_image(load_face().image)
        light = srgb_to_linear(photograph / 255.0) * np.exp((-0.3, 0.0, 0.4))
        blue = np.rint(255 * linear_to_srgb(np.clip(light, 0.0, 1.0))).astype(np.uint8)
        write_image(tmp_path / "blue.png", blue)
        fits = make_fits(tmp_path, load_model("face"))
        fitted = fit(fits, "blue.png")
        wall = np.s_[:40, :80]
        for what in ("flat", "relit"):
            kept, corrected = (
                decode_image(fits.export(fitted, what, (FRONT, 0.25), balance=balance)[2]) for balance in (False, True)
            )
            assert np.abs(kept[wall].astype(int) - blue[wall]).max() <= 1, what
            assert corrected[wall][..., 2].mean() < 0.85 * kept[wall][..., 2].mean(), what
        for what, balance in (("flat", False), ("flat", True), ("balanced", True)):
            drawn, facts = fits.layer(fitted, what, 615, balance)
            assert facts is not None and (facts.get("colour"), facts.get("even")) == ("blue", False)
            exported = decode_image(fits.export(fitted, what, (FRONT, 0.25), balance=balance)[2])
            assert np.array_equal(decode_image(drawn), exported)
        assert np.array_equal(exported[wall], corrected[wall])

    def test_from_the_front_is_flat(self, fits, fitted):
        flat = decode_image(fits.layer(fitted, "flat", 320)[0]).astype(int)
        assert np.abs(fits.draw(fitted, "relit", 320, (FRONT, 0.3))[0] - flat).max() <= 1

    def test_from_a_side_brightens_that_side_and_leaves_the_rest(self, fits, fitted, scene):
        left = fits.draw(fitted, "relit", 320, ([Lamp((-1.0, 0.0, 0.5))], 0.2))[0].astype(int)
        right = fits.draw(fitted, "relit", 320, ([Lamp((1.0, 0.0, 0.5))], 0.2))[0].astype(int)
        x, y = np.rint(fitted.result.landmarks.mean(axis=0)).astype(int)
        reach = int(np.ptp(fitted.result.landmarks[:, 0]) / 3)
        change = (left - right).mean(axis=2)
        assert change[y - 5 : y + 5, x - reach : x - reach // 2].mean() > 5
        assert change[y - 5 : y + 5, x + reach // 2 : x + reach].mean() < -5
        far = ~mesh_mask(fitted, (120, 160), grow=41)
        assert np.array_equal(left[far], scene.image[far])

    def test_comes_in_the_size_asked_for(self, fits, fitted):
        assert fits.draw(fitted, "relit", 80, ([Lamp((1.0, 0.0, 0.5))], 0.2))[0].shape == (80, 60, 3)

    def test_a_method_without_shading_says_so(self, fits):
        with pytest.raises(MethodError, match="method grey does not separate"):
            fits.draw(fit(fits, method="grey"), "relit", 320, (FRONT, 0.3))

    def test_on_request(self, page):
        made = page.fit(picture="face.png").json()
        assert made["no_flat"] is None
        answer = page.ask("GET", f"/api/fits/{made['id']}/relit?light={LIGHT}&size=80")
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/jpeg")
        assert decode_image(answer.content).shape == (80, 60, 3)
        given = page.ask("GET", f"/api/fits/{made['id']}/export?what=relit&light={LIGHT}")
        assert decode_image(given.content).shape == (160, 120, 3)


def test_the_light_of_a_request_has_linear_colours():
    lamp = {"direction": [1, 0, 0], "colour": [1, 0.5, 0], "strength": 2, "softness": 0.5}
    lamps, ambient = light_of(json.dumps({"lamps": [lamp], "ambient": 0}))
    assert ambient == 0
    assert (lamps[0].direction, lamps[0].strength, lamps[0].softness) == ([1, 0, 0], 2, 0.5)
    np.testing.assert_allclose(lamps[0].colour, [1.0, to_linear(np.array(0.5), "srgb"), 0.0])
    assert light_of(None) == ([Lamp([0, 0, 1])], AMBIENT)


class TestTakenApart:
    def test_linear_light_comes_out_as_screens_want_it(self, scene, head_model):
        stored = scene.image / 255
        raw = np.rint(65535 * to_linear(stored)).astype(np.uint16)
        fitter = Fitter(head_model, camera=head_model.camera.suited_to(raw=True))
        result = fitter.fit(raw, scene.landmarks)
        flat = layers.taken_apart(fitter, raw, result, (120, 160), raw=True).flat().astype(int)
        usual = Fitter(head_model)
        expected = layers.taken_apart(usual, scene.image, usual.fit(scene.image, scene.landmarks), (120, 160)).flat()
        assert np.abs(flat - expected).mean() < 1.0
        assert np.abs(flat - expected).max() <= 12

    def test_a_large_picture_is_taken_apart_small(self, scene, head_model):
        import cv2

        large = cv2.resize(scene.image, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
        fitter = Fitter(head_model)
        there = rescaled(scene.landmarks, (160, 120), (640, 480))
        result = fitter.fit(large, there)
        small = layers.taken_apart(fitter, large, result, (240, 320)).flat().astype(int)
        whole = averaged(layers.taken_apart(fitter, large, result, (480, 640)).flat(), (240, 320))
        assert small.shape == (320, 240, 3)
        assert np.abs(small - whole).mean() < 1.5


def mesh_mask(fitted, size: tuple[int, int], grow: int = 3) -> np.ndarray:
    """Pixels of the mesh, and some around it, or without some at its border."""
    import cv2

    shape = rescaled(fitted.result.landmarks, (160, 120), size[::-1])
    mask = np.zeros((size[1], size[0]), np.uint8)
    for triangle in fitted.model.triangles:
        cv2.fillConvexPoly(mask, np.rint(shape[triangle]).astype(np.int32), 1)
    change = cv2.dilate if grow > 0 else cv2.erode
    return change(mask, np.ones((abs(grow), abs(grow)), np.uint8)) > 0


class TestValues:
    def test_numbers_that_are_not_finite_are_null(self):
        values = np.array([[1.23456, np.nan], [np.inf, -2.0]])
        assert numbers(values, 2) == [[1.23, None], [None, -2.0]]
        assert numbers(values[:, 0][:1], 3) == [1.235]

    def test_error_leaves_out_what_is_missing_or_invisible(self, fitted, scene):
        truth = scene.landmarks.copy()
        shape = truth + np.array([3.0, 4.0])
        truth[3] = np.nan
        assert error_of(shape, truth)[0] == pytest.approx(5.0)
        assert error_of(shape, truth[:-1]) is None
        assert error_of(shape, None) is None
        assert error_of(shape, np.full_like(truth, np.nan)) is None
        assert error_of(shape * np.nan, truth) is None

    def test_invisible_landmarks_are_no_truth(self, scene):
        truth = truth_of(Landmarks(scene.landmarks, invisible=(1, 4)))
        assert np.flatnonzero(np.isnan(truth[:, 0])).tolist() == [1, 4]
        assert truth_of(None) is None

    def test_starts(self):
        assert parse_start(None) is None
        assert parse_start({"box": [1, 2.5, 3, 4]}) == (1.0, 2.5, 3.0, 4.0)
        shape = parse_start({"shape": [[1, 2], None, [3, 4]]})
        assert np.array_equal(shape, [[1, 2], [np.nan, np.nan], [3, 4]], equal_nan=True)

    @pytest.mark.parametrize(
        "start",
        [
            [],
            {},
            "middle",
            7,
            {"box": [1, 2, 3]},
            {"box": [1, 2, 3, "4"]},
            {"box": [1, 2, 3, True]},
            {"box": [1, 2, 3, 1e300]},
            {"box": {"x": 1}},
            {"shape": []},
            {"shape": [[1, 2, 3]]},
            {"shape": [[1, None]]},
            {"shape": [[1, 2]], "box": [1, 2, 3, 4]},
            {"point": [1, 2]},
        ],
    )
    def test_starts_that_are_unclear(self, start):
        with pytest.raises(Refusal, match="the start is unclear") as refused:
            parse_start(start)
        assert refused.value.status == 422

    def test_names_of_attachments(self):
        header = attachment('Bild ä "1"\r\n.png', b"").headers["content-disposition"]
        assert header.isascii()
        assert "\n" not in header
        assert header.startswith('attachment; filename="Bild _ _1___.png"; ')
        assert unquote(header.partition("UTF-8''")[2]) == 'Bild ä "1"\r\n.png'


class Page:
    """The studio, asked as the page asks."""

    def __init__(self, folder: Path, model: AAM | None) -> None:
        import httpx

        self.studio = Studio(folder, settings=SETTINGS)
        self.studio.models.listeners.clear()
        if model is not None:
            self.studio.models.publish(model, {})
        self.client = httpx.AsyncClient(
            transport=httpx.ASGITransport(make_app(self.studio)),
            base_url=f"http://127.0.0.1:{SETTINGS.port}",
            headers={"authorization": f"Bearer {SETTINGS.token}"},
        )

    def ask(self, verb: str, path: str, **options):
        import anyio

        async def call():
            return await self.client.request(verb, path, **options)

        answer = anyio.run(call)
        check_answer(answer)
        return answer

    def fit(self, **asked):
        return self.ask("POST", "/api/fits", json=asked)


@pytest.fixture(scope="session")
def page(folder, head_model) -> Page:
    return Page(folder, head_model)


class TestRequests:
    def test_a_picture_of_the_folder(self, page):
        answer = page.fit(picture="face.png", method="li", start=None)
        assert answer.status_code == 200
        made = answer.json()
        assert (made["picture"], made["method"], made["ok"]) == ("face.png", "li", True)
        assert made["error"]["percent"] < 5
        assert isinstance(made["theta_deg"], float)

    def test_a_side_that_is_chosen(self, page):
        fits = [page.fit(picture="face.png", **asked).json() for asked in ({}, {"side": "mirrored"}, {"side": "auto"})]
        assert [made["side"] for made in fits] == [None, "mirrored", None]
        assert fits[0]["shape"] == fits[2]["shape"]

    def test_all_specimens_of_a_side_that_is_chosen(self, page, monkeypatch):
        sides = []

        def no_specimens(fitter, *_, **options):
            sides.append(fitter.side)
            raise StartError("no object was found; give a start")

        monkeypatch.setattr("liaam.studio.fits.fit_specimens", no_specimens)
        for asked in ({}, {"side": "mirrored"}):
            assert page.ask("POST", "/api/fits/all", json={"picture": "face.png", **asked}).status_code == 422
        assert sides == ["auto", "mirrored"]

    def test_a_dropped_picture(self, page, folder):
        data = (folder / "face.png").read_bytes()
        upload = page.ask("POST", "/api/uploads?name=face.png", content=data).json()
        made = page.fit(upload=upload["id"]).json()
        assert (made["upload"], made["error"], made["ok"]) == (upload["id"], None, True)
        from_folder = page.fit(picture="face.png").json()
        assert made["shape"] == from_folder["shape"]
        at_once = page.ask("POST", "/api/uploads?name=face.png&method=soft-li", content=data).json()
        assert at_once["fit"]["shape"] == made["shape"]
        assert page.ask("POST", "/api/uploads?name=face.png&method=none", content=data).json()["fit"] is None
        layer = page.ask("GET", f"/api/fits/{made['id']}/layers/residual?size=80")
        assert set(json.loads(layer.headers["x-scale"])) == {"limit", "what"}
        assert Image.open(io.BytesIO(layer.content)).size == (60, 80)

    @pytest.mark.parametrize("what", [what for what in FILES if what != "relit"])
    def test_what_is_given_away(self, page, tmp_path, scene, what):
        made = page.fit(picture="Bild ä 1.png").json()
        answer = page.ask("GET", f"/api/fits/{made['id']}/export?what={what}")
        assert answer.status_code == 200
        name = unquote(answer.headers["content-disposition"].partition("UTF-8''")[2])
        assert name.startswith("Bild ä 1")
        (tmp_path / name).write_bytes(answer.content)
        if what in ("pts", "ljson", "csv"):
            assert np.allclose(read_landmarks(tmp_path / name).points, made["shape"], atol=6e-4)
        elif what == "json":
            facts = answer.json()
            assert np.allclose(facts["landmarks"], made["shape"], atol=6e-4)
            assert (facts["image"], facts["status"]) == ("Bild ä 1.png", made["status"])
        elif what == "crop":
            height, width = decode_image(answer.content).shape[:2]
            assert width < 120 and height < 160
        else:
            height, width = decode_image(answer.content).shape[:2]
            assert width / height == 120 / 160
            assert height == 160 or what == "overlay"

    def test_nothing_is_written(self, page, folder):
        before = sorted(path.name for path in folder.rglob("*"))
        made = page.fit(picture="face.png").json()
        for what in FILES:
            page.ask("GET", f"/api/fits/{made['id']}/export?what={what}")
        assert sorted(path.name for path in folder.rglob("*")) == before

    @pytest.mark.parametrize(
        ("asked", "status", "text"),
        [
            ({"picture": "nothing.png"}, 404, "no picture 'nothing.png'"),
            ({"picture": "../face.png"}, 404, "no picture"),
            ({"upload": "nonsense"}, 404, "drop it again"),
            ({}, 422, "the picture to fit is unclear"),
            ({"picture": "face.png", "upload": "x"}, 422, "the picture to fit is unclear"),
            ({"picture": 7}, 422, "the picture to fit is unclear"),
            ({"picture": "face.png", "method": "magic"}, 422, "unknown method 'magic'"),
            ({"picture": "face.png", "method": 7}, 422, "the method is not a string"),
            ({"picture": "face.png", "side": 7}, 422, "the side is not a string"),
            ({"picture": "face.png", "side": "left"}, 422, "unknown side 'left'"),
            ({"picture": "face.png", "start": "there"}, 422, "the start is unclear"),
            ({"picture": "face.png", "start": {"box": [5, 5, 5, 5]}}, 422, "the box 5, 5, 5, 5 is empty"),
            ({"picture": "face.png", "start": {"box": [900, 900, 990, 990]}}, 422, "the start lies outside the image"),
            ({"picture": "face.png", "start": {"shape": [[1, 2], [3, 4]]}}, 422, "the start has 2 landmarks"),
            ({"picture": "grey.png", "method": "li"}, 422, "the image is grey"),
        ],
    )
    def test_that_make_no_sense(self, page, asked, status, text):
        answer = page.fit(**asked)
        assert answer.status_code == status
        assert text in answer.json()["error"]

    def test_a_failed_fit_is_an_answer(self, page):
        answer = page.fit(picture="dark.png", method="li", start={"box": [40, 10, 120, 110]})
        assert answer.status_code == 200
        assert (answer.json()["ok"], answer.json()["status"]) == (False, "too dark")
        assert "or a brighter image" in answer.json()["message"]

    @pytest.mark.parametrize(
        ("path", "status", "text"),
        [
            ("layers/heat", 404, "choose one of residual, shading, flat"),
            ("layers/flat?size=big", 422, "not a whole number"),
            ("export?what=zip", 422, "choose one of pts, ljson"),
            ("export", 422, "choose one of pts"),
            ("relit?light=2", 422, "the light is unclear"),
            ("relit?light={", 422, "the light is unclear"),
            ("relit?light=[]", 422, "the light is unclear"),
            ('relit?light={"lamps":[{}]}', 422, "the light is unclear"),
            ('relit?light={"lamps":[{"direction":"up"}]}', 422, "light direction"),
            ('relit?light={"lamps":[{"direction":[0,0,0]}]}', 422, "light direction 0,0,0"),
            ('relit?light={"lamps":[{"direction":[NaN,0,1]}]}', 422, "light direction nan"),
            ('relit?light={"lamps":[{"direction":[0,0,1],"colour":"red"}]}', 422, "the light is unclear"),
            ('relit?light={"lamps":[{"direction":[0,0,1],"colour":[2,0,0]}]}', 422, "lamp colour"),
            ('relit?light={"lamps":[{"direction":[0,0,1],"strength":"2"}]}', 422, "the light is unclear"),
            ('relit?light={"lamps":[],"ambient":2}', 422, "ambient light 2"),
            (f'relit?light={{"lamps":[{",".join(9 * [ONE_LAMP])}]}}', 422, "9 lamps are too many"),
        ],
    )
    def test_views_that_make_no_sense(self, page, path, status, text):
        made = page.fit(picture="face.png").json()
        answer = page.ask("GET", f"/api/fits/{made['id']}/{path}")
        assert answer.status_code == status
        assert text in answer.json()["error"]

    @pytest.mark.parametrize("path", ["layers/flat", "relit", "export?what=pts"])
    def test_fits_that_are_gone(self, page, path):
        answer = page.ask("GET", f"/api/fits/none/{path}")
        assert (answer.status_code, answer.json()["error"]) == (404, "this fit is no longer kept: fit again")

    def test_a_layer_that_a_grey_picture_does_not_have(self, page):
        made = page.fit(picture="grey.png").json()
        answer = page.ask("GET", f"/api/fits/{made['id']}/layers/flat")
        assert answer.status_code == 422
        assert "the picture is grey" in answer.json()["error"]
        assert made["layers"] == ["residual"]
        assert made["no_flat"] == "the picture is grey, but shading needs colour: use a colour picture"

    def test_without_a_model(self, folder, tmp_path):
        shutil.copy(folder / "face.png", tmp_path)
        answer = Page(tmp_path, None).fit(picture="face.png")
        assert answer.status_code == 409
        assert "train one first" in answer.json()["error"]
