"""The active appearance model: one frozen object, one safetensors file."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from liaam.errors import ModelFileError
from liaam.io.files import count_of
from liaam.model.card import EMPTY_CARD, ModelCard
from liaam.model.file import read_fields
from liaam.model.file_bytes import file_bytes
from liaam.model.file_format import UPRIGHT
from liaam.model.light_basis import LightBasis
from liaam.model.mesh import ReferenceFrame
from liaam.model.mirror import mirrored_model
from liaam.model.point_map import PointMap
from liaam.model.regressor import LandmarkRegressor
from liaam.model.shape import ShapeModel
from liaam.model.sides import Sides
from liaam.model.views import MESH, Level, View
from liaam.model.warp import PiecewiseAffineWarp
from liaam.models import MODELS, model_file
from liaam.photometry import CameraModel, Response
from liaam.photometry.features import Features
from liaam.scale.lengths import Length


@dataclass(frozen=True, eq=False)
class AAM:
    """An active appearance model.

    Attributes
    ----------
    views : mapping of str to View
        Views by name: ``mesh``, ``surroundings``. ``mesh`` is always present.
    triangles : (t, 3) int32
        The mesh.
    camera : CameraModel
        The training camera.
    n_images : int
        Number of training images.
    contours : tuple of (indices, closed)
        Lines through landmarks, for drawing, and along which landmarks are less certain than across.
    landmark_names : tuple of str
        One name per landmark, or empty.
    name : str
        Description of the training data, for display.
    n_textures : int
        Number of training images and their copies together; 0 in files that lack it.
    n_lamps : int
        Number of lamps under which these copies were relit.
    light : LightBasis, optional
        What other lights do to the object and its surroundings; only of models trained with lamps.
    points : PointMap, optional
        Map from the points of another landmarker to the landmarks, if it was trained.
    regressor : LandmarkRegressor, optional
        Places the landmarks by regression, for fits to weigh in (:mod:`liaam.model.regressor`), if it was trained.
    refiner : LandmarkRegressor, optional
        Moves the landmarks of fits, from where they are, to where they should be (:mod:`liaam.model.regressor`), if it
        was trained.
    relief : (s, s, 2) float32, optional
        Normals of the object's surface, for relighting: their components to the right and down, on the square of
        :mod:`liaam.model.light_basis`. None if the surface is not known.
    features : Features, optional
        What is known of the function whose channels the appearance ``features`` holds. The function itself is given
        with the method (:func:`liaam.fitting.features_method`).
    search_filter : (h, w, 5) float32, optional
        Filter on gradient orientations that responds to the object at the resolution of the search, its centre at that
        of the mean shape (:mod:`liaam.training.search_filter`); of older files (h, w, 2), or None.
    is_colour : bool
        Whether the model was trained on colour images.
    card : ModelCard
        What users should know: data, licence, accuracy, limits, and whom to credit.
    others : tuple of AAM
        Models of further shapes of the object, of which one Gaussian would not do (such as two species). All
        other attributes are those of the model of the most frequent shape; see :attr:`parts`.
    same_images : bool
        Whether the further shapes were learnt from copies of the images of the first, such as turned heads.
    failing_methods : tuple of str
        Methods of which too few fits to left-out images were right to calibrate them: their fits are doubtful.
    n_missing : (n,) int64, optional
        Number of training images in which each landmark was missing, and was estimated from the others; None if none
        was. See :attr:`n_all_missing`.
    scale : Length, optional
        Length of a pixel of the training images, if all have the same.
    in_pieces : bool
        Whether the mesh leaves out triangles that poses of the object turn over, as where legs cross. It may be in
        pieces, each of which has surroundings of its own, and some landmarks may belong to no triangle.
    poses : (k, n, 2) float32, optional
        Shapes of training images from which fits start, aligned to the mean shape, pixels of the reference frame; of
        models whose mesh is in pieces (:mod:`liaam.fitting.search.poses`).
    in_box : (n, 2) float64, optional
        Mean position of each landmark in the box of a training image's landmarks, relative to its centre, in units of
        its width and height: the best guess in a box where a fit fails. Not of objects that are turned in any
        direction; older files have none.
    rotations : {"upright", "all"}
        Whether the objects in the training images are about upright, or turned in any direction: what fits search for
        by default.
    sides : Sides, optional
        The sides of the training images, of which those of one were reflected, so that fits try both; None if the
        objects have one side as far as is known.
    fingerprints : tuple of str
        Those of the files of the training images (:func:`liaam.io.files.fingerprint_of`), sorted, by which
        :func:`liaam.evaluate` knows these; empty in older files, and for images that were given as arrays.
    """

    views: Mapping[str, View]
    triangles: np.ndarray
    camera: CameraModel
    n_images: int
    contours: tuple[tuple[tuple[int, ...], bool], ...] = ()
    landmark_names: tuple[str, ...] = ()
    name: str = ""
    n_textures: int = 0
    n_lamps: int = 0
    light: LightBasis | None = None
    points: PointMap | None = None
    regressor: LandmarkRegressor | None = None
    refiner: LandmarkRegressor | None = None
    relief: np.ndarray | None = None
    features: Features | None = None
    search_filter: np.ndarray | None = None
    is_colour: bool = True
    card: ModelCard = EMPTY_CARD
    others: tuple["AAM", ...] = ()
    same_images: bool = False
    failing_methods: tuple[str, ...] = ()
    n_missing: np.ndarray | None = None
    scale: Length | None = None
    in_pieces: bool = False
    poses: np.ndarray | None = None
    in_box: np.ndarray | None = None
    rotations: str = UPRIGHT
    sides: Sides | None = None
    fingerprints: tuple[str, ...] = ()

    def __getstate__(self) -> dict:
        """Leave out the fitters that :func:`liaam.fit` keeps with a model."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_fitters", "_first", "reflected")}

    def __repr__(self) -> str:
        images = count_of(self.n_all_images, "image")
        shapes = f", {len(self.parts)} shapes" if self.others else ""
        sides = "" if self.sides is None else f", sides {self.sides.own} and {self.sides.other}"
        return f"AAM({self.name!r}, {self.n_points} landmarks{shapes}{sides}, {self.n_pixels} pixels, {images})"

    def with_view(self, name: str, **changes) -> "AAM":
        """Return a copy of the model with some fields of a view changed."""
        return replace(self, views={**self.views, name: replace(self.views[name], **changes)})

    @property
    def calibrated(self) -> bool:
        """Whether training has calibrated the quality and covariances of fits on left-out images."""
        return any(view.reliabilities for view in self.views.values())

    @property
    def parts(self) -> tuple["AAM", ...]:
        """A model for each shape of the object, the most frequent first: in general only this one."""
        return (self._first, *self.others) if self.others else (self,)

    @cached_property
    def _first(self) -> "AAM":
        return replace(self, others=())

    @cached_property
    def reflected(self) -> "AAM":
        """The model of one shape for objects of the other side: its mirror image, with the landmarks in the same order.

        It has no light basis and no regressor.
        """
        return mirrored_model(self, np.arange(self.n_points))

    def part_of(self, shape: np.ndarray) -> int:
        """Return the index of the part under which a shape (n, 2), without missing points, is most likely."""
        if not self.others:
            return 0
        densities = [np.log(part.n_images) + part.shape_model.log_density(shape) for part in self.parts]
        return int(np.argmax(densities))

    @property
    def n_all_images(self) -> int:
        """Number of training images of all shapes."""
        return self.n_images if self.same_images else sum(part.n_images for part in self.parts)

    @property
    def n_all_missing(self) -> np.ndarray:
        """Number of training images of all shapes in which each landmark was missing, (n,) int64."""
        total = np.zeros(self.n_points, np.int64)
        for part in self.parts[:1] if self.same_images else self.parts:
            if part.n_missing is not None:
                total += part.n_missing
        return total

    @property
    def n_copies(self) -> int:
        """Number of mirrored, relit and turned copies of these images, of all shapes; 0 in files that lack it."""
        return sum(max(part.n_textures, part.n_images) for part in self.parts) - self.n_all_images

    @property
    def theta(self) -> float:
        """Angle of the training camera (theta_1 of the paper), radians."""
        return self.camera.theta

    @property
    def response(self) -> Response:
        """Response of the training camera."""
        return self.camera.response

    @property
    def shape_model(self) -> ShapeModel:
        """Shape model of the view ``mesh``."""
        return self.views[MESH].shape_model

    @property
    def warp(self) -> PiecewiseAffineWarp:
        """Warp of the view ``mesh``."""
        return self.views[MESH].warp

    @property
    def frame(self) -> ReferenceFrame:
        """Reference frame of the view ``mesh``."""
        return self.warp.frame

    @property
    def levels(self) -> tuple[Level, ...]:
        """Levels of the view ``mesh``, coarse to fine."""
        return self.views[MESH].levels

    @property
    def n_points(self) -> int:
        """Number of landmarks."""
        return self.shape_model.n_points

    @property
    def n_pixels(self) -> int:
        """Number of pixels of the reference frame inside the mesh."""
        return self.frame.n_pixels

    @property
    def diagonal(self) -> float:
        """Diagonal of the mean shape's bounding box, pixels of the reference frame."""
        return self.shape_model.diagonal

    def save(self, path: str | os.PathLike) -> None:
        """Write the model as one safetensors file, atomically.

        Raises
        ------
        ModelFileError
            If the folder does not exist or cannot be written.
        """
        from liaam.io import write_bytes_atomically

        write_bytes_atomically(path, self.to_bytes(), ModelFileError)

    def to_bytes(self) -> bytes:
        """Return the content of a model file."""
        return file_bytes(self)


