"""What a model file holds: its versions, the names of its tensors, and limits on its numbers."""

from liaam.photometry.features import LARGEST

# Versions of the format, increased when its meaning changes
SCHEMA_VERSION = 5  # Of a model of one shape
OF_SHAPES = 6  # Of a model of several shapes
OF_MIRRORED = 7  # Of a model with shapes that are stored as mirror images of others
# Versions that are read. Version 4 has the appearances of all methods, modes in single precision.
READABLE = (4, 5, 6, 7)
# Key of a shape's header that is the mirror image of the shape before: the index of each landmark's mirror image
MIRRORED = "mirrored"
MOST_SHAPES = 4  # Largest number of shapes of a model
MAX_DIAGONAL = 2000.0  # Largest diagonal of a reference frame, pixels
MAX_POINTS = 4000  # Largest number of landmarks: the ring around a mesh takes memory that grows with its square
# Largest ratio of a mesh's area to its number of pixels. It exceeds 1 because borders matter in small frames.
ROOMY = 4.0
LONGEST_NAME = 1000  # Largest number of characters of a model's name and the name of a landmark
LONGEST_OF_CARD = 4000  # Largest number of characters of each text of a card
MAX_BLUR = 10.0  # Largest blur of a level, pixels of the reference frame
MAX_LEVELS = 10  # Largest number of levels of a view
MAX_LIGHTS = 100  # Largest number of modes of a light basis
MAX_IMAGES = 10**9  # Largest number of training images and copies
# Limits on numbers of files, so that no result overflows. What training finds is stated for the faces of liaam.
# Largest magnitude of a channel, as of a function's (LARGEST); those of faces are below 4.
MAX_VALUE = LARGEST
MAX_LOG_LIGHT = 20.0  # Largest logarithm of a ratio of lights; those of faces are below 1.2
MAX_VARIANCE = MAX_DIAGONAL**2  # Largest variance of a landmark, square pixels of the frame; of faces 31
MAX_FACTOR = 1e6  # Largest factor on the variances of a fit (faces: 2.2), odds (9), and magnitude of their weights (34)
MAX_SCALE = 100.0  # Largest factor on the errors of a landmark; training finds at most 3.2
LEAST_UNIT = 1e-12  # Least variance of a residual at weight 1; of faces 0.35
LARGEST_UNIT = 1e12  # Largest one
MOST_EXPANSION = 2.0  # Largest factor on the distance of a shape from the mean
LEAST_FREEDOM = 1.0  # Least degrees of freedom: with fewer, shapes have no mean
LARGEST_FILTER = 100  # Largest height and width of the search's filter, pixels
# Smallest fraction of the pixels that a file stores. The others take memory that its size does not suggest.
LEAST_SHARE = 0.1
# Tensors of each part of a model: a light basis, a map from another landmarker's points, a function's channels, and
# those of a view. Those of appearances and of the modes of light are in functions below.
STORED = {
    "light": ("mean", "remainder"),
    "points": ("weights", "errors", "noise"),
    "features": ("mean", "projection"),
    "regressor": ("spacings", "weights", "offsets", "variances", "errors", "noise"),
    "shape": ("modes", "eigenvalues", "unexplained"),
    "reliability": (
        "landmarks",
        "bias",
        "unit",
        "weights",
        "variance_factor",
        "typical",
        "prior",
        "final_prior",
        "expansion",
        "scales",
    ),
    "presence": ("usual", "other", "variances", "contrasts", "spreads"),
}
RELIEF_STEPS = 127  # Stored value of a component of 1 of a relief's normal
MOST_POSES = 100  # Largest number of shapes that fits start from
MOST_STEPS = 10  # Largest number of steps of a regressor
# Limits on the blur of what a refiner sees, pixels of an object with a diagonal of 120, and that of older files
LEAST_SHARPNESS = 0.25
MOST_SHARPNESS = 4.0
OLDER_SHARPNESS = 1.0
MOST_WEIGHT = 1e6  # Largest weight of another landmarker's point
# How objects are turned in training images: about upright, or in any direction
UPRIGHT = "upright"
ALL_ROTATIONS = "all"
ROTATIONS = (UPRIGHT, ALL_ROTATIONS)
FORMAT = "liaam-aam"  # Format in the headers of model files
LAMPS_FORMAT = "liaam-lamps"  # Format in the headers of lamp files
UNNAMED = "soft-li"  # Method whose calibration is stored without its name


def calibration_of(method: str) -> str:
    """Start of the names of the tensors of a method's calibration."""
    return "reliability" if method == UNNAMED else f"reliability/{method}"


def prefix_of(i: int) -> str:
    """Start of the names of the tensors of the i-th of the other shapes."""
    return f"others/{i}/"
