"""Videos: what is written can be read, and what cannot be read is said."""

import importlib
import itertools
import struct
import threading
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from liaam.errors import LiaamError, VideoError
from liaam.io import VideoReader, VideoWriter, video as io_video, video_writer, write_image
from liaam.io.video import is_video
from liaam.io.video_writer import check_video_name
from setups import open_files

N = 30


def picture(i: int, height: int = 48, width: int = 64) -> np.ndarray:
    """A smooth picture that tells its number by its brightness."""
    y, x = np.mgrid[:height, :width]
    smooth = np.stack([x / width, y / height, 0.5 * np.ones((height, width))], axis=2)
    return np.rint(60 + 4 * i + 60 * smooth).astype(np.uint8)


def write(path: Path, images, rate: float = 25) -> Path:
    with video_writer(path, rate) as writer:
        for image in images:
            writer.write(image)
    return path


def read(path, *arguments) -> list:
    with VideoReader(path, *arguments) as video:
        return list(video)


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("video") / "film.mp4", map(picture, range(N)), Fraction(25))


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".mov", ".avi", ".webm"])
def test_what_is_written_comes_back(tmp_path, suffix):
    path = write(tmp_path / f"film{suffix}", map(picture, range(N)), 12.5)
    with VideoReader(path) as video:
        assert float(video.rate) == pytest.approx(12.5)
        frames = list(video)
        assert video.fault == ""
    assert [frame.index for frame in frames] == list(range(N))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(N) / 12.5, atol=1e-2)
    for i, frame in enumerate(frames):
        assert frame.image.dtype == np.uint8
        assert np.abs(frame.image.astype(int) - picture(i)).mean() < 4


def test_a_file_says_how_long_and_what_it_is(video):
    with VideoReader(video) as reader:
        assert (reader.n_frames, reader.live, reader.name) == (N, False, str(video))


def test_odd_sizes_lose_no_pixel(tmp_path):
    (frame,) = read(write(tmp_path / "odd.mp4", [picture(3, 47, 63)]))
    assert frame.image.shape == (48, 64, 3)
    assert np.abs(frame.image[:47, :63].astype(int) - picture(3, 47, 63)).mean() < 4


def test_frames_of_other_sizes_are_fitted_in(tmp_path):
    frames = read(write(tmp_path / "sizes.mp4", [picture(0), picture(1, 96, 128), picture(2, 24, 32)]))
    assert {frame.image.shape for frame in frames} == {(48, 64, 3)}
    assert np.abs(frames[1].image.astype(int) - picture(1)).mean() < 4


def test_grey_stays_grey(tmp_path):
    grey = [np.repeat(picture(i).mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8) for i in range(4)]
    for frame in read(write(tmp_path / "grey.mp4", grey)):
        assert np.ptp(frame.image.astype(int), axis=2).max() == 0


@pytest.mark.parametrize(
    ("start", "stop", "expected"), [(0, 5, range(5)), (7, 9, (7, 8)), (28, None, (28, 29)), (28, 99, (28, 29))]
)
def test_a_part_of_a_video(video, start, stop, expected):
    with VideoReader(video, start, stop) as reader:
        assert reader.n_frames == len(expected)
        frames = list(reader)
    assert [frame.index for frame in frames] == list(expected)
    assert np.abs(frames[0].image.astype(int) - picture(expected[0])).mean() < 4
    assert reader.fault == ""


@pytest.fixture
def growing(tmp_path) -> Path:
    """A video whose third frame is larger than the others."""
    path, data = tmp_path / "grows.mjpeg", b""
    for i, size in enumerate([(48, 64), (48, 64), (96, 128), (48, 64)]):
        write_image(tmp_path / f"{i}.jpg", picture(i, *size))
        data += (tmp_path / f"{i}.jpg").read_bytes()
    path.write_bytes(data)
    return path


def test_a_video_of_changing_size_is_read(growing):
    assert [frame.image.shape[:2] for frame in read(growing)] == [(48, 64), (48, 64), (96, 128), (48, 64)]


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (48, 64, 3), np.uint8)


