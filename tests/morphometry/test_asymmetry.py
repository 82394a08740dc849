"""Asymmetry: geomorph's numbers, known components and errors, and bad input."""

from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from geomorph_results import MATCHING, OBJECT, Printed, read_set, read_shapes
from liaam.morphometry.superimposition import superimpose
from liaam.morphometry.symmetry import Asymmetry, matching_asymmetry, object_asymmetry, sums_of_squares

EFFECTS = {"ind": 0, "side": 1, "ind:side": 2, "ind:side:replicate": 3, "Total": 4}
COLUMNS = {"Df": "df", "SS": "SS", "MS": "MS", "Rsq": "R2", "F": "F"}


def analysed(geomorph: Path, name: str, **options) -> Asymmetry:
    shapes, twins = read_set(geomorph, name)
    if name in MATCHING:
        return matching_asymmetry(shapes, **options)
    return object_asymmetry(shapes, twins, **options)


def rounded_as(value: float, text: str) -> str:
    """Round a number to the digits of a text."""
    exponent = int(Decimal(text).as_tuple().exponent)
    return f"{Decimal(float(value)).quantize(Decimal(1).scaleb(exponent))}"


@pytest.mark.parametrize("name", [*MATCHING, *OBJECT])
def test_anova_of_shape_is_geomorphs_in_all_digits(geomorph, name) -> None:
    printed = Printed.read(geomorph / f"{name}.txt", "shape")
    found = analysed(geomorph, name, permutations=0).shape_anova
    compared = 0
    for effect, cells in printed.cells.items():
        for title in COLUMNS.keys() & cells.keys():
            text = cells[title]
            assert rounded_as(found[COLUMNS[title]][EFFECTS[effect]], text) == f"{Decimal(text):f}", (effect, title)
            compared += 1
    assert compared == 4 * 4 + 2 + 3


def test_anova_of_size_is_geomorphs(geomorph) -> None:
    printed = Printed.read(geomorph / "matching.txt", "centroid size")
    found = analysed(geomorph, "matching", permutations=0).size_anova
    for effect, cells in printed.cells.items():
        for title in COLUMNS.keys() & cells.keys():
            # geomorph 4.0.8 prints F of individuals and sides over the error, but computes P over the interaction.
            column = "F_error" if title == "F" else COLUMNS[title]
            assert rounded_as(found[column][EFFECTS[effect]], cells[title]) == cells[title], (effect, title)


def test_anova_of_sizes_that_are_nearly_1_is_geomorphs_but_for_its_rounding(geomorph) -> None:
    # geomorph subtracts sums of squares near 40, whose last place is 7e-15, from each other.
    printed = Printed.read(geomorph / "mosquito.txt", "centroid size")
    found = analysed(geomorph, "mosquito", permutations=0).size_anova
    for effect, cells in printed.cells.items():
        assert found["SS"][EFFECTS[effect]] == pytest.approx(float(cells["SS"]), abs=5 * 7e-15)


@pytest.mark.parametrize("name", [*MATCHING, *OBJECT])
def test_components_are_geomorphs_after_alignment(geomorph, name) -> None:
    found = analysed(geomorph, name, permutations=0)
    shapes = {
        "symmetric": found.symmetric,
        "asymmetric": found.asymmetric,
        "directional": found.directional,
        "fluctuating": found.fluctuating,
    }
    right = {component: read_shapes(geomorph / f"{name}-{component}.csv") for component in shapes}
    left, _, other = np.linalg.svd(
        np.einsum("mki,mkj->ij", found.symmetric, right["symmetric"])
    )  # one rotation for all
    for component, own in shapes.items():
        np.testing.assert_allclose(own @ left @ other, right[component], atol=1e-9, err_msg=component)


@pytest.mark.parametrize("name", [*MATCHING, *OBJECT])
def test_unsigned_index_is_geomorphs(geomorph, name) -> None:
    right = np.loadtxt(geomorph / f"{name}-unsigned-ai.csv", delimiter=",", skiprows=1, usecols=1)
    np.testing.assert_allclose(analysed(geomorph, name, permutations=0).unsigned_index, right, atol=1e-12)


