"""The table of peers: what is there is measured, what is not is said. Peers are no dependency; none is needed here."""

import cv2
import numpy as np
import pytest

from benchmarks import fit, iteration, peer_opencv, peers
from benchmarks.metrics import recording
from benchmarks.peers import MissingError, Peer, PeerRow, floor_bytes, rows_of
from liaam.training import train
from scenes import Head, make_set


def test_a_peer_that_is_not_installed_is_said_with_the_line_that_installs_it(capsys):
    absent = Peer("nobody", ("no_such_module",), "pip install nobody", lambda: pytest.fail("asked for rows"))
    assert rows_of(absent) == []
    assert "nobody: not measured; not installed (pip install nobody)" in capsys.readouterr().out


def test_a_peer_that_cannot_do_it_says_why(capsys):
    def rows():
        raise MissingError("knows only cats")

    assert rows_of(Peer("cats", (), "", rows)) == []
    assert "cats: not measured; knows only cats" in capsys.readouterr().out


def test_a_peer_that_breaks_on_import_is_said_with_the_line_that_mends_it(capsys):
    def rows():
        raise ImportError("cannot import name 'simps'")

    assert rows_of(Peer("old", (), "pip install 'scipy<1.14'", rows)) == []
    out = capsys.readouterr().out
    assert "cannot import name 'simps'" in out
    assert "pip install 'scipy<1.14'" in out


def test_every_peer_but_ourselves_says_how_to_install_it():
    for peer in peers.PEERS:
        assert bool(peer.modules) == peer.install.startswith("pip install")