def film_of_noise(path: Path, n: int = 60) -> Path:
    """An .mp4 with a keyframe each twelve frames and its index before the pictures, as for the web."""
    import av

    with av.open(str(path), "w", options={"movflags": "faststart"}) as out:
        stream = out.add_stream("mpeg4", rate=25, options={"g": "12"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for i in range(n):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(noise(i), format="rgb24")))
        out.mux(stream.encode())
    return path


def trimmed(source: Path, path: Path, n_hidden: int) -> Path:
    """The same pieces with the first frames hidden by an edit list, as 'ffmpeg -ss … -c copy' does it."""
    import av

    with av.open(str(source)) as video, av.open(str(path), "w", options={"movflags": "faststart"}) as out:
        stream = video.streams.video[0]
        copy, shift = out.add_stream_from_template(stream), int(n_hidden / 25 / stream.time_base)
        for packet in video.demux(stream):
            if packet.dts is not None:
                packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, copy
                out.mux(packet)
    return path


@pytest.mark.parametrize("n_hidden", [8, 15])  # and whole groups of frames before a keyframe are not even read
def test_a_trimmed_video_is_whole(tmp_path, n_hidden):
    with VideoReader(trimmed(film_of_noise(tmp_path / "film.mp4"), tmp_path / "trim.mp4", n_hidden)) as reader:
        announced, frames = reader.n_frames, list(reader)
    assert len(frames) == announced == 60 - n_hidden
    assert (frames[0].time, reader.fault) == (0.0, "")


def test_a_trimmed_video_cut_short_says_so(tmp_path):
    path = trimmed(film_of_noise(tmp_path / "film.mp4"), tmp_path / "trim.mp4", 8)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with VideoReader(path) as reader:
        assert 5 < len(list(reader)) < 52
    assert "cut short" in reader.fault or "damaged" in reader.fault


def test_frames_before_the_start_are_told(video):
    told = []
    with VideoReader(video, 3, 5, lambda *done: told.append(done)) as reader:
        assert [frame.index for frame in reader] == [3, 4]
    assert told == [(n, 3, "skipping frames") for n in (1, 2, 3)]


def test_frames_come_inside_of_a_with_block_only(video):
    complaint = "film.mp4: .* write 'with VideoReader"
    with pytest.raises(VideoError, match=complaint):
        list(VideoReader(video))
    with VideoReader(video) as reader:
        frames = iter(reader)
        next(frames)
    with pytest.raises(VideoError, match=complaint):
        next(frames)


def test_frames_come_once(video):
    with VideoReader(video) as reader:
        assert [frame.index for frame in itertools.islice(reader, 10)] == list(range(10))
        assert [frame.index for frame in itertools.islice(reader, N - 10)] == list(range(10, N))
        assert list(reader) == list(reader) == []
        assert reader.fault == ""


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".mov", ".webm"])
def test_times_come_back(tmp_path, suffix):
    times = np.cumsum([4.0, *(0.04, 0.5, 0.033, 0.011) * 5])  # from a later part of a video, and uneven
    path = tmp_path / f"film{suffix}"
    with video_writer(path, 25) as writer:
        for i, time in enumerate(times):
            writer.write(picture(i), time)
    with VideoReader(path) as reader:
        frames = list(reader)
    assert reader.fault == ""
    np.testing.assert_allclose([frame.time for frame in frames], times - 4.0, atol=2e-3)


def test_times_that_are_missing_or_run_backwards(tmp_path):
    path = tmp_path / "film.mp4"
    with video_writer(path, 25) as writer:
        for i, time in enumerate([None, 7.0, float("nan"), 7.5, 7.5, 3.0, 8.0]):
            writer.write(picture(i), time)
    times = [frame.time for frame in read(path)]
    np.testing.assert_allclose(times, [0, 0.04, 0.08, 0.54, 0.541, 0.542, 1.04], atol=1e-3)