@pytest.mark.parametrize("name", [*MATCHING, *OBJECT])
def test_permutations_of_geomorph_give_its_p(geomorph, name) -> None:
    lines = (geomorph / f"{name}.txt").read_text().split("centroid size")[0].split("Pr(>F)")[1].splitlines()
    right = [float(line.split()[1]) for line in lines if line.startswith(("ind ", "side ", "ind:side "))]
    found = analysed(geomorph, name).shape_anova["P_geomorph"][:3]
    # Both are shares of 1000 orders; their difference has at most this standard deviation.
    deviation = np.sqrt(2 * np.maximum(np.multiply(right, np.subtract(1, right)), 0.003) / 1000)
    assert (np.abs(np.subtract(found, right)) < 4 * deviation).all()


def test_superimposition_is_gpagens(geomorph) -> None:
    shapes, _ = read_set(geomorph, "object")
    fit = superimpose(shapes.reshape(-1, *shapes.shape[-2:]))
    right = read_shapes(geomorph / "object-gpagen.csv")
    left, _, other = np.linalg.svd(np.einsum("mki,mkj->ij", fit.shapes, right))
    np.testing.assert_allclose(fit.shapes @ left @ other, right, atol=1e-9)
    sizes = np.loadtxt(geomorph / "object-csize.csv", delimiter=",", skiprows=1, usecols=1)
    np.testing.assert_allclose(fit.sizes, sizes, rtol=1e-12)


MEAN = np.array([[-30.0, 20], [30, 20], [-40, -25], [40, -25], [0, 45], [0, -50]])
TWINS = [1, 0, 3, 2, 4, 5]


