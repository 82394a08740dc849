"""The table of methods: each fitting method is one row of parameters of the common objective (eq 10, generalised).

A model can fit with the methods for whose appearances it was trained.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from liaam.encoding_constants import GRADIENTS
from liaam.errors import MethodError
from liaam.image_reference import CHANNELS
from liaam.model import AAM, MESH, SURROUNDINGS, VIEWS
from liaam.model.appearance import APPEARANCES
from liaam.photometry import CHROMATICITY, ENCODINGS, LUMINANCE
from liaam.photometry.features import WIDEST, Encoder, FeatureFunction, name_of

LOSSES = ("huber", "l1", "cauchy", "geman-mcclure", "tukey", "learnt")
"""Robust losses as weights of iteratively reweighted least squares, in the order of the core's. Theobald, Matthews and
Baker, "Evaluating error functions for robust active appearance models", FG 2006 (the paper's [12]), compare them. The
constants of huber, cauchy, geman-mcclure and tukey give the usual efficiency of 95 % for Gaussian residuals; l1 and
learnt have two thirds. ``learnt`` weighs a residual by its density under a Gaussian learnt for each pixel from images
without occlusion."""

METRICS = {
    "luminance": LUMINANCE,
    "rgb": np.eye(3),
    "chromaticity": CHROMATICITY,
    "orientation": np.eye(3)[:2],
    "soft": np.eye(3, 6),
    "invariant": np.zeros((1, 3)),
    "features": np.eye(WIDEST),
}
"""Rows of P by name, (k, channels of the encoding). ``invariant``, and the last row of ``soft``, are L(theta) (eq 8) on
the channels of log RGB. ``features`` has as many rows as the model compares channels."""

INVARIANT_AT = {"invariant": (0, 0), "soft": (2, 2)}
"""Metrics that depend on the angles: the row that holds L(theta), and the first of its three channels."""

GRADIENT_ROWS = 2
"""Number of rows of ``soft`` that are gradients, the first ones; the others are colour."""

ALL_COLOUR = 0.99
"""Share of usable colours around a sample of ``soft`` from which its colour counts, in training and in fits."""

CORRELATED = np.array([8.0, 30.0])
"""Factors on the number of correlated pixels for the model's errors in gradients and in colour: they are patches rather
than grains, and widest in colour."""

FREE_ANGLES = {
    "none": np.zeros((2, 0)),
    "image": np.array([[0.0], [1.0]]),
    "both": np.eye(2),
    "shared": np.array([[1.0], [1.0]]),
}
"""d (theta_1, theta_2) / d (free angles) of each choice of free angles, (2, n_free)."""

ENCODING_OF = {name: name for name in ENCODINGS} | {"varied": "value", "invariant": "log", "features": "features"}
"""Encoding of each appearance; ``features`` is any function of the user."""

OWN_METRICS = tuple(name for name in METRICS if name in ENCODING_OF.values())
"""Encodings that have a metric of their name, which is their only one."""

PROJECTED_APPEARANCES = ("invariant", *GRADIENTS, "features")
"""Appearances that are learnt after the projection, so that P(theta_1) is not applied to them again."""

LEARNT_FROM_RELIT = {"varied", "illumination"}
"""Appearances that are learnt from relit copies of the images."""

BIASES = ("none", "common", "rows")
"""Which channels get a constant: none, all the same one, or each its own."""

WEIGHTS = ("model", "noise", "rows")
"""Whose variances weigh the pixels, in the order of the core's."""

STEPS = ("own", "scored", "expected")
"""Whose gradient the steps use: the image's own, first that and then the model's, or the one that the model expects."""

CHOICES: dict[str, Any] = {
    "encoding": ENCODINGS,
    "appearance": APPEARANCES,
    "metric": METRICS,
    "free_angles": FREE_ANGLES,
    "bias": BIASES,
    "weights": WEIGHTS,
    "step": STEPS,
    "view": VIEWS,
    "loss": ("squares", *LOSSES),
}
"""What the fields of a method may be; ``encoding`` may also be a function."""


@dataclass(frozen=True)
class Method:
    """A fitting method: how the difference between model and image is measured.

    The residual of a pixel is ``P(theta_2) E(I(W(x; p))) - P(theta_1) (A0 + sum_i lambda_i A_i)`` minus
    the extra modes, with ``E`` the encoding and ``P`` the metric. With ``E = log`` and ``P = L`` this is eq 10.

    Attributes
    ----------
    name : str
        Name in results and messages. Two rows that differ only in name and summary are equal.
    summary : str
        One-line description.
    encoding : {"value", "log", "orientation", "soft"} or callable
        Encoding of the image, or a function of the user (:func:`liaam.fitting.features_method`).
    appearance : {"value", "log", "orientation", "soft", "invariant", "varied", "features"}
        Which of the model's appearances is fitted.
    metric : {"luminance", "rgb", "chromaticity", "orientation", "soft", "invariant", "features"}
        Rows of P. Only ``invariant`` and the last row of ``soft`` depend on the angles.
    free_angles : {"none", "image", "both", "shared"}
        Which of theta_1 (model) and theta_2 (image) are estimated.
    gain : bool
        Add the mean appearance as a mode (a global gain).
    bias : {"none", "common", "rows"}
        Add a constant, common to all channels or one per row of P.
    illumination : bool
        Add the model's illumination basis (AIA, the paper's [6]).
    normalise : bool
        Bring the image's samples to the mean and standard deviation of the mean appearance
        (photometric normalisation, the paper's [1]).
    weights : {"model", "noise", "rows"}
        "model" uses the model's weights. "noise" uses inverse variances of the residual due to image noise. "rows" does
        so for each row of P, with the variance of the model's errors estimated from the image.
    step : {"own", "scored", "expected"}
        Gradient used in steps (:mod:`liaam.fitting.reference.loop`). "own" is the image's, "expected" the one that the
        model expects, and "scored" the image's first and the expected one at the end.
    loss : str
        "squares", or a robust loss of :data:`liaam.fitting.methods.LOSSES`.
    view : {"mesh", "surroundings"}
        Which of the model's views is fitted (:class:`liaam.model.View`): its shapes, pixels and appearances.
    """

    name: str = field(compare=False)
    summary: str = field(compare=False)
    encoding: Any
    appearance: str
    metric: str
    free_angles: str = "none"
    gain: bool = False
    bias: str = "none"
    illumination: bool = False
    normalise: bool = False
    weights: str = "model"
    step: str = "own"
    loss: str = "squares"
    view: str = MESH

    def __post_init__(self) -> None:
        """Raise an error if a value is unknown, or if some do not go together."""
        for name, choices in CHOICES.items():
            value = getattr(self, name)
            if not callable(value) and value not in choices:
                raise MethodError(f"unknown {name} {value!r}; choose from {', '.join(choices)}")
        conflict = self._metric_conflict() or self._encoding_conflict() or self._appearance_conflict()
        if conflict is not None:
            raise MethodError(f"method {self.name}: {conflict}")

    def _metric_conflict(self) -> str | None:
        """Describe what the metric cannot show; None if there is no conflict."""
        if self.metric not in INVARIANT_AT and self.free_angles != "none":
            return f"metric {self.metric} has no angle to free"
        # L . 1 = 0 (and C . 1 = 0): a constant common to all log channels is a null vector.
        if self.needs_colour and self.bias == "common":
            return f"a common bias is invisible to metric {self.metric}"
        if self.gain and self.metric == "invariant":
            return "a gain on logarithms does not model any change of light"
        return None

    def _encoding_conflict(self) -> str | None:
        """Describe what is for another encoding, or for other weights; None if there is no conflict."""
        encoding = self.encoding_name
        if ENCODING_OF[self.appearance] != encoding:
            return f"{encoding} images do not suit a {self.appearance} appearance"
        for name in OWN_METRICS:
            if (self.metric == name) != (encoding == name):
                return f"metric {self.metric} does not suit encoding {encoding}"
        if self.weights == "rows" and encoding != "soft":
            return "weights by rows are for encoding soft"
        if self.weights == "noise" and encoding != "log":
            return (
                "noise weights are for methods that compare logarithms, whose noise depends on brightness; the noise "
                "of values is uniform"
            )
        if self.weights != "model" and self.loss == "learnt":
            return f"weights by {self.weights} already include the model's errors; leave out 'learnt'"
        if (self.illumination or self.normalise) and encoding != "value":
            return "an illumination basis and normalisation need encoding value"
        return None

    def _appearance_conflict(self) -> str | None:
        """Describe what does not suit an appearance that was projected before it was learnt; None if all does."""
        if self.appearance == "invariant" and self.metric != "invariant":
            return "the invariant appearance needs the invariant metric"
        if self.appearance in ("invariant", "soft") and self.free_angles in ("both", "shared"):
            return "theta_1 is fixed by an appearance projected before the PCA"
        return None

    @property
    def encoding_name(self) -> str:
        """Name of the encoding; ``features`` for a function of the user."""
        return "features" if callable(self.encoding) else self.encoding

    @property
    def needs_colour(self) -> bool:
        """Whether the method cannot use grey images."""
        return self.metric in ("invariant", "chromaticity")

    @property
    def n_rows(self) -> int:
        """Number of rows of P, k."""
        return len(self._rows)

    @property
    def _rows(self) -> np.ndarray:
        """Rows of P, (k, channels of the encoding); those of L(theta) are 0."""
        if isinstance(self.encoding, Encoder):
            return np.eye(self.encoding.width)
        return METRICS[self.metric]

    @property
    def reweighs(self) -> bool:
        """Whether weights are updated between iterations."""
        return self.weighs_noise or self.normalise or self.loss != "squares"

    @property
    def weighs_noise(self) -> bool:
        """Whether the weights depend on the image's noise."""
        return self.weights != "model"

    @property
    def solves_angle(self) -> bool:
        """Whether theta_2 and lambda have a joint closed-form optimum (:mod:`liaam.fitting.loop.angles`)."""
        return self.metric == "invariant"

    @property
    def expects(self) -> bool:
        """Whether any steps use the gradient that the model expects."""
        return self.step != "own"

    @property
    def has_angles(self) -> bool:
        """Whether the metric depends on the cameras' angles."""
        return self.metric in INVARIANT_AT

    @property
    def angle_directions(self) -> np.ndarray:
        """Derivatives of (theta_1, theta_2) by the free angles, (2, n_free)."""
        return FREE_ANGLES[self.free_angles]

    @property
    def metric_parts(self) -> np.ndarray:
        """Parts of P(theta_2) = parts[0] + cos(theta_2) parts[1] + sin(theta_2) parts[2], (3, k, 8) float64.

        Encoded images have eight channels; the last one is the weight.
        """
        rows = self._rows
        parts = np.zeros((3, len(rows), CHANNELS))
        parts[0, :, : rows.shape[1]] = rows
        if self.has_angles:
            row, first = INVARIANT_AT[self.metric]
            # L(theta) = (cos, sin, -cos - sin), on three channels
            parts[0, row] = 0.0
            parts[1, row, first : first + 3] = (1.0, 0.0, -1.0)
            parts[2, row, first : first + 3] = (0.0, 1.0, -1.0)
        return parts

    @property
    def model_metric_parts(self) -> np.ndarray:
        """The same for P(theta_1), on the channels of the appearance, (3, k, c) float64.

        It is the identity for an appearance that was projected before it was learnt.
        """
        if self.appearance in PROJECTED_APPEARANCES:
            parts = np.zeros((3, self.n_rows, self.n_rows))
            parts[0] = np.eye(self.n_rows)
            return parts
        return self.metric_parts[:, :, : self._rows.shape[1]]

    def model_metric(self, theta: float) -> np.ndarray:
        """Return P(theta_1) for the model, (k, channels of the appearance)."""
        return at_angle(self.model_metric_parts, theta)

    def image_metric(self, theta: float) -> np.ndarray:
        """Return P(theta_2) for the image, (k, channels of the encoding)."""
        return at_angle(self.metric_parts[:, :, : self._rows.shape[1]], theta)


def at_angle(parts: np.ndarray, theta: float) -> np.ndarray:
    """Combine parts (3, ...) that are constant and multiplied by cos and sin of an angle."""
    factors = np.array([1.0, np.cos(theta), np.sin(theta)], parts.dtype)
    return np.ascontiguousarray(np.tensordot(factors, parts, axes=1))


class MethodTable(dict[str, Method]):
    """Methods by name; printed as a table."""

    def __repr__(self) -> str:
        width = max(map(len, self))
        return "\n".join(f"{name:{width}}  {method.summary}" for name, method in self.items())


_TABLE = (
    Method(
        "soft-li",
        "gradients of log brightness and of the invariant, by estimated variance; the default, for any light",
        encoding="soft",
        appearance="soft",
        metric="soft",
        weights="rows",
        step="expected",
        view=SURROUNDINGS,
    ),
    Method(
        "grey",
        "luminance; drifts when the light changes",
        encoding="value",
        appearance="value",
        metric="luminance",
        gain=True,
        bias="common",
    ),
    Method(
        "rgb",
        "colour values; drifts when the light changes",
        encoding="value",
        appearance="value",
        metric="rgb",
        gain=True,
        bias="common",
    ),
    Method(
        "li",
        "light-invariant projection; estimates the image's angle (paper section 4)",
        encoding="log",
        appearance="log",
        metric="invariant",
        free_angles="image",
        step="scored",
    ),
    Method(
        "li-lit",
        "as li, with an appearance learnt after the projection",
        encoding="log",
        appearance="invariant",
        metric="invariant",
        free_angles="image",
        step="scored",
    ),
    Method(
        "li-pc",
        "as li; estimates the angles of both cameras",
        encoding="log",
        appearance="log",
        metric="invariant",
        free_angles="both",
        step="scored",
    ),
    Method(
        "li-pcs",
        "as li-pc, with one angle for both cameras",
        encoding="log",
        appearance="log",
        metric="invariant",
        free_angles="shared",
        step="scored",
    ),
    Method(
        "chroma",
        "log-chromaticity: invariant to intensity; assumes one colour of light for the whole object",
        encoding="log",
        appearance="log",
        metric="chromaticity",
        bias="rows",
        step="scored",
    ),
    Method(
        "grey-plain",
        "unmodified luminance: even a change of exposure is an error",
        encoding="value",
        appearance="value",
        metric="luminance",
    ),
    Method(
        "grey-norm",
        "luminance normalised to the model's mean and standard deviation (affine photometric normalisation)",
        encoding="value",
        appearance="value",
        metric="luminance",
        normalise=True,
    ),
    Method(
        "varied",
        "as grey, learnt from relit images too (train with --lamps)",
        encoding="value",
        appearance="varied",
        metric="luminance",
        gain=True,
        bias="common",
    ),
    Method(
        "aia",
        "active illumination: as grey, plus an illumination basis (train with --lamps)",
        encoding="value",
        appearance="value",
        metric="luminance",
        gain=True,
        bias="common",
        illumination=True,
    ),
    Method(
        "igo",
        "orientation of the luminance gradient: ignores its magnitude",
        encoding="orientation",
        appearance="orientation",
        metric="orientation",
    ),
)

METHODS = MethodTable((method.name, method) for method in _TABLE)
"""All methods by name, in the order of the table."""


def features_method(function: FeatureFunction, **changes) -> Method:
    """Return a method that compares the channels of a function of the image.

    Parameters
    ----------
    function : callable
        From an image (h, w, 3) float32, sRGB values in [0, 1], to its channels (h, w, c) float. The model must be
        trained with it: ``liaam.train(data, features=function)``.
    **changes
        Fields of :class:`Method`, such as ``loss="huber"``.
    """
    name = name_of(function)
    method = Method(
        name, f"channels of the function {name}", encoding=function, appearance="features", metric="features"
    )
    return replace(method, **changes)


DEFAULT_METHOD = "soft-li"
"""Suits images under any light."""

NOISE_SUFFIX = "noise"


def get_method(method: str | Method) -> Method:
    """Return the method of a name; a :class:`Method` is returned unchanged.

    A name may have suffixes: ``+noise`` weighs pixels by the image's noise, and the name of a loss makes the
    method robust, as in ``li+noise``, ``grey+tukey`` or ``li+noise+huber``.

    Raises
    ------
    MethodError
        If no method or suffix has that name; the message lists those that exist.
    """
    if isinstance(method, Method):
        return method
    if not isinstance(method, str):
        raise MethodError(f"method {method!r} is neither a name nor a Method; choose from {', '.join(METHODS)}")
    method = "+".join(part.strip() for part in method.split("+"))
    base, *suffixes = method.split("+")
    if base not in METHODS:
        raise MethodError(f"unknown method {method!r}; choose from {', '.join(METHODS)} (see 'liaam fit --help')")
    changes: dict[str, str] = {}
    for suffix in suffixes:
        field_name, value = ("weights", "noise") if suffix == NOISE_SUFFIX else ("loss", suffix)
        if field_name in changes or (field_name == "loss" and suffix not in LOSSES):
            raise MethodError(
                f"method {method!r}: the suffix +{suffix} is unknown or repeated; use +{NOISE_SUFFIX} and at most one "
                f"of {', '.join(f'+{name}' for name in LOSSES)}"
            )
        changes[field_name] = value
    return replace(METHODS[base], name=method, **changes) if changes else METHODS[base]


def needed_by(method: Method) -> set[str]:
    """Return the names of the appearances that a method needs at each level of its view."""
    names = {method.appearance}
    if method.illumination:
        names.add("illumination")
    return names


def _missing(model: AAM, method: Method) -> set[str]:
    """Return the names of the appearances that the model lacks."""
    if method.view not in model.views:
        return needed_by(method)
    missing: set[str] = set()
    for level in model.views[method.view].levels:
        missing |= needed_by(method) - set(level.appearances)
    return missing


def methods_of(model: AAM) -> tuple[str, ...]:
    """Return the names of the methods that a model can fit with."""
    return tuple(name for name, method in METHODS.items() if not _missing(model, method))


def check_holds(model: AAM, method: Method) -> None:
    """Raise an error if the model lacks what the method needs."""
    if method.view not in model.views:
        raise MethodError(
            f"method {method.name}: the model has no view {method.view}; train it again, or use method "
            f"'{'li' if model.is_colour else 'grey'}'"
        )
    missing = _missing(model, method)
    if missing & LEARNT_FROM_RELIT and not model.n_lamps:
        raise MethodError(
            f"method {method.name} needs a model trained on relit images; train it with lamps "
            "and at least one copy of each image ('liaam train --lamps', or train(..., lamps=...))"
        )
    if missing:
        raise MethodError(
            f"method {method.name}: the model was trained for {', '.join(methods_of(model)) or 'no method'}; train it "
            f"again with '--methods {method.name.partition('+')[0]}' (train(..., methods=...)), or use one of these"
        )
    levels = model.views[method.view].levels
    if method.loss == "learnt" and any(level.appearances[method.appearance].unexplained is None for level in levels):
        raise MethodError(f"method {method.name}: the model has no variances of its errors; train it again")


def gaussian_median(k: int) -> float:
    """Return the median root mean square of k standard normal variables; 1 / 1.4826 for one."""
    from scipy.special import gammaincinv

    chi_squared_median = 2.0 * gammaincinv(k / 2, 0.5)
    return float((chi_squared_median / k) ** 0.5)