def test_an_avi_keeps_to_its_rate(tmp_path):
    path = tmp_path / "film.avi"
    with video_writer(path, 25) as writer:
        for i, time in enumerate([0.0, 3.0, 3.1]):
            writer.write(picture(i), time)
    np.testing.assert_allclose([frame.time for frame in read(path)], [0, 0.04, 0.08], atol=1e-3)


def test_leaving_early_ends_the_thread(video):
    before = threading.active_count()
    with VideoReader(video) as reader:
        assert next(iter(reader)).index == 0
    assert threading.active_count() == before


# What cannot be read


def test_a_video_cut_short_gives_what_it_has(tmp_path):
    path = write(tmp_path / "film.mkv", map(noise, range(60)))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    frames = read(path)
    assert 5 < len(frames) < 60


def test_a_video_that_announces_more_than_it_has_says_so(tmp_path):
    path = film_of_noise(tmp_path / "fast.mp4")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with VideoReader(path) as reader:
        frames = list(reader)
    assert 5 < len(frames) < 60
    assert "cut short" in reader.fault or "damaged" in reader.fault


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("no.mp4", None, "does not exist"),
        ("empty.mp4", b"", "is empty"),
        ("text.mp4", b"no video at all " * 50, "is not a video"),
        ("text.txt", b"no video at all " * 50, "has no video stream|is not a video"),
        ("zeros.avi", bytes(5000), "is not a video"),
    ],
)
def test_no_video(tmp_path, name, content, complaint):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(VideoError, match=complaint) as error:
        read(tmp_path / name)
    assert name in str(error.value)


def test_an_mp4_without_its_index_is_no_video(tmp_path, video):
    (tmp_path / "cut.mp4").write_bytes(video.read_bytes()[:2000])
    with pytest.raises(VideoError, match="cut short before its index"):
        read(tmp_path / "cut.mp4")


def test_a_folder_without_images_is_no_video(tmp_path):
    (tmp_path / ".1.png").write_bytes(b"hidden")
    with pytest.raises(VideoError, match="is a folder without images; give a video, or a folder of frames"):
        VideoReader(tmp_path)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.bmp", "a.ppm", "a.gif", "a.webp"])
def test_an_image_is_no_video(tmp_path, name):
    Image.fromarray(picture(0)).save(tmp_path / name)
    with pytest.raises(VideoError, match="is an image, not a video: use 'liaam fit', or give a folder of frames"):
        VideoReader(tmp_path / name)


@pytest.mark.parametrize("name", ["a.gif", "a.png"])
def test_an_animation_is_a_video(tmp_path, name):
    first, *others = (Image.fromarray(picture(i)) for i in (0, 9, 18))
    first.save(tmp_path / name, save_all=True, append_images=others, duration=100)
    frames = read(tmp_path / name)
    assert np.abs(frames[2].image.astype(int) - picture(18)).mean() < 4
    np.testing.assert_allclose([frame.time for frame in frames], [0, 0.1, 0.2], atol=1e-6)


def test_a_folder_of_frames_is_read_in_natural_order(tmp_path):
    for i in (0, 1, 2, 10):
        write_image(tmp_path / f"frame{i}.png", picture(i).astype(np.uint16) * 257 if i == 2 else picture(i))
    (tmp_path / "frame3.jpg").write_bytes(b"\xff\xd8\xff and nothing else")
    (tmp_path / "notes.txt").write_text("of frames")
    with VideoReader(tmp_path) as reader:
        assert (reader.n_frames, reader.rate, reader.live) == (5, 25, False)
        frames = list(reader)
    assert "frame3.jpg is damaged or cut short" in reader.fault
    assert [frame.index for frame in frames] == [0, 1, 2, 4]
    assert frames[3].time == pytest.approx(0.16)
    for frame, i in zip(frames, (0, 1, 2, 10), strict=True):
        np.testing.assert_array_equal(frame.image, picture(i))
    assert [frame.index for frame in read(tmp_path, 1, 3)] == [1, 2]
    with pytest.raises(VideoError, match="has only 5 frames, so none from frame 200 on"):
        read(tmp_path, 200)


