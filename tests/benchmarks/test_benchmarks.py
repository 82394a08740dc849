"""Benchmarks use the engine's inside, which no one promises to keep: they have to run at least."""

from itertools import islice

import pytest

from benchmarks import batch, fit, iteration, many, relight, search, track
from experiments.relit import lit_pairs

pytestmark = pytest.mark.slow

SMALL = (160, 120)


def test_the_benchmark_of_an_iteration_runs(monkeypatch, capsys):
    monkeypatch.setattr(iteration, "ROUNDS", 2)
    monkeypatch.setattr(iteration, "WARM_UP", 0)
    iteration.main()
    assert "iteration_ratio" in capsys.readouterr().out


def test_the_benchmark_of_the_search_runs(monkeypatch, capsys):
    monkeypatch.setattr(search, "N_HEADS", 3)
    monkeypatch.setattr(search, "SIZE", SMALL)
    search.main()
    assert "search_found_percent" in capsys.readouterr().out


def test_the_benchmark_of_a_batch_runs(monkeypatch, capsys):
    monkeypatch.setattr(batch, "DISTINCT", 6)
    monkeypatch.setattr(batch, "MEASURES", ((batch.measure_memory, 20),))
    batch.main()
    assert "batch_memory_growth_percent" in capsys.readouterr().out


def test_the_benchmark_of_tracking_runs(head_model, clip, capsys, monkeypatch):
    monkeypatch.setattr(track, "METHODS", ("soft-li",))
    track.measure(head_model, clip, 6)
    out = capsys.readouterr().out
    assert "track_lost 0 of 6" in out
    assert "track_relit_soft-li" in out
    assert "track_flicker" in out


def test_the_benchmark_of_tracking_says_what_it_lacks(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("LIAAM_SHARED_DATA", str(tmp_path))
    track.main()
    assert "left out" in capsys.readouterr().out


def test_the_benchmark_of_many_fits_runs(head_model, moving, monkeypatch, capsys):
    for name, value in {"N_PICTURES": 2, "ROUNDS": 1, "METHODS": ("grey",)}.items():
        monkeypatch.setattr(many, name, value)
    monkeypatch.setattr(many, "make_model", lambda: head_model)
    monkeypatch.setattr(many, "make_set", lambda *_, **__: moving[: many.N_SCENES])
    many.main()
    out = capsys.readouterr().out
    assert "many_grey_rate_2" in out
    assert "many_grey_speedup" in out


def test_the_benchmark_of_relighting_runs(head_model, capsys, monkeypatch):
    monkeypatch.setattr(relight, "PERSONS", (5,))
    monkeypatch.setattr(relight, "train_on_flat_light", lambda _: head_model)
    monkeypatch.setattr(relight, "lit_pairs", lambda head, size=SMALL: islice(lit_pairs(head, size=SMALL), 1))
    relight.main()
    out = capsys.readouterr().out
    assert "relight_flat_error_found" in out
    assert "relight_flat_seam_true" in out
    assert "relight_light_ms" in out


@pytest.mark.parametrize("method", ["li", "soft_li"])
def test_the_benchmark_of_growth_in_modes_runs(monkeypatch, capsys, method):
    monkeypatch.setattr(fit, "MODES", (2, 4))
    monkeypatch.setattr(fit, "MODES_ROUNDS", 1)
    monkeypatch.setattr(fit, "BARS", {method.replace("_", "-"): 1.0})
    fit.measure_modes()
    assert f"modes_exponent_{method}" in capsys.readouterr().out


@pytest.mark.slow
def test_the_benchmark_of_the_first_fit_runs(head_model, moving, monkeypatch, capsys):
    monkeypatch.setattr(fit, "make_model", lambda: head_model)
    monkeypatch.setattr(fit, "make_pictures", lambda: ([], [(moving[0].image, moving[0].landmarks)]))
    fit.measure_start()
    assert "process_s" in capsys.readouterr().out
