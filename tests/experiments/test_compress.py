"""Images kept as appearance and light: the coder, the measures, and a small run."""

import numpy as np
import pytest

from experiments import compress
from experiments.generic import HeldOut, get_trained, request_of_folders
from experiments.protocol import eight_bit
from liaam.datasets import load_folder


def test_symbols_are_decoded_as_coded_and_take_their_entropy(rng):
    deviations = rng.uniform(0.1, 20.0, 300)
    tables = [compress.frequencies(deviation, 1.0) for deviation in deviations]
    for table in tables:
        assert (np.diff(table) > 0).all()
        assert (table[0], table[-1]) == (0, compress.TOTAL)
    probabilities = [np.diff(table) / compress.TOTAL for table in tables]
    symbols = [int(rng.choice(len(p), p=p)) for p in probabilities]
    code = compress.encode_symbols(symbols, tables)
    bits = -sum(np.log2(p[symbol]) for p, symbol in zip(probabilities, symbols, strict=True))
    assert 0 <= 8 * len(code) - bits <= 9
    assert compress.decode_symbols(code, tables) == symbols


@pytest.mark.parametrize("symbols", [[], [0], [65535, 0, 65535], [65535] * 4])
def test_extreme_symbols(symbols):
    tables = [compress.UNIFORM] * len(symbols)
    assert compress.decode_symbols(compress.encode_symbols(symbols, tables), tables) == symbols


def test_ssim_of_equal_and_of_unlike_images(rng):
    image = rng.integers(0, 255, (40, 50, 3)).astype(np.uint8)
    assert compress.ssim_map(image, image) == pytest.approx(1.0)
    assert abs(compress.ssim_map(image, 255 - image).mean()) < 1.0
    assert compress.ssim_map(image, 255 - image).mean() < 0.0


def test_only_the_mesh_counts(rng):
    crop = rng.integers(0, 255, (40, 50, 3)).astype(np.uint8)
    inside = np.zeros((40, 50), bool)
    inside[10:30, 10:40] = True
    other = crop.copy()
    other[~inside] = 0
    kept = compress.Target(crop, inside).kept("jpeg", 10, other)
    assert kept.ssim == pytest.approx(1.0)
    other[inside] = crop[inside] ^ 1  # one step of 255 everywhere
    assert compress.Target(crop, inside).kept("jpeg", 10, other).psnr == pytest.approx(20 * np.log10(255))


@pytest.fixture(scope="module")
def request_of(lit):
    return request_of_folders(lit / "data", lit / "test", None, "1m", 60.0)[0]


def test_coordinates_are_decoded_within_half_a_step(request_of, lit):
    codec = compress.Codec(get_trained(request_of, 0).model, 1.0)
    sample = load_folder(lit / "test")[0]
    image, shape = eight_bit(sample), sample.landmarks.points
    own = codec.coordinates_of_shape(shape)
    assert codec.shape_of(own) == pytest.approx(codec.model.shape_model.project(shape), abs=0.3)
    coordinates = np.concatenate([own, codec.coordinates_of_light(image, shape)])
    reach = np.concatenate([np.full(4, np.inf), 5.5 * np.sqrt(np.concatenate(codec.variances))])
    coordinates = np.clip(coordinates, -reach, reach)
    decoded = codec.decode(codec.encode(coordinates))
    assert np.abs(decoded - coordinates).max() <= 0.5 * codec.steps.max() + 1e-9
    assert (np.abs(decoded - coordinates) <= 0.5 * codec.steps + 1e-9).all()


def test_a_small_run(request_of):
    rows = compress.keep_object(request_of, HeldOut(0, "05"))
    assert len(rows) == 2 * len(compress.CODECS) * len(compress.BUDGETS)
    assert all(row["bytes"] <= row["budget"] for row in rows)
    summary = compress.summarise(rows)
    assert summary["images"] == 2
    for found in summary["codecs"].values():
        known = [value for _, value in found["psnr"] if value is not None]
        assert known == sorted(known)  # more bytes are never worse
    (few,) = (row for row in rows if (row["codec"], row["light"], row["budget"]) == ("liaam", "1m", 64))
    assert few["psnr"] > 20.0
    header, body = compress.table(summary)
    assert {len(line) for line in body} == {len(header)}
    assert compress.draw(summary).axes