def test_sound_alone_is_no_video(tmp_path):
    import wave

    with wave.open(str(tmp_path / "sound.wav"), "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(8000)
        sound.writeframes(bytes(8000))
    with pytest.raises(VideoError, match="has no video stream"):
        VideoReader(tmp_path / "sound.wav")


def test_a_video_without_frames_says_so(tmp_path, video):
    """The index is there, and the pictures are zeros."""
    data = bytearray(video.read_bytes())
    begin = data.index(b"mdat") + 4
    end = data.index(b"moov") - 4
    data[begin:end] = bytes(end - begin)
    (tmp_path / "zeros.mp4").write_bytes(data)
    with pytest.raises(VideoError, match="no frame that can be decoded"):
        read(tmp_path / "zeros.mp4")


def test_a_part_that_is_not_there(video):
    with pytest.raises(VideoError, match="has only 30 frames"):
        read(video, 30)
    for start, stop in ((-1, None), (5, 5), (5, 3)):
        with pytest.raises(VideoError, match="later end"):
            VideoReader(video, start, stop)


def test_a_camera_that_is_not_there():
    with pytest.raises(VideoError, match=r"camera 97 cannot be opened .*connect it"):
        VideoReader(97)


def test_without_pyav(monkeypatch, tmp_path, video):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(VideoError, match=r'pip install "\.\[video\]"'):
        VideoReader(video)
    with pytest.raises(VideoError, match=r'pip install "\.\[video\]"'):
        write(tmp_path / "film.mp4", [picture(0)])


def test_no_file_is_left_open(tmp_path, monkeypatch):
    (tmp_path / "text.txt").write_bytes(b"no video at all " * 50)
    film = film_of_noise(tmp_path / "film.mp4", 150)
    small = write(tmp_path / "small.mp4", [picture(0)])
    assert is_video(small) and not is_video(tmp_path / "text.txt")
    assert len(read(film, 110)) == 40
    monkeypatch.setattr(io_video, "MAX_PIXELS", 100)
    assert not is_video(small)
    assert open_files(tmp_path) == []


# What cannot be written


@pytest.mark.parametrize("name", ["film.gif", "film", "film.txt"])
def test_names_that_are_no_videos(tmp_path, name):
    with pytest.raises(VideoError, match="name ends in"):
        write(tmp_path / name, [picture(0)])


def test_no_folder_to_write_to(tmp_path):
    with pytest.raises(VideoError, match="does not exist"):
        write(tmp_path / "none" / "film.mp4", [picture(0)])


def test_nothing_is_left_of_a_video_that_failed(tmp_path):
    with pytest.raises(VideoError, match="no frame to write"):
        write(tmp_path / "film.mp4", [])
    with pytest.raises(LiaamError, match="on purpose"), video_writer(tmp_path / "film.mp4", 25) as writer:
        writer.write(picture(0))
        raise LiaamError("on purpose")
    assert list(tmp_path.iterdir()) == []


def write_long(path: Path, codec: str, options: dict, n: int = 260) -> Path:
    """A film with a key frame now and then, whose frames refer to later ones where the codec can do that."""
    import av

    with av.open(str(path), "w") as out:
        stream = out.add_stream(codec, rate=25, options=options)
        stream.height, stream.width, stream.pix_fmt = 48, 64, "yuv420p"
        for i in range(n):
            image = picture(i % 45)
            image[:24, : 64 * i // n] = 250  # no two frames are alike
            out.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        out.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("film.mp4", "libx264", {"g": "60", "bf": "3"}),
        ("film.mkv", "libx264", {"g": "50", "bf": "2", "x264-params": "open-gop=1"}),
        ("film.webm", "libvpx-vp9", {"g": "40", "deadline": "realtime", "cpu-used": "8"}),
        ("film.avi", "mpeg4", {"g": "30"}),
        ("film.mov", "mpeg4", {"g": "500"}),
    ],
)
def test_a_start_in_the_middle_gives_the_same_frames(tmp_path, name, codec, options):
    path = write_long(tmp_path / name, codec, options)
    whole = read(path)
    for start in (100, 137, 201, 259):
        with VideoReader(path, start, start + 4) as video:
            part = list(video)
            assert video.fault == ""
        assert [frame.index for frame in part] == list(range(start, min(start + 4, 260)))
        for frame in part:
            assert frame.time == pytest.approx(whole[frame.index].time, abs=1e-9)
            np.testing.assert_array_equal(frame.image, whole[frame.index].image)
    with VideoReader(path, 150) as video:
        assert [frame.index for frame in video] == list(range(150, 260))
        assert video.fault == ""
    with pytest.raises(VideoError, match="only 260 frames"):
        read(path, 300)


