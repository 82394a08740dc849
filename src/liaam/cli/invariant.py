"""The commands ``liaam camera invariant`` and ``register``: what a camera's angle is used for, without a model."""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from liaam.cli.camera import Pictures, degrees
from liaam.cli.inputs import camera_for, refuse_inputs, unique_stems
from liaam.cli.terminal import complain, progress_bar, say, show_table, table_of
from liaam.errors import LiaamError
from liaam.io import atomic_path, make_folder, read_image, write_image, write_text_atomically
from liaam.io.atomic import check_output

KnownCamera = Annotated[
    str | None,
    typer.Option(
        "--camera",
        help="A camera file; or the response alone: srgb (default), linear, or a gamma; or the angle theta alone, in "
        "degrees from 60 to 180 (122 for an unknown camera).",
    ),
]
BLOCK = 2  # pixels: comparisons average so many across, against noise and rounding


def invariant(
    images: Pictures,
    given_camera: KnownCamera = None,
    sweep: Annotated[
        bool, typer.Option("--sweep", help="Also draw invariant images over theta, and the entropy curve.")
    ] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Also compare the images, which must be registered and of one size.")
    ] = False,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("liaam-invariant"),
) -> None:
    """Write the invariant image of each image: .png for viewing, .tif (float) and .npy for computing."""
    from liaam.calibration import agreement, averaged
    from liaam.photometry import invariant_image
    from liaam.plotting import save_figure
    from liaam.plotting.photometry import figure_of_agreement, figure_of_sweep, invariant_picture

    camera = camera_for(images, given_camera)
    pictures = [read_image(path) for path in images]
    # Fail before writing anything if the images cannot be compared.
    averages = None
    if compare:
        averages = averaged(pictures, camera, block=BLOCK, names=[path.name for path in images])
    make_folder(output)
    stems = unique_stems(images)
    with progress_bar() as progress:
        for i, (path, stem, pixels) in enumerate(zip(images, stems, pictures, strict=True)):
            progress(i, len(images), path.name)
            values = invariant_image(pixels, camera, name=path.name)
            seen = float(np.isfinite(values).mean())
            if seen < 0.1:
                complain(f"{path.name}: {1 - seen:.0%} of the pixels are dark or saturated and have no invariant")
            write_image(output / f"{stem}_invariant.png", invariant_picture(values))
            write_image(output / f"{stem}_invariant.tif", values)
            with atomic_path(output / f"{stem}_invariant.npy") as temporary, temporary.open("wb") as file:
                np.save(file, values, allow_pickle=False)
            if sweep:
                save_figure(figure_of_sweep(pixels, camera), output / f"{stem}_sweep.png")
    if averages is not None:
        pairs = agreement(averages)
        names = [path.name for path in images]
        lines = ["first,second,invariant,log_grey,share"]
        table = table_of("first", "second", "invariant", "log grey", "fraction of pixels")
        for pair in pairs:
            both = names[pair.first], names[pair.second]
            lines.append(f"{both[0]},{both[1]},{pair.invariant:.6f},{pair.log_grey:.6f},{pair.share:.6f}")
            table.add_row(*both, f"{pair.invariant:.3f}", f"{pair.log_grey:.3f}", f"{pair.share:.2f}")
        write_text_atomically(output / "agreement.csv", "\n".join(lines) + "\n")
        save_figure(figure_of_agreement(pictures, names, averages, pairs), output / "agreement.png")
        if len(pairs) <= 15:
            show_table(table)
        medians = (np.median([getattr(pair, key) for pair in pairs]) for key in ("invariant", "log_grey"))
        say("median correlation: invariant {:.3f}, log grey {:.3f}".format(*medians))
    say(f"written to {output}, at theta {degrees(camera.theta)}")


def register(
    first: Annotated[Path, typer.Argument(metavar="A", help="Reference image.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Image to align with A.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Image to write. By default B_registered.png.")
    ] = None,
    warp: Annotated[str, typer.Option(help="homography, affine, similarity or translation.")] = "homography",
    given_camera: KnownCamera = None,
) -> None:
    """Align two images of a flat or distant scene, even under different lights."""
    from liaam.plotting.photometry import checkerboard
    from liaam.registration import register as align

    output = output or Path(f"{second.stem}_registered.png")
    check_output(output)
    board, facts_file = (output.with_name(f"{output.stem}_{name}") for name in ("check.png", "homography.json"))
    refuse_inputs([output, board], [first, second])
    camera = camera_for([first, second], given_camera)
    a = read_image(first)
    b = read_image(second)
    with progress_bar() as progress:
        progress(0, 2, f"registering {second.name}")
        registration = align(a, b, group=warp, response=camera.response, theta=camera.theta)
        if not registration.status.ok:
            raise LiaamError(
                f"{second.name} could not be registered with {first.name} ({registration.status}): "
                f"{registration.message}"
            )
        progress(1, 2, f"writing {output.name}")
        sampled, _ = registration.warp(b)
        write_image(output, sampled)
        write_image(board, checkerboard(a, sampled))
        facts = {"first": first.name, "second": second.name, **registration.to_dict()}
        write_text_atomically(facts_file, json.dumps(facts, indent=1) + "\n")
    say(f"{registration.status}: {registration.message}")
    say(f"written to {output}, {facts_file.name} (pixels of A to pixels of B) and {board.name}")
