"""What training states about the accuracy of fits to left-out images."""

import numpy as np

from liaam.model.shape import ShapeModel
from liaam.training.left_out_fits import LeftOutFit, LeftOutFits

TRIANGLE = np.array([[-10.0, -5.0], [10.0, -5.0], [0.0, 10.0]])


def fit_off_by(error: float, near: bool = True, name: str = "") -> LeftOutFit:
    return LeftOutFit(
        name=name,
        near=near,
        error=error,
        evidence=np.ones(2),
        unit=1.0,
        shapes=ShapeModel(TRIANGLE, np.zeros((0, 6)), np.zeros(0)),
        contours=(),
        truth=TRIANGLE,
        known=np.ones(3, bool),
        p=np.zeros(4),
        covariance=np.eye(4),
    )


def test_the_accuracy_counts_fits_from_near_starts_alone():
    fits = [fit_off_by(0.01), fit_off_by(0.02), fit_off_by(0.2), fit_off_by(0.2, near=False)]
    assert LeftOutFits(fits=fits, n_near=4).describe() == (
        "in left-out images, 2 of 4 fits from starts near the object are right (error at most 3% of the "
        "diagonal of the landmarks' box); the mean error of right fits is 1.5%"
    )


def test_the_accuracy_is_not_stated_where_nothing_was_fitted_or_nothing_was_right():
    assert LeftOutFits().describe() == ""
    none_right = LeftOutFits(fits=[fit_off_by(0.2)], n_near=1).describe()
    assert "0 of 1 fit " in none_right and "mean error" not in none_right


def test_images_whose_fits_are_not_right_are_named_if_they_are_more_than_a_few():
    right = [fit_off_by(0.01)] * 18
    wrong = [fit_off_by(0.04, name="b.png"), fit_off_by(0.2, name="c.png")]
    assert LeftOutFits(fits=right + wrong, n_near=20).describe_faults() == ""
    said = LeftOutFits(fits=[*right, *wrong, wrong[0]], n_near=22, lost=["a.png"]).describe_faults()
    assert said.startswith("4 of 22 fits to left-out images are not right")
    assert "(a.png, b.png, c.png)" in said