def test_a_film_cut_short_is_told_from_the_middle_on(tmp_path):
    path = write_long(tmp_path / "film.avi", "mpeg4", {"g": "20", "qscale": "2"})
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    with VideoReader(path, 120) as video:
        indices = [frame.index for frame in video]
    assert indices[0] == 120
    assert "cut short" in video.fault or "damaged" in video.fault


def without_beginning(path: Path, to: Path, first: int) -> Path:
    """Copy a film without its first pieces, as a recorder does that is switched on in the middle."""
    import av

    with av.open(str(path)) as given, av.open(str(to), "w") as out:
        stream = out.add_stream_from_template(given.streams.video[0])
        for i, packet in enumerate(given.demux(given.streams.video[0])):
            if packet.dts is not None and i >= first:
                packet.stream = stream
                out.mux(packet)
    return to


def with_damage(path: Path, to: Path, where: set[int]) -> Path:
    """Copy a film with nonsense for some of its pieces."""
    import av

    with av.open(str(path)) as given, av.open(str(to), "w") as out:
        stream = out.add_stream_from_template(given.streams.video[0])
        for i, packet in enumerate(given.demux(given.streams.video[0])):
            if packet.dts is None:
                continue
            if i in where:
                broken = av.Packet(bytes(40))
                broken.pts, broken.dts, broken.time_base = packet.pts, packet.dts, packet.time_base
                packet = broken
            packet.stream = stream
            out.mux(packet)
    return to


@pytest.mark.parametrize("name", ["cut.ts", "damaged.mp4", "damaged.avi"])
def test_frames_have_one_number_from_wherever_they_are_read(tmp_path, name):
    whole = write_long(tmp_path / "film.mp4", *(("mpeg4", {"g": "25"}) if "avi" in name else ("libx264", {"g": "25"})))
    path = tmp_path / name
    if "cut" in name:
        without_beginning(whole, path, 13)
    else:
        with_damage(whole, path, {40, 77, 160})
    numbered = {frame.index: frame.image for frame in read(path)}
    for start in (100, 137, 201):
        part = read(path, start, start + 5)
        assert len(part) >= 4
        for frame in part:
            np.testing.assert_array_equal(frame.image, numbered[frame.index])


def test_damage_before_the_end_of_a_part_is_told(tmp_path):
    whole = write_long(tmp_path / "film.mp4", "mpeg4", {"g": "25"})
    path = with_damage(whole, tmp_path / "damaged.mp4", {40})
    with VideoReader(path, 0, 60) as video:
        frames = list(video)
    if len(frames) < 60:  # some decoders make something of it
        assert "damaged" in video.fault


def test_words_in_a_video_that_are_no_text_do_not_keep_it_from_being_read(tmp_path):
    path = tmp_path / "x.mp4"
    with video_writer(path) as video:
        for _ in range(2):
            video.write(np.zeros((32, 48, 3), np.uint8))
    data = path.read_bytes()
    assert b"Lavf" in data  # the program that wrote it, which FFmpeg gives as metadata
    path.write_bytes(data.replace(b"Lavf", b"La\x80f"))
    with VideoReader(path) as frames:
        assert len(list(frames)) == 2


