"""liaam: light-invariant active appearance models.

Train a deformable model on landmarked colour images taken under one light and fit it to images under any
other. The public names below load on first use, so that ``import liaam`` is quick.
"""

from importlib import import_module

__version__ = "0.1.0"

_HOME = {
    "AAM": "liaam.model",
    "Dataset": "liaam.datasets",
    "FitResult": "liaam.fitting",
    "FitStatus": "liaam.fitting",
    "Fitter": "liaam.fitting",
    "Landmarks": "liaam.io",
    "LiaamError": "liaam.errors",
    "METHODS": "liaam.fitting",
    "Method": "liaam.fitting",
    "Sample": "liaam.datasets",
    "SolverOptions": "liaam.fitting",
    "fit": "liaam.fitting",
    "load_folder": "liaam.datasets",
    "load_model": "liaam.model",
    "read_image": "liaam.io",
    "read_landmarks": "liaam.io",
    "train": "liaam.training",
    "write_image": "liaam.io",
    "write_landmarks": "liaam.io",
}

__all__ = [*sorted(_HOME), "__version__"]  # noqa: PLE0604


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'liaam' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
