"""What mutation testing is for: the modules, the tests that are theirs, and mutants that no test could notice."""

LANDMARKS = ("tests/io/test_landmarks.py",)
IMAGES = ("tests/io/test_images.py",)

TESTS: dict[str, tuple[str, ...]] = {
    "liaam.io.atomic": ("tests/io/test_atomic.py",),
    "liaam.io.files": ("tests/io/test_files.py",),
    "liaam.io.images": IMAGES,
    "liaam.io.pixels": IMAGES,
    "liaam.io.raw": ("tests/io/test_raw.py",),
    "liaam.io.results": ("tests/io/test_results.py",),
    "liaam.io.starts": ("tests/io/test_starts.py",),
    "liaam.io.landmarks": LANDMARKS,
    "liaam.io.landmarks.asf": LANDMARKS,
    "liaam.io.landmarks.base": LANDMARKS,
    "liaam.io.landmarks.coco": LANDMARKS,
    "liaam.io.landmarks.csv_points": LANDMARKS,
    "liaam.io.landmarks.dlib_xml": LANDMARKS,
    "liaam.io.landmarks.ljson": LANDMARKS,
    "liaam.io.landmarks.pts": LANDMARKS,
    "liaam.io.landmarks.tem": LANDMARKS,
    "liaam.io.video": ("tests/io/test_video.py",),
    "liaam.model.file": ("tests/model/test_model_file.py",),
    "liaam.io.tensors": ("tests/model/test_model_file.py",),
    "liaam.lamps.bank": ("tests/lamps/test_bank.py",),
    "liaam.photometry.camera": ("tests/photometry/test_camera.py",),
    "liaam.photometry.response": ("tests/photometry/test_response.py", "tests/photometry/test_camera.py"),
    "liaam.studio.safety": ("tests/studio/test_guard.py",),
    "liaam.studio.uploads": ("tests/studio/test_uploads.py",),
}
"""Tests of each module."""

PARTS: dict[str, tuple[str, ...]] = {"liaam.lamps.bank": ("load_lamps", "_names", "_are_sound", "Lamps.save")}
"""Functions that are tried of a module, where that is not all of them."""

EQUIVALENT: tuple[tuple[str, str, str, str], ...] = ()
"""Module, line, change, and why nothing differs."""