def with_header_of(path: Path, width: int, height: int) -> Path:
    """Write an .avi whose header says a size, in a codec that knows of no other."""
    import av

    with av.open(str(path), "w") as out:
        stream = out.add_stream("msvideo1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "rgb555le"
        for i in range(2):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture(i), format="rgb24").reformat(format="rgb555le")))
        out.mux(stream.encode())
    data = bytearray(path.read_bytes())
    struct.pack_into("<ii", data, data.index(b"strf") + 12, width, height)
    struct.pack_into("<ii", data, data.index(b"avih") + 40, width, height)
    path.write_bytes(data)
    return path


def test_a_codec_that_nobody_knows_is_told(tmp_path):
    path = write(tmp_path / "x.mkv", map(picture, range(3)))
    path.write_bytes(path.read_bytes().replace(b"V_MPEG4/ISO/AVC", b"V_MPEG4/ISO/XYZ"))
    with pytest.raises(VideoError, match="codec that FFmpeg does not know"):
        read(path)


@pytest.mark.parametrize("side", [8000, 16_000, 30_000])
def test_frames_of_too_many_pixels_are_refused_before_they_are_decoded(tmp_path, side):
    path = with_header_of(tmp_path / "vast.avi", side, side)
    with pytest.raises(VideoError, match=r"more than 50,000,000 pixels|pixels, more than the 50,000,000 allowed"):
        read(path)


def test_a_frame_that_is_larger_than_the_header_says_is_refused(growing, monkeypatch):
    monkeypatch.setattr(io_video, "MAX_PIXELS", 7000)
    with pytest.raises(VideoError, match="frame 2 has 128 x 96 pixels, more than the 7,000 allowed"):
        read(growing)


def test_the_decoder_refuses_what_is_larger_still(growing, monkeypatch):
    monkeypatch.setattr(io_video, "MAX_PIXELS", 3500)
    with VideoReader(growing) as reader:
        assert {frame.image.shape for frame in reader} == {(48, 64, 3)}
    assert "could not be decoded" in reader.fault


# Cameras


class FakeCapture:
    """Stands for a camera of OpenCV: so many pictures of blue, and then none."""

    def __init__(self, n: int = 5, rate: float = 29.97, is_open: bool = True) -> None:
        self.left, self.rate, self.is_open, self.released = n, rate, is_open, False
        self.asked = None

    def __call__(self, number: int) -> "FakeCapture":
        self.number = number
        return self

    def isOpened(self) -> bool:  # noqa: N802
        return self.is_open

    def get(self, what: int) -> float:
        self.asked = what
        return self.rate

    def read(self) -> tuple[bool, np.ndarray | None]:
        self.left -= 1
        if self.left < 0:
            return False, None
        return True, np.full((4, 6, 3), [200, self.left, 0], np.uint8)

    def release(self) -> None:
        self.released = True


@pytest.fixture
def camera(monkeypatch):
    """Put a camera in OpenCV's place; gives a way to make it."""
    import cv2

    def plug(**options) -> FakeCapture:
        capture = FakeCapture(**options)
        monkeypatch.setattr(cv2, "VideoCapture", capture)
        return capture

    return plug


def test_a_camera_gives_pictures_until_it_is_unplugged(camera):
    import cv2

    capture = camera()
    with VideoReader(91) as video:
        assert (video.name, video.live, video.n_frames) == ("camera 91", True, None)
        assert video.rate == 30
        frames = list(video)
    assert (capture.number, capture.asked, capture.released) == (91, cv2.CAP_PROP_FPS, True)
    assert [frame.index for frame in frames] == list(range(5))
    assert [frame.image[3, 5].tolist() for frame in frames] == [[0, i, 200] for i in (4, 3, 2, 1, 0)]
    times = [frame.time for frame in frames]
    assert times == sorted(times) and times[0] >= 0 and times[-1] < 60
    assert video.fault == "the camera sends no more images; check that it is still connected"


@pytest.mark.parametrize(("told", "rate"), [(0.0, 25), (0.3, 25), (1.4, 1), (59.94, 60), (-1.0, 1)])
def test_the_rate_of_a_camera_that_tells_none_is_assumed(camera, told, rate):
    camera(rate=told)
    assert VideoReader(91).rate == rate


