"""What mutation testing is for: the modules, the tests that are theirs, and mutants that no test could notice."""

LANDMARKS = ("tests/io/test_landmarks.py",)
IMAGES = ("tests/io/test_images.py",)

TESTS: dict[str, tuple[str, ...]] = {
    "liaam.io.atomic": ("tests/io/test_atomic.py",),
    "liaam.io.files": ("tests/io/test_io_files.py", *IMAGES, "tests/io/test_raw.py"),
    "liaam.io.images": (*IMAGES, "tests/io/test_raw.py"),
    "liaam.io.raw": ("tests/io/test_raw.py",),
    "liaam.io.results": ("tests/io/test_results.py",),
    "liaam.io.starts": ("tests/io/test_starts.py",),
    "liaam.io.landmarks": LANDMARKS,
    "liaam.io.landmarks.asf": LANDMARKS,
    "liaam.io.landmarks.base": LANDMARKS,
    "liaam.io.landmarks.coco": LANDMARKS,
    "liaam.io.landmarks.contours": LANDMARKS,
    "liaam.io.landmarks.csv_points": LANDMARKS,
    "liaam.io.landmarks.dlib_xml": LANDMARKS,
    "liaam.io.landmarks.ljson": LANDMARKS,
    "liaam.io.landmarks.pts": LANDMARKS,
    "liaam.io.landmarks.reading": LANDMARKS,
    "liaam.io.landmarks.tem": LANDMARKS,
    "liaam.io.landmarks.text": LANDMARKS,
    "liaam.io.landmarks.tps": (*LANDMARKS, "tests/io/test_tps.py"),
    "liaam.io.landmarks.writers": (*LANDMARKS, "tests/io/test_tps.py"),
    "liaam.io.video": ("tests/io/test_video.py",),
    "liaam.model.file": ("tests/model/test_model_file.py",),
    "liaam.io.tensors": ("tests/lamps/test_bank.py",),
    "liaam.lamps.bank": ("tests/lamps/test_bank.py",),
    "liaam.photometry.camera": ("tests/photometry/test_camera.py",),
    "liaam.photometry.response": ("tests/photometry/test_response.py", "tests/photometry/test_camera.py"),
    "liaam.studio.safety": ("tests/studio/test_guard.py",),
    "liaam.studio.uploads": ("tests/studio/test_uploads.py",),
}
"""Tests of each module."""

PARTS: dict[str, tuple[str, ...]] = {"liaam.lamps.bank": ("load_lamps", "_names", "Lamps.save")}
"""Functions that are tried of a module, where that is not all of them."""

EQUIVALENT: tuple[tuple[str, str, str, str], ...] = (
    (
        "liaam.io.files",
        'numbers = ((len(digits), digits) for digits in (word.lstrip("0") for word in words[1::2]))',
        "'0' -> 'XX0'",
        "there is no X among digits",
    ),
    (
        "liaam.io.results",
        'return json.dumps(_plain(content), indent=1, allow_nan=False) + "\\n"',
        "False -> True",
        "_plain has made null of them",
    ),
    ("liaam.io.starts", "read_start(text, Path(), (1, 1))", "1 -> 2", "no size is asked for where there is no file"),
    ("liaam.io.raw", "image = image.reshape(*image.shape[:2], -1)", "1 -> 2", "NumPy takes -2 for -1"),
    ("liaam.io.images", "return _kind_of(data[:16]) is not None", "16 -> 17", "signatures are shorter"),
    ("liaam.io.images", "kind = _kind_of(file.read(16))", "16 -> 17", "signatures are shorter"),
    ("liaam.io.images", "if header.bits <= 8:", "8 -> 9", "no header has 9 to 15 bits"),
    ("liaam.io.images", "bits=16 if deep else 8,", "16 -> 17", "bits are compared with 8 only"),
    (
        "liaam.io.images",
        'bilevel = match is not None and match["kind"] in b"14"',
        "b'14' -> b'XX14'",
        "the kind is a digit",
    ),
    (
        "liaam.io.images",
        'strip = strip.convert("RGBA")',
        "'RGBA' -> 'XXRGBA'",
        "Pillow takes an unknown mode of a palette for RGB, and warns of nothing either",
    ),
    (
        "liaam.io.images",
        'suffix = ".pgm" if array.ndim == 2 else ".ppm"',
        "'.ppm' -> 'XX.ppm'",
        "OpenCV looks at what comes after the dot",
    ),
    (
        "liaam.io.images",
        'suffix = ".pgm" if array.ndim == 2 else ".ppm"',
        "'.pgm' -> 'XX.pgm'",
        "OpenCV looks at what comes after the dot",
    ),
    (
        "liaam.io.landmarks.base",
        "return np.isnan(self.points[:, 0])",
        "0 -> 1",
        "a landmark that lacks one of x and y is refused",
    ),
    (
        "liaam.io.landmarks.text",
        'return len(data.translate(None, bytes(set(range(32)) - set(b"\\t\\n\\f\\r")))) < len(data)',
        r"b'\t\n\x0c\r' -> b'XX\t\n\x0c\r'",
        "X is no control character",
    ),
    (
        "liaam.studio.uploads",
        "upload = Upload(secrets.token_urlsafe(9), name, data, width, height)",
        "9 -> 10",
        "any number of random letters will do",
    ),
    (
        "liaam.photometry.response",
        "for _ in range(2):",
        "2 -> 3",
        "a further step of Newton's changes nothing",
    ),
    (
        "liaam.model.file",
        "if np.abs(modes).max(initial=0.0) > 2.0:",
        "2.0 -> 3.0",
        "what is above 2 has a squared length above 4, which is refused too",
    ),
    (
        "liaam.model.file",
        "if np.abs(modes).max(initial=0.0) > 2.0:",
        "0.0 -> 1.0",
        "no less than 2",
    ),
    (
        "liaam.photometry.camera",
        "light = to_linear(np.minimum(stored, 1.0), self.response) / self.falloff(*image.shape[:2])[..., None]",
        "1.0 -> 1.5",
        "what is above SATURATED stays what it was",
    ),
    (
        "liaam.photometry.camera",
        "corner = max(middle_x**2 + middle_y**2, 1e-12)",
        "1e-12 -> 1.5e-12",
        "it divides 0 only",
    ),
    (
        "liaam.photometry.camera",
        "return falloff_at(np.square(np.linspace(0.0, 1.0, 101)), vignetting)",
        "np.linspace(0.0, 1.0, 101) -> np.linspace(1.0, 0.0, 101)",
        "only the largest and the least are looked at",
    ),
)
"""Module, line without its comment, change, and why no test could tell."""