def load_model(path: str | os.PathLike) -> AAM:
    """Read and validate a model file. No code in the file is executed.

    Parameters
    ----------
    path : path or "face"
        File, or the name of a model that comes with liaam (:data:`liaam.models.MODELS`). The latter is read once.
        Give a file that has such a name with its folder.

    Raises
    ------
    ModelFileError
        If the file is missing, truncated, inconsistent, of another version, or not a liaam model.

    Examples
    --------
    >>> model = liaam.load_model("face")
    >>> model.landmark_names[:2]
    """
    name = os.fspath(path)
    return _included(name) if name in MODELS else _read(path)


def named_model(model: AAM | str) -> AAM:
    """Return a model, also by the name of one that comes with liaam; what is no text is returned as it is."""
    if isinstance(model, str) and model not in MODELS:
        names = ", ".join(map(repr, MODELS))
        raise ModelFileError(
            f"{model!r} is not a model; give a model first, or the name of one that comes with liaam ({names}); of a "
            "file, give liaam.load_model(path)"
        )
    return _included(model) if isinstance(model, str) and model in MODELS else model  # type: ignore[return-value]


@cache
def _included(name: str) -> AAM:
    return _read(model_file(name))


def _read(path: str | os.PathLike[str]) -> AAM:
    first, others = read_fields(path)
    parts = [AAM(**first)]
    for fields in others:
        parts.append(AAM(**fields) if isinstance(fields, dict) else mirrored_model(parts[-1], fields))
    return replace(parts[0], others=tuple(parts[1:])) if others else parts[0]