def test_a_part_of_what_a_camera_gives(camera):
    camera(n=9)
    with VideoReader(91, 2, 5) as video:
        assert video.n_frames == 3
        assert [frame.index for frame in video] == [2, 3, 4]
    assert video.fault == ""


def test_a_camera_that_is_not_there_names_those_that_are(camera, monkeypatch):
    capture = camera(is_open=False)
    glob = Path.glob
    for names, words in (
        (["video2", "video0"], r"camera 91 cannot be opened \(available: 0, 2\)"),
        ([], r"camera 91 cannot be opened \(no camera found\)"),
    ):
        there = [Path("/dev") / name for name in names]
        monkeypatch.setattr(Path, "glob", lambda self, what, t=there: t if str(self) == "/dev" else glob(self, what))
        with pytest.raises(VideoError, match=words):
            VideoReader(91)
        assert capture.released


def test_the_log_of_opencv_is_quiet_only_while_a_camera_is_opened(camera):
    import cv2

    log = cv2.utils.logging
    before, seen = log.getLogLevel(), []
    capture = camera(is_open=False)
    capture.get = lambda what: seen.append(log.getLogLevel()) or 25.0
    with pytest.raises(VideoError):
        VideoReader(91)
    assert seen == [log.LOG_LEVEL_SILENT]
    assert log.getLogLevel() == before


# Odds and ends


@pytest.mark.parametrize("angle", [0, 90, -90, 180, 270, 89.7])
def test_pictures_are_upright(video, angle):
    file = io_video._File(video)
    image = picture(0, 4, 6)
    frame = SimpleNamespace(rotation=angle)
    file.reformatter = SimpleNamespace(reformat=lambda frame, format: SimpleNamespace(to_ndarray=lambda: image))
    upright = file._picture(frame)
    file.close()
    np.testing.assert_array_equal(upright, np.rot90(image, round(angle / 90)))
    assert upright.flags.c_contiguous


def test_what_is_a_video_is_told_by_its_beginning(video, tmp_path):
    assert is_video(video)
    (tmp_path / "a.mp4").write_bytes(b"no video at all " * 50)
    assert not is_video(tmp_path / "a.mp4")
    assert not is_video(tmp_path / "none.mp4")


@pytest.mark.parametrize(
    ("name", "codecs", "codec"),
    [("a.mp4", {"libx264", "mpeg4"}, "h264"), ("a.mp4", {"mpeg4"}, "mpeg4"), ("a.webm", {"libvpx-vp9"}, "vp9")],
)
def test_the_first_encoder_that_there_is_is_taken(tmp_path, monkeypatch, name, codecs, codec):
    import av

    monkeypatch.setattr(av, "codecs_available", codecs)
    with av.open(str(write(tmp_path / name, [picture(0)]))) as container:
        assert container.streams.video[0].codec_context.name == codec
        assert container.streams.video[0].codec_context.pix_fmt == "yuv420p"


@pytest.mark.parametrize(("name", "encoder"), [("a.mp4", "libx264"), ("a.webm", "libvpx-vp9")])
def test_a_missing_encoder_is_named(tmp_path, monkeypatch, name, encoder):
    import av

    monkeypatch.setattr(av, "codecs_available", set())
    with pytest.raises(VideoError, match=rf"{name}: this PyAV lacks the encoder {encoder}; install PyAV from PyPI"):
        write(tmp_path / name, [picture(0)])


@pytest.mark.parametrize("rate", [Fraction(30000, 1001), 29.97, 7, 1])
def test_the_rate_comes_back(tmp_path, rate):
    with VideoReader(write(tmp_path / "film.mp4", map(picture, range(5)), rate)) as reader:
        assert float(reader.rate) == pytest.approx(float(rate), rel=1e-4)
        np.testing.assert_allclose([frame.time for frame in reader], np.arange(5) / float(rate), atol=1e-3)


def test_a_name_that_is_no_video_is_told_with_one_that_is():
    check_video_name(Path("film.MP4"))
    with pytest.raises(VideoError) as caught:
        check_video_name(Path("film.gif"))
    assert str(caught.value) == (
        "film.gif: a video's name ends in .mp4, .m4v, .mov, .mkv, .avi, .webm, such as film.mp4"
    )