def turned(shapes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Turn, scale and shift each of shapes (..., k, 2) at random."""
    angles = rng.uniform(0, 2 * np.pi, shapes.shape[:-2])
    cosines = np.cos(angles)
    sines = np.sin(angles)
    turn = np.moveaxis(np.array([[cosines, sines], [-sines, cosines]]), (0, 1), (-2, -1))
    size = rng.uniform(0.5, 2, (*angles.shape, 1, 1))
    return size * (shapes @ turn) + rng.normal(0, 100, (*angles.shape, 1, 2))


def test_pose_and_order_of_specimens_do_not_matter(rng) -> None:
    shapes = MEAN + rng.normal(0, 2, (8, 2, 2, 6, 2))
    first = matching_asymmetry(shapes, permutations=0, tolerance=0)
    second = matching_asymmetry(turned(shapes, rng)[::-1], permutations=0, tolerance=0)
    np.testing.assert_allclose(second.distances[::-1], first.distances, rtol=1e-9)
    for title in ("SS", "F", "R2"):
        np.testing.assert_allclose(second.shape_anova[title], first.shape_anova[title], rtol=1e-9)


def test_known_directional_asymmetry_of_objects_is_found(rng) -> None:
    shift = np.zeros((6, 2))
    shift[1] = [3.0, 4.0]  # one landmark of the first pair lies 5 pixels away from where its twin has it
    shapes = turned(MEAN + shift + rng.normal(0, 0.2, (40, 1, 6, 2)), rng)
    found = object_asymmetry(shapes, TWINS, permutations=199)
    size = np.linalg.norm(MEAN + shift - (MEAN + shift).mean(axis=0))
    difference = found.directional[0] - found.directional[1]
    expected = np.sqrt(2) * 5 / size  # of both twins, before it spreads over the others
    assert 0.75 * expected < np.linalg.norm(difference) < expected
    table = found.shape_anova
    assert table["P"][1] == pytest.approx(1 / 200)
    assert table["F"][1] > 100
    assert found.error == "" and np.isnan(table["F"][2]) and np.isnan(table["P"][2])
    np.testing.assert_allclose(
        found.mean[TWINS] @ np.linalg.lstsq(found.mean[TWINS], found.mean)[0], found.mean, atol=1e-7
    )


def test_individuals_that_do_not_differ_are_not_significant_and_those_that_do_are(rng) -> None:
    noise = rng.normal(0, 1, (10, 2, 2, 6, 2))
    found = matching_asymmetry(MEAN + noise, permutations=199).shape_anova
    assert min(found["P"][:3]) > 0.02
    own = rng.normal(0, 5, (10, 1, 1, 6, 2))
    found = matching_asymmetry(MEAN + noise + own, permutations=199).shape_anova
    assert found["P"][0] == pytest.approx(1 / 200)
    assert found["P"][2] > 0.02


def test_seed_decides_the_permutations(rng) -> None:
    shapes = MEAN + rng.normal(0, 1, (6, 2, 2, 6, 2))
    tables = [matching_asymmetry(shapes, permutations=50, seed=seed).shape_anova for seed in (1, 1, 2)]
    assert tables[0]["Z"][:3] == tables[1]["Z"][:3] != tables[2]["Z"][:3]


def with_errors(shapes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Add errors of other sizes in x and y at each landmark; return their covariances, too."""
    deviations = np.linspace(0.5, 2, 12).reshape(6, 2)
    covariances = np.broadcast_to(np.square(deviations)[:, :, None] * np.eye(2), (*shapes.shape, 2))
    return shapes + deviations * rng.normal(size=shapes.shape), covariances


@pytest.mark.parametrize("kind", ["matching", "object"])
def test_error_from_covariances_is_that_of_replicates(kind, rng) -> None:
    n = 150
    own = np.tile(MEAN + rng.normal(0, 1, (n, 1, 6, 2)), (1, 2, 1, 1))
    if kind == "matching":
        shapes, covariances = with_errors(own[:, :, None].repeat(2, axis=2), rng)
        both = matching_asymmetry(shapes, permutations=0)
        one = matching_asymmetry(shapes[:, :, :1], covariances[:, :, :1], permutations=99)
    else:
        shapes, covariances = with_errors(own, rng)
        both = object_asymmetry(shapes, TWINS, permutations=0)
        one = object_asymmetry(shapes[:, :1], TWINS, covariances[:, :1], permutations=99)
    assert (both.error, one.error) == ("replicates", "covariances")
    # A mean square of so many configurations with 8 dimensions has a standard deviation of some percent.
    assert one.shape_anova["MS"][3] == pytest.approx(both.shape_anova["MS"][3], rel=0.15)
    assert np.isnan(one.shape_anova["df"][3])


@pytest.mark.parametrize("kind", ["matching", "object"])
def test_p_of_the_interaction_by_covariances_is_uniform_without_asymmetry(kind, rng) -> None:
    found = []
    for _ in range(40):
        if kind == "matching":
            own = MEAN + rng.normal(0, 3, (6, 1, 1, 6, 2))
            shapes, covariances = with_errors(own.repeat(2, axis=1), rng)
            table = matching_asymmetry(shapes, covariances, permutations=49).shape_anova
        else:
            own = rng.normal(0, 3, (6, 1, 6, 2))
            own = MEAN + own + (own * [-1, 1])[..., TWINS, :]
            shapes, covariances = with_errors(own, rng)
            table = object_asymmetry(shapes, TWINS, covariances, permutations=49).shape_anova
        found.append(table["P"][2])
    assert 0.3 < np.mean(found) < 0.7  # 0.5, with a standard deviation of 0.29 / sqrt(40) = 0.046
    assert np.min(found) < 0.15 and np.max(found) > 0.85


def test_fluctuating_asymmetry_beyond_the_covariances_is_significant(rng) -> None:
    shapes, covariances = with_errors(MEAN + rng.normal(0, 5, (10, 2, 1, 6, 2)), rng)
    found = matching_asymmetry(shapes, covariances, permutations=99)
    assert found.shape_anova["P"][2] == pytest.approx(0.01)
    assert found.shape_anova["F"][2] == pytest.approx(found.shape_anova["MS"][2] / found.shape_anova["MS"][3])


def test_sums_of_squares_add_up(rng) -> None:
    values = rng.normal(1e3, 1, (5, 2, 3, 4))
    total = np.square(values - values.mean(axis=(0, 1, 2))).sum()
    assert sums_of_squares(values).sum() == pytest.approx(total)


def test_identical_specimens_have_a_defined_answer() -> None:
    found = matching_asymmetry(np.tile(MEAN, (3, 2, 2, 1, 1)), permutations=9)
    assert np.abs(found.shape_anova["SS"]).max() < 1e-28
    assert np.abs(found.distances).max() < 1e-14
