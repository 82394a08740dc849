import numpy as np
import pytest

from liaam.io import Contour, Landmarks
from liaam.studio.refusal import Refusal
from liaam.studio.template import Template, parse_template, template_of


def test_a_template_survives_json():
    template = Template(
        ("a", "b", "c"), (Contour((0, 1, 2), closed=True),), (1, 0, 2), ((1.0, 2.0), (3.0, 4.5), (0.0, 9.0))
    )
    assert parse_template(template.as_json(), 3) == template
    assert parse_template({"names": [" a ", "b"]}, 3) == Template(("a", "b"))


def test_landmarks_without_sound_names_get_numbers():
    points = np.array([[0, 0], [1, 0], [0.5, 3]])
    for names in ((), ("a", "a", "b"), ("a", " ", "b")):
        assert template_of(Landmarks(points, (), names)).names == ("1", "2", "3")
    assert template_of(Landmarks([[0, 0], [np.nan, np.nan]])).points is None


@pytest.mark.parametrize("data", [None, "names", ["a", "b"], 3])
def test_what_is_no_object_is_refused(data):
    with pytest.raises(Refusal, match="not an object"):
        parse_template(data, 3)