def test_an_error_while_decoding_comes_out_where_frames_are_taken(video, monkeypatch):
    def broken(self, frame):
        raise MemoryError("full")

    monkeypatch.setattr(io_video._File, "_picture", broken)
    with VideoReader(video) as reader, pytest.raises(MemoryError, match="full"):
        list(reader)


@pytest.mark.parametrize(("height", "width"), [(48, 64), (47, 64), (48, 63), (47, 63)])
def test_a_frame_that_lacks_a_row_or_column_gets_its_neighbour(height, width):
    writer = VideoWriter(None, Path("film.mp4"), Fraction(25))
    writer._size = (48, 64)
    image = picture(0, height, width)
    fitted = writer._fitted(image)
    assert fitted.shape == (48, 64, 3) and fitted.flags.c_contiguous
    np.testing.assert_array_equal(fitted[:height, :width], image)
    np.testing.assert_array_equal(fitted[-1, :width], image[-1])
    np.testing.assert_array_equal(fitted[:height, -1], image[:, -1])


@pytest.mark.parametrize(("height", "width"), [(46, 64), (48, 62), (49, 64), (48, 65), (96, 128)])
def test_a_frame_of_another_size_is_scaled(height, width):
    writer = VideoWriter(None, Path("film.mp4"), Fraction(25))
    writer._size = (48, 64)
    fitted = writer._fitted(picture(0, height, width))
    assert fitted.shape == (48, 64, 3)
    assert np.abs(fitted.astype(int) - picture(0)).max() <= 4


def test_a_file_that_does_not_say_how_long_it_is(tmp_path):
    film = write(tmp_path / "film.mkv", map(picture, range(5)))
    with VideoReader(film) as video:
        assert video.n_frames is None
        assert len(list(video)) == 5
        assert VideoReader(film, 1, 3).n_frames == 2


def test_frames_without_a_time_come_at_the_rate(video):
    file = io_video._File(video)
    file._frames_of = lambda packet: [SimpleNamespace(time=None, width=64, height=48)] if packet.size else []
    times = [time for time, _ in file]
    file.close()
    np.testing.assert_allclose(times, np.arange(N) / 25)


def test_times_that_stand_still_or_run_backwards_go_on_at_the_rate(video):
    file, stamps = io_video._File(video), iter([5.0, 5.5, 5.5, 5.2, 7.0])
    file._frames_of = lambda packet: [
        SimpleNamespace(time=stamp, width=64, height=48) for stamp in itertools.islice(stamps, 1)
    ]
    times = [time for time, _ in file]
    file.close()
    np.testing.assert_allclose(times, [0.0, 0.5, 0.54, 0.58, 2.0])


def test_pieces_that_cannot_be_decoded_are_counted(video):
    file = io_video._File(video)

    def broken() -> None:
        raise file.errors(1, "bad")

    assert file.damage == ""
    assert file._frames_of(SimpleNamespace(decode=broken)) == []
    file._frames_of(SimpleNamespace(decode=broken))
    assert (file.n_damaged, file.n_seen) == (2, 2)
    assert file.damage == f"{video} is damaged: 2 packets could not be decoded and are missing"
    file.close()


def test_a_file_that_cannot_be_read_on_gives_what_comes_before(video, monkeypatch):
    class File(io_video._File):
        def __init__(self, path: Path):
            super().__init__(path)
            real = self.container

            def demux(stream):
                for i, packet in enumerate(real.demux(stream)):
                    if i == 12:
                        raise self.errors(5, "Input/output error")
                    yield packet

            self.container = SimpleNamespace(demux=demux, close=real.close)

    monkeypatch.setattr(io_video, "_File", File)
    with VideoReader(video) as reader:
        n = len(list(reader))
    assert 0 < n <= 12
    assert reader.fault == (f"{video} is damaged after frame {n} (Input/output error); only earlier frames were read")