def test_photographs_that_are_not_there_are_said(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("LIAAM_SHARED_DATA", str(tmp_path))
    peers.photographs.cache_clear()
    try:
        assert rows_of(Peer("liaam on photographs", (), "", peers.photograph_rows)) == []
    finally:
        peers.photographs.cache_clear()
    assert "not measured; needs photographs" in capsys.readouterr().out


def test_an_iteration_is_the_difference_of_two_fits_by_the_steps_between(monkeypatch):
    times = {"a": np.array([[30.0, 50.0]]), "less a": np.array([[10.0, 10.0]]), "b": np.array([[7.0]])}
    monkeypatch.setattr(peers, "in_turn", lambda blocks, rounds: {name: times[name] for name in blocks})
    rows = [PeerRow("a", "", [print], [print], 10), PeerRow("b", "", [print])]
    measured = peers.measure(rows)
    assert measured["a"].tolist() == [[2.0, 4.0]]
    assert measured["b"].tolist() == [[7.0]]


def test_the_floor_is_that_of_the_readme():
    assert floor_bytes(*iteration.make_fit("li")) == pytest.approx(1.89e6, rel=0.01)
    assert floor_bytes(*iteration.make_fit("soft-li")) == pytest.approx(4.4e6, rel=0.01)


def test_the_table_has_a_metric_for_each_row_and_its_ratio_to_ours(monkeypatch, capsys):
    rows = [
        PeerRow("peers_liaam_li", "ours", [print]),
        PeerRow("peers_cat", "theirs", [print], beside="peers_liaam_li"),
    ]
    lone = [PeerRow("peers_lone", "theirs", [print], beside="peers_not_measured")]
    monkeypatch.setattr(peers, "PEERS", (Peer("x", (), "", lambda: rows), Peer("y", (), "", lambda: lone)))
    times = {"peers_liaam_li": np.array([2.0]), "peers_cat": np.array([5.0]), "peers_lone": np.array([1.0])}
    monkeypatch.setattr(peers, "measure", lambda rows: times)
    with recording() as metrics:
        peers.main()
    assert metrics == {"peers_liaam_li_ms": 2.0, "peers_cat_ms": 5.0, "peers_lone_ms": 1.0, "peers_cat_ratio": 2.5}
    assert "of peers_liaam_li_ms" in capsys.readouterr().out


def test_of_varied_images_the_mean_and_the_slowest_count_too(monkeypatch):
    rows = [PeerRow("peers_wild", "", [print], varied=True)]
    monkeypatch.setattr(peers, "PEERS", (Peer("x", (), "", lambda: rows),))
    times = np.array([[1.0, 2.0, 30.0], [1.0, 4.0, 30.0], [1.0, 3.0, 999.0]])  # of three rounds
    monkeypatch.setattr(peers, "measure", lambda rows: {"peers_wild": times})
    with recording() as metrics:
        peers.main()
    assert metrics == {
        "peers_wild_ms": 3.0,
        "peers_wild_mean_ms": pytest.approx(34.0 / 3, rel=1e-5),
        "peers_wild_most_ms": 30.0,
    }


def test_the_chase_follows_every_node(rng):
    order = peers.chase(rng, 1000)()
    assert sorted(order.tolist()) == list(range(1000))
    assert np.abs(np.diff(order)).mean() > 100  # in random order


@pytest.fixture
def small_heads(monkeypatch):
    """Few heads and a small model, for rows that are only built."""
    monkeypatch.setattr(fit, "N_TRAINING", 5)
    monkeypatch.setattr(fit, "N_PICTURES", 1)
    monkeypatch.setattr(fit, "SIZE", (160, 120))
    monkeypatch.setattr(iteration, "ROUNDS", 1)
    fit.make_pictures.cache_clear()
    fit.make_model.cache_clear()
    yield
    fit.make_pictures.cache_clear()
    fit.make_model.cache_clear()


@pytest.mark.slow
def test_our_own_rows_and_the_floor_can_be_timed(small_heads, monkeypatch, capsys):
    monkeypatch.setattr(peers, "ROUNDS", 1)
    monkeypatch.setattr(peers, "METHODS", ("soft-li",))
    monkeypatch.setattr(peers, "PEERS", peers.PEERS[:2])
    with recording() as metrics:
        peers.main()
    assert set(metrics) == {
        "peers_floor_blas_ms",
        "peers_floor_move_soft_li_ms",
        "peers_floor_move_li_ms",
        "peers_floor_chase_ms",
        "peers_liaam_soft_li_ms",
        "peers_liaam_soft_li_iteration_ms",
        "peers_liaam_soft_li_iteration_ratio",
    }


def test_one_core_is_given_back():
    import os

    before = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    with pytest.raises(RuntimeError, match="broken"), peers.one_core():
        if before is not None:
            assert len(os.sched_getaffinity(0)) == 1
        raise RuntimeError("broken")
    assert before is None or os.sched_getaffinity(0) == before


def test_the_model_file_for_opencv_has_what_opencv_reads(tmp_path):
    pictures = [(scene.image, scene.landmarks) for scene in make_set(5, Head(5), size=(160, 120))]
    model = train(pictures, diagonal=60.0, leave_out=False, lamps=None, methods="grey")
    path = tmp_path / "aam.yaml"
    n_pixels = peer_opencv.write_model(path, model, pictures, 3)
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    n_points, inner = model.shape_model.n_points, file.getNode("scale0_AA").mat()
    shapes = np.hstack([file.getNode("Q").mat(), file.getNode("S").mat()])
    assert inner.shape == (n_pixels, 3)
    np.testing.assert_allclose(inner.T @ inner, np.eye(3), atol=1e-5)
    np.testing.assert_allclose(shapes.T @ shapes, np.eye(shapes.shape[1]), atol=1e-5)
    assert shapes[:n_points, 2] == pytest.approx(n_points**-0.5)  # all x before all y
    assert file.getNode("s0").size() == file.getNode("scale0_base_shape").size() == 2 * n_points
    pixels = file.getNode("scale0_textureIdx")
    assert 3 * pixels.size() == file.getNode("AAM_tri").size()
    assert all(pixels.at(i).size() > 0 for i in range(pixels.size()))
    assert file.getNode("scale0_ind1").size() == file.getNode("scale0_A0").mat().size


def test_a_sliver_without_pixels_is_left_out_for_opencv():
    base = np.array([[2, 2], [12, 2], [2, 12], [2.2, 2.2]], np.float32)
    labels, kept = peer_opencv.triangle_picture(base, np.array([[0, 3, 1], [0, 1, 2]]))
    assert kept.tolist() == [[0, 1, 2]]
    assert set(np.unique(labels)) == {0, 1}


def test_a_texture_is_carried_to_the_frame():
    base = np.array([[2, 2], [22, 2], [2, 22]], np.float32)
    labels, triangles = peer_opencv.triangle_picture(base, np.array([[0, 1, 2]]))
    y, x = np.mgrid[:60, :60]
    ramp = (2 * x + y).astype(np.uint8)
    carried = peer_opencv.carried(ramp, 2.0 * base, base, labels, triangles)
    at = carried[5, 7]  # OpenCV's own way of counting: one column and two rows on in the frame, and back in the picture
    assert at == 2 * (2 * 8 - 1) + (2 * 7 - 2)
